"""Maps along both axes on the host, in blocks that stay in the cache.

The lines along x run a few rows at a time and leave the array turned, columns as rows; then, for a
few columns at a time, everything that happens along y with the product in its midst; then the
lines along x again, which turn it back. Every transform but those two then has its samples side by
side. Zeros are not transformed along x, and the padded array never exists.
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

Part = TypeVar("Part")
Own = TypeVar("Own")


def share(work: Callable[[Part, Own], None], parts: Sequence[Part], owned: Sequence[Own]) -> None:
    """``work`` on every part, the calling thread and others taking the next one each."""
    left, failed = iter(parts), Event()

    def run(own: Own) -> None:
        try:
            for part in left:
                if failed.is_set():
                    return
                work(part, own)
        except BaseException:
            failed.set()
            raise

    others: list[Future[None]] = []
    full: ThreadPoolExecutor | None = None
    try:
        for own in owned[1 : len(parts)]:
            others.append(_kept(len(owned) - 1).submit(run, own))
    except RuntimeError:  # no memory for one more thread: the caller and those that began do it
        full = _kept(len(owned) - 1)
        _kept.cache_clear()
    try:
        run(owned[0])
    finally:
        if full is not None:  # what was refused a thread is queued all the same
            full.shutdown(cancel_futures=True)
        begun = [other for other in others if not other.cancel()]
        try:
            wait(begun)
        except BaseException:  # an interrupt: what they work on is the caller's
            failed.set()
            wait(begun)
            raise
    for other in begun:
        other.result()


@cache
def _kept(count: int) -> ThreadPoolExecutor:
    """So many threads; a process that was forked off makes its own."""
    return ThreadPoolExecutor(count, thread_name_prefix="clplen-blocks")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_kept.cache_clear)


BLOCK_BYTES = 2**20  # of a block of rows or columns, about what a core's cache holds
SMALL_BYTES = 2**19  # of a block that is worth a thread's while
FEWEST, MOST = 16, 48  # rows or columns of a block, more of them where they are short
APART = 16  # samples between rows, so that a column does not meet the same cache lines everywhere
INTO, BACK = (0, 1), (2, 3)  # slots of windows and of their transforms, before the product, after
FACTORS = 4  # first slot of the factors of a block


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of a 2-D spectrum on the host, turned: columns are rows.

    Attributes
    ----------
    values : numpy.ndarray
        Complex, shape (mx, my); or, even in both axes, the quadrant (mx//2 + 1, my//2 + 1).
    shape : tuple of int
        (my, mx).
    lit : numpy.ndarray, optional
        bool, one for each stored column: False where all its factors are zero. None: all True.
    is_conjugated : bool
        Whether the factors are the conjugates of ``values``.
    """

    values: Array
    shape: tuple[int, int]
    lit: Array | None = None
    is_conjugated: bool = False

    @property
    def is_mirrored(self) -> bool:
        """Whether columns are stored up to the middle only: column k is also column mx - k."""
        return self.values.shape[0] < self.shape[1]

    def lit_columns(self) -> Array:
        """Of all mx columns whether they are lit."""
        if self.lit is None:
            return np.ones(self.shape[1], np.bool_)
        place = np.arange(self.shape[1])
        return self.lit[np.minimum(place, self.shape[1] - place)] if self.is_mirrored else self.lit

    def load(self, chosen: slice, out: Array) -> None:
        """Some of the stored columns, unfolded along y: (columns, my)."""
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
    """A product with factors, and what happens along the axes after it."""

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
    """Fill ``targets``, one for each product (one where there is none)."""
    count, ny, _ = source.shape
    width = into.shape_after(source.shape[-2:])[1]
    with ExitStack() as held:

        def borrow(rows: int) -> Array:
            """Turned: the columns of all fields' rows, (width, n rows)."""
            shape = (width, count * rows + APART)
            return held.enter_context(workspace.borrow(shape, source.dtype))[:, :-APART]

        team = _Team(fft)
        first = borrow(ny)
        team.rows(source.reshape(count * ny, -1), into.x, first.T, ny)
        if not products:
            team.columns(_by_field(first, count), into.y, targets[0])
            return
        heights = [one.back.shape_after(one.factors.shape)[0] for one in products]
        between = [borrow(height) for height in heights[:-1]]
        between.append(first if heights[-1] == ny else borrow(heights[-1]))
        team.filtered(
            _by_field(first, count), into.y, products, [_by_field(one, count) for one in between]
        )
        for made, product, target, height in zip(between, products, targets, heights, strict=True):
            out = target.reshape(count * height, -1)
            team.rows(made.T, product.back.x, out, height)


