"""Cue of correspondence: mean and variance over the views, sheared by planes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.lightfield.arrays.smoothing import Smoother, box_taps
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.depth.cue import (
    BATCH_PLANES,
    Cue,
    Map,
    PeakTracker,
    depth_memory,
    nearest_zero,
    require_maps,
)
from clplen.lightfield.depth.sheared_views import (
    add_colours,
    edge_table,
    launch_sheared,
    vectors_of,
    view_tables,
)
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import MemoryEstimate

Vector = np.ndarray[Any, np.dtype[np.float64]]

_BOX = 9  # pixels: side of the box over which the variance is averaged
_HEIGHT, _VECTORS = 4, 8  # rows and vectors of a block, on CPUs


def shear_moments(lf: LightField, planes: Vector) -> tuple[cla.Array, cla.Array]:
    """Compute mean and variance over the shifted, linearly interpolated views.

    Both are float32, shape (planes, y, x[, c]): S1, the refocused pictures, and S2 - S1^2 >= 0.
    Taps outside a view reduce its weight in proportion. The variance is that of the interpolated
    values, so it does not separate along y and x.
    """
    device = lf.device
    shape = (planes.size, *lf.shape[2:])
    nbytes = 8 * int(np.prod(shape, dtype=np.int64))
    device.require_memory(nbytes + lf.data.nbytes, "The mean and variance of these planes")
    mean, variance = (device.empty(shape, np.float32) for _ in range(2))
    views = np.flatnonzero(lf.weights)
    tables = view_tables(lf, planes, views, lf.weights.ravel()[views])
    grid = unit_steps(lf).reshape(-1, 2)[views]
    middle = views[np.argmin(np.hypot(*grid.T))]
    args = (mean, variance, lf.data, *tables, np.int32(views.size), np.int32(middle))
    if not (device.rows and _launch_blocks(lf, args, planes.size, device.download(tables[0]))):
        launch_sheared(lf, ("moments.cl", "moments"), planes.size, args)
    return mean, variance


def _launch_blocks(
    lf: LightField, args: tuple[Any, ...], planes: int, position: np.ndarray[Any, Any]
) -> bool:
    """Enqueue moments_blocks; return False if the planes' span exceeds local memory."""
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    lanes = vectors_of(device)[0]
    chunk = lanes * _VECTORS
    low = position[..., 1:3].min(axis=0)
    span = position[..., 1:3].max(axis=0) - low
    pitch = -(-(chunk + (int(span[:, 1].max()) + 1) * channels) // lanes) * lanes
    sums = (3 * planes + 1) * _HEIGHT * chunk + chunk
    rows = (_HEIGHT + 1 + int(span[:, 0].max())) * pitch
    if 4 * (sums + rows) > int(device.cl_device.local_mem_size) // 2:
        return False
    edge, reach = edge_table(nx, channels, chunk)
    kernel = device.kernel(
        "moments.cl",
        "moments_blocks",
        SAMPLE=C_TYPE[lf.dtype],
        LANES=lanes,
        VECTORS=_VECTORS,
        HEIGHT=_HEIGHT,
    )
    device.launch(
        kernel,
        (-(-nx * channels // chunk), -(-ny // _HEIGHT)),
        *args,
        *(device.upload(table.astype(np.int32)) for table in (low, span)),
        *(np.int32(n) for n in (planes, pitch)),
        *(cl.LocalMemory(4 * n) for n in (sums, rows)),
        device.upload(edge),
        *(np.int32(n) for n in (reach, ny, nx, channels)),
        group=(1, 1),
    )
    return True


def correspondence_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Return the disparity of least variance over the views, with confidence, per pixel.

    V_d = B * (S2 - S1^2), summed over the colours, with B a box of 9 pixels. A parabola through the
    lowest value and its two neighbours refines the result.
    """
    size = (lf.shape[2], lf.shape[3])
    require_maps(
        lf, BATCH_PLANES + 7 + (BATCH_PLANES if len(lf.shape) == 5 else 0), 2 * BATCH_PLANES
    )
    start = nearest_zero(planes)
    tracker = PeakTracker(size, device=lf.device, start=start, capacity=BATCH_PLANES, lowest=True)
    gather = Smoother(box_taps(_BOX), device=lf.device)
    for first in range(0, planes.size, BATCH_PLANES):
        batch = planes[first : first + BATCH_PLANES]
        variance = add_colours(shear_moments(lf, batch)[1], lf.device)
        gather(tracker.curve, variance, start=tracker.stored, count=batch.size)
        tracker.add(batch)
    return tracker.finish()


def correspondence_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """Estimate the memory of `correspondence_disparity`; its box reaches half its size."""
    channels, batch = (*source.shape, 1)[4], min(BATCH_PLANES, planes.size)
    return depth_memory(
        "correspondence",
        source,
        planes,
        reach=_BOX // 2,
        floats=3 * batch * channels + 2 * batch + 9,
        largest=batch * channels,
    )


CUE = Cue(correspondence_disparity, correspondence_memory)
