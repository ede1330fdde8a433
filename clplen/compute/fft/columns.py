"""Maps along both axes on the host, in blocks that fit in the cache.

First the lines along x run on a few rows at a time and transpose the array. Then, for a few
columns at a time, everything along y runs, with the product in the middle. Last, the lines along x
run again and transpose back. All transforms except those along x thus read contiguous samples.
Zeros are not transformed along x, and the padded array is never allocated.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from threading import Event
from typing import Any, TypeVar

import numpy as np

from clplen.compute.fft.lines import Line, Separable
from clplen.compute.fft.plans import Slots, Workspace
from clplen.compute.fft.routes import FFTRoute
from clplen.types import Array

Part = TypeVar("Part")  # part of the work
State = TypeVar("State")  # private state of a thread


def share(
    work: Callable[[Part, State], None], parts: Sequence[Part], states: Sequence[State]
) -> None:
    """Apply ``work`` to every part, in the calling thread and a thread per further state."""
    queue, failed = iter(parts), Event()

    def run(state: State) -> None:
        try:
            for part in queue:
                if failed.is_set():
                    return
                work(part, state)
        except BaseException:
            failed.set()
            raise

    futures: list[Future[None]] = []
    full: ThreadPoolExecutor | None = None
    try:
        for state in states[1 : len(parts)]:
            futures.append(_thread_pool(len(states) - 1).submit(run, state))
    except RuntimeError:  # no memory for another thread: the caller and the running threads go on
        full = _thread_pool(len(states) - 1)
        _thread_pool.cache_clear()
    try:
        run(states[0])
    finally:
        if full is not None:  # work that got no thread is queued nevertheless
            full.shutdown(cancel_futures=True)
        running = [future for future in futures if not future.cancel()]
        try:
            wait(running)
        except BaseException:  # an interrupt; the threads use arrays of the caller
            failed.set()
            wait(running)
            raise
    for future in running:
        future.result()


@cache
def _thread_pool(count: int) -> ThreadPoolExecutor:
    """Return a pool of threads; a forked process creates a new pool."""
    return ThreadPoolExecutor(count, thread_name_prefix="clplen-blocks")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_thread_pool.cache_clear)


BLOCK_BYTES = 2**20  # maximum bytes of a block, about the cache of a core
SMALL_BYTES = 2**19  # minimum bytes of a block that outweigh the overhead of a thread
MIN_BLOCK_LINES = 16  # minimum number of rows or columns of a block
MAX_BLOCK_LINES = 48  # maximum number, unless lines are shorter than SMALL_BYTES / 48
ROW_GAP = 16  # samples between rows, so that columns spread over the sets of the cache
INTO, BACK = (0, 1), (2, 3)  # slots (window, transform) before and after the product
FACTORS = 4  # first slot of the factors of a block


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of a 2-D spectrum on the host, transposed: columns are stored as rows.

    Attributes
    ----------
    values : numpy.ndarray
        Complex, shape (mx, my), or the quadrant (mx//2 + 1, my//2 + 1) if even along both axes.
    shape : tuple of int
        (my, mx).
    lit : numpy.ndarray, optional
        Flags of stored columns, bool: False if all factors of a column are zero. None: all True.
    is_conjugated : bool
        True if the factors are the conjugates of ``values``.
    """

    values: Array
    shape: tuple[int, int]
    lit: Array | None = None
    is_conjugated: bool = False

    @property
    def is_mirrored(self) -> bool:
        """True if columns are stored up to the middle only: column k is also column mx - k."""
        return self.values.shape[0] < self.shape[1]

    def lit_columns(self) -> Array:
        """Return flags of all mx columns: True if a column has factors other than zero."""
        if self.lit is None:
            return np.ones(self.shape[1], np.bool_)
        column = np.arange(self.shape[1])
        return (
            self.lit[np.minimum(column, self.shape[1] - column)] if self.is_mirrored else self.lit
        )

    def load(self, chosen: slice, out: Array) -> None:
        """Copy some of the stored columns to ``out`` (columns, my), unfolded along y."""
        stored = self.values[chosen]
        rows = stored.shape[1]
        if self.is_conjugated:
            np.conjugate(stored, out=out[:, :rows])
            stored = out[:, :rows]
        else:
            out[:, :rows] = stored
        out[:, rows:] = stored[:, 1 : self.shape[0] - rows + 1][:, ::-1]


@dataclass(frozen=True, eq=False)
class Product:
    """Product with factors, and the maps along both axes after it."""

    factors: Factors
    back: Separable


