"""Blocks of large pictures, written to files in the order in which they are computed."""

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
    """Focal stack that is computed in parts, such as by `clplen.lightfield.stack_tiles`.

    Its iterator yields (planes, rows, columns, pictures): three slices of the whole stack and
    float32 samples of shape (planes, rows, columns[, c]). The parts cover each sample once.

    Parameters
    ----------
    *args, **kwargs : object
        Arguments of the implementing class; the protocol itself is not instantiated.

    Attributes
    ----------
    shape : tuple of int
        Shape (n, y, x[, c]).
    disparities : numpy.ndarray
        Disparity in pixels per view step, larger when nearer; float64 of shape (n,).
    alphas : numpy.ndarray
        Ratio F/F', NaN where unknown; float64 of shape (n,).
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres.
    camera : CameraModel or None
        Camera of the light field, if known.

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
        """Shape (n, y, x[, c])."""

    @property
    def disparities(self) -> Array:
        """Disparities in pixels per view step, larger when nearer; float64, shape (n,)."""

    @property
    def alphas(self) -> Array:
        """Ratios F/F', NaN where unknown; float64, shape (n,)."""

    @property
    def spacing(self) -> Spacing | None:
        """Signed (dv, du, dy, dx) in metres."""

    @property
    def camera(self) -> CameraModel | None:
        """Camera of the light field, if known."""

    def __iter__(self) -> Iterator[Block]: ...


def as_block(values: Array) -> list[Block]:
    """Return an array in host memory as one block."""
    planes, rows, columns = (slice(0, n) for n in values.shape[:3])
    return [(planes, rows, columns, values)]


def checked_blocks(blocks: Iterable[Block], shape: tuple[int, ...]) -> Generator[Block, None, None]:
    """Yield blocks as float32; raise an error unless they cover the whole."""
    iterator = iter(blocks)
    count = 0
    try:
        for planes, rows, columns, values in iterator:
            slices = [
                slice(*part.indices(n)[:2])
                for n, part in zip(shape[:3], (planes, rows, columns), strict=True)
            ]
            expected = (*(max(0, part.stop - part.start) for part in slices), *shape[3:])
            if values.shape != expected:
                raise ShapeError(
                    f"A block of planes {planes}, rows {rows} and columns {columns} must have "
                    f"shape {expected}, got {values.shape}."
                )
            count += values.size
            if values.size:
                yield slices[0], slices[1], slices[2], values.astype(np.float32, copy=False)
    finally:
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
    if count != math.prod(shape):
        raise ValueError(
            f"The blocks must cover all {math.prod(shape):,} samples of {shape} once, got "
            f"{count:,}."
        )


def write_rows(file: BinaryIO, values: Array, *, start: int, step: int) -> None:
    """Write a part of a picture at its offset in a file; a memory map would count as memory."""
    is_contiguous = values[0].nbytes == step
    for number, run in enumerate([values] if is_contiguous else values):
        file.seek(start + number * step)
        file.write(np.ascontiguousarray(run).data)
