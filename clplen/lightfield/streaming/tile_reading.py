"""Reading of tiles in a thread, from a temporary copy where that is faster."""

from __future__ import annotations

import errno
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.compute.device import Device, DeviceLike, as_device
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import (
    Array,
    Block,
    StoredLightField,
    as_lightfield,
)
from clplen.lightfield.streaming.tile_plan import StreamPlan, Tile

Source = LightField | StoredLightField  # sources of tiles; a light field on a device is one tile
Progress = Callable[[int, int], None]

_MAX_REQUEST = 1 << 30  # bytes of one request


@dataclass(frozen=True)
class RawSamples:
    """Plain samples in a file, read by requests (mapped pages would count as memory)."""

    file: int  # Descriptor of the open file
    offset: int  # Bytes before the first sample
    shape: tuple[int, ...]  # In the order of the file, the last axis fastest
    dtype: np.dtype[Any]

    def read(self, selection: tuple[slice, ...], out: Array | None = None) -> Array:
        """Read the samples of a slice of each axis."""
        size = tuple(part.stop - part.start for part in selection)
        out = np.empty(size, self.dtype) if out is None else out
        steps = [math.prod(self.shape[axis + 1 :]) for axis in range(len(size))]
        first = sum(part.start * step for part, step in zip(selection, steps, strict=True))
        axis = len(size) - 1
        while axis > 0 and size[axis] == self.shape[axis]:
            axis -= 1  # from this axis on, samples are contiguous
        for index in np.ndindex(*size[:axis]):
            index_offset = first + sum(i * step for i, step in zip(index, steps, strict=False))
            self._fetch(
                out[index].reshape(-1).view(np.uint8), self.offset + index_offset * out.itemsize
            )
        return out

    def _fetch(self, out: Array, at: int) -> None:
        done = 0
        while done < out.size:
            count = os.preadv(self.file, [out[done : done + _MAX_REQUEST].data], at + done)
            if count == 0:
                raise EOFError(f"it ends after {at + done:,} bytes")
            done += count


def require_disk(nbytes: int) -> None:
    """Reject a temporary file that exceeds the free space of the disk."""
    folder = tempfile.gettempdir()
    free = shutil.disk_usage(folder).free
    if nbytes > free:
        raise OSError(
            errno.ENOSPC,
            f"The views need a temporary file of {nbytes:,} bytes, but {folder} has only {free:,} "
            "bytes free; set TMPDIR to a larger disk, or pass a larger memory=.",
        )


@contextmanager
def spooled(source: StoredLightField) -> Iterator[StoredLightField]:
    """Copy a light field to an unnamed temporary file, from which bands are read quickly.

    The views are copied in the groups in which they are stored; the file is in ``$TMPDIR``.
    """
    require_disk(source.nbytes)
    with tempfile.TemporaryFile(prefix="clplen-") as file:
        _copy_views(source, file.fileno())
        samples = RawSamples(file.fileno(), 0, source.shape, source.dtype)
        colours = tuple(slice(0, n) for n in source.shape[4:])

        def fill(block: Block, out: Array) -> None:
            samples.read((*block, *colours), out)

        yield replace(
            source, fill=fill, chunks=(1, source.shape[3]), views_at_once=(1, 1), overhead=0
        )


def _copy_views(source: StoredLightField, file: int) -> None:
    V, U, ny, nx = source.shape[:4]
    size = source.nbytes // (V * U)
    down, across = source.views_at_once
    buffer = np.empty(min(down, V) * min(across, U) * size, np.uint8)
    for v, u in source.groups():
        shape = (v.stop - v.start, u.stop - u.start, *source.shape[2:])
        out = buffer[: shape[0] * shape[1] * size].view(source.dtype).reshape(shape)
        source.read((v, u, slice(0, ny), slice(0, nx)), out=out)
        for i, row in enumerate(out):
            at = ((v.start + i) * U + u.start) * size
            _store(file, row.reshape(-1).view(np.uint8), at)


def _store(file: int, values: Array, at: int) -> None:
    done = 0
    while done < values.size:
        done += os.pwrite(file, values[done : done + _MAX_REQUEST].data, at + done)


@contextmanager
def fast_source(source: Source, plan: StreamPlan) -> Iterator[Source]:
    """Yield the source, or a copy of its samples for fast reading of tiles."""
    if isinstance(source, LightField) or not plan.bytes_scratch:
        yield source
        return
    with spooled(source) as copied:
        yield copied


def as_source(lf: Any, device: DeviceLike | None) -> tuple[Source, Device]:
    """Return a light field as a source of tiles, an array on a device, and the device."""
    if isinstance(lf, StoredLightField):
        return lf, as_device(device)
    lf = as_lightfield(lf, device=device)
    return lf, lf.device


def read_tiles(
    source: Source, tiles: tuple[Tile, ...], device: Device, progress: Progress | None
) -> Iterator[tuple[Tile, LightField]]:
    """Yield tiles on the device, while a thread reads the next tile into one buffer.

    The caller must release a tile before the next one, so that only one exists.
    """
    if isinstance(source, LightField):
        yield tiles[0], source
        _report(progress, 1, 1)
        return
    if len(tiles) == 1 and tiles[0].outer_shape == source.shape[2:4]:
        yield tiles[0], source.load(device)
        _report(progress, 1, 1)
        return
    max_pixels = max(tile.outer_shape[0] * tile.outer_shape[1] for tile in tiles)
    buffer = np.empty(max_pixels * source.bytes_per_pixel, np.uint8)
    last: tuple[int, int] | None = None
    with ThreadPoolExecutor(1, thread_name_prefix="clplen-reading") as reader:
        pending = reader.submit(_read, source, tiles[0], buffer)
        for number, tile in enumerate(tiles, 1):
            if last not in (None, tile.outer_shape):
                device.free_spare()
            last = tile.outer_shape
            lf = source.part(pending.result(), device)
            if number < len(tiles):
                pending = reader.submit(_read, source, tiles[number], buffer)
            yield tile, lf
            del lf
            _report(progress, number, len(tiles))
    device.free_spare()


def _read(source: StoredLightField, tile: Tile, buffer: Array) -> Array:
    V, U, *_ = source.shape
    shape = (V, U, *tile.outer_shape, *source.shape[4:])
    size = int(np.prod(shape, dtype=np.int64)) * source.dtype.itemsize
    out = buffer[:size].view(source.dtype).reshape(shape)
    return source.read((slice(0, V), slice(0, U), tile.outer_rows, tile.outer_columns), out=out)


def _report(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)