def _by_field(turned: Array, count: int) -> Array:
    """A view (width, n, rows) of (width, n rows)."""
    return turned.reshape(len(turned), count, turned.shape[1] // count)


class _Team:
    """Threads that share the blocks of an array."""

    def __init__(self, fft: FFTRoute) -> None:
        self.workers = [_Worker(fft) for _ in range(fft.threads)]

    def rows(self, source: Array, lines: tuple[Line, ...], target: Array, ny: int) -> None:
        """``lines`` along x of fields of ny rows each, (n ny, nx) to (n ny, mx)."""
        longest = max((line.length for line in lines), default=1)

        def some(chosen: slice, worker: _Worker) -> None:
            worker.apply(source[chosen], lines, INTO, target=target[chosen])

        share(some, _row_ranges(len(source), ny, longest * source.itemsize), self.workers)

    def columns(self, source: Array, lines: tuple[Line, ...], target: Array) -> None:
        """``lines`` along y of turned fields, (mx, n, ny) to (n, my, mx)."""
        longest = max((line.length for line in lines), default=1)

        def some(chosen: slice, worker: _Worker) -> None:
            for place, out in enumerate(target):
                worker.apply(source[chosen, place], lines, INTO, target=out.T[chosen])

        share(some, _ranges(range(len(source)), longest * source.itemsize), self.workers)

    def filtered(
        self,
        source: Array,
        lines: tuple[Line, ...],
        products: Sequence[Product],
        targets: Sequence[Array],
    ) -> None:
        """Along y of turned fields, (mx, n, ny): ``lines``, each product, and its way back.

        ``source`` is lost; the last target may be the same memory. Columns whose factors are all
        zero are not transformed.
        """
        factors = [product.factors for product in products]

        def block(chosen: slice, loaded: Sequence[Array], worker: _Worker) -> None:
            for place in range(source.shape[1]):
                values = worker.apply(source[chosen, place], lines, INTO)
                for which, (product, target) in enumerate(zip(products, targets, strict=True)):
                    made = values
                    if which < len(products) - 1:
                        made = worker.take(BACK[1], values.shape, values.dtype)
                    np.multiply(values, loaded[which], out=made)
                    out = target[chosen, place]
                    worker.apply(made, product.back.y, BACK, own=True, target=out)

        def some(part: list[slice], worker: _Worker) -> None:
            own, *mirrored = part
            loaded = [worker.load(one, own, FACTORS + i) for i, one in enumerate(factors)]
            block(own, loaded, worker)
            for chosen in mirrored:
                first = factors[0].shape[1] - chosen.stop + 1 - own.start
                same = slice(first, first + chosen.stop - chosen.start)
                again = [
                    made[same][::-1] if one.is_mirrored else worker.load(one, chosen, FACTORS + i)
                    for i, (one, made) in enumerate(zip(factors, loaded, strict=True))
                ]
                block(chosen, again, worker)

        def dark(chosen: slice, _: _Worker) -> None:
            for target in targets:
                target[chosen] = 0

        share(dark, _dark_ranges(factors, source.itemsize), self.workers)
        share(some, _column_ranges(factors, source.itemsize), self.workers)


class _Worker:
    """What one thread does to a block of lines, in its own scratch memory."""

    def __init__(self, fft: FFTRoute) -> None:
        self.fft, self.slots = fft, Slots()
        self.framed: dict[int, tuple[Line, int]] = {}  # zeros that a window has already

    def take(self, slot: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
        """A slot's array, its lines apart."""
        lines, length = shape
        return self.slots.take(slot, (lines, length + APART), dtype)[:, :length]

    def load(self, factors: Factors, chosen: slice, slot: int) -> Array:
        """The factors of some columns in a slot."""
        shape = (chosen.stop - chosen.start, factors.shape[0])
        out = self.take(slot, shape, factors.values.dtype)
        factors.load(chosen, out)
        return out

    def apply(
        self,
        values: Array,
        lines: tuple[Line, ...],
        places: tuple[int, int],
        *,
        own: bool = False,
        target: Array | None = None,
    ) -> Array:
        """``lines`` along the last axis of a block, into ``target`` or a slot.

        Samples go from windows in the slot ``places[0]`` to transforms in ``places[1]``, where
        ``values`` lie that are a thread's ``own``: nothing else is overwritten.
        """
        done = [line for line in lines if line.kind != "none"]
        for line in done:
            whole = line.place == 0 and line.n == line.length and line.pre is None
            source = values if whole else self._window(values, line, places[0])
            if target is not None and line is done[-1] and _is_bare(line):
                out = target
            elif whole and own:
                out = values
            else:
                out = self.take(places[1], source.shape, source.dtype)
            values, own = _transform(source, line, out, self.fft), True
        if target is not None and not (done and _is_bare(done[-1])):
            target[...] = values
        return values

    def _window(self, values: Array, line: Line, slot: int) -> Array:
        """The samples times ``pre`` in a window of zeros, which stay for the next block."""
        stop = line.place + line.n
        window = self.take(slot, (len(values), line.length), values.dtype)
        if self.framed.get(slot) != (line, len(values)):
            window[:, : line.place] = 0
            window[:, stop:] = 0
            self.framed[slot] = (line, len(values))
        if line.pre is None:
            window[:, line.place : stop] = values
        else:
            np.multiply(values, line.pre, out=window[:, line.place : stop])
        return window


def _is_bare(line: Line) -> bool:
    """Whether a transform's result is the line's, as it is."""
    return line.m == line.length and line.kernel is None and line.post is None


def _size(line_bytes: int) -> int:
    """How many lines of so many bytes make a block, a multiple of ``FEWEST``."""
    most = min(max(MOST, SMALL_BYTES // line_bytes), BLOCK_BYTES // line_bytes)
    return max(most // FEWEST, 1) * FEWEST


def _ranges(run: range, line_bytes: int) -> list[slice]:
    """Ranges that make up a run, a block each."""
    size = _size(line_bytes)
    return [slice(start, min(start + size, run.stop)) for start in range(run.start, run.stop, size)]


def _runs(chosen: Array) -> list[range]:
    """Where a row of bools is True without a break."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).tolist()
    return [range(*ends) for ends in zip(edges[::2], edges[1::2], strict=True)]


def _row_ranges(count: int, ny: int, line_bytes: int) -> list[slice]:
    """Blocks of rows of fields of ny each, across fields only where one has too few for a block.

    A field's blocks are then those that it has alone, and so is its rounding.
    """
    if ny < _size(line_bytes):
        return _ranges(range(count), line_bytes)
    own = _ranges(range(ny), line_bytes)
    return [slice(k + one.start, k + one.stop) for k in range(0, count, ny) for one in own]


def _lit(factors: Sequence[Factors]) -> Array:
    """Columns of which some factor is not zero; with those that mirror them, where any is."""
    if any(one.lit is None for one in factors):
        return np.ones(factors[0].shape[1], np.bool_)
    lit = np.logical_or.reduce([one.lit_columns() for one in factors])
    if any(one.is_mirrored for one in factors):
        lit = lit | np.roll(lit[::-1], 1)
    return lit


def _dark_ranges(factors: Sequence[Factors], itemsize: int) -> list[slice]:
    """Blocks of the other columns."""
    runs, line_bytes = _runs(~_lit(factors)), factors[0].shape[0] * itemsize
    return [chosen for run in runs for chosen in _ranges(run, line_bytes)]


def _column_ranges(factors: Sequence[Factors], itemsize: int) -> list[list[slice]]:
    """Blocks of the lit columns of a product, beside each the columns that mirror it.

    The factors of both are then read from memory once.
    """
    my, mx = factors[0].shape
    lit, line_bytes = _lit(factors), my * itemsize
    if not any(one.is_mirrored for one in factors):
        return [[chosen] for run in _runs(lit) for chosen in _ranges(run, line_bytes)]
    parts = []
    for run in _runs(lit[: mx // 2 + 1]):
        for chosen in _ranges(run, line_bytes):
            low, high = max(chosen.start, 1), min(chosen.stop, (mx + 1) // 2)
            mirrored = slice(mx - high + 1, mx - low + 1)
            parts.append([chosen, mirrored] if low < high else [chosen])
    return parts


def _transform(source: Array, line: Line, out: Array, fft: FFTRoute) -> Array:
    """The transform of a line from ``source`` into ``out``, cut out and times ``post``."""
    # Padding makes lengths that nobody chose; they may be awkward.
    careful = line.n < line.length or line.m < line.length
    fft.lines(source, out, 1, line.kind != "inverse", careful=careful)
    if line.kernel is not None:
        out *= line.kernel
        fft.lines(out, out, 1, False, careful=careful)
    kept = out[:, line.start : line.start + line.m]
    if line.post is not None:
        kept *= line.post
    return kept
