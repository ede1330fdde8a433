"""Volumes of a job's frames; point images and matrices are kept from item to item."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from clplen.batch.jobs.items import layout_in
from clplen.batch.jobs.task import Task
from clplen.batch.work.fingerprints import fingerprint
from clplen.batch.work.product_files import SUFFIXES, Product
from clplen.batch.work.resources import Resources
from clplen.cameras.light_field_microscope import Microscope
from clplen.config.setting_tables import take_settings
from clplen.io.results.volume_series import count_complete, series_in
from clplen.io.store.digest import digest
from clplen.lightfield.raw.raw_image import RawImage
from clplen.microscopy.deconvolution_files import read_picture, read_psf, write_result
from clplen.microscopy.pipeline import Deconvolver
from clplen.microscopy.series_files import Page, Remarks, SeriesWriter, pages_of, words_of_series
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings

logger = logging.getLogger(__name__)

Advance = Callable[[int, int], None]


def volume_products(
    task: Task, raw: RawImage | None, resources: Resources, advance: Advance
) -> Iterator[Product]:
    """Yield the volume of a frame or a series in each format."""
    layout = layout_in(task.source.get("layout", {}), task.base)
    table = dict(task.work["deconvolve"])
    path = Path(task.base, task.source["path"]) if task.source["kind"] == "file" else None
    pages = pages_of(path) if path else []
    files = {"psf": str(Path(task.base, table.pop("psf")))}
    files |= {name: layout[name] for name in ("white", "dark") if name in layout}
    how = take_settings(DeconvolutionSettings, table)
    how.require_series(len(pages) > 1, in_turn=False)
    of_lattice = take_settings(LatticeSettings, table, Path(task.base))
    of_lattice.require_no_white("white" in files)
    files |= {} if of_lattice.mask is None else {"mask": str(of_lattice.mask)}
    picture = _frame(pages, raw)
    lattice = of_lattice.of_frame(picture.shape, path or "The frame")
    deconvolver = _cached_deconvolver(
        resources, files, how, force=layout.get("force", False), lattice=lattice
    )
    if len(pages) > 1:
        for name in task.work["formats"]:
            write = partial(_write_series, deconvolver, pages, task.name, advance)
            yield Product(f"volume{SUFFIXES[name]}", write)
        return
    frame = deconvolver.prepared(picture)
    said = deconvolver.checks() + deconvolver.diagnose(frame)
    found = deconvolver(frame, progress=advance)
    said += deconvolver.diagnose(frame, found)
    for text in said:
        logger.warning("%s: %s", task.name, text)
    more = {
        "left_out": frame.left_out,
        "below_0": frame.negative,
        "remarks": said,
        "place": deconvolver.place(),
        "job": {"frame": digest(path) if path else None, "number": None, **deconvolver.words},
    }
    write = partial(write_result, found=found, images=deconvolver.images, more=more, replace=True)
    for name in task.work["formats"]:
        yield Product(f"volume{SUFFIXES[name]}", write)


def _frame(pages: list[Page], raw: RawImage | None) -> Any:
    """The raw frame of an item, of a series the first one."""
    if pages:
        return read_picture(pages[0].path, pages[0].number)
    if raw is None or not isinstance(raw.camera, Microscope):
        raise ValueError(
            "[deconvolve] is of frames of a light-field microscope, and this one is none: give it "
            "a job of its own."
        )
    return raw.to_numpy()


def _write_series(
    deconvolver: Deconvolver, pages: list[Page], name: str, advance: Advance, path: Path
) -> None:
    """Write the volumes of a series to one file; what is there of it is gone on with."""
    how, remarks = deconvolver.how, Remarks()
    words = words_of_series(pages, deconvolver.words, deconvolver.begin.words, how.rolling)
    about, records = series_in(path)
    is_same = about.get("job") == words and how.batch in (None, about.get("batch"))
    if is_same and count_complete(path) == len(pages) and path.exists():
        return
    batch = about["batch"] if is_same and records else None
    writer = SeriesWriter(path, pages, deconvolver, words, batch=batch)
    said, done = deconvolver.checks(), writer.done
    for some in writer:
        done += len(some.pages)
        advance(done, len(pages))
        said += remarks.new(some)
    for text in (*said, *remarks.repeated(len(pages) - writer.done)):
        logger.warning("%s: %s", name, text)


def _cached_deconvolver(
    resources: Resources, files: dict[str, Any], how: DeconvolutionSettings, **more: Any
) -> Deconvolver:
    """That of the item before, where it has the same files and settings."""
    prints = ((name, path, fingerprint(Path(path))) for name, path in files.items())
    key = (how, more, *prints)
    if resources.deconvolver is None or resources.deconvolver[0] != key:
        resources.deconvolver = None  # its matrices go before others come
        images = read_psf(files.pop("psf"))
        made = Deconvolver(
            images, how, device=resources.device, memory=resources.memory // 2, **files, **more
        )
        resources.deconvolver = (key, made)
    return resources.deconvolver[1]
