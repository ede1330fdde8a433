"""The cue of correspondence: mean and variance over the views, sheared by planes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.lightfield.arrays.smoothing import Smoother, box_taps
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.depth.cue import (
    AT_ONCE,
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

_BOX = 9  # pixels: over which the variance is gathered
_HEIGHT, _VECTORS = 4, 8  # rows and vectors of a block, on CPUs


def shear_moments(lf: LightField, planes: Vector) -> tuple[cla.Array, cla.Array]:
    """Mean and variance over the views, each shifted and interpolated linearly.

    Both are float32, shape (planes, y, x[, c]): S1, the refocused pictures, and S2 - S1^2, not
    negative. A sample outside a view counts in neither, in proportion to the taps that lie
    outside; the variance is that of the interpolated values, so that it is not separable along y
    and x.
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
    """Enqueue moments_blocks, unless local memory does not suffice for planes so far apart."""
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
    """Disparity of the least variance over the views at every pixel, and how sure that is.

    V_d = B * (S2 - S1^2), the variances of the colours added, with B a box of 9 pixels; the lowest
    is refined by the parabola through it and its two neighbours.
    """
    size = (lf.shape[2], lf.shape[3])
    require_maps(lf, AT_ONCE + 7 + (AT_ONCE if len(lf.shape) == 5 else 0), 2 * AT_ONCE)
    start = nearest_zero(planes)
    tracker = PeakTracker(size, device=lf.device, start=start, most=AT_ONCE, lowest=True)
    gather = Smoother(box_taps(_BOX), device=lf.device)
    for first in range(0, planes.size, AT_ONCE):
        batch = planes[first : first + AT_ONCE]
        variance = add_colours(shear_moments(lf, batch)[1], lf.device)
        gather(tracker.curve, variance, start=tracker.held, count=batch.size)
        tracker.add(batch)
    return tracker.finish()


def correspondence_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """What `correspondence_disparity` needs; its box reaches half its size."""
    channels, most = (*source.shape, 1)[4], min(AT_ONCE, planes.size)
    return depth_memory(
        "correspondence",
        source,
        planes,
        reach=_BOX // 2,
        floats=3 * most * channels + 2 * most + 9,
        largest=most * channels,
    )


CUE = Cue(correspondence_disparity, correspondence_memory)
