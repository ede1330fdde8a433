"""Volumes over time, of one file or several, read one at a time."""

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
from clplen.io.store.zarr_files import opened_store, storage

Array = np.ndarray[Any, Any]

_KINDS = ".tif, .zarr and .npy"
_ORDERS = {2: "yx", 3: "zyx", 4: "tzyx", 5: "tczyx"}  # of axes that have no names
_CLOSE = 1e-6  # of a voxel: other sizes are other sizes


@dataclass(frozen=True)
class StoredFile:
    """What a file holds."""

    path: Path
    axes: dict[str, int]  # lengths of t, c and z by letter, the slowest first, of the file
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
        """Volumes (z, y, x) as stored."""
        with unreadable(self.path, "volume"):
            for values in self._stored(times):
                yield np.asarray(values).reshape(self.shape)

    def _stored(self, times: range) -> Iterator[Array]:
        suffix = self.path.suffix.lower()
        if suffix in tiff.SUFFIXES:
            groups = ([self._page(t, z) for z in range(self.shape[0])] for t in times)
            yield from read_tiff_stacks(self.path, groups, max_bytes=self.max_bytes)
            return
        with _opened(self.path) as (level, _):
            for t in times:
                self._require(level if suffix == zarr_files.SUFFIX else None)
                place = tuple({"t": t, "c": 0}.get(axis, slice(None)) for axis in self.axes)
                yield np.asarray(level[place])

    def _page(self, t: int, z: int) -> int:
        """The number of the page of a plane."""
        place = [{"t": t, "c": 0, "z": z}[axis] for axis in self.axes]
        return int(np.ravel_multi_index(place, tuple(self.axes.values())))

    def _require(self, level: Any) -> None:
        """Refuse a volume that does not fit into memory, or that the file cannot hold."""
        size = 8 * math.prod(self.shape)
        bound = Bound(self.path, size, 1.0, self.max_bytes)
        if level is not None:
            bound = storage(level, self.path, "a volume", self.max_bytes)
        bound.require(size // 2, "a volume")


@dataclass(frozen=True, repr=False)
class StoredVolumes:
    """Volumes of several times, of which one is in memory at a time.

    ``len(series)`` is the number of times, ``series[t]`` reads a volume (planes, y, x), and a loop
    reads one after the other.

    Attributes
    ----------
    files : tuple
        What each file holds.
    planes : numpy.ndarray or None
        z of each plane in metres, where the files say it.
    voxel : tuple of float or None
        (dy, dx) in metres, where the files say it.

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
        """(times, planes, rows, columns)."""
        return (sum(file.times for file in self.files), *self.files[0].shape)

    @property
    def axes(self) -> tuple[Array, Array, Array] | None:
        """Coordinates of planes, rows and columns in metres, voxel (0, 0) at 0; None if unknown."""
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
            raise IndexError(f"The series has {count} times, from 0 on, not {time}.")
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
    """Open volumes of one or several times, without reading them.

    Parameters
    ----------
    paths : path-like or sequence of path-like
        One file of all times or some, or several, one after the other: OME-TIFF, or a TIFF of
        ImageJ, with axes T and Z; other TIFFs, whose pages are planes of one time; OME-Zarr with
        axes t and z; ``.npy`` of shape (t, z, y, x) or (z, y, x). With one channel.
    max_bytes : int, optional
        Largest allocation, of one volume; default half of the free memory.

    Returns
    -------
    StoredVolumes
        Of all times, in order.

    Raises
    ------
    FormatError, ValueError
        If a file is missing, damaged, of another kind, has several channels, or if files differ in
        shape, z or the size of a voxel; if there is no path.

    Examples
    --------
    >>> np.save("series.npy", np.zeros((7, 5, 16, 24), np.float32))
    >>> clplen.io.open_volumes("series.npy")
    <StoredVolumes: 7 times, (z, y, x) = (5, 16, 24)>
    """
    several = [paths] if isinstance(paths, str) or hasattr(paths, "__fspath__") else list(paths)
    if not several:
        raise ValueError("There is no file to open.")
    files = tuple(_described(Path(path), max_bytes) for path in several)
    for file in files[1:]:
        _compare(files[0], file)
    return StoredVolumes(files, files[0].planes, files[0].voxel)


def _described(path: Path, max_bytes: int | None) -> StoredFile:
    """What a file holds, without its samples."""
    require_file(path, "volume", folder=True)
    with unreadable(path, "volume"):
        axes, sides, kind = _axes(path)
    if kind not in "uif" or min((*sides, *axes.values())) < 1:
        raise FormatError(f"{path} holds no volume of numbers (t, z, y, x): its axes are {axes}.")
    if axes.get("c", 1) > 1:
        raise FormatError(f"{path} has {axes['c']} channels: give a file of one of them.")
    said, count = read_description(path), axes.get("z", 1)
    planes: Array | None = None
    um, steps = said.about.get("planes_um"), said.planes
    if isinstance(um, list) and len(um) == count:
        planes = np.array(um, np.float64) * 1e-6
    elif steps is not None:
        planes = steps[0] + steps[1] * np.arange(count)
    elif count == 1:
        planes = np.zeros(1)
    return StoredFile(path, axes, sides, planes, said.pixel, max_bytes)


def _axes(path: Path) -> tuple[dict[str, int], tuple[int, int], str]:
    """Lengths of the axes before y and x, those of y and x, and the kind of the samples."""
    suffix = path.suffix.lower()
    if suffix in tiff.SUFFIXES:
        first = next(read_tiff_stacks(path, [[0]]))
        if first.ndim != 3:
            raise FormatError(f"{path} holds colours: give a file of one channel.")
        axes = {name.lower(): size for name, size in stack_axes(path).items()}
        return axes, first.shape[1:], first.dtype.kind
    if suffix not in (zarr_files.SUFFIX, *npy.SUFFIXES):
        raise FormatError(f"{path} is no volume: volumes are {_KINDS}.")
    with _opened(path) as (level, names):
        shape, kind = tuple(level.shape), np.dtype(level.dtype).kind
    names = names if len(names) == len(shape) else _ORDERS.get(len(shape), "")
    if names[-2:] != "yx" or not set(names[:-2]) <= set("tcz") or len(set(names)) != len(names):
        raise FormatError(f"{path} holds shape {shape} with axes {names!r}, not (t, z, y, x).")
    sizes = dict(zip(names, map(int, shape), strict=True))
    sides = sizes.pop("y"), sizes.pop("x")
    return sizes, sides, kind


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, str]]:
    """The array of a NumPy file, or the full size of an OME-Zarr with a letter for each axis."""
    if path.suffix.lower() != zarr_files.SUFFIX:
        yield map_npy(path, what="a volume"), ""
        return
    with opened_store(path, "write .tif") as group:
        try:
            name = str(multiscales(group)["datasets"][0]["path"])
        except (KeyError, IndexError, TypeError):
            name = "0"
        yield group[name], axes_in(group)


def _compare(first: StoredFile, other: StoredFile) -> None:
    """Refuse volumes that do not fit onto each other."""
    if first.shape != other.shape:
        raise FormatError(
            f"{other.path} has shape {other.shape}, {first.path} {first.shape}: the volumes of a "
            "series have one shape (z, y, x)."
        )
    for what, one, two in (
        ("voxels", first.voxel, other.voxel),
        ("planes", first.planes, other.planes),
    ):
        if (one is None) != (two is None):
            raise FormatError(
                f"Of {first.path} and {other.path} only one says how large its {what} are: give "
                "volumes of one series."
            )
        if one is not None and two is not None and not _alike(np.array(one), np.array(two)):
            raise FormatError(
                f"{other.path} has other {what} than {first.path} ({_said(two)} and {_said(one)} "
                "um): give volumes of one series."
            )


def _alike(one: Array, two: Array) -> bool:
    steps = np.abs(np.diff(one)) if len(one) > 2 else np.abs(one)
    return bool(np.abs(one - two).max() <= _CLOSE * max(float(steps.max(initial=0.0)), 1e-12))


def _said(values: Any) -> str:
    """Some lengths in micrometres."""
    um = [f"{1e6 * one:.6g}" for one in values]
    return " x ".join(um) if len(um) == 2 else f"{um[0]} to {um[-1]}"
