"""Deconvolution of a series of raw frames into one file, batch by batch and resumable."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any

from clplen.errors import ShapeError
from clplen.files import PathLike, naming
from clplen.io.formats.tiff import frames_in
from clplen.io.results.volume_series import VolumeSeries
from clplen.io.store.digest import digest
from clplen.microscopy.deconvolution_files import Values, read_picture, refuse_volume
from clplen.microscopy.frames.prepare import Prepared
from clplen.microscopy.pipeline import Deconvolver, rolling_background


@dataclass(frozen=True)
class Page:
    """A frame: a whole file, or a page of a TIFF."""

    path: Path
    number: int | None = None

    @property
    def name(self) -> str:
        """Name of its volume."""
        return self.path.stem if self.number is None else f"{self.path.stem}_{self.number:04d}"

    def __str__(self) -> str:
        return str(self.path) if self.number is None else f"{self.path}, frame {self.number}"


def pages_of(path: PathLike) -> list[Page]:
    """Return the frames of a file, in order."""
    path = Path(path)
    refuse_volume(path)
    count = frames_in(path)
    return [Page(path)] if count == 1 else [Page(path, number) for number in range(count)]


def series_provenance(
    pages: list[Page], shared: dict[str, Any], start: list[str | float | None], rolling: int | None
) -> dict[str, Any]:
    """Return all inputs that the volumes of a series depend on, after a round trip by JSON."""
    digests = {path: digest(path) for path in {page.path for page in pages}}
    frames = json.dumps([[digests[page.path], page.number] for page in pages])
    inputs = {"frames": sha256(frames.encode()).hexdigest(), "count": len(pages), **shared}
    inputs |= {"start": start, "rolling": rolling}
    record: dict[str, Any] = json.loads(json.dumps(inputs))
    return record


@dataclass(frozen=True)
class Batch:
    """Frames whose volumes are written, with the messages about each frame and volume."""

    pages: list[Page]
    frames: list[Prepared]
    remarks: list[list[str]]


class Remarks:
    """Messages about frames, each reported once and counted over the frames."""

    def __init__(self) -> None:
        self._first: dict[str, Page] = {}
        self._count: dict[str, int] = {}

    def new(self, batch: Batch) -> Iterator[str]:
        """Yield the messages that no earlier frame had."""
        for page, remarks in zip(batch.pages, batch.remarks, strict=True):
            for text in remarks:
                key = "".join(c for c in text if not c.isdigit())
                if key not in self._first:
                    self._first[key] = page
                    yield f"{page}: {text}"
                self._count[key] = self._count.get(key, 0) + 1

    def repeated(self, frames: int) -> Iterator[str]:
        """Yield the number of frames for each message that repeats."""
        for key, page in self._first.items():
            if self._count[key] > 1:
                yield f"the message about {page} holds for {self._count[key]} of {frames} frames."


class SeriesWriter:
    """Writer of the volumes of a series; iterating over it writes batch after batch.

    ``batch`` is the batch size of a partly written file to resume, or None for a new file.
    """

    def __init__(
        self, path: PathLike, pages: list[Page], series: Deconvolver, job: dict[str, Any],
        *, batch: int | None = None,
    ) -> None:  # fmt: skip
        self.pages, self.series = pages, series
        self.shape = self._prepared(pages[0]).counts.shape
        self.batch = batch or series.batch(self.shape)
        images, projector = series.images, series.projector_for(self.shape)
        self.file = VolumeSeries(
            path,
            frames=len(pages),
            shape=projector.volume_shape,
            planes=images.planes,
            voxel=(images.side, images.side),
            description={
                "voxel_um": [round(images.side * 1e6, 9)] * 2,
                "values": "energy of a voxel, photons (counts over the gain) of the frame",
                "degenerate_um": [round(z * 1e6, 9) for z in projector.degenerate],
                "place": series.voxel_grid(),
                "job": job,
            },
            batch=self.batch,
        )
        self.done = self.file.open(resume=batch is not None)

    def __iter__(self) -> Iterator[Batch]:
        series, position = self.series, self.done
        pending: deque[tuple[Prepared, Values | None]] = deque()  # frames of the batch

        def read() -> Iterator[tuple[Prepared, Values | None]]:
            for page, pair in zip(self.pages[self.done :], self._frames(), strict=True):
                if pair[0].counts.shape != self.shape:
                    raise ShapeError(
                        f"{page} must have the size of the first frame: write frames of different "
                        "cameras to different files."
                    )
                pending.append(pair)
                yield pair

        before = self.file.read(position - 1) if position else None
        volumes = series.series(read(), self.shape, self.batch, before=before)
        while results := list(islice(volumes, min(self.batch, len(self.pages) - position))):
            pages, frames = self.pages[position : position + len(results)], []
            records: list[dict[str, Any]] = []
            for page, result in zip(pages, results, strict=True):
                frame, low = pending.popleft()
                frames.append(frame)
                messages = series.diagnose(frame) + series.diagnose(frame, result, low)
                records.append({
                    "name": page.name, "residual": float(result.residuals[-1]),
                    "iterations": result.iterations, "remarks": messages,
                })  # fmt: skip
            self.file.append([result.volume for result in results], records)
            position += len(results)
            yield Batch(pages, frames, [record["remarks"] for record in records])
        self.file.end()

    def _frames(self) -> Iterator[tuple[Prepared, Values | None]]:
        """Yield the remaining frames with their rolling background, or None."""
        rolling = self.series.how.rolling
        if rolling is None:
            for page in self.pages[self.done :]:
                yield self._prepared(page), None
            return
        start = max(self.done - rolling // 2, 0)
        prepared = (self._prepared(page) for page in self.pages[start:])
        pairs = rolling_background(prepared, rolling)
        yield from islice(pairs, self.done - start, None)

    def _prepared(self, page: Page) -> Prepared:
        picture = read_picture(page.path, page.number)
        with naming(str(page)):
            return self.series.prepared(picture)
