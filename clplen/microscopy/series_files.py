"""A series of raw frames to one file of volumes, batch by batch; it goes on after it was ended."""

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
from clplen.microscopy.pipeline import Deconvolver, lowest


@dataclass(frozen=True)
class Page:
    """A frame: a file, or one of several in a TIFF."""

    path: Path
    number: int | None = None

    @property
    def name(self) -> str:
        """Of its volume."""
        return self.path.stem if self.number is None else f"{self.path.stem}_{self.number:04d}"

    def __str__(self) -> str:
        return str(self.path) if self.number is None else f"{self.path}, frame {self.number}"


def pages_of(path: PathLike) -> list[Page]:
    """The frames of a file, in order."""
    path = Path(path)
    refuse_volume(path)
    count = frames_in(path)
    return [Page(path)] if count == 1 else [Page(path, number) for number in range(count)]


def words_of_series(
    pages: list[Page], shared: dict[str, Any], start: list[str | float | None], rolling: int | None
) -> dict[str, Any]:
    """What the volumes of a series depend on, as JSON gives it back."""
    digests = {path: digest(path) for path in {page.path for page in pages}}
    frames = json.dumps([[digests[page.path], page.number] for page in pages])
    words = {"frames": sha256(frames.encode()).hexdigest(), "count": len(pages), **shared}
    found: dict[str, Any] = json.loads(json.dumps(words | {"start": start, "rolling": rolling}))
    return found


@dataclass(frozen=True)
class Batch:
    """Volumes that are on the disk, and what is said of each frame and volume."""

    pages: list[Page]
    frames: list[Prepared]
    remarks: list[list[str]]


class Remarks:
    """Remarks on frames, each said once with the number of frames that it is of."""

    def __init__(self) -> None:
        self._first: dict[str, Page] = {}
        self._count: dict[str, int] = {}

    def new(self, batch: Batch) -> Iterator[str]:
        """Sentences that no frame before had."""
        for page, remarks in zip(batch.pages, batch.remarks, strict=True):
            for text in remarks:
                key = "".join(c for c in text if not c.isdigit())
                if key not in self._first:
                    self._first[key] = page
                    yield f"{page}: {text}"
                self._count[key] = self._count.get(key, 0) + 1

    def repeated(self, frames: int) -> Iterator[str]:
        """How many of the frames sentences are of."""
        for key, page in self._first.items():
            if self._count[key] > 1:
                yield f"what is said of {page} holds for {self._count[key]} of {frames} frames."


class SeriesWriter:
    """The file of the volumes of some frames; iterated over, it is written batch by batch.

    ``batch`` is that of the file that is gone on with, if there is one.
    """

    def __init__(
        self, path: PathLike, pages: list[Page], series: Deconvolver, words: dict[str, Any],
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
                "place": series.place(),
                "job": words,
            },
            batch=self.batch,
        )
        self.done = self.file.open(resume=batch is not None)

    def __iter__(self) -> Iterator[Batch]:
        series, at = self.series, self.done
        seen: deque[tuple[Prepared, Values | None]] = deque()  # of the batch

        def read() -> Iterator[tuple[Prepared, Values | None]]:
            for page, one in zip(self.pages[self.done :], self._lit(), strict=True):
                if one[0].counts.shape != self.shape:
                    raise ShapeError(
                        f"{page} has another size than the first frame: a series in one file is of "
                        "one camera."
                    )
                seen.append(one)
                yield one

        before = self.file.read(at - 1) if at else None
        volumes = series.series(read(), self.shape, self.batch, before=before)
        while some := list(islice(volumes, min(self.batch, len(self.pages) - at))):
            pages, frames = self.pages[at : at + len(some)], []
            records: list[dict[str, Any]] = []
            for page, one in zip(pages, some, strict=True):
                frame, low = seen.popleft()
                frames.append(frame)
                said = series.diagnose(frame) + series.diagnose(frame, one, low)
                records.append({
                    "name": page.name, "residual": float(one.residuals[-1]),
                    "iterations": one.iterations, "remarks": said,
                })  # fmt: skip
            self.file.append([one.volume for one in some], records)
            at += len(some)
            yield Batch(pages, frames, [one["remarks"] for one in records])
        self.file.end()

    def _lit(self) -> Iterator[tuple[Prepared, Values | None]]:
        """Frames that are missing, with what of them is background."""
        rolling = self.series.how.rolling
        if rolling is None:
            for page in self.pages[self.done :]:
                yield self._prepared(page), None
            return
        start = max(self.done - rolling // 2, 0)
        pairs = lowest((self._prepared(page) for page in self.pages[start:]), rolling)
        yield from islice(pairs, self.done - start, None)

    def _prepared(self, page: Page) -> Prepared:
        picture = read_picture(page.path, page.number)
        with naming(str(page)):
            return self.series.prepared(picture)
