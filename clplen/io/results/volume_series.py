"""Series of volumes in one OME-TIFF (TZYX) or OME-Zarr (TCZYX), written while they are found."""

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
    """A file of volumes that grows, and goes on after its writer was killed.

    Attributes
    ----------
    done : int
        Volumes that are there.
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
            "planes_um": [round(one * 1e6, 9) for one in z],
            "batch": batch,
            "shape": list(shape),
        }
        layout = SeriesLayout(
            frames, shape, voxel, tuple(float(one) for one in z), plane_step(z), about
        )
        kind = _kind(self.path)
        self._file = kind(self.path, layout)
        self._frames, self._batch = frames, batch

    @property
    def done(self) -> int:
        """Volumes that are there."""
        return len(self._file.records)

    @property
    def records(self) -> list[Record]:
        """What is said of each of them."""
        return self._file.records

    def open(self, *, go_on: bool) -> int:
        """Begin, or go on with what is there; the number of volumes that are."""
        if go_on:
            _, records = self._file.stored(self.path)
            whole = self._file.whole(records[: self._frames])
            if whole < self._frames:
                whole -= whole % self._batch
            if whole:
                self._file.resume(records[:whole])
                return whole
        check_space(self.path, self._file.nbytes)
        self._file.begin()
        return 0

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Add volumes, with what is said of each; they are on the disk afterwards."""
        said = [
            {**record, "range": [float(one.min()), float(one.max())]}
            for one, record in zip(volumes, records, strict=True)
        ]
        self._file.append(volumes, said)

    def read(self, t: int) -> Array:
        """The volume of a frame that is there."""
        return self._file.read(t)

    def end(self) -> None:
        """All volumes are there."""
        self._file.end()


def series_in(path: PathLike) -> tuple[dict[str, Any], list[Record]]:
    """Description and records of a series of volumes, whole or not; empty of anything else.

    Parameters
    ----------
    path : path-like
        OME-TIFF (TZYX) or OME-Zarr (TCZYX) of `clplen microscope deconvolve`; it may be missing.

    Returns
    -------
    dict, list of dict
        What is known of all volumes, and of each one that is there: "name", "residual",
        "iterations", "range" and "remarks".

    Examples
    --------
    >>> from clplen.io.results.volume_series import VolumeSeries
    >>> file = VolumeSeries(
    ...     "series.ome.tif", frames=2, shape=(3, 8, 9), planes=[-1e-6, 0.0, 1e-6],
    ...     voxel=(1e-6, 1e-6), description={})
    >>> file.open(go_on=False)
    0
    >>> file.append(np.ones((2, 3, 8, 9), np.float32), [{"name": "a"}, {"name": "b"}])
    >>> file.end()
    >>> about, records = clplen.io.series_in("series.ome.tif")
    >>> about["planes_um"], [one["name"] for one in records]
    ([-1.0, 0.0, 1.0], ['a', 'b'])
    """
    return _kind(Path(path)).stored(Path(path))


def read_volume_series(path: PathLike, frame: int) -> Array:
    """Read one volume of a series.

    Parameters
    ----------
    path : path-like
        OME-TIFF (TZYX) or OME-Zarr (TCZYX) of `clplen microscope deconvolve`.
    frame : int
        From 0.

    Returns
    -------
    numpy.ndarray
        float32, shape (planes, y, x).

    Raises
    ------
    FormatError
        If it is no such file, or has no such frame.

    Examples
    --------
    >>> from clplen.io.results.volume_series import VolumeSeries
    >>> file = VolumeSeries(
    ...     "series.ome.tif", frames=2, shape=(3, 8, 9), planes=[-1e-6, 0.0, 1e-6],
    ...     voxel=(1e-6, 1e-6), description={})
    >>> file.open(go_on=False)
    0
    >>> file.append(np.ones((2, 3, 8, 9), np.float32), [{"name": "a"}, {"name": "b"}])
    >>> file.end()
    >>> clplen.io.read_volume_series("series.ome.tif", 1).shape
    (3, 8, 9)
    """
    path = Path(path)
    about, records = series_in(path)
    if not about:
        raise FormatError(f"{path} is no series of volumes that clplen wrote.")
    if not 0 <= frame < len(records):
        raise FormatError(f"{path} has frames 0 to {len(records) - 1}, not {frame}.")
    series = _stored(path, about)
    if not series.holds(frame):
        raise FormatError(f"{path} is truncated or damaged: copy or write it again.")
    return series.read(frame)


def count_whole(path: PathLike) -> int:
    """Volumes of a series, from the first one on, that are there with all their bytes."""
    about, records = series_in(path)
    return _stored(Path(path), about).whole(records) if about else 0


def _stored(path: Path, about: dict[str, Any]) -> GrowingTiff | GrowingZarr:
    planes, ny, nx = (int(n) for n in about["shape"])
    return _kind(path)(path, SeriesLayout(0, (planes, ny, nx), (1.0, 1.0), (0.0,), None))


def _kind(path: Path) -> type[GrowingTiff] | type[GrowingZarr]:
    return GrowingZarr if path.suffix.lower() == zarr_files.SUFFIX else GrowingTiff
