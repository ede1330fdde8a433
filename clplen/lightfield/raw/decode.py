"""Decoding of a raw lenslet image to views: sampling of every sub-image about its centre.

On CPUs a lattice along the sensor's rows and columns has a separate kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid

Vector = np.ndarray[Any, np.dtype[np.float64]]
Table = np.ndarray[Any, Any]
Interpolation = Literal["cubic", "linear", "spline"]

FRACTION = 2.0**24  # positions are multiples of 2^-24 pixel, exact in float32
_MARGIN = 4  # zeros at either end of a line of pixels


def is_upright(grid: LensletGrid) -> bool:
    """Return True if y depends on row and v only, x on column and u, equally in all rows."""
    across = (grid.column_step[0], grid.column_view_step[0])
    down = (grid.row_step[1], grid.row_view_step[1])
    return not any((*across, *down, grid.odd_row_shift)) and grid.columns is None


def fits_local_memory(width: int, device: Device) -> bool:
    """Return True if local memory holds a row of the sensor."""
    return _line_bytes(width) <= int(device.cl_device.local_mem_size)


def _line_bytes(width: int) -> int:
    return 4 * (width + 2 * _MARGIN)


def strides_of(views: cla.Array, grid: LensletGrid) -> list[int]:
    """Return the strides of a light field in samples along the grid's (V, U, rows, columns)."""
    strides = [int(n) // views.dtype.itemsize for n in views.strides]
    return [strides[axis] for axis in ((1, 0, 3, 2) if grid.exchanged else (0, 1, 2, 3))]


def taps_along(
    grid: LensletGrid, shape: tuple[int, int], interpolation: Interpolation
) -> tuple[tuple[Table, Table], tuple[Table, Table]]:
    """Return pixels and weights along y (view by view, row by row) and x of an upright grid."""
    (V, U), (rows, columns), (ny, nx) = grid.views, grid.count, shape
    y = _positions(grid.first[0], V, grid.row_view_step[0], rows, grid.row_step[0])
    x = _positions(grid.first[1], U, grid.column_view_step[1], columns, grid.column_step[1])
    return _taps(y, ny, interpolation), _taps(x, nx, interpolation)


def _positions(first: float, views: int, view_step: float, count: int, step: float) -> Vector:
    """Return positions along one axis, view by view, (views count,), see `grid_tables`."""
    corner = first - (views - 1) / 2 * view_step
    parts = (np.arange(views) * view_step, corner + np.arange(count) * step)
    return np.add.outer(*(np.round(part * FRACTION) / FRACTION for part in parts)).ravel()


def _taps(position: Vector, n: int, interpolation: Interpolation) -> tuple[Table, Table]:
    """Return the first of four pixels, int32, and their weights, float32, shape (4, ...).

    The weights are those of `resample`, 0 off the sensor.
    """
    integers = np.floor(position)
    t = position - integers
    weights = tap_weights(t, interpolation)
    first = np.clip(integers - 1, -_MARGIN, n).astype(np.int32)
    pixel = integers - 1 + np.arange(4)[:, None]
    inside = (pixel >= 0) & (pixel < n)
    return first, np.where(inside, weights, 0).astype(np.float32)


def tap_weights(t: Vector, interpolation: Interpolation) -> Table:
    """Return the weights of four samples about positions between the second and the third."""
    if interpolation == "linear":
        return np.stack((0 * t, 1 - t, t, 0 * t))
    if interpolation == "spline":
        s = 1 - t
        return np.stack((s**3, (3 * t - 6) * t**2 + 4, (3 * s - 6) * s**2 + 4, t**3)) / 6
    return np.stack(
        (
            ((1 - 0.5 * t) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1,
            ((2 - 1.5 * t) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        )
    )


def resample(
    pixels: cla.Array, grid: LensletGrid, device: Device, *, interpolation: Interpolation = "cubic"
) -> cla.Array:
    """Resample a raw image (ny, nx), float32, to views, interpolated along both axes.

    An integer position copies its pixel; pixels off the sensor are 0. On a hexagonal lattice every
    lenslet is sampled about its own centre. Its odd rows are then interpolated by the same cubic,
    in the same pass, to the columns of the even rows (or all rows to the grid's ``columns``), which
    makes the lattice rectangular. At the end of such a row the last lenslet is repeated.
    """
    _check(pixels, grid, device)
    device.require_memory(4 * int(np.prod(grid.shape, dtype=np.int64)), "This light field")
    views = device.empty(grid.shape, np.float32)
    (V, U), (rows, lenslets) = grid.views, grid.count
    ny, nx = (int(n) for n in pixels.shape)
    strides = [np.int64(n) for n in strides_of(views, grid)]
    if device.rows and is_upright(grid) and fits_local_memory(nx, device):
        (above, down), (left, across) = taps_along(grid, (ny, nx), interpolation)
        device.launch(
            device.kernel("upright.cl", "decode_upright"),
            (V * rows,),
            *(views, pixels),
            *(device.upload(table) for table in (above, down, left + _MARGIN, across)),
            *(np.int32(n) for n in (ny, nx, V, U, rows, lenslets)),
            *strides,
            cl.LocalMemory(_line_bytes(nx)),
            group=(1,),
        )
        return views
    columns = lenslets if grid.columns is None else grid.columns[0]
    tables = grid_tables(grid, device)
    device.launch_rows(
        device.kernel("decode.cl", "decode", **form_of(interpolation)),
        (V, rows, U, columns),
        *(views, pixels, *tables.rows, *tables.columns),
        *(table for steps in tables.steps for table in split_places(steps, device)),
        *tables.near,
        *(np.int32(n) for n in (ny, nx, rows, lenslets, columns)),
        *strides,
    )
    return views


def form_of(interpolation: Interpolation) -> dict[str, Any]:
    """Return the macros of kernels that read or spread samples."""
    return {} if interpolation == "cubic" else {interpolation.upper(): True}


def _check(pixels: cla.Array, grid: LensletGrid, device: Device) -> None:
    if len(pixels.shape) != 2:
        raise ShapeError(
            "A colour picture of lenslets cannot be sliced into views; decode its colours in turn, "
            "or pass the raw frame with bayer=."
        )
    check_grid(grid)
    bad = count_bad(pixels, device)
    if bad:
        raise ValueError(
            f"The raw image has {bad} pixels that are NaN or infinite, which interpolation would "
            "spread; replace them before decoding, for example by the mean of their neighbours."
        )


def check_grid(grid: LensletGrid) -> None:
    """Reject a grid without lenslets or views, or with non-finite numbers."""
    if min(*grid.count, *grid.shape) < 1:
        raise ShapeError(
            "A lenslet grid must have at least one lenslet and one view along each axis, got "
            f"{grid.count} lenslets of {grid.views} views."
        )
    steps = (grid.row_step, grid.column_step, grid.row_view_step, grid.column_view_step)
    numbers = (*grid.first, *(n for step in steps for n in step), grid.odd_row_shift)
    numbers += (1.0,) if grid.columns is None else grid.columns
    if not np.isfinite(numbers).all():
        raise ValueError(f"The numbers of a lenslet grid must be finite, got {grid}.")


@dataclass(frozen=True)
class GridTables:
    """Positions of a grid's samples for the kernels: integers and fractions of pixels."""

    rows: tuple[cla.Array, cla.Array]  # pixel (0, 0) of the first lenslet of each row
    columns: tuple[cla.Array, cla.Array]  # each lenslet relative to the first one of its row
    near: tuple[cla.Array, cla.Array]  # columns relative to the lenslets of even and odd rows
    steps: tuple[Vector, Vector]  # views down and to the right, float64, (V, 2) and (U, 2)
    device: Device

    def views(self, v: int) -> tuple[cla.Array, cla.Array]:
        """Return the positions of the views of row v."""
        down, right = self.steps
        return split_places(down[v] + right, self.device)


def grid_tables(grid: LensletGrid, device: Device) -> GridTables:
    """Return the tables of the positions of a grid's samples."""
    V, U = grid.views
    row, column = np.asarray(grid.row_step), np.asarray(grid.column_step)
    down, right = np.asarray(grid.row_view_step), np.asarray(grid.column_view_step)
    corner = np.asarray(grid.first) - (V - 1) / 2 * down - (U - 1) / 2 * right
    i, k = (np.arange(n)[:, None] for n in grid.count)
    shift = np.where(i % 2, grid.odd_row_shift, 0.0)
    return GridTables(
        split_places(corner + i * row + shift * column, device),
        split_places(k * column, device),
        split_places(near_places(grid), device),
        (np.arange(V)[:, None] * down, np.arange(U)[:, None] * right),
        device,
    )


def near_places(grid: LensletGrid) -> Vector:
    """Return the columns' positions among the lenslets of even and odd rows, (2, columns)."""
    count, step = (grid.count[1], 1.0) if grid.columns is None else grid.columns
    shifts = np.array([0.0, grid.odd_row_shift])  # shift of a row's own lenslets, in columns
    return np.asarray(np.arange(count) * step - shifts[:, None])


def split_places(
    positions: np.ndarray[Any, np.dtype[np.float64]], device: Device
) -> tuple[cla.Array, cla.Array]:
    """Split positions into integers and fractions, int32 and float32."""
    rounded = np.round(positions * FRACTION) / FRACTION
    integers = np.floor(rounded)
    fractions = (rounded - integers).astype(np.float32)
    return device.upload(integers.astype(np.int32)), device.upload(fractions)
