"""Time series of volumes in one or several files, read volume by volume."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clplen.errors import FormatError
from clplen.files import PathLike, require_file
from clplen.io.formats import npy, tiff
from clplen.io.formats.npy import map_npy
from clplen.io.formats.tiff import read_tiff_stacks, stack_axes
from clplen.io.formats.untrusted import Bound
from clplen.io.store import zarr_files
from clplen.io.store.picture_series import (
    axes_in,
    multiscales,
    read_description,
    unreadable,
)
from clplen.io.store.zarr_files import open_checked, storage

Array = np.ndarray[Any, Any]

_KINDS = ".tif, .zarr and .npy"
_ORDERS = {2: "yx", 3: "zyx", 4: "tzyx", 5: "tczyx"}  # default axes of unnamed arrays, by dimension
_MAX_MISMATCH = 1e-6  # relative difference of voxel sizes and plane positions


@dataclass(frozen=True)
class StoredFile:
    """Layout of a file of volumes."""

    path: Path
    axes: dict[str, int]  # lengths of t, c and z by letter, slowest axis first
    sides: tuple[int, int]  # rows, columns
    planes: Array | None
    voxel: tuple[float, float] | None
    max_bytes: int | None

    @property
    def times(self) -> int:
        return self.axes.get("t", 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        return (self.axes.get("z", 1), *self.sides)

    def volumes(self, times: range) -> Iterator[Array]:
        """Yield volumes (z, y, x) as stored."""
        with unreadable(self.path, "volume"):
            for values in self._arrays(times):
                yield np.asarray(values).reshape(self.shape)

    def _arrays(self, times: range) -> Iterator[Array]:
        suffix = self.path.suffix.lower()
        if suffix in tiff.SUFFIXES:
            groups = ([self._page(t, z) for z in range(self.shape[0])] for t in times)
            yield from read_tiff_stacks(self.path, groups, max_bytes=self.max_bytes)
            return
        with _open_array(self.path) as (level, _):
            for t in times:
                self._require(level if suffix == zarr_files.SUFFIX else None)
                index = tuple({"t": t, "c": 0}.get(axis, slice(None)) for axis in self.axes)
                yield np.asarray(level[index])

    def _page(self, t: int, z: int) -> int:
        """Return the page number of a plane."""
        index = [{"t": t, "c": 0, "z": z}[axis] for axis in self.axes]
        return int(np.ravel_multi_index(index, tuple(self.axes.values())))

    def _require(self, level: Any) -> None:
        """Raise an error if a volume exceeds the memory or the capacity of the file."""
        size = 8 * math.prod(self.shape)
        bound = Bound(self.path, size, 1.0, self.max_bytes)
        if level is not None:
            bound = storage(level, self.path, "a volume", self.max_bytes)
        bound.require(size // 2, "a volume")


@dataclass(frozen=True, repr=False)
class StoredVolumes:
    """Time series of volumes that are read on demand.

    ``len(series)`` is the number of time points and ``series[t]`` reads a volume (planes, y, x). A
    loop reads the volumes in order.

    Attributes
    ----------
    files : tuple
        Layouts of the files.
    planes : numpy.ndarray or None
        Depth z of each plane in metres, if stored.
    voxel : tuple of float or None
        Voxel size (dy, dx) in metres, if stored.

    Examples
    --------
    >>> planes = np.linspace(-4e-6, 4e-6, 5)
    >>> for t in range(3):
    ...     volume = np.full((5, 16, 24), t, np.float32)
    ...     clplen.io.write_volume(f"t{t}.ome.tif", volume, planes=planes, voxel=(5e-7, 5e-7))
    >>> series = clplen.io.open_volumes(["t0.ome.tif", "t1.ome.tif", "t2.ome.tif"])
    >>> series
    <StoredVolumes: 3 times, (z, y, x) = (5, 16, 24)>
    >>> [float(volume.mean()) for volume in series], float(series[-1][0, 0, 0])
    ([0.0, 1.0, 2.0], 2.0)
    """

    files: tuple[Any, ...]
    planes: Array | None
    voxel: tuple[float, float] | None

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape (times, planes, rows, columns)."""
        return (sum(file.times for file in self.files), *self.files[0].shape)

    @property
    def axes(self) -> tuple[Array, Array, Array] | None:
        """Coordinates of planes, rows and columns in metres, voxel (0, 0) at 0; or None."""
        if self.planes is None or self.voxel is None:
            return None
        rows, columns = (
            step * np.arange(n) for n, step in zip(self.shape[2:], self.voxel, strict=True)
        )
        return self.planes, rows, columns

    def __repr__(self) -> str:
        times = self.shape[0]
        count = f"{times} time" + "s" * (times != 1)
        return f"<StoredVolumes: {count}, (z, y, x) = {self.shape[1:]}>"

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, time: int) -> Array:
        count = len(self)
        if not -count <= time < count:
            raise IndexError(
                f"time must be less than {count}, the number of time points, got {time}."
            )
        time %= count
        for file in self.files:
            if time < file.times:
                return next(file.volumes(range(time, time + 1)))
            time -= file.times
        raise AssertionError

    def __iter__(self) -> Iterator[Array]:
        for file in self.files:
            yield from file.volumes(range(file.times))


