"""Parts of large pictures, in the order in which they become known, on their way into files."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator
from typing import Any, BinaryIO, Protocol

import numpy as np

from clplen.errors import ShapeError
from clplen.lightfield.raw.raw_image import CameraModel, Spacing

Array = np.ndarray[Any, Any]
Block = tuple[slice, slice, slice, Array]  # planes, rows, columns and their samples


class Tiles(Protocol):
    """A focal stack that comes in parts, such as those of `clplen.lightfield.stack_tiles`.

    Iterated over once, it gives (planes, rows, columns, pictures): three slices of the whole stack
    and float32 of shape (planes, rows, columns[, c]). Together they are the whole, each sample
    once.

    Parameters
    ----------
    *args, **kwargs : object
        Of the class that fulfils the protocol; the protocol itself is not made.

    Attributes
    ----------
    shape : tuple of int
        (n, y, x[, c]).
    disparities : numpy.ndarray
        Shape (n,), float64: pixels a view step, nearer larger.
    alphas : numpy.ndarray
        Shape (n,), float64: F/F'; NaN where unknown.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres.
    camera : CameraModel or None
        The camera that took it, when known.

    Examples
    --------
    >>> clplen.io.write_npy("lf.npy", np.random.default_rng(1).random((3, 3, 32, 32), np.float32))
    >>> with clplen.open_lightfield("lf.npy") as stored:
    ...     tiles = clplen.lightfield.stack_tiles(stored, disparities=[0.0, 0.5])
    ...     clplen.io.write_stack("stack.tif", tiles)
    >>> tiles.shape, clplen.io.read_stack("stack.tif").disparities.tolist()
    ((2, 32, 32), [0.0, 0.5])
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, y, x[, c])."""

    @property
    def disparities(self) -> Array:
        """float64, shape (n,): pixels a view step, nearer larger."""

    @property
    def alphas(self) -> Array:
        """float64, shape (n,): F/F'; NaN where unknown."""

    @property
    def spacing(self) -> Spacing | None:
        """Signed (dv, du, dy, dx) in metres."""

    @property
    def camera(self) -> CameraModel | None:
        """The camera that took it, when known."""

    def __iter__(self) -> Iterator[Block]: ...


def as_block(values: Array) -> list[Block]:
    """An array in host memory as one block."""
    planes, rows, columns = (slice(0, n) for n in values.shape[:3])
    return [(planes, rows, columns, values)]


def checked_blocks(blocks: Iterable[Block], shape: tuple[int, ...]) -> Generator[Block, None, None]:
    """Pass blocks on as float32, and make sure that they make up the whole."""
    iterator = iter(blocks)
    found = 0
    try:
        for planes, rows, columns, values in iterator:
            places = [
                slice(*part.indices(n)[:2])
                for n, part in zip(shape[:3], (planes, rows, columns), strict=True)
            ]
            wanted = (*(max(0, part.stop - part.start) for part in places), *shape[3:])
            if values.shape != wanted:
                raise ShapeError(
                    f"A block of planes {planes}, rows {rows} and columns {columns} has shape "
                    f"{wanted}, not {values.shape}."
                )
            found += values.size
            if values.size:
                yield places[0], places[1], places[2], values.astype(np.float32, copy=False)
    finally:
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
    if found != math.prod(shape):
        raise ValueError(
            f"The blocks hold {found:,} samples of the {math.prod(shape):,} of {shape}: give each "
            "once."
        )


def write_rows(file: BinaryIO, values: Array, *, start: int, step: int) -> None:
    """Write a part of a picture to its place in a file, without a map, which counts as memory."""
    together = values[0].nbytes == step
    for number, run in enumerate([values] if together else values):
        file.seek(start + number * step)
        file.write(np.ascontiguousarray(run).data)
