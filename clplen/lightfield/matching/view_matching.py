"""Match the views of a light field with its centre on planes, past occlusions.

Costs of planes are aggregated over similar neighbours, and disparities are refined over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.arrays.shear import vector_lanes
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.alpha_law import row_ratio, unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews

Table = np.ndarray[Any, Any]
Vector = np.ndarray[Any, np.dtype[np.float64]]
Map = np.ndarray[Any, np.dtype[np.float32]]
Integers = np.ndarray[Any, np.dtype[np.int32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]
Spans = np.ndarray[Any, np.dtype[np.int32]]

GROUPS = 9  # all views and eight half apertures
RATIO, MARGIN = 1.2, 0.17  # required advantage of a half aperture; margin in levels a channel
TRUNCATION = 10.0  # levels a channel: maximum cost
_DELTA = 1e-4  # pixels: step of numerical derivatives
WINDOW = 7  # pixels: half width of the windows of costs and planes
_BLOCK, _SUPPORT_BLOCK = 512, 64  # pixels of a row per work-item on CPUs: match, others
VECTOR = 16  # pixels of a row that are processed together
_VECTORS, _HEIGHT = 8, 4  # vectors of pixels, and rows, of an item of match_rows
_TOLERANCE = 1e-6  # of a view step: tolerance of views on the line between two halves


@dataclass(frozen=True)
class ViewGroups:
    """Views in use, sorted by the half apertures that they belong to."""

    view: Table  # int32, shape (K,): number v U + u of each view
    # float64, shape (K, 2): (y, x) in pixels from a point's position in the centre view to its
    # sample, at disparity 1
    step: Vector
    first: Table  # int32, shape (patterns + 1,): first view of each pattern
    pattern: Table  # float32, shape (patterns, 9): share of a pattern's views in every group
    # int32 indices of the views that make the centre, and their ``share`` (float32, sum 1)
    reference: Table
    share: Table

    def upload(self, device: Device) -> list[Any]:
        """Return the kernel arguments of groups and references."""
        return [
            device.upload(self.first),
            device.upload(self.pattern),
            np.int32(len(self.pattern)),
            device.upload(self.reference),
            device.upload(self.share),
            np.int32(len(self.reference)),
        ]


def group_views(lf: SampledViews) -> ViewGroups:
    """Return the weighted views and their groups.

    The eight half apertures are bounded by lines through the middle, 45 degrees apart. A view on
    such a line belongs to both sides by one half; the middle view belongs to no half.
    """
    lit = np.flatnonzero(lf.weights.ravel() > 0).astype(np.int32)
    if lit.size < 2:
        raise ValueError(f"Depth needs at least two views with a weight, got {lit.size}.")
    steps = unit_steps(lf).reshape(-1, 2)
    offsets = -steps[lit] / np.maximum(np.abs(steps).max(axis=0), _TOLERANCE)
    angles = np.arange(8) * np.pi / 4
    sides = offsets @ np.stack((np.sin(angles), np.cos(angles)))
    halves = np.where(np.abs(sides) < _TOLERANCE, 0.5, sides > 0)
    halves[np.abs(offsets).max(axis=1) < _TOLERANCE] = 0
    pattern, pattern_index = np.unique(
        np.column_stack((np.ones(len(lit)), halves)), axis=0, return_inverse=True
    )
    order = np.argsort(pattern_index.ravel(), kind="stable")
    counts = np.bincount(pattern_index.ravel(), minlength=len(pattern))
    reference, share = _references(steps[lit][order] / (row_ratio(lf.spacing), 1))
    return ViewGroups(
        lit[order],
        steps[lit][order],
        np.concatenate(([0], np.cumsum(counts))).astype(np.int32),
        pattern.astype(np.float32),
        reference,
        share,
    )


def _references(positions: Vector) -> tuple[Table, Table]:
    """Return the views next to the middle with bilinear shares, or the nearest view."""
    share = np.prod(np.maximum(1 - np.abs(positions), 0), axis=1)
    if not share.any():
        share[np.argmin((positions**2).sum(axis=1))] = 1
    indices = np.flatnonzero(share)
    return indices.astype(np.int32), (share[indices] / share.sum()).astype(np.float32)


@dataclass(frozen=True)
class ShiftTables:
    """Device tables of the shifts of every view on every plane."""

    at: cla.Array  # at, part, slopes, reach: as in kernels/lightfield/matching.cl and refine.cl
    part: cla.Array
    slopes: cla.Array
    reach: cla.Array
    planes: cla.Array  # float32
    count: int  # number of planes


def shift_tables(views: ViewGroups, planes: Vector, gain: Vector, *, device: Device) -> ShiftTables:
    """Return shifts in pixels, taps and their derivatives of every view on every plane.

    The taps sample the bell (1 - t^2/4)^4, similar to a Gaussian of 0.7 pixels and 0 from two
    pixels on, corrected to keep positions exact. In contrast to linear or cubic taps, their blur
    and noise are equal for all fractions, so that noise favours no plane.
    """
    shift = np.clip(planes[:, None, None] * views.step, -(2**20), 2**20)
    pixels = np.floor(shift)
    fractions = shift - pixels
    taps = bell_taps(fractions)
    change = (bell_taps(fractions + _DELTA) - bell_taps(fractions - _DELTA)) / (2 * _DELTA)
    scale = np.stack((gain, np.ones_like(gain)), axis=-1)[..., None]
    return ShiftTables(
        device.upload(pixels.astype(np.int32)),
        device.upload((taps * scale).astype(np.float32)),
        device.upload((change * scale).astype(np.float32)),
        device.upload((fractions > 0).astype(np.int32)),
        device.upload(planes.astype(np.float32)),
        planes.size,
    )


def bell_taps(fractions: Vector) -> Vector:
    """Return taps at -1, 0, 1, 2 (last axis) for a fraction: sum 1, mean equal to the fraction."""
    t = np.arange(-1, 3)
    taps = np.maximum(1 - (t - fractions[..., None]) ** 2 / 4, 0) ** 4
    taps /= taps.sum(axis=-1, keepdims=True)
    mean = (taps * t).sum(axis=-1, keepdims=True)
    spread = (taps * (t - mean) ** 2).sum(axis=-1, keepdims=True)
    return taps * (1 + (fractions[..., None] - mean) / spread * (t - mean))


def row_sums(lf: LightField) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the sum of the samples of every row of every view."""
    V, U, ny, nx, channels = (*lf.shape, 1)[:5]
    sums = lf.device.empty((V * U, ny), np.float32)
    rows, samples = np.int32(V * U * ny), np.int32(nx * channels)
    kernel = lf.device.kernel("views.cl", "brightness", SAMPLE=C_TYPE[lf.dtype])
    lf.device.launch(kernel, (int(rows),), sums, lf.data, rows, samples)
    return lf.device.download(sums)


