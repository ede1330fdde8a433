"""Adjoint of decoding: views back to a raw lenslet image.

For a lattice along the sensor's rows and columns it is a product of two sparse matrices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.raw.decode import (
    FRACTION,
    Interpolation,
    check_grid,
    form_of,
    grid_tables,
    is_upright,
    near_places,
    split_places,
    strides_of,
    tap_weights,
    taps_along,
)
from clplen.lightfield.raw.lenslet_grid import LensletGrid

Table = np.ndarray[Any, Any]

_SLACK = 0.01  # lenslets or views: tolerance of the bounds against rounding
_UNBOUNDED = 1e6  # more than all lenslets or views
_REACH = 2.0  # reach of cubic convolution in pixels
_BAND = 64  # rows of the raw image per work-item of a CPU


def resample_adjoint(
    views: cla.Array,
    shape: tuple[int, int],
    grid: LensletGrid,
    *,
    device: Device,
    interpolation: Interpolation = "cubic",
) -> cla.Array:
    """Apply the transpose of `clplen.lightfield.raw.decode.resample`.

    Every sample of the views is spread to the pixels that it is interpolated from, with equal
    weights. Results are bitwise reproducible.
    """
    check_grid(grid)
    strides = strides_of(views, grid)
    raw = device.empty(shape, np.float32)
    if is_upright(grid):
        _spread_upright(raw, views, grid, strides, device, interpolation)
    else:
        _spread_any(raw, views, grid, strides, device, interpolation)
    return raw


def _spread_upright(
    raw: cla.Array,
    views: cla.Array,
    grid: LensletGrid,
    strides: list[int],
    device: Device,
    interpolation: Interpolation,
) -> None:
    ny, nx = (int(n) for n in raw.shape)
    (V, _), (rows, columns) = grid.views, grid.count
    device.require_memory(4 * V * rows * nx, "The rows of this raw image")
    line = device.empty((V * rows, nx), np.float32)
    down, right = taps_along(grid, (ny, nx), interpolation)
    stride_v, stride_u, stride_y, stride_x = strides
    start, sample, weight = _by_pixel(*right, nx)
    offset = sample // columns * np.int64(stride_u) + sample % columns * np.int64(stride_x)
    device.launch_rows(
        device.kernel("decode_adjoint.cl", "across", **form_of(interpolation)),
        line.shape,
        *(line, views, device.upload(start), device.upload(offset), device.upload(weight)),
        *(np.int32(n) for n in (rows, nx)),
        *(np.int64(n) for n in (stride_v, stride_y)),
    )
    device.launch_rows(
        device.kernel("decode_adjoint.cl", "upwards", **form_of(interpolation)),
        raw.shape,
        *(raw, line),
        *(device.upload(table) for table in _by_pixel(*down, ny)),
        np.int32(nx),
    )


def _by_pixel(first: Table, weights: Table, n: int) -> tuple[Table, Table, Table]:
    """Return (start, sample, weight) by pixel of an axis, from four taps of each sample."""
    pixel = first + np.arange(len(weights))[:, None]
    sample = np.broadcast_to(np.arange(first.size), pixel.shape)
    valid = (weights != 0) & (pixel >= 0) & (pixel < n)
    return sparse_rows(pixel[valid], sample[valid], weights[valid], n)


def sparse_rows(row: Table, index: Table, weight: Table, n: int) -> tuple[Table, Table, Table]:
    """Return a sparse matrix in rows, in the layout of the kernels."""
    order = np.lexsort((index, row))
    start = np.searchsorted(row[order], np.arange(n + 1))
    index, weight = (np.append(a[order], 0) for a in (index, weight))
    return start.astype(np.int32), index.astype(np.int32), weight.astype(np.float32)


def _spread_any(
    raw: cla.Array,
    views: cla.Array,
    grid: LensletGrid,
    strides: list[int],
    device: Device,
    interpolation: Interpolation,
) -> None:
    ny, nx = (int(n) for n in raw.shape)
    (V, U), (rows, count) = grid.views, grid.count
    sampled, strides = _of_lenslets(views, grid, strides, device, interpolation)
    tables = grid_tables(grid, device)
    bounds = (*_bounds_of_lenslets(grid), np.array([0, grid.odd_row_shift]))
    device.launch(
        device.kernel("decode_adjoint.cl", "pixels", **form_of(interpolation)),
        (-(-ny // _BAND), 1) if device.rows else (nx, ny),
        *(raw, sampled),
        *(*tables.rows, *tables.columns),
        *(table for steps in tables.steps for table in split_places(steps, device)),
        *(a.astype(np.float32) for a in (*bounds, *_bounds_of_views(grid), _tall(grid))),
        *(np.int32(n) for n in (_BAND, ny, nx, rows, count, V, U)),
        *(np.int64(n) for n in strides),
    )


def _of_lenslets(
    views: cla.Array,
    grid: LensletGrid,
    strides: list[int],
    device: Device,
    interpolation: Interpolation,
) -> tuple[cla.Array, list[int]]:
    """Return samples at the lenslets, before the interpolation of rows, and their strides."""
    (V, U), (rows, count) = grid.views, grid.count
    positions = np.round(near_places(grid) * FRACTION) / FRACTION
    if positions.shape[1] == count and (positions == np.arange(count)).all():
        return views, strides
    device.require_memory(4 * V * U * rows * count, "The samples of these lenslets")
    even, odd = (
        sparse_rows(*_near_lenslets(row, count, interpolation), count) for row in positions
    )
    starts = even[0], odd[0] + np.int32(even[1].size)
    tables = starts, (even[1], odd[1]), (even[2], odd[2])
    sampled = device.empty((V, U, rows, count), np.float32)
    device.launch_rows(
        device.kernel("decode_adjoint.cl", "lenslets", **form_of(interpolation)),
        (V * U, rows, count),
        *(sampled, views),
        *(device.upload(np.concatenate(parts)) for parts in tables),
        *(np.int32(n) for n in (U, rows, count)),
        *(np.int64(n) for n in strides),
    )
    return sampled, [U * rows * count, rows * count, count, 1]


def _near_lenslets(
    positions: Table, count: int, interpolation: Interpolation
) -> tuple[Table, Table, Table]:
    """Return (lenslet, column, weight) of the four lenslets about each column's position."""
    integers = np.floor(positions)
    t = np.float32(positions - integers).astype(np.float64)
    weights = tap_weights(t, "linear" if interpolation == "linear" else "cubic")
    lenslet = np.clip(integers.astype(int) - 1 + np.arange(4)[:, None], 0, count - 1)
    column = np.broadcast_to(np.arange(positions.size), lenslet.shape)
    valid = weights != 0
    return lenslet[valid], column[valid], weights[valid]


