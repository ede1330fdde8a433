"""Detail of views, and the planes that it makes likely at each pixel.

Detail does not depend on brightness differences between views.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps, launch_stretches, whole_taps
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.matching.view_matching import (
    VECTOR,
    WINDOW,
    Spans,
    group_views,
    match_costs,
    shift_tables,
)
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField

Map = np.ndarray[Any, np.dtype[np.float32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_SIGMA = 2.0  # pixels: Gaussian that is subtracted
STEPS = 64  # steps of a level: detail is stored as uint16, up to 512 levels both ways
_MIN_RANGE = 0.25  # pixels a view step: a larger range of disparities within
_WINDOW = 13  # pixels along both axes indicates an outline
_INSIDE = 0.1  # pixels a view step: tolerance of that range
_MIN_WEIGHT = 1e-3  # of a pixel near an outline: minimum weight
_COST_SIGMA = 3.0  # pixels: Gaussian over which costs are compared
# Factor and levels a channel: sample costs that exceed detail costs by both indicate brightness
# differences between views, anywhere and at outlines.
_MAX_RATIO, _MAX_RATIO_AT_OUTLINES = (1.1, 0.1), (1.3, 0.4)
DETAIL_REACH = gaussian_taps(_SIGMA).size - 1  # pixels: reach of detail,
OUTLINE_REACH = _WINDOW // 2 + gaussian_taps(_COST_SIGMA).size - 1  # and of `is_even`
_INNER = 0.56  # of the aperture's half width: views that are matched on coarse planes
_COARSE_STEP = 2  # planes: step of the coarse planes
# Up to these counts, all views are matched on all planes
_MAX_FULL_VIEWS, _MAX_FULL_PLANES = 25, 12
_BLUR = 1.5  # pixels: Gaussian over the coarse costs
SPAN_REACH = gaussian_taps(_BLUR).size - 1  # pixels: reach of spans
_RISE, _LEVELS = 0.5, 0.6  # of the rise from the least to the mean cost, and levels a channel:
# limits up to which a plane is likely
_SPAN_MARGIN = 0.3  # pixels a view step beyond the range by detail in which samples are matched
_EMPTY_SPAN = np.array((1, 0), np.int32)
_MIN_RISE = 4.0  # levels a channel: with a smaller rise, all planes are likely


def view_detail(lf: LightField, gains: Map) -> LightField:
    """Return each view less its Gaussian of 2 pixels, in 64ths of a level from 2^15 on.

    Smooth brightness differences between views vanish, but so does the difference between both
    sides of an outline. Samples are therefore matched as well (`is_even`).
    """
    device = lf.device
    V, U, ny, nx, channels = (*lf.shape, 1)[:5]
    taps = gaussian_taps(_SIGMA)
    radius = taps.size - 1
    out = device.empty(lf.data.shape, np.uint16)
    launch_stretches(
        device,
        ("view_detail.cl", "view_detail"),
        (V * U, ny, nx * channels),
        (
            out,
            lf.data,
            device.upload(whole_taps(taps, device)),
            device.upload((STEPS * gains).astype(np.float32)),
            *(np.int32(n) for n in (radius, ny, nx)),
        ),
        halos=(radius * channels,),
        channels=channels,
        SAMPLE=C_TYPE[lf.dtype],
        CHANNELS=channels,
    )
    return replace(lf, data=out, raw=None)


@dataclass(frozen=True)
class Surroundings:
    """Disparities from detail in the neighbourhood of each pixel, within 6 pixels."""

    low: Map  # low, high: smallest and largest disparity, float32, shape (y, x)
    high: Map
    # bool: range of a quarter pixel or more, as at outlines, or within 6 pixels of the edges, which
    # the Gaussian of each view reaches
    near: Mask

    @classmethod
    def of(cls, disparity: Map) -> Surroundings:
        """Return the surroundings in a disparity map, shape (y, x)."""
        high = maximum_filter(disparity, _WINDOW, mode="nearest")
        low = minimum_filter(disparity, _WINDOW, mode="nearest")
        near = np.asarray(high - low > _MIN_RANGE)
        for rows in (near, near.T):
            rows[: _WINDOW // 2] = rows[max(len(rows) - _WINDOW // 2, 0) :] = True
        return cls(low, high, near)

    def between(self, disparity: Map) -> Mask:
        """Return a mask of disparities inside the range of the neighbourhood, with tolerance."""
        return np.asarray((disparity > self.low - _INSIDE) & (disparity < self.high + _INSIDE))


def is_even(
    costs: tuple[Map, Map], disparity: Map, surroundings: Surroundings, channels: int
) -> Mask:
    """Return a mask of pixels whose samples outrank their detail.

    Detail is robust to brightness differences but mixes both sides of an outline. Near outlines
    samples win if their costs match those of detail, i.e. brightness is equal in all views. They
    also win with slightly higher costs if their disparity is inside the range found by detail.
    """
    near = surroundings.near
    weight = np.maximum(
        gaussian_filter(near.astype(np.float32), _COST_SIGMA, mode="nearest"), _MIN_WEIGHT
    )
    sample_costs, detail = (
        gaussian_filter(np.where(near, cost, np.float32(0)), _COST_SIGMA, mode="nearest") / weight
        for cost in costs
    )
    factor, levels = _MAX_RATIO
    even = sample_costs < factor * detail + levels * channels
    factor, levels = _MAX_RATIO_AT_OUTLINES
    nearly = sample_costs < factor * detail + levels * channels
    return np.asarray(near & (even | (nearly & surroundings.between(disparity))))


@dataclass(frozen=True)
class LikelyPlanes:
    """Range of likely planes at every pixel."""

    # int32, shape (y, x, 2): first and last plane; last < first if empty
    spans: Spans
    # float32, shape (y, x): mean cost over all planes; None if all planes are likely
    mean_cost: Map | None

    def only(self, surroundings: Surroundings, planes: Vector) -> LikelyPlanes:
        """Restrict spans to the range of the neighbourhood near outlines; empty elsewhere."""
        first = np.searchsorted(planes, surroundings.low - _SPAN_MARGIN)
        last = np.searchsorted(planes, surroundings.high + _SPAN_MARGIN) - 1
        near = np.stack((first, last), axis=-1)
        near = np.clip(near, self.spans[..., :1], self.spans[..., 1:]).astype(np.int32)
        return replace(self, spans=np.where(surroundings.near[..., None], near, _EMPTY_SPAN))


def likely_planes(detail: LightField, planes: Vector, gain: float) -> LikelyPlanes:
    """Return the planes between the first and the last of good agreement among inner views.

    Inner views move half as far between planes, so every second plane suffices. Costs are smoothed
    by a Gaussian of 1.5 pixels, and spans are extended by one coarse plane at both ends. Where
    costs hardly differ, as on plain surfaces, all planes are likely.
    """
    device, (ny, nx) = detail.device, detail.shape[2:4]
    if np.count_nonzero(detail.weights > 0) <= _MAX_FULL_VIEWS or planes.size <= _MAX_FULL_PLANES:
        spans_of_all = np.tile(np.array((0, planes.size - 1), np.int32), (ny, nx, 1))
        return LikelyPlanes(spans_of_all, None)
    steps = np.abs(unit_steps(detail))
    inner = (steps <= _INNER * steps.max(axis=(0, 1))).all(axis=-1)
    inner_detail = replace(detail, weights=np.where(inner, detail.weights, 0))
    views, coarse = group_views(inner_detail), planes[::_COARSE_STEP]
    tables = shift_tables(views, coarse, np.full(len(views.view), gain), device=device)
    costs = match_costs(inner_detail, views, tables, all_planes((ny, nx), coarse.size))
    smooth = device.empty(costs.shape, np.float32)
    Smoother(gaussian_taps(_BLUR), device=device)(smooth, costs, start=0, count=coarse.size)
    cost = device.download(smooth)
    lowest, mean_cost = cost.min(axis=0), cost.mean(axis=0)
    channels = (*detail.shape, 1)[4]
    is_likely = cost <= lowest + _RISE * (mean_cost - lowest) + _LEVELS * channels
    is_likely |= mean_cost - lowest < _MIN_RISE * channels
    first, last = (np.zeros((ny, nx), np.int32) for _ in range(2))
    for p in range(coarse.size):
        np.copyto(last, p + 1, where=is_likely[p])
        np.copyto(first, coarse.size - p - 2, where=is_likely[coarse.size - p - 1])
    spans = np.stack((first, last), axis=-1) * _COARSE_STEP
    return LikelyPlanes(np.clip(spans, 0, planes.size - 1).astype(np.int32), mean_cost)


def all_planes(shape: tuple[int, ...], count: int) -> Spans:
    """Return spans of all planes for blocks of 16 pixels of a row."""
    ny, nx = shape
    return np.tile(np.array((0, count - 1), np.int32), (ny, -(-nx // VECTOR), 1))


def block_spans(spans: Spans, count: int) -> Spans:
    """Return the spans of blocks of 16 pixels of a row (the last block may be shorter)."""
    first, last = _without_none(spans, count)
    starts = np.arange(0, first.shape[1], VECTOR)
    return np.stack(
        (np.minimum.reduceat(first, starts, axis=1), np.maximum.reduceat(last, starts, axis=1)),
        axis=-1,
    )


def gathered_spans(spans: Spans, count: int) -> Spans:
    """Return the union of spans within 7 pixels, whose costs the aggregation reads."""
    first, last = _without_none(spans, count)
    size = 2 * WINDOW + 1
    limits = minimum_filter(first, size, mode="nearest"), maximum_filter(last, size, mode="nearest")
    return np.stack(limits, axis=-1)


def _without_none(spans: Spans, count: int) -> tuple[Spans, Spans]:
    """Return first and last planes, with first beyond all and last before all for empty spans."""
    empty = spans[..., 0] > spans[..., 1]
    first, last = np.where(empty, count, spans[..., 0]), np.where(empty, -1, spans[..., 1])
    return first.astype(np.int32), last.astype(np.int32)
