"""A series of frames to one file of volumes, which grows while it runs and goes on when ended."""

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
class Asked:
    """What the command line asks for."""

    output: Path
    pages: list[Page]  # frames, in order
    batch: int | None  # frames that are found together
    preview: Path | None  # PNG of the latest frame
    force: bool  # whether a series of other settings may go


def check(
    output: Path, preview: Path | None, pages: list[Page], others: list[Path], force: bool
) -> None:
    """Refuse outputs that cannot be written, before anything is computed for them."""
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


def write(asked: Asked, words: dict[str, Any], opened: Callable[[], Deconvolver]) -> None:
    """Write the volumes that are missing; ``words`` are what they depend on."""
    from clplen.io.results.volume_series import count_complete, series_in
    from clplen.microscopy.series_files import Remarks, SeriesWriter

    about, records = series_in(asked.output)
    count = len(asked.pages)
    go_on = bool(records) and _is_same(asked, about, words, len(records))
    if go_on and count_complete(asked.output) == count and asked.output.exists():
        click.echo(f"{asked.output} is there already, of the same frames and words.")
        return
    series = opened()
    for text in series.checks():
        note(text)
    batch = about["batch"] if go_on else None
    writer = SeriesWriter(asked.output, asked.pages, series, words, batch=batch)
    if writer.done:
        click.echo(f"{asked.output} goes on after {writer.done} of {count} frames.")
    began, remarks, at = time.perf_counter(), Remarks(), writer.done
    with progress_bar(count, "frame") as bar:
        bar.update(at)
        for some in writer:
            for text in remarks.new(some):
                note(text)
            if asked.preview is not None:
                _show(asked.preview, some.frames[-1], series)
            at += len(some.pages)
            update_bar(bar, at, count)
    made, took = count - writer.done, time.perf_counter() - began
    for text in remarks.repeated(made):
        note(text)
    volumes = " x ".join(str(n) for n in series.projector_for(writer.shape).volume_shape)
    click.echo(
        f"{asked.output} holds {count} volumes of {volumes} voxels (z, y, x); {made} made in "
        f"{took:.3g} s, {made / took:.3g} frames a second, {writer.batch} together; residual of "
        f"the last one {writer.file.records[-1]['residual']:.3g}."
    )


def _is_same(asked: Asked, about: dict[str, Any], words: dict[str, Any], there: int) -> bool:
    """Whether what is there is of the same series; what is not goes with --force only."""
    found = about.get("job")
    if not isinstance(found, dict):
        return False
    other = next((name for name in {**words, **found} if words.get(name) != found.get(name)), None)
    if other is None and asked.batch in (None, about.get("batch")):
        return True
    if asked.force:
        return False
    if other is None:
        how = f"{about.get('batch')} frames together, not {asked.batch}"
    elif other == "frames":
        how = "other frames"
    else:
        how = f"{other} = {found.get(other)}, not {words.get(other)}"
    raise click.ClickException(
        f"{asked.output} has {there} volumes made with {how}: name another output, or --force "
        "makes all of them anew."
    )


def _show(preview: Path, frame: Prepared, series: Deconvolver) -> None:
    from clplen.io.formats.picture import write_picture
    from clplen.microscopy.model.images import PointImages
    from clplen.microscopy.series.preview import preview as refocused

    assert isinstance(series.images, PointImages)
    write_picture(preview, refocused(frame.counts, series.images, series.device))
