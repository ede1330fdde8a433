"""OME-Zarr of a time series of volumes that grows frame by frame: always whole, always readable.

OME-NGFF 0.4 with the axes t, c, z, y, x; a chunk is all planes of a time point (of at most 512 x
512 pixels), a file of its own. Chunks of new time points are on the disk before the arrays' length
says so, and the length before the attribute that counts them: whatever moment the process is
killed at, readers see whole time points only.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from clplen.files import filling, replacing, said_of
from clplen.io.store.ome_zarr import (
    chunk_sides,
    create_level,
    level_sizes,
    means,
    multiscales,
    omero,
)
from clplen.io.store.picture_blocks import Array
from clplen.io.store.series_layout import Record, SeriesLayout, checked_series
from clplen.io.store.zarr_files import FORMAT_2, zarr_package
from clplen.outputs import MARK

_INSTEAD = "write .ome.tif"
_AXES = "TCZYX"


class GrowingZarr:
    """A series in an OME-Zarr folder.

    Attributes
    ----------
    records : list of dict
        What is said of each volume that is there.
    """

    def __init__(self, path: Path, layout: SeriesLayout) -> None:
        zarr_package(_INSTEAD)
        self.path, self.layout = path, layout
        self.records: list[Record] = []
        self._sizes = level_sizes(layout.shape, "ZYX")

    @property
    def nbytes(self) -> int:
        """Bytes of all volumes with their smaller levels."""
        return 4 * self.layout.frames * sum(map(math.prod, self._sizes))

    @staticmethod
    def stored(path: Path) -> tuple[dict[str, Any], list[Record]]:
        """Description and records of what is there; empty of what is no such series."""
        with suppress(Exception):  # what others wrote, or nothing
            return checked_series(_read_json(path / ".zattrs")["clplen"])
        return {}, []

    def begin(self) -> None:
        """Make the folder, without a time point; what was there goes."""
        zarr = zarr_package(_INSTEAD)
        with filling(self.path, durable=True, replace=True) as folder:
            for level, size in enumerate(self._sizes):
                chunks = (1, 1, size[0], *chunk_sides(size))
                create_level(folder, str(level), (0, 1, *size), chunks)
            zarr.open_group(zarr.storage.LocalStore(folder), mode="a", **FORMAT_2)
            _write_json(folder / ".zattrs", self._attributes())

    def resume(self, records: list[Record]) -> None:
        """Go on after so many time points; later ones go."""
        self.records = list(records)
        with said_of(self.path):
            _write_json(self.path / ".zattrs", self._attributes())
            for level in range(len(self._sizes)):
                self._set_length(level, len(records))
                for name in (self.path / str(level)).iterdir():
                    is_time = name.is_dir() and name.name.isascii() and name.name.isdigit()
                    if is_time and int(name.name) >= len(records):
                        shutil.rmtree(name)

    def whole(self, records: list[Record]) -> int:
        """Time points from the first one on whose files all have their size."""
        if not all(map(self._is_own, range(len(self._sizes)))):
            return 0
        missing = (t for t in range(len(records)) if not self.holds(t))
        return next(missing, len(records))

    def holds(self, t: int) -> bool:
        """Return whether all files of a time point have their size."""
        for level, size in enumerate(self._sizes):
            sides = chunk_sides(size)
            nbytes = 4 * size[0] * math.prod(sides)
            for i, k in _places(size, sides):
                name = self._chunk(level, t, i, k)
                if not name.is_file() or name.stat().st_size != nbytes:
                    return False
        return True

    def _is_own(self, level: int) -> bool:
        """Return whether a level is a folder of this series, not a link to one of others."""
        folder = self.path / str(level)
        with suppress(Exception):  # what others wrote
            shape = list(_read_json(folder / ".zarray")["shape"])
            return not folder.is_symlink() and shape[1:] == [1, *self._sizes[level]]
        return False

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Add volumes, float32 (planes, y, x), with what is said of each."""
        with said_of(self.path):
            for t, volume in enumerate(volumes, start=len(self.records)):
                for level, size in enumerate(self._sizes):
                    volume = volume if level == 0 else np.stack([means(one) for one in volume])
                    self._write(level, t, size, volume)
            self.records += records
            for level in reversed(range(len(self._sizes))):
                self._set_length(level, len(self.records))
            _write_json(self.path / ".zattrs", self._attributes())

    def read(self, t: int) -> Array:
        """The volume of a time point, as it was given."""
        size = self._sizes[0]
        sides, found = chunk_sides(size), np.empty(size, np.float32)
        for i, k in _places(size, sides):
            part = np.fromfile(self._chunk(0, t, i, k), "<f4").reshape(size[0], *sides)
            rows, columns = _part(i, sides[0], size[1]), _part(k, sides[1], size[2])
            high, wide = rows.stop - rows.start, columns.stop - columns.start
            found[:, rows, columns] = part[:, :high, :wide]
        return found

    def end(self) -> None:
        """Nothing is left to do: the folder is whole after each time point."""

    def _write(self, level: int, t: int, size: tuple[int, ...], volume: Array) -> None:
        sides = chunk_sides(size)
        for i, k in _places(size, sides):
            name = self._chunk(level, t, i, k)
            name.parent.mkdir(parents=True, exist_ok=True)
            full = np.zeros((size[0], *sides), "<f4")
            part = volume[:, _part(i, sides[0], size[1]), _part(k, sides[1], size[2])]
            full[:, : part.shape[1], : part.shape[2]] = part
            with name.open("wb") as file:
                file.write(full.data)
                file.flush()
                os.fsync(file.fileno())

    def _chunk(self, level: int, t: int, i: int, k: int) -> Path:
        return self.path.joinpath(str(level), str(t), "0", "0", str(i), str(k))

    def _set_length(self, level: int, frames: int) -> None:
        name = self.path / str(level) / ".zarray"
        about = _read_json(name)
        _write_json(name, {**about, "shape": [frames, *about["shape"][1:]]})

    def _attributes(self) -> dict[str, Any]:
        """OME's metadata and what is said of the volumes."""
        layout = self.layout
        spacing = (math.nan, math.nan, *layout.voxel)
        low = [record["range"] for record in self.records]
        limits = (min((a for a, _ in low), default=0.0), max((b for _, b in low), default=0.0))
        scales = multiscales(self.path, self._sizes, _AXES, spacing, layout.depth, layout.first)
        return {
            "multiscales": [scales],
            "omero": omero(("intensity",), [limits], colour=False),
            "clplen": {**layout.about, "records": self.records},
            "software": MARK,
        }


def _places(size: tuple[int, ...], sides: tuple[int, int]) -> Iterator[tuple[int, int]]:
    rows, columns = (range(-(-n // side)) for n, side in zip(size[-2:], sides, strict=True))
    return ((i, k) for i in rows for k in columns)


def _part(number: int, side: int, total: int) -> slice:
    return slice(number * side, min((number + 1) * side, total))


def _read_json(path: Path) -> Any:
    if not path.is_file():  # a pipe would be waited for
        raise FileNotFoundError(f"There is no file {path}.")
    return json.loads(path.read_text(encoding="utf-8"))


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path, durable=True) as temporary:
        temporary.write_text(json.dumps(values), encoding="utf-8")