def run_on_host(
    source: Array,
    into: Separable,
    products: Sequence[Product],
    targets: Sequence[Array],
    fft: FFTRoute,
    workspace: Workspace,
) -> None:
    """Fill ``targets``, with an array for each product, or a single array without products."""
    count, ny, _ = source.shape
    width = into.shape_after(source.shape[-2:])[1]
    with ExitStack() as stack:

        def borrow(rows: int) -> Array:
            """Return a transposed array for the rows of all fields, (width, n rows)."""
            shape = (width, count * rows + ROW_GAP)
            return stack.enter_context(workspace.borrow(shape, source.dtype))[:, :-ROW_GAP]

        team = _Team(fft)
        first = borrow(ny)
        team.rows(source.reshape(count * ny, -1), into.x, first.T, ny)
        if not products:
            team.columns(_by_field(first, count), into.y, targets[0])
            return
        heights = [product.back.shape_after(product.factors.shape)[0] for product in products]
        between = [borrow(height) for height in heights[:-1]]
        between.append(first if heights[-1] == ny else borrow(heights[-1]))
        views = [_by_field(columns, count) for columns in between]
        team.filtered(_by_field(first, count), into.y, products, views)
        for columns, product, target, height in zip(
            between, products, targets, heights, strict=True
        ):
            out = target.reshape(count * height, -1)
            team.rows(columns.T, product.back.x, out, height)


