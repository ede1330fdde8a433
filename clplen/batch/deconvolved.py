"""Volumes behind the frames of a job, with point images and matrices that its items share."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clplen.batch.items import layout_in
from clplen.batch.stamps import stamp
from clplen.batch.task import Task
from clplen.batch.volumes import Deconvolver, How, read_picture, read_psf, write_result
from clplen.batch.workshop import Workshop
from clplen.io.store.digest import digest

if TYPE_CHECKING:
    from clplen.lightfield.raw.raw_image import RawImage

logger = logging.getLogger(__name__)

Written = tuple[str, Callable[[Path], Any]]
Advance = Callable[[int, int], None]


def volumes(
    task: Task, raw: RawImage | None, shop: Workshop, suffixes: dict[str, str], advance: Advance
) -> Iterator[Written]:
    """Names and writers of the volume of a frame.

    Parameters
    ----------
    task : Task
        Its work has [deconvolve].
    raw : RawImage or None
        The frame, if it was simulated.
    shop : Workshop
        Keeps what the next frame needs too.
    suffixes : dict
        Of the formats.
    advance : callable
        (done, all) of the iterations.

    Raises
    ------
    ValueError
        If what was simulated is no frame of a microscope.
    """
    layout = layout_in(task.source.get("layout", {}), task.base)
    table = dict(task.work["deconvolve"])
    path = Path(task.base, task.source["path"]) if task.source["kind"] == "file" else None
    files = {"psf": str(Path(task.base, table.pop("psf")))}
    files |= {name: layout[name] for name in ("white", "dark") if name in layout}
    series = _kept(shop, files, How(**table), force=layout.get("force", False))
    frame = series.prepared(_frame(path, raw))
    said = series.remarks(frame)
    found = series(frame, progress=advance)
    said += series.remarks(frame, found)
    for text in said:
        logger.warning("%s: %s", task.name, text)
    more = {
        "left_out": frame.left_out,
        "below_0": frame.negative,
        "remarks": said,
        "place": series.place(),
        "job": {"frame": digest(path) if path else None, "number": None, **series.words},
    }
    write = partial(write_result, found=found, images=series.images, more=more, replace=True)
    for name in task.work["formats"]:
        yield f"volume{suffixes[name]}", write


def _frame(path: Path | None, raw: RawImage | None) -> Any:
    """The raw frame of an item."""
    if path is not None:
        return read_picture(path)
    if raw is None or raw.camera is None or raw.camera.kind != "microscope":
        raise ValueError(
            "[deconvolve] is of frames of a light-field microscope, and this one is none: give it "
            "a job of its own."
        )
    return raw.to_numpy()


def _kept(shop: Workshop, files: dict[str, str], how: How, *, force: bool = False) -> Deconvolver:
    """That of the item before, where it has the same files and words."""
    key = (how, force, *((name, path, stamp(Path(path))) for name, path in files.items()))
    if shop.deconvolver is None or shop.deconvolver[0] != key:
        shop.deconvolver = None  # its matrices go before others come
        images = read_psf(files.pop("psf"))
        made = Deconvolver(
            images, how, device=shop.device, memory=shop.memory // 2, force=force, **files
        )
        shop.deconvolver = (key, made)
    return shop.deconvolver[1]