def open_volumes(
    paths: PathLike | Sequence[PathLike], *, max_bytes: int | None = None
) -> StoredVolumes:
    """Open volumes of one or several time points without reading them.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        Files in time order, with a single channel: OME-TIFF or ImageJ TIFF with axes T and Z; other
        TIFFs, whose pages are the planes of a time point; OME-Zarr with axes t and z; ``.npy`` of
        shape (t, z, y, x) or (z, y, x).
    max_bytes : int, optional
        Largest allocation for a volume; default half of the free memory.

    Returns
    -------
    StoredVolumes
        Volumes of all time points, in order.

    Raises
    ------
    FormatError, ValueError
        If a file is missing, damaged, of another kind or has several channels; if files differ in
        shape, z or voxel size; if ``paths`` is empty.

    Examples
    --------
    >>> np.save("series.npy", np.zeros((7, 5, 16, 24), np.float32))
    >>> clplen.io.open_volumes("series.npy")
    <StoredVolumes: 7 times, (z, y, x) = (5, 16, 24)>
    """
    path_list = [paths] if isinstance(paths, str) or hasattr(paths, "__fspath__") else list(paths)
    if not path_list:
        raise ValueError("paths must contain at least one file.")
    files = tuple(_layout(Path(path), max_bytes) for path in path_list)
    for file in files[1:]:
        _compare(files[0], file)
    return StoredVolumes(files, files[0].planes, files[0].voxel)


def _layout(path: Path, max_bytes: int | None) -> StoredFile:
    """Return the layout of a file without reading its samples."""
    require_file(path, "volume", folder=True)
    with unreadable(path, "volume"):
        axes, sides, kind = _axes(path)
    if kind not in "uif" or min((*sides, *axes.values())) < 1:
        raise FormatError(f"{path} is not a volume of numbers (t, z, y, x): its axes are {axes}.")
    if axes.get("c", 1) > 1:
        raise FormatError(f"{path} has {axes['c']} channels: give a file with one channel.")
    description, count = read_description(path), axes.get("z", 1)
    planes: Array | None = None
    um, steps = description.about.get("planes_um"), description.planes
    if isinstance(um, list) and len(um) == count:
        planes = np.array(um, np.float64) * 1e-6
    elif steps is not None:
        planes = steps[0] + steps[1] * np.arange(count)
    elif count == 1:
        planes = np.zeros(1)
    return StoredFile(path, axes, sides, planes, description.pixel, max_bytes)


def _axes(path: Path) -> tuple[dict[str, int], tuple[int, int], str]:
    """Return the lengths of the leading axes, those of y and x, and the kind of dtype."""
    suffix = path.suffix.lower()
    if suffix in tiff.SUFFIXES:
        first = next(read_tiff_stacks(path, [[0]]))
        if first.ndim != 3:
            raise FormatError(f"{path} is a colour picture: give a file with one channel.")
        axes = {name.lower(): size for name, size in stack_axes(path).items()}
        return axes, first.shape[1:], first.dtype.kind
    if suffix not in (zarr_files.SUFFIX, *npy.SUFFIXES):
        raise FormatError(f"{path} is not a volume: volumes are {_KINDS}.")
    with _open_array(path) as (level, names):
        shape, kind = tuple(level.shape), np.dtype(level.dtype).kind
    names = names if len(names) == len(shape) else _ORDERS.get(len(shape), "")
    if names[-2:] != "yx" or not set(names[:-2]) <= set("tcz") or len(set(names)) != len(names):
        raise FormatError(f"{path} must have axes (t, z, y, x), got {names!r} with shape {shape}.")
    sizes = dict(zip(names, map(int, shape), strict=True))
    sides = sizes.pop("y"), sizes.pop("x")
    return sizes, sides, kind


@contextmanager
def _open_array(path: Path) -> Iterator[tuple[Any, str]]:
    """Open a NumPy array, or the full size of an OME-Zarr with the letters of its axes."""
    if path.suffix.lower() != zarr_files.SUFFIX:
        yield map_npy(path, what="a volume"), ""
        return
    with open_checked(path, "write .tif") as group:
        try:
            name = str(multiscales(group)["datasets"][0]["path"])
        except (KeyError, IndexError, TypeError):
            name = "0"
        yield group[name], axes_in(group)


def _compare(first: StoredFile, other: StoredFile) -> None:
    """Raise FormatError for volumes that differ in shape, voxels or planes."""
    if first.shape != other.shape:
        raise FormatError(
            f"The volumes of a series must have equal shapes (z, y, x), got {first.shape} from "
            f"{first.path} and {other.shape} from {other.path}."
        )
    for what, reference, other_values in (
        ("voxels", first.voxel, other.voxel),
        ("planes", first.planes, other.planes),
    ):
        if (reference is None) != (other_values is None):
            raise FormatError(
                f"Only one of {first.path} and {other.path} states its {what}: give volumes of one "
                "series."
            )
        if (
            reference is not None
            and other_values is not None
            and not _alike(np.array(reference), np.array(other_values))
        ):
            raise FormatError(
                f"{other.path} and {first.path} have different {what} "
                f"({_micrometres(other_values)} and {_micrometres(reference)} um): give volumes of "
                "one series."
            )


def _alike(first: Array, second: Array) -> bool:
    steps = np.abs(np.diff(first)) if len(first) > 2 else np.abs(first)
    return bool(
        np.abs(first - second).max() <= _MAX_MISMATCH * max(float(steps.max(initial=0.0)), 1e-12)
    )


def _micrometres(values: Any) -> str:
    """Return lengths in micrometres as text."""
    um = [f"{1e6 * length:.6g}" for length in values]
    return " x ".join(um) if len(um) == 2 else f"{um[0]} to {um[-1]}"
