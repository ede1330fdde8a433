"""Which parts of a stored light field are read in turn, so that a budget of memory suffices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from clplen.checks import is_integer
from clplen.compute.device import Device
from clplen.compute.memory import free_memory
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.focal_stacks import MemoryEstimate
from clplen.reprs import OneLine

_LEAST = 16  # rows and columns that a tile writes, at least
_ALIGNED = 16  # columns: where vectors of a row begin
_RESERVE = 16  # one part in so many of the budget for tables, programs and what is not counted
_AGAIN = 2.0  # how often all may be read before a copy of plain samples pays
_WORTH = 1.15  # times the pixels of the best tiles: below it, wide tiles are taken
_ROUNDED = 1.5  # how much more than the tiles themselves makes a source slow in bands


@dataclass(frozen=True)
class Tile:
    """A part of the picture: what is written, and what is read for it (clipped at the edges).

    Attributes
    ----------
    rows, columns : slice
        What is written.
    outer_rows, outer_columns : slice
        What is read for it.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 16, 20))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     tile = clplen.lightfield.stack_tiles(stored, disparities=[0, 1]).plan.tiles[0]
    ...     print(tile.rows, tile.columns)
    slice(0, 16, None) slice(0, 20, None)
    """

    rows: slice
    columns: slice
    outer_rows: slice
    outer_columns: slice

    @property
    def inside(self) -> tuple[slice, slice]:
        """Where what is written lies in what is read."""
        pairs = ((self.rows, self.outer_rows), (self.columns, self.outer_columns))
        y, x = (slice(a.start - b.start, a.stop - b.start) for a, b in pairs)
        return y, x

    @property
    def outer_shape(self) -> tuple[int, int]:
        """(rows, columns) that are read."""
        y, x = (part.stop - part.start for part in (self.outer_rows, self.outer_columns))
        return y, x


@dataclass(frozen=True, repr=False)
class StreamPlan(OneLine):
    """How a light field is taken through memory part by part. Printed, it says so in a few lines.

    Attributes
    ----------
    tiles : tuple of Tile
        In the order in which they are written.
    planes : tuple of slice
        Groups of planes of each tile.
    halo : tuple of int
        (y, x) pixels that shears and windows need around a tile.
    passes : int
        How often all samples are read.
    bytes_read : int
        From the source, with halos and whole chunks.
    bytes_peak : int
        Largest need of memory, on the host and the device together.
    bytes_scratch : int
        Of the temporary file that the views are copied to first; 0 for none.
    band_rows : int
        Full rows that a pass before that over the tiles reads at a time; 0 without one.
    memory : int
        The budget in bytes.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 16, 20))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     plan = clplen.lightfield.stack_tiles(stored, disparities=[0, 1]).plan
    ...     print(len(plan.tiles), plan.passes)
    1 1
    """

    tiles: tuple[Tile, ...]
    planes: tuple[slice, ...]
    halo: tuple[int, int]
    passes: int
    bytes_read: int
    bytes_peak: int
    bytes_scratch: int
    band_rows: int
    memory: int

    @property
    def in_core(self) -> bool:
        """Whether one tile is everything."""
        return len(self.tiles) == 1

    @property
    def outer_shape(self) -> tuple[int, int]:
        """(rows, columns) of the largest tile that is read."""
        rows, columns = zip(*(tile.outer_shape for tile in self.tiles), strict=True)
        return max(rows), max(columns)

    def __str__(self) -> str:
        rows, columns = self.outer_shape
        lines = [
            f"{len(self.tiles)} tile{'s'[: len(self.tiles) > 1]} of up to {rows} x {columns} "
            f"pixels with a halo of {self.halo[0]} x {self.halo[1]}"
            + (", all in core" if self.in_core else ""),
            f"{_mib(self.bytes_read)} read in {self.passes} pass{'es'[: 2 * (self.passes > 1)]}, "
            f"planes in {len(self.planes)} group{'s'[: len(self.planes) > 1]}",
            f"{_mib(self.bytes_peak)} of memory at most, of {_mib(self.memory)}",
        ]
        if self.bytes_scratch:
            lines.append(f"{_mib(self.bytes_scratch)} copied to a temporary file first")
        return "\n".join(lines)


def plan_tiles(
    source: LightField | StoredLightField,
    estimates: Sequence[MemoryEstimate],
    *,
    memory: int | None,
    device: Device,
) -> StreamPlan:
    """Return the largest tiles that fit: full rows, or parts where their halos cost less.

    A light field on a device is one tile, and nothing is read.
    """
    if isinstance(source, LightField):
        ny, nx, one = *source.shape[2:4], estimates[0]
        need = source.data.nbytes + ny * nx * (one.per_pixel + one.kept)
        tiles = bands((ny, nx), ny)
        return StreamPlan(tiles, one.planes, one.halo, 1, 0, need, 0, ny, need)
    memory = memory_budget(memory, device)
    for estimate in estimates:
        plan = _planned(source, estimate, _Budget.of(source, estimate, memory, device))
        if plan is not None:
            return plan
    least = min(
        _least(source, estimate, _Budget.of(source, estimate, 1, device)) for estimate in estimates
    )
    raise ValueError(
        f"{estimates[0].what} of {source!r} does not fit into memory={memory:,} bytes: its "
        f"smallest tile, with what the planes shift into it, needs {least:,}; give that, or fewer "
        "or nearer planes."
    )


def memory_budget(memory: int | None, device: Device) -> int:
    """The bytes that may be taken: as given, or half of what is free on host and device."""
    if memory is None:
        memory = min(free_memory(), device.memory_bytes) // 2
    if not is_integer(memory) or memory < 1:
        raise ValueError(f"memory is a positive number of bytes, not {memory!r}.")
    return int(memory)


def bands(size: tuple[int, ...], rows: int) -> tuple[Tile, ...]:
    """Tiles of a picture (y, x): at most so many full rows each, without a halo."""
    ny, nx = size[:2]
    parts = [slice(y, min(y + rows, ny)) for y in range(0, ny, rows)]
    return tuple(Tile(part, slice(0, nx), part, slice(0, nx)) for part in parts)


@dataclass(frozen=True)
class _Budget:
    """What tiles may need: fixed bytes, bytes a pixel, and bytes of the largest array a pixel."""

    memory: int
    fixed: int
    pixel: int
    largest: int
    before: int  # bytes before and after the pass over the tiles
    row: int  # bytes of a row in those passes
    whole: int  # fixed bytes and bytes a pixel if everything is one tile
    limit: int  # bytes of one array on the device
    on_device: int

    @classmethod
    def of(
        cls, source: StoredLightField, estimate: MemoryEstimate, memory: int, device: Device
    ) -> _Budget:
        pixels = source.shape[2] * source.shape[3]
        samples = source.bytes_per_pixel
        copies = 1 if device.is_cpu else 2
        most = max(estimate.per_pixel + estimate.kept, estimate.before)
        limit = min(device.memory_bytes, int(device.cl_device.max_mem_alloc_size))
        return cls(
            memory,
            estimate.kept * pixels + source.overhead,
            2 * samples + estimate.per_pixel,
            max(samples, estimate.largest),
            estimate.before * pixels + source.overhead,
            2 * samples * source.shape[3] if estimate.passes > 1 else 0,
            source.overhead + pixels * (copies * samples + most),
            limit,
            device.memory_bytes,
        )

    @property
    def usable(self) -> int:
        return self.memory - -(-self.memory // _RESERVE)

    def need(self, pixels: int) -> int:
        return max(self.fixed + pixels * self.pixel, self.before + self.row)

    @property
    def band_rows(self) -> int:
        """Full rows that a pass before may read at a time; 0 if none fits, or there is no such."""
        room = min(self.usable - self.before, self.on_device)
        return max(min(room, self.limit), 0) // self.row if self.row else 0

    def pixels(self) -> int:
        """Pixels that a tile may read."""
        room = min(self.usable - self.fixed, self.on_device)
        return max(min(room // self.pixel, self.limit // self.largest), 0)


def _planned(
    source: StoredLightField, estimate: MemoryEstimate, budget: _Budget
) -> StreamPlan | None:
    ny, nx = source.shape[2:4]
    everything = Tile(slice(0, ny), slice(0, nx), slice(0, ny), slice(0, nx))
    fits = budget.whole <= min(budget.usable, budget.on_device)
    if fits and ny * nx * budget.largest <= budget.limit:
        return _plan(source, estimate, (everything,), budget, budget.whole)
    result = []
    for columns in _column_cuts(nx, estimate.halo[1]):
        width = max(outer.stop - outer.start for _, outer in columns)
        rows = _row_cuts(ny, estimate.halo[0], budget.pixels() // width)
        if rows is None:
            continue
        result.append(tuple(Tile(y, x, oy, ox) for y, oy in rows for x, ox in columns))
    if not result or (estimate.passes > 1 and budget.band_rows < 1):
        return None
    best = min(result, key=_area)
    if _area(result[0]) < _WORTH * _area(best):  # the widest, full rows if they fit at all
        best = result[0]
    largest = max(math.prod(tile.outer_shape) for tile in best)
    plan = _plan(source, estimate, best, budget, budget.need(largest))
    return None if plan.bytes_scratch and _to_copy(source) > budget.usable else plan


def _plan(
    source: StoredLightField,
    estimate: MemoryEstimate,
    tiles: tuple[Tile, ...],
    budget: _Budget,
    peak: int,
) -> StreamPlan:
    samples = source.bytes_per_pixel
    passes = 1 if len(tiles) == 1 else estimate.passes
    chunked = sum(_chunked(source, tile) for tile in tiles)
    read = passes * chunked * samples
    slow = chunked > _ROUNDED * _area(tiles) and read > _AGAIN * source.nbytes
    scratch = source.nbytes if slow and len(tiles) > 2 else 0
    return StreamPlan(
        tiles,
        estimate.planes,
        estimate.halo,
        passes,
        scratch or read,
        peak,
        scratch,
        min(budget.band_rows, source.shape[2]),
        budget.memory,
    )


def _area(tiles: tuple[Tile, ...]) -> int:
    return sum(math.prod(tile.outer_shape) for tile in tiles)


def _chunked(source: StoredLightField, tile: Tile) -> int:
    """Pixels that are read for a tile in whole chunks; parts of single rows are read alone."""
    pixels = 1
    parts = (tile.outer_rows, tile.outer_columns)
    for part, chunk, size in zip(parts, source.chunks, source.shape[2:4], strict=True):
        pixels *= min(-(-part.stop // chunk) * chunk, size) - part.start // chunk * chunk
    return math.prod(tile.outer_shape) if source.chunks[0] == 1 else pixels


def _to_copy(source: StoredLightField) -> int:
    """Bytes of memory that copying the views takes, those that are read at once."""
    views = math.prod(min(a, b) for a, b in zip(source.views_at_once, source.shape, strict=False))
    return source.overhead + views * (source.nbytes // math.prod(source.shape[:2]))


Cuts = list[tuple[slice, slice]]


def _cuts(size: int, halo: int, middle: int) -> Cuts:
    """(written, read) parts of an axis: all are read over the same length, middle + 2 halo."""
    count = -(-(size - 2 * halo) // middle)
    if size <= 2 * halo or count < 2:
        return [(slice(0, size), slice(0, size))]
    length, start, parts = middle + 2 * halo, 0, []
    for index in range(count):
        first = min(max(start - halo, 0), size - length)
        stop = size if index == count - 1 else first + length - halo
        parts.append((slice(start, stop), slice(first, first + length)))
        start = stop
    return parts


def _row_cuts(size: int, halo: int, most: int) -> Cuts | None:
    """The fewest bands of at most so many rows each; None if they are too low."""
    if most >= size:
        return _cuts(size, halo, size)
    if most < 2 * halo + min(_LEAST, size) or size <= 2 * halo:
        return None
    count = -(-(size - 2 * halo) // (most - 2 * halo))
    return _cuts(size, halo, -(-(size - 2 * halo) // count))


def _column_cuts(size: int, halo: int) -> list[Cuts]:
    """Full rows first, then rows in two parts, three and so on."""
    wide = -(-halo // _ALIGNED) * _ALIGNED
    result, middle = [_cuts(size, wide, size)], 0
    for count in range(2, max(size // _LEAST, 1) + 1):
        part = -(-(size - 2 * wide) // count)
        if part < 1:
            break
        if (wider := -(-part // _ALIGNED) * _ALIGNED) != middle:
            middle = wider
            result.append([(x, _aligned(outer)) for x, outer in _cuts(size, wide, middle)])
    return [cuts for i, cuts in enumerate(result) if i == 0 or len(cuts) > 1]


def _aligned(part: slice) -> slice:
    """From a place on where vectors of a row begin."""
    return slice(part.start // _ALIGNED * _ALIGNED, part.stop)


def _least(source: StoredLightField, estimate: MemoryEstimate, budget: _Budget) -> int:
    """A budget that is enough for the smallest tile."""
    ny, nx = source.shape[2:4]
    width = min(
        max(o.stop - o.start for _, o in cuts) for cuts in _column_cuts(nx, estimate.halo[1])
    )
    height = min(2 * estimate.halo[0] + min(_LEAST, ny), ny)
    need = min(budget.need(height * width), budget.whole)
    if source.chunks[0] > 1:
        need = max(need, _to_copy(source))
    return -(-need * _RESERVE // (_RESERVE - 1)) + _RESERVE


def _mib(count: int) -> str:
    return f"{count / 2**20:,.1f} MiB"
