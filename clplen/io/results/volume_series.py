"""Series of volumes in one OME-TIFF (TZYX) or OME-Zarr (TCZYX), written during computation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import check_finite, positive_integer, real_array
from clplen.errors import FormatError
from clplen.files import PathLike, check_space
from clplen.io.results.volume_files import plane_step
from clplen.io.store import zarr_files
from clplen.io.store.growing_tiff import GrowingTiff
from clplen.io.store.growing_zarr import GrowingZarr
from clplen.io.store.picture_blocks import Array
from clplen.io.store.series_layout import Record, SeriesLayout


class VolumeSeries:
    """File of volumes that grows, and can be resumed after its writer was killed.

    Attributes
    ----------
    done : int
        Number of stored volumes.
    """

    def __init__(
        self,
        path: PathLike,
        *,
        frames: int,
        shape: tuple[int, int, int],
        planes: Any,
        voxel: tuple[float, float],
        description: dict[str, Any],
        batch: int = 1,
    ) -> None:
        self.path = Path(path)
        z = real_array(planes, "planes", np.float64)
        check_finite(voxel=voxel, planes=z)
        for number in (frames, *shape):
            positive_integer(number, "An axis of a series")
        about = {
            **description,
            "planes_um": [round(depth * 1e6, 9) for depth in z],
            "batch": batch,
            "shape": list(shape),
        }
        layout = SeriesLayout(
            frames, shape, voxel, tuple(float(depth) for depth in z), plane_step(z), about
        )
        kind = _kind(self.path)
        self._file = kind(self.path, layout)
        self._frames, self._batch = frames, batch

    @property
    def done(self) -> int:
        """Number of stored volumes."""
        return len(self._file.records)

    @property
    def records(self) -> list[Record]:
        """Descriptions of the stored volumes."""
        return self._file.records

    def open(self, *, resume: bool) -> int:
        """Begin or resume the file, and return the number of stored volumes."""
        if resume:
            _, records = self._file.stored(self.path)
            count = self._file.count_complete(records[: self._frames])
            if count < self._frames:
                count -= count % self._batch
            if count:
                self._file.resume(records[:count])
                return count
        check_space(self.path, self._file.nbytes)
        self._file.begin()
        return 0

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Write volumes and their records; they are on disk when the call returns."""
        full_records = [
            {**record, "range": [float(volume.min()), float(volume.max())]}
            for volume, record in zip(volumes, records, strict=True)
        ]
        self._file.append(volumes, full_records)

    def read(self, t: int) -> Array:
        """Return the stored volume of a frame."""
        return self._file.read(t)

    def end(self) -> None:
        """Complete the file after the last volume."""
        self._file.end()


def series_in(path: PathLike) -> tuple[dict[str, Any], list[Record]]:
    """Return description and records of a series of volumes, complete or not; else empty.

    Parameters
    ----------
    path : path-like
        OME-TIFF (TZYX) or OME-Zarr (TCZYX) of `clplen microscope deconvolve`; it may be missing.

    Returns
    -------
    dict, list of dict
        Description of all volumes, and a record for each stored volume with "name", "residual",
        "iterations", "range" and "remarks".

    Examples
    --------
    >>> from clplen.io.results.volume_series import VolumeSeries
    >>> file = VolumeSeries(
    ...     "series.ome.tif", frames=2, shape=(3, 8, 9), planes=[-1e-6, 0.0, 1e-6],
    ...     voxel=(1e-6, 1e-6), description={})
    >>> file.open(resume=False)
    0
    >>> file.append(np.ones((2, 3, 8, 9), np.float32), [{"name": "a"}, {"name": "b"}])
    >>> file.end()
    >>> about, records = clplen.io.series_in("series.ome.tif")
    >>> about["planes_um"], [record["name"] for record in records]
    ([-1.0, 0.0, 1.0], ['a', 'b'])
    """
    return _kind(Path(path)).stored(Path(path))


def read_volume_series(path: PathLike, frame: int) -> Array:
    """Read a volume of a series.

    Parameters
    ----------
    path : path-like
        OME-TIFF (TZYX) or OME-Zarr (TCZYX) of `clplen microscope deconvolve`.
    frame : int
        Index of the volume, from 0.

    Returns
    -------
    numpy.ndarray
        Volume of shape (planes, y, x), float32.

    Raises
    ------
    FormatError
        If the file is of another kind or has no such frame.

    Examples
    --------
    >>> from clplen.io.results.volume_series import VolumeSeries
    >>> file = VolumeSeries(
    ...     "series.ome.tif", frames=2, shape=(3, 8, 9), planes=[-1e-6, 0.0, 1e-6],
    ...     voxel=(1e-6, 1e-6), description={})
    >>> file.open(resume=False)
    0
    >>> file.append(np.ones((2, 3, 8, 9), np.float32), [{"name": "a"}, {"name": "b"}])
    >>> file.end()
    >>> clplen.io.read_volume_series("series.ome.tif", 1).shape
    (3, 8, 9)
    """
    path = Path(path)
    about, records = series_in(path)
    if not about:
        raise FormatError(f"{path} is not a series of volumes written by clplen.")
    if not 0 <= frame < len(records):
        raise FormatError(f"frame must be 0 to {len(records) - 1} in {path}, got {frame}.")
    series = _writer(path, about)
    if not series.holds(frame):
        raise FormatError(f"{path} is truncated or damaged: copy or write it again.")
    return series.read(frame)


def count_complete(path: PathLike) -> int:
    """Return the number of leading volumes of a series that have all their bytes."""
    about, records = series_in(path)
    return _writer(Path(path), about).count_complete(records) if about else 0


def _writer(path: Path, about: dict[str, Any]) -> GrowingTiff | GrowingZarr:
    planes, ny, nx = (int(n) for n in about["shape"])
    return _kind(path)(path, SeriesLayout(0, (planes, ny, nx), (1.0, 1.0), (0.0,), None))


def _kind(path: Path) -> type[GrowingTiff] | type[GrowingZarr]:
    return GrowingZarr if path.suffix.lower() == zarr_files.SUFFIX else GrowingTiff
