"""Sampling of sub-images whose lattice lies along the sensor's rows and columns, on CPUs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.lightfield.raw.raw_image import LensletGrid, RawImage

Vector = np.ndarray[Any, np.dtype[np.float64]]

FRACTION = 2.0**24  # positions are multiples of 2^-24 pixel, which float32 holds exactly
_MARGIN = 4  # zeros at either end of a line of pixels


def is_upright(grid: LensletGrid) -> bool:
    """Whether y depends on the row and v alone, x on the column and u, alike in all rows."""
    across = (grid.column_step[0], grid.column_view_step[0])
    down = (grid.row_step[1], grid.row_view_step[1])
    return not any((*across, *down, grid.odd_row_shift)) and grid.columns is None


def has_room(raw: RawImage) -> bool:
    """Whether local memory holds a row of the sensor."""
    return _line_bytes(raw) <= int(raw.device.cl_device.local_mem_size)


def _line_bytes(raw: RawImage) -> int:
    return 4 * (raw.shape[1] + 2 * _MARGIN)


def upright(views: cla.Array, raw: RawImage, grid: LensletGrid, *, linear: bool) -> None:
    """Fill the views of such a grid, as `clplen.lightfield.raw.decode.resample` describes."""
    device, (ny, nx) = raw.device, raw.shape
    (V, U), (rows, columns) = grid.views, grid.count
    y = _positions(grid.first[0], V, grid.row_view_step[0], rows, grid.row_step[0])
    x = _positions(grid.first[1], U, grid.column_view_step[1], columns, grid.column_step[1])
    (above, down), (left, across) = (_taps(at, n, linear) for at, n in ((y, ny), (x, nx)))
    strides = [int(n) // views.dtype.itemsize for n in views.strides]
    order = (1, 0, 3, 2) if grid.exchanged else (0, 1, 2, 3)
    device.launch(
        device.kernel("upright.cl", "decode_upright"),
        (V * rows,),
        views,
        raw.data,
        *(device.upload(table) for table in (above, down, left + _MARGIN, across)),
        *(np.int32(n) for n in (ny, nx, V, U, rows, columns)),
        *(np.int64(strides[axis]) for axis in order),
        cl.LocalMemory(_line_bytes(raw)),
        group=(1,),
    )


def _positions(first: float, views: int, view_step: float, count: int, step: float) -> Vector:
    """Along one axis, view by view, shape (views count,): see `_row_tables` in decode.py."""
    corner = first - (views - 1) / 2 * view_step
    parts = (np.arange(views) * view_step, corner + np.arange(count) * step)
    return np.add.outer(*(np.round(part * FRACTION) / FRACTION for part in parts)).ravel()


def _taps(position: Vector, n: int, linear: bool) -> tuple[Any, Any]:
    """First of four pixels of an axis of n, int32, and their weights, float32, shape (4, ...).

    Keys (1981), eq. 15, a = -1/2, or linear; 0 off the sensor.
    """
    whole = np.floor(position)
    t = position - whole
    if linear:
        weights = [np.zeros_like(t), 1 - t, t, np.zeros_like(t)]
    else:
        weights = [
            ((1 - 0.5 * t) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1,
            ((2 - 1.5 * t) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        ]
    first = np.clip(whole - 1, -_MARGIN, n).astype(np.int32)
    pixel = whole - 1 + np.arange(4)[:, None]
    inside = (pixel >= 0) & (pixel < n)
    return first, np.where(inside, weights, 0).astype(np.float32)
