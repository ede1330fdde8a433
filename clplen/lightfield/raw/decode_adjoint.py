"""From views back to a raw lenslet image: the adjoint of sampling every sub-image.

A lattice along the sensor's rows and columns is a product of two sparse matrices.
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

_SLACK = 0.01  # lenslets or views that rounding may move the bounds of what a pixel sees
_FAR = 1e6  # more than all lenslets or views
_PIXELS = 2.0  # reach of cubic convolution
_BAND = 64  # rows of the raw image that a CPU's work-item makes


def resample_adjoint(
    views: cla.Array,
    shape: tuple[int, int],
    grid: LensletGrid,
    *,
    device: Device,
    interpolation: Interpolation = "cubic",
) -> cla.Array:
    """The transpose of `clplen.lightfield.raw.decode.resample`.

    Every sample of the views is spread to the pixels that it is interpolated from, by the same
    weights. The result has the same bits in every run.
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
    """(start, sample, weight) by pixel of an axis, of four taps of each sample."""
    pixel = first + np.arange(len(weights))[:, None]
    sample = np.broadcast_to(np.arange(first.size), pixel.shape)
    kept = (weights != 0) & (pixel >= 0) & (pixel < n)
    return sparse_rows(pixel[kept], sample[kept], weights[kept], n)


def sparse_rows(row: Table, index: Table, weight: Table, n: int) -> tuple[Table, Table, Table]:
    """A sparse matrix by its rows, as kernels read it."""
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
    """Samples of the lenslets themselves, whose rows were interpolated, and their strides."""
    (V, U), (rows, count) = grid.views, grid.count
    places = np.round(near_places(grid) * FRACTION) / FRACTION
    if places.shape[1] == count and (places == np.arange(count)).all():
        return views, strides
    device.require_memory(4 * V * U * rows * count, "The samples of these lenslets")
    even, odd = (sparse_rows(*_near_lenslets(row, count, interpolation), count) for row in places)
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
    places: Table, count: int, interpolation: Interpolation
) -> tuple[Table, Table, Table]:
    """(lenslet, column, weight) of the four lenslets about each column's place in a row."""
    whole = np.floor(places)
    t = np.float32(places - whole).astype(np.float64)
    weights = tap_weights(t, "linear" if interpolation == "linear" else "cubic")
    lenslet = np.clip(whole.astype(int) - 1 + np.arange(4)[:, None], 0, count - 1)
    column = np.broadcast_to(np.arange(places.size), lenslet.shape)
    kept = weights != 0
    return lenslet[kept], column[kept], weights[kept]


def _inverse(first: tuple[float, float], second: tuple[float, float]) -> Table | None:
    """What takes (y, x) to multiples of two vectors; None where they lie on one line."""
    basis = np.array([first, second], np.float64).T
    spread = float(np.prod(np.linalg.norm(basis, axis=0)))
    if not abs(np.linalg.det(basis)) > 1e-6 * spread:
        return None
    return np.asarray(np.linalg.inv(basis))


def _bounds_of_lenslets(grid: LensletGrid) -> tuple[Table, Table]:
    """(y, x) from the first sample of the first lenslet to (i, k) of the first sample of a lenslet
    there, and how far i and k of lenslets that come near may be off: (least, most) of each."""
    inverse = _inverse(grid.row_step, grid.column_step)
    if inverse is None:
        return np.zeros(4), np.array([-_FAR, _FAR, -_FAR, _FAR])
    V, U = grid.views
    along = inverse @ np.array([grid.row_view_step, grid.column_view_step]).T
    corners = along @ np.array([(v, u) for v in (0, V - 1) for u in (0, U - 1)]).T
    reach = _PIXELS * np.abs(inverse).sum(axis=1) + _SLACK
    least, most = -corners.max(axis=1) - reach, reach - corners.min(axis=1)
    return inverse.ravel(), np.stack((least, most), axis=1).ravel()


def _bounds_of_views(grid: LensletGrid) -> tuple[Table, Table]:
    """The same of the views of one lenslet."""
    inverse = _inverse(grid.row_view_step, grid.column_view_step)
    if inverse is None:
        return np.zeros(4), np.array([-_FAR, _FAR, -_FAR, _FAR])
    reach = _PIXELS * np.abs(inverse).sum(axis=1) + _SLACK
    return inverse.ravel(), np.stack((-reach, reach), axis=1).ravel()


def _tall(grid: LensletGrid) -> Table:
    """Rows (from, to) from the first view of a lenslet to pixels that its views are spread to."""
    V, U = grid.views
    ends = np.add.outer(
        (0, (V - 1) * grid.row_view_step[0]), (0, (U - 1) * grid.column_view_step[0])
    )
    return np.array([ends.min() - _PIXELS - 1, ends.max() + _PIXELS + 2])
