"""Maps along both axes on the host, in blocks that stay in the cache.

The lines along x run a few rows at a time; then, for a few columns at a time, everything that
happens along y with the product in its midst; then the lines along x again. Zeros are not
transformed along x, and the padded array never exists.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.lines import Line, Separable
from clplen.compute.workspace import Slots

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.compute.fft import FFTRoute

Array = np.ndarray[Any, Any]

BLOCK_BYTES = 2**21  # of a block of rows or columns, about what a core's cache holds
FEWEST, MOST = 8, 64  # rows or columns of a block
APART = 16  # samples between rows, so that a column does not meet the same cache lines everywhere
INTO, BACK = (0, 1), (2, 3)  # scratch arrays of the lines before and after the product


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of a 2-D spectrum on the host, cut into blocks of columns.

    Attributes
    ----------
    blocks : tuple of numpy.ndarray
        Complex, contiguous, all columns from the first on: all rows, or those up to the middle
        of what is even.
    shape : tuple of int
        (my, mx).
    """

    blocks: tuple[Array, ...]
    shape: tuple[int, int]

    @classmethod
    def cut(cls, values: Array, shape: tuple[int, int]) -> Factors:
        """Copy factors (my, mx), or their quadrant (my//2 + 1, mx//2 + 1), into blocks."""
        mx, stored = shape[1], values.shape[1]
        size = _size(shape[0] * values.itemsize)
        # column k of an even spectrum is also column mx - k
        columns = np.where(np.arange(mx) < stored, np.arange(mx), mx - np.arange(mx))
        starts = range(0, mx, size)
        blocks = (np.take(values, columns[start : start + size], axis=1) for start in starts)
        return cls(tuple(blocks), shape)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(block.nbytes for block in self.blocks)

    def multiply(self, values: Array, index: int) -> None:
        """The columns of a block, (my, columns), times their factors, in place."""
        factors = self.blocks[index]
        stored = len(factors)
        values[:stored] *= factors
        values[stored:] *= factors[1 : self.shape[0] - stored + 1][::-1]


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
    device: Device,
) -> None:
    """Fill ``targets``, one for each product (one where there is none).

    Parameters
    ----------
    source : numpy.ndarray
        Complex, shape (n, ny, nx); not changed.
    into : Separable
    products : sequence of Product
    targets : sequence of numpy.ndarray
        Shape (n, my, mx).
    device : Device
        Its FFT route and its workspace are used.
    """
    width = into.shape_after(source.shape[-2:])[1]
    # The threads end first: what they write to is lent until then.
    with ExitStack() as held, ThreadPoolExecutor(device.fft.threads) as pool:

        def borrow(rows: int) -> Array:
            shape = (len(source), rows, width + APART)
            return held.enter_context(device.workspace.borrow(shape, source.dtype))[..., :width]

        team = _Team(pool, device.fft)
        first = borrow(source.shape[1])
        team.rows(source, into.x, first)
        if not products:
            team.columns(first, into.y, targets[0])
            return
        heights = [one.back.shape_after(one.factors.shape)[0] for one in products]
        between = [borrow(height) for height in heights[:-1]]
        between.append(first if heights[-1] == source.shape[1] else borrow(heights[-1]))
        team.filtered(first, into.y, products, between)
        for made, product, target in zip(between, products, targets, strict=True):
            team.rows(made, product.back.x, target)


