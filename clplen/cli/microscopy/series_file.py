"""A series of frames to one file of volumes, which grows while it runs and goes on when ended."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clplen.cli.microscopy.frames import Page
from clplen.cli.shared.console import (
    check_output,
    check_suffix,
    note,
    progress_bar,
    update_bar,
)

if TYPE_CHECKING:
    from clplen.io.results.volume_series import VolumeSeries
    from clplen.microscopy.frames.prepare import Prepared
    from clplen.microscopy.pipeline import Deconvolver, Values
    from clplen.microscopy.reconstruction.deconvolution import DeconvolutionResult
    from clplen.microscopy.series.starts import Start

_FRAMES = "frames"


@dataclass(frozen=True)
class Asked:
    """What the command line asks for."""

    output: Path
    pages: list[Page]  # frames, in order
    batch: int | None  # frames that are found together
    rolling: int | None  # frames over which the minimum is background
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


def write(
    asked: Asked, shared: dict[str, Any], begin: Start, opened: Callable[[], Deconvolver]
) -> None:
    """Write the volumes that are missing."""
    from clplen.io.results.volume_series import count_whole, series_in

    job = {
        _FRAMES: _digest(asked.pages),
        "count": len(asked.pages),
        **shared,
        "start": begin.words,
        "rolling": asked.rolling,
    }
    about, records = series_in(asked.output)
    job = json.loads(json.dumps(job))
    go_on = bool(records) and _is_same(asked, about, job, len(records))
    if go_on and count_whole(asked.output) == len(asked.pages) and asked.output.exists():
        click.echo(f"{asked.output} is there already, of the same frames and words.")
        return
    series = opened()
    for text in series.checks():
        note(text)
    first = _prepared(series, asked.pages[0])
    shape = first.counts.shape
    batch = about["batch"] if go_on else series.batch(shape)
    file = _file(asked, series, shape, job, batch)
    done = file.open(go_on=go_on)
    if done:
        click.echo(f"{asked.output} goes on after {done} of {len(asked.pages)} frames.")
    began = time.perf_counter()
    _fill(asked, series, file, shape, batch, done)
    file.end()
    made, took = len(asked.pages) - done, time.perf_counter() - began
    volumes = " x ".join(str(n) for n in series.projector_for(shape).volume_shape)
    click.echo(
        f"{asked.output} holds {len(asked.pages)} volumes of {volumes} voxels (z, y, x); {made} "
        f"made in {took:.3g} s, {made / took:.3g} frames a second, {batch} together; residual of "
        f"the last one {file.records[-1]['residual']:.3g}."
    )


def _fill(
    asked: Asked,
    series: Deconvolver,
    file: VolumeSeries,
    shape: tuple[int, ...],
    batch: int,
    done: int,
) -> None:
    """Find the volumes from the one after ``done`` on, and write them batch by batch."""
    seen: deque[tuple[Prepared, Values | None]] = deque()  # of the batch
    notes = _Notes()
    with progress_bar(len(asked.pages), "frame") as bar:
        bar.update(done)

        def read() -> Iterator[tuple[Prepared, Values | None]]:
            for page, (frame, low) in zip(
                asked.pages[done:], _lit(asked, series, done), strict=True
            ):
                if frame.counts.shape != shape:
                    raise click.ClickException(
                        f"{page} has another size than the first frame: a series in one file is of "
                        "one camera."
                    )
                seen.append((frame, low))
                yield frame, low

        before = file.read(done - 1) if done else None
        volumes = series.series(read(), shape, batch, before=before)
        at = done
        while some := list(islice(volumes, min(batch, len(asked.pages) - at))):
            frames = [seen.popleft() for _ in some]
            pages = asked.pages[at : at + len(some)]
            said = [
                notes.add(page, series.diagnose(frame) + series.diagnose(frame, one, low))
                for page, (frame, low), one in zip(pages, frames, some, strict=True)
            ]
            file.append([one.volume for one in some], _records(pages, some, said))
            if asked.preview is not None:
                _show(asked.preview, frames[-1][0], series)
            at += len(some)
            update_bar(bar, at, len(asked.pages))
    notes.tell(len(asked.pages) - done)


def _records(
    pages: list[Page], some: list[DeconvolutionResult], said: list[list[str]]
) -> list[dict[str, Any]]:
    return [
        {
            "name": page.name,
            "residual": float(one.residuals[-1]),
            "iterations": one.iterations,
            "remarks": remarks,
        }
        for page, one, remarks in zip(pages, some, said, strict=True)
    ]


class _Notes:
    """Remarks on frames, each said once with the number of frames that it is of."""

    def __init__(self) -> None:
        self._first: dict[str, Page] = {}
        self._count: dict[str, int] = {}

    def add(self, page: Page, remarks: list[str]) -> list[str]:
        for text in remarks:
            key = "".join(c for c in text if not c.isdigit())
            if key not in self._first:
                self._first[key] = page
                note(f"{page}: {text}")
            self._count[key] = self._count.get(key, 0) + 1
        return remarks

    def tell(self, frames: int) -> None:
        for key, page in self._first.items():
            if self._count[key] > 1:
                note(f"what is said of {page} holds for {self._count[key]} of {frames} frames.")


def _lit(asked: Asked, series: Deconvolver, done: int) -> Iterator[tuple[Prepared, Values | None]]:
    """Frames from ``done`` on, with what of them is background."""
    from clplen.microscopy.pipeline import lowest

    if asked.rolling is None:
        for page in asked.pages[done:]:
            yield _prepared(series, page), None
        return
    start = max(done - asked.rolling // 2, 0)
    pairs = lowest((_prepared(series, page) for page in asked.pages[start:]), asked.rolling)
    yield from islice(pairs, done - start, None)


def _prepared(series: Deconvolver, page: Page) -> Prepared:
    from clplen.files import naming
    from clplen.microscopy.deconvolution_files import read_picture

    picture = read_picture(page.path, page.number)
    with naming(str(page)):
        return series.prepared(picture)


def _file(
    asked: Asked, series: Deconvolver, shape: tuple[int, ...], job: dict[str, Any], batch: int
) -> VolumeSeries:
    from clplen.io.results.volume_series import VolumeSeries

    images, projector = series.images, series.projector_for(shape)
    description = {
        "voxel_um": [round(images.side * 1e6, 9)] * 2,
        "values": "energy of a voxel, photons (counts over the gain) of the frame",
        "degenerate_um": [round(z * 1e6, 9) for z in projector.degenerate],
        "place": series.place(),
        "job": job,
    }
    return VolumeSeries(
        asked.output,
        frames=len(asked.pages),
        shape=projector.volume_shape,
        planes=images.planes,
        voxel=(images.side, images.side),
        description=description,
        batch=batch,
    )


def _is_same(asked: Asked, about: dict[str, Any], job: dict[str, Any], there: int) -> bool:
    """Whether what is there is of the same series; what is not goes with --force only."""
    found = about.get("job")
    if not isinstance(found, dict):
        return False
    other = next((name for name in {**job, **found} if job.get(name) != found.get(name)), None)
    if other is None and asked.batch in (None, about.get("batch")):
        return True
    if asked.force:
        return False
    if other is None:
        how = f"{about.get('batch')} frames together, not {asked.batch}"
    elif other == _FRAMES:
        how = "other frames"
    else:
        how = f"{other} = {found.get(other)}, not {job.get(other)}"
    raise click.ClickException(
        f"{asked.output} has {there} volumes made with {how}: name another output, or --force "
        "makes all of them anew."
    )


def _digest(pages: list[Page]) -> str:
    """Of all frames in their order."""
    from clplen.io.store.digest import digest

    digests = {path: digest(path) for path in {page.path for page in pages}}
    words = [[digests[page.path], page.number] for page in pages]
    return sha256(json.dumps(words).encode()).hexdigest()


def _show(preview: Path, frame: Prepared, series: Deconvolver) -> None:
    from clplen.io.formats.picture import write_picture
    from clplen.microscopy.model.images import PointImages
    from clplen.microscopy.series.preview import preview as refocused

    assert isinstance(series.images, PointImages)
    write_picture(preview, refocused(frame.counts, series.images, series.device))