def _by_field(turned: Array, count: int) -> Array:
    """Return a view (width, n, rows) of an array (width, n rows)."""
    return turned.reshape(len(turned), count, turned.shape[1] // count)


class _Team:
    """Threads that share the blocks of an array."""

    def __init__(self, fft: FFTRoute) -> None:
        self.workers = [_Worker(fft) for _ in range(fft.threads)]

    def rows(self, source: Array, lines: tuple[Line, ...], target: Array, ny: int) -> None:
        """Apply ``lines`` along x of fields with ny rows each, (n ny, nx) to (n ny, mx)."""
        longest = max((line.length for line in lines), default=1)

        def some(chosen: slice, worker: _Worker) -> None:
            worker.apply(source[chosen], lines, INTO, target=target[chosen])

        share(some, _row_ranges(len(source), ny, longest * source.itemsize), self.workers)

    def columns(self, source: Array, lines: tuple[Line, ...], target: Array) -> None:
        """Apply ``lines`` along y of transposed fields, (mx, n, ny) to (n, my, mx)."""
        longest = max((line.length for line in lines), default=1)

        def some(chosen: slice, worker: _Worker) -> None:
            for field, out in enumerate(target):
                worker.apply(source[chosen, field], lines, INTO, target=out.T[chosen])

        share(some, _ranges(range(len(source)), longest * source.itemsize), self.workers)

    def filtered(
        self,
        source: Array,
        lines: tuple[Line, ...],
        products: Sequence[Product],
        targets: Sequence[Array],
    ) -> None:
        """Apply ``lines`` along y of transposed fields (mx, n, ny), each product, and its maps.

        ``source`` is overwritten; the last target may share its memory. Columns whose factors are
        all zero are not transformed.
        """
        factors = [product.factors for product in products]

        def block(chosen: slice, loaded: Sequence[Array], worker: _Worker) -> None:
            for field in range(source.shape[1]):
                values = worker.apply(source[chosen, field], lines, INTO)
                for number, (product, target) in enumerate(zip(products, targets, strict=True)):
                    filtered = values
                    if number < len(products) - 1:
                        filtered = worker.take(BACK[1], values.shape, values.dtype)
                    np.multiply(values, loaded[number], out=filtered)
                    out = target[chosen, field]
                    worker.apply(filtered, product.back.y, BACK, in_place=True, target=out)

        def some(part: list[slice], worker: _Worker) -> None:
            stored, *mirrored = part
            loaded = [worker.load(table, stored, FACTORS + i) for i, table in enumerate(factors)]
            block(stored, loaded, worker)
            for chosen in mirrored:
                first = factors[0].shape[1] - chosen.stop + 1 - stored.start
                mirror = slice(first, first + chosen.stop - chosen.start)
                reflected = [
                    values[mirror][::-1]
                    if table.is_mirrored
                    else worker.load(table, chosen, FACTORS + i)
                    for i, (table, values) in enumerate(zip(factors, loaded, strict=True))
                ]
                block(chosen, reflected, worker)

        def dark(chosen: slice, _: _Worker) -> None:
            for target in targets:
                target[chosen] = 0

        share(dark, _dark_ranges(factors, source.itemsize), self.workers)
        share(some, _column_ranges(factors, source.itemsize), self.workers)


class _Worker:
    """State of a thread: its scratch arrays, and the maps that it applies to blocks of lines."""

    def __init__(self, fft: FFTRoute) -> None:
        self.fft, self.slots = fft, Slots()
        self.framed: dict[int, tuple[Line, int]] = {}  # windows whose margins are zero

    def take(self, slot: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        """Return a slot's array, with gaps between its lines."""
        lines, length = shape
        return self.slots.take(slot, (lines, length + ROW_GAP), dtype)[:, :length]

    def load(self, factors: Factors, chosen: slice, slot: int) -> Array:
        """Return the factors of some columns in a slot."""
        shape = (chosen.stop - chosen.start, factors.shape[0])
        out = self.take(slot, shape, factors.values.dtype)
        factors.load(chosen, out)
        return out

    def apply(
        self,
        values: Array,
        lines: tuple[Line, ...],
        slots: tuple[int, int],
        *,
        in_place: bool = False,
        target: Array | None = None,
    ) -> Array:
        """Apply ``lines`` along the last axis of a block, into ``target`` or a slot.

        Windows of samples use the slot ``slots[0]`` and transforms ``slots[1]``. ``values`` are
        overwritten only if ``in_place``; they are then in ``slots[1]``.
        """
        active = [line for line in lines if line.kind != "none"]
        for line in active:
            is_unpadded = line.offset == 0 and line.n == line.length and line.pre is None
            source = values if is_unpadded else self._window(values, line, slots[0])
            if target is not None and line is active[-1] and _is_bare(line):
                out = target
            elif is_unpadded and in_place:
                out = values
            else:
                out = self.take(slots[1], source.shape, source.dtype)
            values, in_place = _transform(source, line, out, self.fft), True
        if target is not None and not (active and _is_bare(active[-1])):
            target[...] = values
        return values

    def _window(self, values: Array, line: Line, slot: int) -> Array:
        """Return the samples times ``pre`` in a window of zeros, which the next block reuses."""
        stop = line.offset + line.n
        window = self.take(slot, (len(values), line.length), values.dtype)
        if self.framed.get(slot) != (line, len(values)):
            window[:, : line.offset] = 0
            window[:, stop:] = 0
            self.framed[slot] = (line, len(values))
        if line.pre is None:
            window[:, line.offset : stop] = values
        else:
            np.multiply(values, line.pre, out=window[:, line.offset : stop])
        return window


def _is_bare(line: Line) -> bool:
    """Return True if a transform gives the line's result without further steps."""
    return line.m == line.length and line.kernel is None and line.post is None


def _size(line_bytes: int) -> int:
    """Return the number of lines of a block, a multiple of ``MIN_BLOCK_LINES``."""
    lines = min(max(MAX_BLOCK_LINES, SMALL_BYTES // line_bytes), BLOCK_BYTES // line_bytes)
    return max(lines // MIN_BLOCK_LINES, 1) * MIN_BLOCK_LINES


def _ranges(run: range, line_bytes: int) -> list[slice]:
    """Divide a run into ranges of a block each."""
    size = _size(line_bytes)
    return [slice(start, min(start + size, run.stop)) for start in range(run.start, run.stop, size)]


def _runs(chosen: Array) -> list[range]:
    """Return the ranges of consecutive True values."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).tolist()
    return [range(*ends) for ends in zip(edges[::2], edges[1::2], strict=True)]


def _row_ranges(count: int, ny: int, line_bytes: int) -> list[slice]:
    """Return the blocks of rows of fields with ny rows each.

    Blocks span fields only if a field is smaller than a block, so a batch rounds as its fields do.
    """
    if ny < _size(line_bytes):
        return _ranges(range(count), line_bytes)
    blocks = _ranges(range(ny), line_bytes)
    return [slice(k + rows.start, k + rows.stop) for k in range(0, count, ny) for rows in blocks]


def _lit(factors: Sequence[Factors]) -> Array:
    """Return flags of columns in which a factor is not zero, and of their mirrored columns."""
    if any(table.lit is None for table in factors):
        return np.ones(factors[0].shape[1], np.bool_)
    lit = np.logical_or.reduce([table.lit_columns() for table in factors])
    if any(table.is_mirrored for table in factors):
        lit = lit | np.roll(lit[::-1], 1)
    return lit


def _dark_ranges(factors: Sequence[Factors], itemsize: int) -> list[slice]:
    """Return the blocks of the other columns."""
    runs, line_bytes = _runs(~_lit(factors)), factors[0].shape[0] * itemsize
    return [chosen for run in runs for chosen in _ranges(run, line_bytes)]


def _column_ranges(factors: Sequence[Factors], itemsize: int) -> list[list[slice]]:
    """Return blocks of the lit columns of a product, each with the columns that mirror it.

    The factors of both are then read from memory once.
    """
    my, mx = factors[0].shape
    lit, line_bytes = _lit(factors), my * itemsize
    if not any(table.is_mirrored for table in factors):
        return [[chosen] for run in _runs(lit) for chosen in _ranges(run, line_bytes)]
    parts = []
    for run in _runs(lit[: mx // 2 + 1]):
        for chosen in _ranges(run, line_bytes):
            low, high = max(chosen.start, 1), min(chosen.stop, (mx + 1) // 2)
            mirrored = slice(mx - high + 1, mx - low + 1)
            parts.append([chosen, mirrored] if low < high else [chosen])
    return parts


def _transform(source: Array, line: Line, out: Array, fft: FFTRoute) -> Array:
    """Transform a line from ``source`` into ``out``, crop it and multiply by ``post``."""
    # Padded lengths may have large prime factors.
    careful = line.n < line.length or line.m < line.length
    fft.lines(source, out, 1, line.kind != "inverse", careful=careful)
    if line.kernel is not None:
        out *= line.kernel
        fft.lines(out, out, 1, False, careful=careful)
    cropped = out[:, line.start : line.start + line.m]
    if line.post is not None:
        cropped *= line.post
    return cropped