class _Team:
    """Threads that share the blocks of an array."""

    def __init__(self, pool: ThreadPoolExecutor, fft: FFTRoute) -> None:
        self.pool, self.fft = pool, fft
        self.slots = [Slots() for _ in range(fft.threads)]

    def rows(self, source: Array, lines: tuple[Line, ...], target: Array) -> None:
        """``lines`` along the last axis."""
        rows, out = source.reshape(-1, source.shape[-1]), target.reshape(-1, target.shape[-1])
        longest = max((line.length for line in lines), default=1)

        def some(part: tuple[int, int], slots: Slots) -> None:
            chosen = slice(*part)
            out[chosen] = _apply(rows[chosen], lines, 1, self.fft, slots, INTO)

        self._share(some, _row_ranges(source.shape, longest * source.itemsize))

    def columns(self, source: Array, lines: tuple[Line, ...], target: Array) -> None:
        """``lines`` along the axis before the last."""
        longest = max((line.length for line in lines), default=1)

        def some(part: tuple[int, int], slots: Slots) -> None:
            chosen = slice(*part)
            for one, out in zip(source, target, strict=True):
                out[:, chosen] = _apply(one[:, chosen], lines, 0, self.fft, slots, INTO)

        self._share(some, _ranges(source.shape[-1], longest * source.itemsize))

    def filtered(
        self,
        source: Array,
        lines: tuple[Line, ...],
        products: Sequence[Product],
        targets: Sequence[Array],
    ) -> None:
        """Along the axis before the last: ``lines``, each product, and its way back."""
        fft, last = self.fft, len(products) - 1

        size = products[0].factors.blocks[0].shape[1]

        def some(index: int, slots: Slots) -> None:
            chosen = slice(index * size, (index + 1) * size)
            for place, one in enumerate(source):
                block = _apply(one[:, chosen], lines, 0, fft, slots, INTO)
                for which, (product, target) in enumerate(zip(products, targets, strict=True)):
                    made = block
                    if which < last or not _is_scratch(lines):
                        made = slots.take(BACK[1], block.shape, block.dtype)
                        made[...] = block
                    product.factors.multiply(made, index)
                    target[place, :, chosen] = _apply(
                        made, product.back.y, 0, fft, slots, BACK, own=True
                    )

        self._share(some, range(len(products[0].factors.blocks)))

    def _share(self, work: Callable[[Any, Slots], None], parts: Sequence[Any]) -> None:
        """``work`` on every part, each thread taking the next one."""
        if len(parts) == 1:
            work(parts[0], self.slots[0])
            return
        left, failed = iter(parts), Event()

        def worker(slots: Slots) -> None:
            for part in left:
                if failed.is_set():
                    return
                try:
                    work(part, slots)
                except BaseException:
                    failed.set()
                    raise

        list(self.pool.map(worker, self.slots))


def _size(line_bytes: int) -> int:
    """How many lines of so many bytes make a block."""
    return max(FEWEST, min(MOST, BLOCK_BYTES // line_bytes))


def _ranges(count: int, line_bytes: int) -> list[tuple[int, int]]:
    """Ranges that make up range(count), a block each."""
    size = _size(line_bytes)
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def _row_ranges(shape: tuple[int, ...], line_bytes: int) -> list[tuple[int, int]]:
    """Blocks of the rows of a batch, across fields only where a field has too few for a block.

    A field's blocks are then those that it has alone, and so is its rounding.
    """
    ny = shape[-2]
    count = math.prod(shape[:-2])
    if ny < _size(line_bytes):
        return _ranges(count * ny, line_bytes)
    own = _ranges(ny, line_bytes)
    return [(one * ny + start, one * ny + stop) for one in range(count) for start, stop in own]


def _is_scratch(lines: tuple[Line, ...]) -> bool:
    """Whether ``lines`` leave a block in a thread's own memory."""
    return any(line.kind != "none" for line in lines)


def _apply(
    values: Array,
    lines: tuple[Line, ...],
    axis: int,
    fft: FFTRoute,
    slots: Slots,
    places: tuple[int, int],
    *,
    own: bool = False,
) -> Array:
    """``lines`` along one axis of a 2-D block, in scratch memory; ``own``: it is there already."""
    taken = 0
    for line in lines:
        if line.kind == "none":
            continue
        whole = line.place == 0 and line.n == line.length and line.pre is None
        window = values
        if not (own and whole):
            shape = list(values.shape)
            shape[axis] = line.length
            window = slots.take(places[taken % 2], shape, values.dtype)
            taken += 1  # what is read from lies in the other one
        if not whole:
            _place(values, line, axis, window)
        values = _transform(values if whole else window, line, axis, window, fft)
        own = True
    return values


def _place(values: Array, line: Line, axis: int, window: Array) -> None:
    """The samples times ``pre`` in a window of zeros."""
    along, source = (window, values) if axis == 0 else (window.T, values.T)
    stop = line.place + line.n
    along[: line.place] = 0
    along[stop:] = 0
    if line.pre is None:
        along[line.place : stop] = source
    else:
        np.multiply(source, line.pre[:, None], out=along[line.place : stop])


def _transform(source: Array, line: Line, axis: int, window: Array, fft: FFTRoute) -> Array:
    """The transform of a line from ``source`` into ``window``, cut out and times ``post``."""
    along = window if axis == 0 else window.T
    # Padding makes lengths that nobody chose; they may be awkward.
    careful = line.n < line.length or line.m < line.length
    fft.lines(source, window, axis, line.kind != "inverse", careful=careful)
    if line.kernel is not None:
        along *= line.kernel[:, None]
        fft.lines(window, window, axis, False, careful=careful)
    kept = along[line.start : line.start + line.m]
    if line.post is not None:
        kept *= line.post[:, None]
    return kept if axis == 0 else kept.T
