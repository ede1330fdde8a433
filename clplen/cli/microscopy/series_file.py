"""Deconvolution of a series into one growing file of volumes that an interrupted run resumes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.shared.console import (
    check_output,
    check_suffix,
    note,
    progress_bar,
    update_bar,
)

if TYPE_CHECKING:
    from clplen.microscopy.frames.prepare import Prepared
    from clplen.microscopy.pipeline import Deconvolver
    from clplen.microscopy.series_files import Page


@dataclass(frozen=True)
class SeriesRequest:
    """Output, frames and settings of a series."""

    output: Path
    pages: list[Page]  # frames, in order
    batch: int | None  # number of frames reconstructed together
    preview: Path | None  # PNG of the latest frame
    force: bool  # True to overwrite a series of other settings


def check(
    output: Path, preview: Path | None, pages: list[Page], others: list[Path], force: bool
) -> None:
    """Reject outputs that cannot be written, before any computation."""
    from clplen.files import check_folder
    from clplen.io.store.zarr_files import zarr_package

    check_suffix(output, (".tif", ".tiff", ".zarr"))
    if output.suffix.lower() == ".zarr":
        zarr_package("write .ome.tif")
    read = [*{page.path for page in pages}, *others]
    check_folder(output.parent)
    check_output(output, force, read)
    if preview is not None:
        check_suffix(preview, (".png",))
        check_output(preview, force, read)


def write(
    request: SeriesRequest, settings: dict[str, Any], open_series: Callable[[], Deconvolver]
) -> None:
    """Write the missing volumes, which depend on ``settings``."""
    from clplen.io.results.volume_series import count_complete, series_in
    from clplen.microscopy.series_files import Remarks, SeriesWriter

    output, count = request.output, len(request.pages)
    about, records = series_in(output)
    resumes = bool(records) and _can_resume(request, about, settings, len(records))
    if resumes and count_complete(output) == count and output.exists():
        click.echo(f"{output} is up to date.")
        return
    series = open_series()
    for text in series.checks():
        note(text)
    batch = about["batch"] if resumes else None
    writer = SeriesWriter(output, request.pages, series, settings, batch=batch)
    if writer.done:
        click.echo(f"{output} continues after {writer.done} of {count} frames.")
    start, remarks, done = time.perf_counter(), Remarks(), writer.done
    with progress_bar(count, "frame") as bar:
        bar.update(done)
        for group in writer:
            for text in remarks.new(group):
                note(text)
            if request.preview is not None:
                _write_preview(request.preview, group.frames[-1], series)
            done += len(group.pages)
            update_bar(bar, done, count)
    written, seconds = count - writer.done, time.perf_counter() - start
    for text in remarks.repeated(written):
        note(text)
    volumes = " x ".join(str(n) for n in series.projector_for(writer.shape).volume_shape)
    click.echo(
        f"{output} holds {count} volumes of {volumes} voxels (z, y, x); {written} computed in "
        f"{seconds:.3g} s, {written / seconds:.3g} frames per second in groups of {writer.batch}; "
        f"residual of the last volume {writer.file.records[-1]['residual']:.3g}."
    )


def _can_resume(
    request: SeriesRequest, about: dict[str, Any], settings: dict[str, Any], count: int
) -> bool:
    """Return True if the file has equal settings; raise an error unless --force is set."""
    job = about.get("job")
    if not isinstance(job, dict):
        return False
    names = {**settings, **job}
    changed_key = next((name for name in names if settings.get(name) != job.get(name)), None)
    if changed_key is None and request.batch in (None, about.get("batch")):
        return True
    if request.force:
        return False
    if changed_key is None:
        difference = f"{about.get('batch')} frames together, not {request.batch}"
    elif changed_key == "frames":
        difference = "other frames"
    else:
        difference = f"{changed_key} = {job.get(changed_key)}, not {settings.get(changed_key)}"
    raise click.ClickException(
        f"{request.output} has {count} volumes made with {difference}: choose another output, or "
        "recompute all volumes with --force."
    )


def _write_preview(preview: Path, frame: Prepared, series: Deconvolver) -> None:
    from clplen.io.formats.picture import write_picture
    from clplen.microscopy.model.images import PointImages
    from clplen.microscopy.series.preview import preview as refocused

    assert isinstance(series.images, PointImages)
    write_picture(preview, refocused(frame.counts, series.images, series.device))
