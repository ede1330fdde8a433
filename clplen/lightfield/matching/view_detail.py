"""Detail of views, and which planes it makes likely at which pixels.

Brightness that differs from view to view leaves detail alone.
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

_SIGMA = 2.0  # pixels: what a wider Gaussian leaves is detail
STEPS = 64  # of a level: detail is kept as uint16, up to 512 levels either way
_OUTLINE = 0.25  # pixels a view step: disparities that differ more within
_WINDOW = 13  # so many pixels along both axes have an outline between them
_INSIDE = 0.1  # pixels a view step by which a disparity may leave that span
_ANY = 1e-3  # of a pixel near an outline: least weight
_EVENED = 3.0  # pixels: Gaussian over which costs are compared
# Where costs of the samples are above those of their detail by this factor and these levels a
# channel, brightness differs between the views: anywhere, and beside outlines.
_UNEVEN, _UNEVEN_AT_OUTLINES = (1.1, 0.1), (1.3, 0.4)
DETAIL_REACH = gaussian_taps(_SIGMA).size - 1  # pixels that detail needs,
OUTLINE_REACH = _WINDOW // 2 + gaussian_taps(_EVENED).size - 1  # and `is_even` of its maps
_INNER = 0.56  # of the aperture's half width: views that are compared on coarse planes
_APART = 2  # planes: every second one is coarse
_FEW_VIEWS, _FEW_PLANES = 25, 12  # up to which all views are compared on all planes at once
_BLUR = 1.5  # pixels: Gaussian over the coarse costs
SPAN_REACH = gaussian_taps(_BLUR).size - 1  # pixels of costs that spans need
_RISE, _LEVELS = 0.5, 0.6  # of the rise from the least to the mean cost, and levels a channel, up
# to which a plane is likely
_BESIDE = 0.3  # pixels a view step beyond what detail finds, out to which samples are compared
_NOWHERE = np.array((1, 0), np.int32)
_PLAIN = 4.0  # levels a channel: where the rise is less, all planes are


def view_detail(lf: LightField, gains: Map) -> LightField:
    """Each view less its own Gaussian of 2 pixels, in 64ths of a level, from 2^15 on.

    Brightness that differs from view to view, smoothly over the picture, is gone; so is what tells
    the two sides of an outline apart, which is why samples are compared as well (`is_even`).
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
    """What detail finds about each pixel, within 6 pixels."""

    low: Map  # low, high: The least and the largest disparity, float32, shape (y, x)
    high: Map
    # bool: where they differ by a quarter of a pixel and more, as beside an outline; and within 6
    # pixels of the edges, over which the Gaussian of each view reaches
    near: Mask

    @classmethod
    def of(cls, disparity: Map) -> Surroundings:
        """Those of a disparity map, shape (y, x)."""
        high = maximum_filter(disparity, _WINDOW, mode="nearest")
        low = minimum_filter(disparity, _WINDOW, mode="nearest")
        near = np.asarray(high - low > _OUTLINE)
        for rows in (near, near.T):
            rows[: _WINDOW // 2] = rows[max(len(rows) - _WINDOW // 2, 0) :] = True
        return cls(low, high, near)

    def between(self, disparity: Map) -> Mask:
        """Where a disparity lies between those around, or next to them."""
        return np.asarray((disparity > self.low - _INSIDE) & (disparity < self.high + _INSIDE))


def is_even(costs: tuple[Map, Map], disparity: Map, around: Surroundings, channels: int) -> Mask:
    """Where the samples themselves are to be believed, of what samples and their detail say.

    Detail is right where brightness differs from view to view, and mixes both sides of an outline.
    Near outlines samples are believed where brightness is the same in all views, so that samples
    agree as well as their detail; or nearly so well, if their disparity lies between those that
    detail finds around.
    """
    near = around.near
    weight = np.maximum(gaussian_filter(near.astype(np.float32), _EVENED, mode="nearest"), _ANY)
    ours, detail = (
        gaussian_filter(np.where(near, cost, np.float32(0)), _EVENED, mode="nearest") / weight
        for cost in costs
    )
    factor, more = _UNEVEN
    even = ours < factor * detail + more * channels
    factor, more = _UNEVEN_AT_OUTLINES
    nearly = ours < factor * detail + more * channels
    return np.asarray(near & (even | (nearly & around.between(disparity))))


@dataclass(frozen=True)
class LikelyPlanes:
    """Planes that are worth trying."""

    # int32, shape (y, x, 2): the first and the last one; last < first where there is none
    spans: Spans
    # float32, shape (y, x): mean cost over all planes; None where all planes are tried
    usual: Map | None

    def only(self, around: Surroundings, planes: Vector) -> LikelyPlanes:
        """Those near what was found around, at pixels near outlines; none at the others."""
        first = np.searchsorted(planes, around.low - _BESIDE)
        last = np.searchsorted(planes, around.high + _BESIDE) - 1
        near = np.stack((first, last), axis=-1)
        near = np.clip(near, self.spans[..., :1], self.spans[..., 1:]).astype(np.int32)
        return replace(self, spans=np.where(around.near[..., None], near, _NOWHERE))


def likely_planes(detail: LightField, planes: Vector, gain: float) -> LikelyPlanes:
    """Planes between the first and the last one on which the inner views agree well.

    The inner views move half as far from plane to plane as all of them, so that every second plane
    does. Costs are smoothed by a Gaussian of 1.5 pixels; one coarse plane more is tried at either
    end. Where costs hardly differ, as on plain surfaces, all planes are.
    """
    device, (ny, nx) = detail.device, detail.shape[2:4]
    if np.count_nonzero(detail.weights > 0) <= _FEW_VIEWS or planes.size <= _FEW_PLANES:
        every = np.tile(np.array((0, planes.size - 1), np.int32), (ny, nx, 1))
        return LikelyPlanes(every, None)
    steps = np.abs(unit_steps(detail))
    inner = (steps <= _INNER * steps.max(axis=(0, 1))).all(axis=-1)
    few = replace(detail, weights=np.where(inner, detail.weights, 0))
    views, coarse = group_views(few), planes[::_APART]
    tables = shift_tables(views, coarse, np.full(len(views.view), gain), device=device)
    costs = match_costs(few, views, tables, all_planes((ny, nx), coarse.size))
    smooth = device.empty(costs.shape, np.float32)
    Smoother(gaussian_taps(_BLUR), device=device)(smooth, costs, start=0, count=coarse.size)
    cost = device.download(smooth)
    least, usual = cost.min(axis=0), cost.mean(axis=0)
    channels = (*detail.shape, 1)[4]
    likely = cost <= least + _RISE * (usual - least) + _LEVELS * channels
    likely |= usual - least < _PLAIN * channels
    first, last = (np.zeros((ny, nx), np.int32) for _ in range(2))
    for p in range(coarse.size):
        np.copyto(last, p + 1, where=likely[p])
        np.copyto(first, coarse.size - p - 2, where=likely[coarse.size - p - 1])
    spans = np.stack((first, last), axis=-1) * _APART
    return LikelyPlanes(np.clip(spans, 0, planes.size - 1).astype(np.int32), usual)


def all_planes(shape: tuple[int, ...], count: int) -> Spans:
    """Spans of all planes for blocks of 16 pixels of a row."""
    ny, nx = shape
    return np.tile(np.array((0, count - 1), np.int32), (ny, -(-nx // VECTOR), 1))


def block_spans(spans: Spans, count: int) -> Spans:
    """Spans for blocks of 16 pixels of a row, or what is left of them at its end."""
    first, last = _without_none(spans, count)
    starts = np.arange(0, first.shape[1], VECTOR)
    return np.stack(
        (np.minimum.reduceat(first, starts, axis=1), np.maximum.reduceat(last, starts, axis=1)),
        axis=-1,
    )


def gathered_spans(spans: Spans, count: int) -> Spans:
    """Spans of all pixels at most 7 from those of some spans, whose costs gathering reads."""
    first, last = _without_none(spans, count)
    size = 2 * WINDOW + 1
    around = minimum_filter(first, size, mode="nearest"), maximum_filter(last, size, mode="nearest")
    return np.stack(around, axis=-1)


def _without_none(spans: Spans, count: int) -> tuple[Spans, Spans]:
    """First and last planes; where there is none, the first is behind all, and the last before."""
    none = spans[..., 0] > spans[..., 1]
    first, last = np.where(none, count, spans[..., 0]), np.where(none, -1, spans[..., 1])
    return first.astype(np.int32), last.astype(np.int32)
