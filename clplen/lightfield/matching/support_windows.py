"""Costs of planes gathered over neighbours that look alike, and disparity refined over them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.shear import vector_lanes
from clplen.lightfield.matching.view_matching import (
    VECTOR,
    Mask,
    ShiftTables,
    Spans,
    ViewGroups,
    depth_kernel,
    in_vectors,
    support_block,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField

Map = np.ndarray[Any, np.dtype[np.float32]]
Whole = np.ndarray[Any, np.dtype[np.int32]]


def gather_costs(
    lf: LightField,
    out: cla.Array,
    costs: cla.Array,
    picture: cla.Array,
    scales: tuple[Map, Map],
    spans: Spans,
) -> None:
    """Mean of the costs round a pixel, by nearness and likeness: gather of support.cl."""
    device = lf.device
    planes, ny, nx = (int(n) for n in costs.shape)
    if in_vectors(lf):
        kernel, size = depth_kernel(lf, "gather_rows"), (ny, -(-nx // VECTOR))
    else:
        kernel, size = depth_kernel(lf, "gather"), (-(-nx // support_block(device)), ny)
    device.launch(
        kernel,
        size,
        out,
        costs,
        device.upload(spans),
        picture,
        *(device.upload(scale) for scale in scales),
        *(np.int32(n) for n in (planes, ny, nx)),
    )


def lowest_valley(
    lf: LightField,
    costs: cla.Array,
    tables: ShiftTables,
    spans: Spans,
    usual: Map | None = None,
) -> tuple[Map, Whole, Map, Map]:
    """Disparity of the least cost, its plane, the cost, and its depth below the others, 0 to 1.

    ``spans``, int32, shape (y, x, 2), hold the first and the last plane of a pixel. The others are
    the second valley, or the ``usual`` cost, at least the mean over the span. All are 0 where no
    plane is tried.
    """
    device = lf.device
    _, ny, nx = (int(n) for n in costs.shape)
    place, least, second, mean = (device.zeros((ny, nx), np.float32) for _ in range(4))
    nearest = device.zeros((ny, nx), np.int32)
    args = (
        place,
        nearest,
        least,
        second,
        mean,
        costs,
        device.upload(spans),
        tables.planes,
        *(np.int32(n) for n in (tables.count, ny, nx)),
    )
    if in_vectors(lf):
        blocks = -(-nx // vector_lanes(device)[0])
        device.launch(depth_kernel(lf, "valley_rows"), (blocks, ny), *args)
    else:
        device.launch_rows(depth_kernel(lf, "valley"), (ny, nx), *args)
    low, next_low = (device.download(a) for a in (least, second))
    tried = device.download(mean)
    usual = tried if usual is None else np.maximum(usual, tried)
    rise = np.minimum(next_low, usual) - low
    margin = np.clip(rise / np.maximum(usual, 1e-6), 0, 1)
    return device.download(place), device.download(nearest), low, margin


def normal_equations(
    lf: LightField,
    views: ViewGroups,
    tables: ShiftTables,
    disparity: Map,
    nearest: Whole,
    wanted: Mask,
    out: tuple[cla.Array, cla.Array],
) -> None:
    """A and B of kernels/lightfield/refine.cl at the wanted pixels."""
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    args = (
        *out,
        lf.data,
        device.upload(wanted.astype(np.uint8)),
        device.upload(disparity),
        device.upload(nearest),
        tables.planes,
        device.upload(views.view),
        device.upload(views.step.astype(np.float32)),
        tables.at,
        tables.part,
        tables.slopes,
        tables.reach,
        *views.upload(device),
        *(np.int32(n) for n in (len(views.view), ny, nx)),
        *(np.float32(t) for t in thresholds(channels)),
    )
    if in_vectors(lf):
        device.launch(depth_kernel(lf, "normal_rows"), (-(-nx // VECTOR), ny), *args)
    else:
        device.launch_rows(depth_kernel(lf, "normal"), (ny, nx), *args)


def fit_planes(
    lf: LightField,
    disparity: Map,
    picture: cla.Array,
    maps: tuple[Map, Map, Map],
    normal: tuple[cla.Array, cla.Array],
    limits: tuple[float, float, float],
) -> tuple[Map, Map]:
    """Planes through the neighbours' steps: fit of kernels/lightfield/refine.cl."""
    device = lf.device
    ny, nx = disparity.shape
    out, known = (device.empty((ny, nx), np.float32) for _ in range(2))
    if in_vectors(lf):
        kernel, block = depth_kernel(lf, "fit_rows"), vector_lanes(device)[0]
    else:
        kernel, block = depth_kernel(lf, "fit"), support_block(device)
    device.launch(
        kernel,
        (-(-nx // block), ny),
        out,
        known,
        *normal,
        device.upload(disparity),
        picture,
        *(device.upload(m) for m in maps),
        *(np.float32(limit) for limit in limits),
        *(np.int32(n) for n in (ny, nx)),
    )
    return device.download(out), device.download(known)