def _inverse(first: tuple[float, float], second: tuple[float, float]) -> Table | None:
    """Return the matrix from (y, x) to multiples of two vectors; None if they are parallel."""
    basis = np.array([first, second], np.float64).T
    spread = float(np.prod(np.linalg.norm(basis, axis=0)))
    if not abs(np.linalg.det(basis)) > 1e-6 * spread:
        return None
    return np.asarray(np.linalg.inv(basis))


def _bounds_of_lenslets(grid: LensletGrid) -> tuple[Table, Table]:
    """Return the matrix from (y, x), relative to the first sample, to lenslet indices (i, k).

    Also return the index range (lowest, highest) of contributing lenslets.
    """
    inverse = _inverse(grid.row_step, grid.column_step)
    if inverse is None:
        return np.zeros(4), np.array([-_UNBOUNDED, _UNBOUNDED, -_UNBOUNDED, _UNBOUNDED])
    V, U = grid.views
    along = inverse @ np.array([grid.row_view_step, grid.column_view_step]).T
    corners = along @ np.array([(v, u) for v in (0, V - 1) for u in (0, U - 1)]).T
    reach = _REACH * np.abs(inverse).sum(axis=1) + _SLACK
    lowest, highest = -corners.max(axis=1) - reach, reach - corners.min(axis=1)
    return inverse.ravel(), np.stack((lowest, highest), axis=1).ravel()


def _bounds_of_views(grid: LensletGrid) -> tuple[Table, Table]:
    """Return the matrix and range of `_bounds_of_lenslets` for the views of one lenslet."""
    inverse = _inverse(grid.row_view_step, grid.column_view_step)
    if inverse is None:
        return np.zeros(4), np.array([-_UNBOUNDED, _UNBOUNDED, -_UNBOUNDED, _UNBOUNDED])
    reach = _REACH * np.abs(inverse).sum(axis=1) + _SLACK
    return inverse.ravel(), np.stack((-reach, reach), axis=1).ravel()


def _tall(grid: LensletGrid) -> Table:
    """Return the row range of the pixels reached by the views of a lenslet."""
    V, U = grid.views
    ends = np.add.outer(
        (0, (V - 1) * grid.row_view_step[0]), (0, (U - 1) * grid.column_view_step[0])
    )
    return np.array([ends.min() - _REACH - 1, ends.max() + _REACH + 2])
