"""Plan of the tiles of a stored light field for a budget of memory."""

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

_MIN_TILE = 16  # minimum rows and columns that a tile writes
_ALIGNMENT = 16  # columns at which vectors of a row begin
_RESERVE = 16  # one part in this many of the budget is reserved for tables, programs and overhead
_MAX_PASSES = 2.0  # passes over plain samples above which a temporary copy pays off
# Times the pixels of the best tiles: limit up to which wide tiles are preferred
_WIDE_TILE_RATIO = 1.15
_MAX_CHUNK_RATIO = 1.5  # times the tiles' own pixels: above it a source is slow in bands


@dataclass(frozen=True)
class Tile:
    """A part of the picture: the area written and the area read for it (clipped at the edges).

    Attributes
    ----------
    rows, columns : slice
        Area that is written.
    outer_rows, outer_columns : slice
        Area that is read.

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
        """Slices of the written area within the area that is read."""
        pairs = ((self.rows, self.outer_rows), (self.columns, self.outer_columns))
        y, x = (slice(a.start - b.start, a.stop - b.start) for a, b in pairs)
        return y, x

    @property
    def outer_shape(self) -> tuple[int, int]:
        """Size (rows, columns) of the area that is read."""
        y, x = (part.stop - part.start for part in (self.outer_rows, self.outer_columns))
        return y, x


@dataclass(frozen=True, repr=False)
class StreamPlan(OneLine):
    """Plan of processing a light field in parts; printing gives a summary.

    Attributes
    ----------
    tiles : tuple of Tile
        Tiles in the order in which they are written.
    planes : tuple of slice
        Groups of planes of each tile.
    halo : tuple of int
        Pixels (y, x) around a tile for shears and windows.
    passes : int
        Number of passes over all samples.
    bytes_read : int
        Bytes read from the source, with halos and whole chunks.
    bytes_peak : int
        Peak memory in bytes, on the host and the device together.
    bytes_scratch : int
        Bytes of a temporary copy of the views; 0 for none.
    band_rows : int
        Full rows read at a time by a pass before the tiles; 0 without one.
    memory : int
        Budget in bytes.

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
        """True if a single tile covers everything."""
        return len(self.tiles) == 1

    @property
    def outer_shape(self) -> tuple[int, int]:
        """Size (rows, columns) of the largest tile that is read."""
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
            f"{_mib(self.bytes_peak)} of memory at most, out of {_mib(self.memory)}",
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
    """Choose the largest tiles that fit: full rows, or parts if their halos cost less.

    A light field on a device is one tile, without any reading.
    """
    if isinstance(source, LightField):
        ny, nx, first_estimate = *source.shape[2:4], estimates[0]
        need = source.data.nbytes + ny * nx * (
            first_estimate.per_pixel + first_estimate.result_bytes
        )
        tiles = bands((ny, nx), ny)
        return StreamPlan(
            tiles, first_estimate.planes, first_estimate.halo, 1, 0, need, 0, ny, need
        )
    memory = memory_budget(memory, device)
    for estimate in estimates:
        plan = _planned(source, estimate, _Budget.of(source, estimate, memory, device))
        if plan is not None:
            return plan
    min_bytes = min(
        _min_budget(source, estimate, _Budget.of(source, estimate, 1, device))
        for estimate in estimates
    )
    raise ValueError(
        f"{estimates[0].subject} of {source!r} does not fit into memory={memory:,} bytes: its "
        f"smallest tile, with what the planes shift into it, needs {min_bytes:,}; pass that, fewer "
        "planes, or planes nearer to 0."
    )


def memory_budget(memory: int | None, device: Device) -> int:
    """Return the budget in bytes: ``memory``, or half of the free memory of host and device."""
    if memory is None:
        memory = min(free_memory(), device.memory_bytes) // 2
    if not is_integer(memory) or memory < 1:
        raise ValueError(f"memory must be a positive number of bytes, got {memory!r}.")
    return int(memory)


def bands(size: tuple[int, ...], rows: int) -> tuple[Tile, ...]:
    """Split a picture (y, x) into bands of up to ``rows`` full rows, without a halo."""
    ny, nx = size[:2]
    parts = [slice(y, min(y + rows, ny)) for y in range(0, ny, rows)]
    return tuple(Tile(part, slice(0, nx), part, slice(0, nx)) for part in parts)