def match_costs(lf: LightField, views: ViewGroups, tables: ShiftTables, spans: Spans) -> cla.Array:
    """Compute the cost of every plane at every pixel of the centre view.

    The cost is the mean over the views of the absolute difference to the centre, summed over
    channels and truncated. A half aperture replaces the whole where it agrees clearly better: an
    occluder usually hides a point from one side of the aperture only.
    """
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    everywhere = bool((spans == (0, tables.count - 1)).all())
    allocate = device.empty if everywhere else device.zeros
    out = allocate((tables.count, ny, nx), np.float32)
    if in_vectors(lf):
        kernel = depth_kernel(lf, "match_rows")
        size = (tables.count, -(-ny // _HEIGHT), -(-nx // (VECTOR * _VECTORS)))
    else:
        kernel = depth_kernel(lf, "match")
        size = (-(-nx // match_block(device)), ny, tables.count)
    device.launch(
        kernel,
        size,
        out,
        lf.data,
        device.upload(spans),
        device.upload(views.view),
        tables.at,
        tables.part,
        tables.reach,
        *views.upload(device),
        *(np.int32(n) for n in (len(views.view), ny, nx)),
        *(np.float32(t) for t in thresholds(channels)),
    )
    return out


def depth_kernel(lf: LightField, name: str) -> cl.Kernel:
    """Return a kernel of combined.cl; all kernels of a kind of light field share a program."""
    lanes = vector_lanes(lf.device)[0]
    vectors = {"LANES": lanes, "MATCH_VECTORS": _VECTORS} if in_vectors(lf) else {}
    return lf.device.kernel(
        "combined.cl",
        name,
        SAMPLE=C_TYPE[lf.dtype],
        CHANNELS=(*lf.shape, 1)[4],
        RADIUS=WINDOW,
        BLOCK=support_block(lf.device),
        MATCH_BLOCK=match_block(lf.device),
        **vectors,
    )


def in_vectors(lf: LightField) -> bool:
    """Return True if samples are compared in vectors."""
    return lf.device.rows and (*lf.shape, 1)[4] in (1, 3)


def support_block(device: Device) -> int:
    """Return the pixels of a row per item of gather and fit."""
    return _SUPPORT_BLOCK if device.rows else 1


def match_block(device: Device) -> int:
    """Return the pixels of a row per item of match."""
    return _BLOCK if device.rows else 1


def thresholds(channels: int) -> tuple[float, float, float]:
    """Return tau, ratio and margin of the kernels."""
    return (TRUNCATION * channels, RATIO, MARGIN * channels)


def gather_costs(
    lf: LightField,
    out: cla.Array,
    costs: cla.Array,
    picture: cla.Array,
    scales: tuple[Map, Map],
    spans: Spans,
) -> None:
    """Average the costs around a pixel, weighted by distance and similarity (support.cl)."""
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
    mean_cost: Map | None = None,
) -> tuple[Map, Integers, Map, Map]:
    """Return the disparity of least cost, its plane, its cost and its relative depth (0 to 1).

    ``spans``, int32, shape (y, x, 2), are the first and last plane of a pixel. The depth is
    relative to the second valley or the ``mean_cost``, at least the mean over the span. Empty
    spans give 0.
    """
    device = lf.device
    _, ny, nx = (int(n) for n in costs.shape)
    position, lowest, second, mean = (device.zeros((ny, nx), np.float32) for _ in range(4))
    nearest = device.zeros((ny, nx), np.int32)
    args = (
        position,
        nearest,
        lowest,
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
    low, next_low = (device.download(a) for a in (lowest, second))
    span_mean = device.download(mean)
    mean_cost = span_mean if mean_cost is None else np.maximum(mean_cost, span_mean)
    rise = np.minimum(next_low, mean_cost) - low
    margin = np.clip(rise / np.maximum(mean_cost, 1e-6), 0, 1)
    return device.download(position), device.download(nearest), low, margin


def normal_equations(
    lf: LightField,
    views: ViewGroups,
    tables: ShiftTables,
    disparity: Map,
    nearest: Integers,
    mask: Mask,
    out: tuple[cla.Array, cla.Array],
) -> None:
    """Compute A and B of kernels/lightfield/refine.cl at the pixels of a mask."""
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    args = (
        *out,
        lf.data,
        device.upload(mask.astype(np.uint8)),
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
    """Fit planes to the neighbours' steps (fit of kernels/lightfield/refine.cl)."""
    device = lf.device
    ny, nx = disparity.shape
    out, information = (device.empty((ny, nx), np.float32) for _ in range(2))
    if in_vectors(lf):
        kernel, block = depth_kernel(lf, "fit_rows"), vector_lanes(device)[0]
    else:
        kernel, block = depth_kernel(lf, "fit"), support_block(device)
    device.launch(
        kernel,
        (-(-nx // block), ny),
        out,
        information,
        *normal,
        device.upload(disparity),
        picture,
        *(device.upload(m) for m in maps),
        *(np.float32(limit) for limit in limits),
        *(np.int32(n) for n in (ny, nx)),
    )
    return device.download(out), device.download(information)
