"""OME-Zarr of a time series of volumes that grows frame by frame and is always readable.

OME-NGFF 0.4 with the axes t, c, z, y, x. A chunk is a file with all planes of a time point, of at
most 512 x 512 pixels. Chunks are written first, then the length of the arrays, then the attribute
that counts the time points: readers see complete time points only, even after a crash.
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

from clplen.files import filling, replacing, write_errors
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

_ALTERNATIVE = "write .ome.tif"
_AXES = "TCZYX"


class GrowingZarr:
    """Time series of volumes in an OME-Zarr folder.

    Attributes
    ----------
    records : list of dict
        Description of each stored volume.
    """

    def __init__(self, path: Path, layout: SeriesLayout) -> None:
        zarr_package(_ALTERNATIVE)
        self.path, self.layout = path, layout
        self.records: list[Record] = []
        self._sizes = level_sizes(layout.shape, "ZYX")

    @property
    def nbytes(self) -> int:
        """Size of all volumes and their reduced levels in bytes."""
        return 4 * self.layout.frames * sum(map(math.prod, self._sizes))

    @staticmethod
    def stored(path: Path) -> tuple[dict[str, Any], list[Record]]:
        """Return description and records of a series on disk; empty for anything else."""
        with suppress(Exception):  # foreign or missing file
            return checked_series(_read_json(path / ".zattrs")["clplen"])
        return {}, []

    def begin(self) -> None:
        """Create the folder without time points, replacing an existing one."""
        zarr = zarr_package(_ALTERNATIVE)
        with filling(self.path, durable=True, replace=True) as folder:
            for level, size in enumerate(self._sizes):
                chunks = (1, 1, size[0], *chunk_sides(size))
                create_level(folder, str(level), (0, 1, *size), chunks)
            zarr.open_group(zarr.storage.LocalStore(folder), mode="a", **FORMAT_2)
            _write_json(folder / ".zattrs", self._attributes())

    def resume(self, records: list[Record]) -> None:
        """Continue after the time points of ``records``, and remove later ones."""
        self.records = list(records)
        with write_errors(self.path):
            _write_json(self.path / ".zattrs", self._attributes())
            for level in range(len(self._sizes)):
                self._set_length(level, len(records))
                for name in (self.path / str(level)).iterdir():
                    is_time = name.is_dir() and name.name.isascii() and name.name.isdigit()
                    if is_time and int(name.name) >= len(records):
                        shutil.rmtree(name)

    def count_complete(self, records: list[Record]) -> int:
        """Return the number of leading time points whose files all have the right size."""
        if not all(map(self._is_valid_level, range(len(self._sizes)))):
            return 0
        missing = (t for t in range(len(records)) if not self.holds(t))
        return next(missing, len(records))

    def holds(self, t: int) -> bool:
        """Return True if all files of a time point have the right size."""
        for level, size in enumerate(self._sizes):
            sides = chunk_sides(size)
            nbytes = 4 * size[0] * math.prod(sides)
            for i, k in _chunk_indices(size, sides):
                name = self._chunk(level, t, i, k)
                if not name.is_file() or name.stat().st_size != nbytes:
                    return False
        return True

    def _is_valid_level(self, level: int) -> bool:
        """Return True if a level is a folder of this series and not a link."""
        folder = self.path / str(level)
        with suppress(Exception):  # foreign file
            shape = list(_read_json(folder / ".zarray")["shape"])
            return not folder.is_symlink() and shape[1:] == [1, *self._sizes[level]]
        return False

    def append(self, volumes: Sequence[Array], records: Sequence[Record]) -> None:
        """Add volumes, float32 of shape (planes, y, x), with their records."""
        with write_errors(self.path):
            for t, volume in enumerate(volumes, start=len(self.records)):
                for level, size in enumerate(self._sizes):
                    volume = volume if level == 0 else np.stack([means(plane) for plane in volume])
                    self._write(level, t, size, volume)
            self.records += records
            for level in reversed(range(len(self._sizes))):
                self._set_length(level, len(self.records))
            _write_json(self.path / ".zattrs", self._attributes())

    def read(self, t: int) -> Array:
        """Return the volume of a time point."""
        size = self._sizes[0]
        sides, volume = chunk_sides(size), np.empty(size, np.float32)
        for i, k in _chunk_indices(size, sides):
            part = np.fromfile(self._chunk(0, t, i, k), "<f4").reshape(size[0], *sides)
            rows, columns = _chunk_slice(i, sides[0], size[1]), _chunk_slice(k, sides[1], size[2])
            high, wide = rows.stop - rows.start, columns.stop - columns.start
            volume[:, rows, columns] = part[:, :high, :wide]
        return volume

    def end(self) -> None:
        """Do nothing: the folder is complete after each time point."""

    def _write(self, level: int, t: int, size: tuple[int, ...], volume: Array) -> None:
        sides = chunk_sides(size)
        for i, k in _chunk_indices(size, sides):
            name = self._chunk(level, t, i, k)
            name.parent.mkdir(parents=True, exist_ok=True)
            full = np.zeros((size[0], *sides), "<f4")
            part = volume[:, _chunk_slice(i, sides[0], size[1]), _chunk_slice(k, sides[1], size[2])]
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
        """Return the OME metadata and the records of the volumes."""
        layout = self.layout
        spacing = (math.nan, math.nan, *layout.voxel)
        ranges = [record["range"] for record in self.records]
        limits = (
            min((a for a, _ in ranges), default=0.0),
            max((b for _, b in ranges), default=0.0),
        )
        scales = multiscales(self.path, self._sizes, _AXES, spacing, layout.depth, layout.first)
        return {
            "multiscales": [scales],
            "omero": omero(("intensity",), [limits], colour=False),
            "clplen": {**layout.about, "records": self.records},
            "software": MARK,
        }


def _chunk_indices(size: tuple[int, ...], sides: tuple[int, int]) -> Iterator[tuple[int, int]]:
    rows, columns = (range(-(-n // side)) for n, side in zip(size[-2:], sides, strict=True))
    return ((i, k) for i in rows for k in columns)


def _chunk_slice(number: int, side: int, total: int) -> slice:
    return slice(number * side, min((number + 1) * side, total))


def _read_json(path: Path) -> Any:
    if not path.is_file():  # a pipe would block
        raise FileNotFoundError(f"There is no file {path}.")
    return json.loads(path.read_text(encoding="utf-8"))


def _write_json(path: Path, values: dict[str, Any]) -> None:
    with replacing(path, durable=True) as temporary:
        temporary.write_text(json.dumps(values), encoding="utf-8")
