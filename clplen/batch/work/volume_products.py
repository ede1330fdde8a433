"""Volumes from the frames of a job; point images and matrices are reused between items."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from clplen.batch.jobs.items import absolute_layout
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
from clplen.microscopy.series_files import Page, Remarks, SeriesWriter, pages_of, series_provenance
from clplen.microscopy.settings import DeconvolutionSettings, LatticeSettings

logger = logging.getLogger(__name__)

Advance = Callable[[int, int], None]


def volume_products(
    task: Task, raw: RawImage | None, resources: Resources, advance: Advance
) -> Iterator[Product]:
    """Yield the volume of a frame or a series in each format."""
    layout = absolute_layout(task.source.get("layout", {}), task.base)
    table = dict(task.work["deconvolve"])
    path = Path(task.base, task.source["path"]) if task.source["kind"] == "file" else None
    pages = pages_of(path) if path else []
    files = {"psf": str(Path(task.base, table.pop("psf")))}
    files |= {name: layout[name] for name in ("white", "dark") if name in layout}
    settings = take_settings(DeconvolutionSettings, table)
    settings.require_series(len(pages) > 1, in_turn=False)
    lattice_settings = take_settings(LatticeSettings, table, Path(task.base))
    lattice_settings.require_no_white("white" in files)
    files |= {} if lattice_settings.mask is None else {"mask": str(lattice_settings.mask)}
    picture = _frame(pages, raw)
    lattice = lattice_settings.lattice_for(picture.shape, path or "The frame")
    deconvolver = _cached_deconvolver(
        resources, files, settings, force=layout.get("force", False), lattice=lattice
    )
    if len(pages) > 1:
        for name in task.work["formats"]:
            write_series = partial(_write_series, deconvolver, pages, task.name, advance)
            yield Product(f"volume{SUFFIXES[name]}", write_series)
        return
    frame = deconvolver.prepared(picture)
    messages = deconvolver.checks() + deconvolver.diagnose(frame)
    result = deconvolver(frame, progress=advance)
    messages += deconvolver.diagnose(frame, result)
    for text in messages:
        logger.warning("%s: %s", task.name, text)
    more = {
        "left_out": frame.left_out,
        "below_0": frame.negative,
        "remarks": messages,
        "place": deconvolver.voxel_grid(),
        "job": {"frame": digest(path) if path else None, "number": None, **deconvolver.provenance},
    }

    def write(path: Path) -> None:
        write_result(path, result, deconvolver.images, more=more, replace=True)

    for name in task.work["formats"]:
        yield Product(f"volume{SUFFIXES[name]}", write)


def _frame(pages: list[Page], raw: RawImage | None) -> Any:
    """Return the raw frame of an item, or the first frame of a series."""
    if pages:
        return read_picture(pages[0].path, pages[0].number)
    if raw is None or not isinstance(raw.camera, Microscope):
        raise ValueError(
            "[deconvolve] applies to frames of a light-field microscope only: process other light "
            "fields in a separate job."
        )
    return raw.to_numpy()


def _write_series(
    deconvolver: Deconvolver, pages: list[Page], name: str, advance: Advance, path: Path
) -> None:
    """Write the volumes of a series to one file; continue an incomplete file."""
    settings, remarks = deconvolver.how, Remarks()
    start = deconvolver.start.provenance
    job = series_provenance(pages, deconvolver.provenance, start, settings.rolling)
    about, records = series_in(path)
    can_resume = about.get("job") == job and settings.batch in (None, about.get("batch"))
    if can_resume and count_complete(path) == len(pages) and path.exists():
        return
    batch = about["batch"] if can_resume and records else None
    writer = SeriesWriter(path, pages, deconvolver, job, batch=batch)
    messages, done = deconvolver.checks(), writer.done
    for group in writer:
        done += len(group.pages)
        advance(done, len(pages))
        messages += remarks.new(group)
    for text in (*messages, *remarks.repeated(len(pages) - writer.done)):
        logger.warning("%s: %s", name, text)


def _cached_deconvolver(
    resources: Resources, files: dict[str, Any], settings: DeconvolutionSettings, **more: Any
) -> Deconvolver:
    """Return the deconvolver of the previous item if files and settings are equal, else a new."""
    prints = ((name, path, fingerprint(Path(path))) for name, path in files.items())
    key = (settings, more, *prints)
    if resources.deconvolver is None or resources.deconvolver[0] != key:
        resources.deconvolver = None  # frees its matrices first
        images, memory = read_psf(files.pop("psf")), resources.memory // 2
        deconvolver = Deconvolver(
            images, settings, device=resources.device, memory=memory, **files, **more
        )
        resources.deconvolver = (key, deconvolver)
    return resources.deconvolver[1]