@dataclass(frozen=True)
class _Budget:
    """Memory of tiles: fixed bytes, bytes a pixel, and bytes a pixel of the largest array."""

    memory: int
    fixed: int
    pixel: int
    largest: int
    before: int  # bytes before and after the pass over the tiles
    row: int  # bytes of a row in those passes
    in_core: int  # bytes if everything is one tile
    limit: int  # bytes of one array on the device
    on_device: int

    @classmethod
    def of(
        cls, source: StoredLightField, estimate: MemoryEstimate, memory: int, device: Device
    ) -> _Budget:
        pixels = source.shape[2] * source.shape[3]
        samples = source.bytes_per_pixel
        copies = 1 if device.is_cpu else 2
        pixel_bytes = max(estimate.per_pixel + estimate.result_bytes, estimate.before)
        limit = min(device.memory_bytes, int(device.cl_device.max_mem_alloc_size))
        return cls(
            memory,
            estimate.result_bytes * pixels + source.overhead,
            2 * samples + estimate.per_pixel,
            max(samples, estimate.largest),
            estimate.before * pixels + source.overhead,
            2 * samples * source.shape[3] if estimate.passes > 1 else 0,
            source.overhead + pixels * (copies * samples + pixel_bytes),
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
        """Full rows of a pass before the tiles; 0 without such a pass or enough memory."""
        room = min(self.usable - self.before, self.on_device)
        return max(min(room, self.limit), 0) // self.row if self.row else 0

    def pixels(self) -> int:
        """Return the pixels that a tile may read."""
        room = min(self.usable - self.fixed, self.on_device)
        return max(min(room // self.pixel, self.limit // self.largest), 0)


def _planned(
    source: StoredLightField, estimate: MemoryEstimate, budget: _Budget
) -> StreamPlan | None:
    ny, nx = source.shape[2:4]
    whole_picture = Tile(slice(0, ny), slice(0, nx), slice(0, ny), slice(0, nx))
    fits = budget.in_core <= min(budget.usable, budget.on_device)
    if fits and ny * nx * budget.largest <= budget.limit:
        return _plan(source, estimate, (whole_picture,), budget, budget.in_core)
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
    if _area(result[0]) < _WIDE_TILE_RATIO * _area(best):  # the widest tiles, full rows if possible
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
    slow = chunked > _MAX_CHUNK_RATIO * _area(tiles) and read > _MAX_PASSES * source.nbytes
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
    """Return the pixels read for a tile in whole chunks; single-row chunks read no excess."""
    pixels = 1
    parts = (tile.outer_rows, tile.outer_columns)
    for part, chunk, size in zip(parts, source.chunks, source.shape[2:4], strict=True):
        pixels *= min(-(-part.stop // chunk) * chunk, size) - part.start // chunk * chunk
    return math.prod(tile.outer_shape) if source.chunks[0] == 1 else pixels


def _to_copy(source: StoredLightField) -> int:
    """Return the bytes of memory needed to copy the views in groups."""
    views = math.prod(min(a, b) for a, b in zip(source.views_at_once, source.shape, strict=False))
    return source.overhead + views * (source.nbytes // math.prod(source.shape[:2]))


Cuts = list[tuple[slice, slice]]


def _cuts(size: int, halo: int, middle: int) -> Cuts:
    """Split an axis into (written, read) parts, all read over the length middle + 2 halo."""
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


def _row_cuts(size: int, halo: int, max_rows: int) -> Cuts | None:
    """Return the fewest bands of at most ``max_rows`` rows each; None if they are too low."""
    if max_rows >= size:
        return _cuts(size, halo, size)
    if max_rows < 2 * halo + min(_MIN_TILE, size) or size <= 2 * halo:
        return None
    count = -(-(size - 2 * halo) // (max_rows - 2 * halo))
    return _cuts(size, halo, -(-(size - 2 * halo) // count))


def _column_cuts(size: int, halo: int) -> list[Cuts]:
    """Return full rows first, then rows in two parts, three and so on."""
    aligned_halo = -(-halo // _ALIGNMENT) * _ALIGNMENT
    result, middle = [_cuts(size, aligned_halo, size)], 0
    for count in range(2, max(size // _MIN_TILE, 1) + 1):
        part = -(-(size - 2 * aligned_halo) // count)
        if part < 1:
            break
        if (aligned := -(-part // _ALIGNMENT) * _ALIGNMENT) != middle:
            middle = aligned
            result.append([(x, _aligned(outer)) for x, outer in _cuts(size, aligned_halo, middle)])
    return [cuts for i, cuts in enumerate(result) if i == 0 or len(cuts) > 1]


def _aligned(part: slice) -> slice:
    """Extend a part to the start of a vector of the row."""
    return slice(part.start // _ALIGNMENT * _ALIGNMENT, part.stop)


def _min_budget(source: StoredLightField, estimate: MemoryEstimate, budget: _Budget) -> int:
    """Return a budget that suffices for the smallest tile."""
    ny, nx = source.shape[2:4]
    width = min(
        max(o.stop - o.start for _, o in cuts) for cuts in _column_cuts(nx, estimate.halo[1])
    )
    height = min(2 * estimate.halo[0] + min(_MIN_TILE, ny), ny)
    need = min(budget.need(height * width), budget.in_core)
    if source.chunks[0] > 1:
        need = max(need, _to_copy(source))
    return -(-need * _RESERVE // (_RESERVE - 1)) + _RESERVE


def _mib(count: int) -> str:
    return f"{count / 2**20:,.1f} MiB"
