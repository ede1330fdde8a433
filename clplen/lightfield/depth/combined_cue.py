"""Depth by matching with occlusion handling, adaptive support and least-squares refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from scipy.ndimage import maximum_filter

from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.cue import (
    MAP_BYTES,
    Cue,
    Mask,
    PartialDepth,
    depth_memory,
    nearest_zero,
)
from clplen.lightfield.depth.energy_cue import PICTURES, energy_disparity, energy_floats
from clplen.lightfield.depth.sparse_points import (
    has_sparse_light,
    lit_pixels,
    point_disparity,
    point_planes,
    sparse_pixels,
)
from clplen.lightfield.matching.view_detail import (
    DETAIL_REACH,
    OUTLINE_REACH,
    SPAN_REACH,
    STEPS,
    LikelyPlanes,
    Surroundings,
    block_spans,
    gathered_spans,
    is_even,
    likely_planes,
    view_detail,
)
from clplen.lightfield.matching.view_matching import (
    WINDOW,
    ShiftTables,
    Spans,
    ViewGroups,
    fit_planes,
    gather_costs,
    group_views,
    lowest_valley,
    match_costs,
    normal_equations,
    row_sums,
    shift_tables,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import DEVICE_FLOAT, HOST_FLOAT, MemoryEstimate

Map = np.ndarray[Any, np.dtype[np.float32]]
Vector = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int32]]

# Gaussian support: pixels, pixels, growth per level of noise
_MIN_SIGMA, _MAX_SIGMA, _SIGMA_GROWTH = 3.0, 6.0, 0.4
_MAX_QUIET_NOISE = 2.0  # levels of noise up to which the support is narrowest
_SIDE_TAP = 0.2  # side taps of the filter of the guiding picture
_COLOUR_TOLERANCE = 6.0  # levels a channel: larger differences separate surfaces
_NOISE_BLUR = 8.0  # pixels: support of the noise estimate
_MIN_NOISE_SUPPORT = 1e-3  # minimum fraction of valid neighbours for the noise estimate
_COST_PER_NOISE = 0.62  # least cost of a channel over the noise of a sample
_FIT_COLOUR_TOLERANCE = 8.0  # levels a channel, for the refinement
_SURFACE_TOLERANCE = 0.2  # pixels a view step: larger differences separate surfaces
_MAX_STEP = 0.1  # pixels a view step: maximum change by the refinement
_RIDGE = 0.3  # pixels^2: regularisation of the refinement
_PRIOR = 100.0  # weight of the matched disparity, in levels^2 a channel at a noise of one level
_MAX_COST_SHARE = 0.8  # of the truncation: a higher least cost is a mismatch,
_MIN_CONFIDENCE = 0.02  # unless the confidence is at least this
_MAX_PLANE_STEP = 0.15  # pixels a view step: maximum distance of planes; gaps get additional planes
# Support of a pixel: refinement, outline test, twice noise and aggregation (of detail, and of
# samples at outlines), range of planes, and detail.
_NOISE_REACH = gaussian_taps(_NOISE_BLUR).size - 1 + WINDOW
_REACH = WINDOW + OUTLINE_REACH + 2 * _NOISE_REACH + SPAN_REACH + DETAIL_REACH
_POINT_FLOATS = 24  # float32 values of a pixel while points are detected
_MERGE_BYTES = MAP_BYTES + 13  # bytes of a pixel while confidences are merged
_ROUNDING = 1e-9  # pixels^-2: information of a blank light field
_HALF_CONFIDENCE_ERROR = 0.05  # pixels a view step: standard deviation at a confidence of one half
_LEVELS = 255.0  # levels between the darkest and the brightest sample of the centre view
_OUTLIERS = 0.2  # per cent of the samples clipped at either end
_MAX_BRIGHTNESS_RATIO = 4.0  # largest brightness ratio of a view that is corrected
_MIN_RADII = 2  # minimum number of view radii for a vignetting fit
_MIN_EXPOSURE_STEP = 0.1  # relative residual above which exposures are corrected
_MIN_VIEWS_PER_PARAMETER = 2  # views a parameter: minimum for a fit over the aperture
_ROUNDS = 20  # iterations of the least-absolute-values fit
_MIN_VIGNETTING = 0.02  # minimum fall of brightness from middle to rim that is corrected


def combined_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Estimate disparity and confidence of every pixel of the centre view.

    docs/depth.md lists the steps: `match_costs`, aggregation over similar neighbours, the lowest
    valley, least squares on all views, and the sharpest plane for mismatches.
    """
    survey = LevelSurvey(lf)
    survey.add(slice(0, lf.shape[2]), lf)
    result = match_views(lf, planes, survey.finish())
    return result.disparity, merge_confidence(result.confidence, result.lost)


def match_views(
    lf: LightField, planes: Vector, levels: SampleLevels, *, inside: tuple[slice, ...] = ()
) -> PartialDepth:
    """Estimate each pixel's disparity from its neighbourhood, `_REACH` pixels wide."""
    dense = _dense(planes)
    centre = centre_picture(lf, group_views(lf))
    result, margin = _match_detail(lf, dense, levels, centre)
    if result.lost[inside].any():
        sharpest, clear = energy_disparity(lf, dense)
        disparity = np.where(result.lost, sharpest, result.disparity)
        result = PartialDepth(
            disparity, np.where(result.lost, clear, result.confidence), result.lost
        )
    disparity = np.where(margin > 0, result.disparity, nearest_zero(dense))
    confidence, lost = result.confidence, result.lost
    sparse = sparse_pixels(centre)
    if sparse[inside].any():
        point_values, clear = point_disparity(lf, planes)
        disparity = np.where(sparse, point_values, disparity)
        # detail spreads over the black beside a point
        neighbourhood = maximum_filter(sparse, 2 * DETAIL_REACH + 1)
        lit = np.where(neighbourhood, lit_pixels(centre), 1)
        confidence = np.where(sparse, clear, confidence) * lit
        lost = lost & ~sparse
    disparity = np.clip(disparity, planes[0], planes[-1]).astype(np.float32)
    return PartialDepth(disparity, confidence.astype(np.float32), lost)


def _match_detail(
    lf: LightField, planes: Vector, levels: SampleLevels, centre: Map
) -> tuple[PartialDepth, Map]:
    """Match on the detail of views, and on their samples near outlines."""
    device = lf.device
    ny, nx = lf.shape[2:4]
    detail_bytes = 2 * math.prod(lf.shape)
    device.require_memory(
        lf.data.nbytes + detail_bytes + 8 * ny * nx * (planes.size + 8),
        "This depth map with its light field",
    )
    views = group_views(lf)
    guide = device.upload(_guide(centre * np.float32(levels.gain)))
    gains = np.zeros(lf.weights.size)
    gains[views.view] = levels.gain * levels.even
    detail = view_detail(lf, gains.reshape(lf.weights.shape))
    likely = likely_planes(detail, planes, 1 / STEPS)
    tables = shift_tables(views, planes, np.full(len(views.view), 1 / STEPS), device=device)
    match, noise = _matched(detail, views, tables, guide, likely)
    A, B = (device.empty(noise.shape, np.float32) for _ in range(2))
    surroundings = Surroundings.of(match.disparity)
    even = np.zeros_like(surroundings.near)
    if surroundings.near.any():
        sample_tables = shift_tables(views, planes, gains[views.view], device=device)
        nearby_planes = likely.only(surroundings, planes)
        samples, sample_noise = _matched(lf, views, sample_tables, guide, nearby_planes)
        costs = (samples.cost, match.cost)
        even = is_even(costs, samples.disparity, surroundings, (*lf.shape, 1)[4])
        match = samples.where(even, match)
        noise = np.where(even, sample_noise, noise)
        normal_equations(lf, views, sample_tables, match.disparity, match.nearest, even, (A, B))
    normal_equations(detail, views, tables, match.disparity, match.nearest, ~even, (A, B))
    return _refined_match(lf, match, guide, noise, (A, B)), match.margin


@dataclass(frozen=True)
class _Match:
    """Lowest valley of the costs at every pixel before refinement, arrays of shape (y, x)."""

    disparity: Map  # disparity, nearest: valley, and its nearest plane
    nearest: Integers
    # cost, margin: cost in the valley, and its relative depth below the second one, 0 to 1
    cost: Map
    margin: Map

    def where(self, mask: Mask, other: _Match) -> _Match:
        """Return this match where the mask is set, the other elsewhere."""
        return _Match(
            np.where(mask, self.disparity, other.disparity),
            np.where(mask, self.nearest, other.nearest),
            np.where(mask, self.cost, other.cost),
            np.where(mask, self.margin, other.margin),
        )


def _matched(
    lf: LightField,
    views: ViewGroups,
    tables: ShiftTables,
    guide: cla.Array,
    likely: LikelyPlanes,
) -> tuple[_Match, Map]:
    """Return the valley of the costs of likely planes, and the noise in levels."""
    spans, count = likely.spans, tables.count
    padded_spans = gathered_spans(spans, count)
    costs = match_costs(lf, views, tables, block_spans(padded_spans, count))
    noise = _noise(lf, costs, tables, padded_spans)
    aggregated = lf.device.empty(costs.shape, np.float32)
    scales = (_distance_scale(noise), _colour_scale(_COLOUR_TOLERANCE, noise, (*lf.shape, 1)[4]))
    gather_costs(lf, aggregated, costs, guide, scales, block_spans(spans, count))
    return _Match(*lowest_valley(lf, aggregated, tables, spans, likely.mean_cost)), noise


def _refined_match(
    lf: LightField, match: _Match, guide: cla.Array, noise: Map, normal: tuple[cla.Array, cla.Array]
) -> PartialDepth:
    """Refine a valley by least squares; return confidence and mask of mismatches too."""
    channels, views = (*lf.shape, 1)[4], int(np.count_nonzero(lf.weights > 0))
    refined, information = _refined(lf, match.disparity, guide, noise, normal)
    precision = information * views / np.maximum(noise, 1) ** 2
    precision = np.where(precision > _ROUNDING, precision, 0)
    confidence = match.margin * precision / (precision + 1 / _HALF_CONFIDENCE_ERROR**2)
    lost = (match.cost > _MAX_COST_SHARE * thresholds(channels)[0]) & (confidence < _MIN_CONFIDENCE)
    return PartialDepth(refined, confidence.astype(np.float32), lost)


def merge_confidence(confidence: Map, lost: Mask) -> Map:
    """Merge confidences: a matched pixel outranks a pixel of the sharpest plane."""
    median = np.median(confidence[~lost]) if lost.any() and not lost.all() else 0.0
    return (
        np.where(lost, confidence * median, confidence) if median > _MIN_CONFIDENCE else confidence
    )


def _guide(picture: Map) -> Map:
    """Return the smoothed guiding picture, channels first."""
    smooth = _smoothed(picture)
    return smooth if smooth.ndim == 2 else np.ascontiguousarray(np.moveaxis(smooth, -1, 0))


def _smoothed(picture: Map) -> Map:
    """Blur a picture slightly along both axes, against noise in colour differences."""
    for axis in (0, 1):
        pad = [(1, 1) if i == axis else (0, 0) for i in range(picture.ndim)]
        wide = np.pad(picture, pad, mode="edge")
        n = picture.shape[axis]
        before, after = (np.take(wide, np.arange(n) + i, axis=axis) for i in (0, 2))
        picture = (1 - 2 * _SIDE_TAP) * picture + _SIDE_TAP * (before + after)
    return np.ascontiguousarray(picture, np.float32)


def _dense(planes: Vector) -> Vector:
    """Insert planes where neighbouring planes are far apart."""
    steps = np.diff(planes)
    parts = np.maximum(np.ceil(steps / _MAX_PLANE_STEP - 1e-9), 1).astype(int)
    between = [
        low + step * np.arange(n) / n for low, step, n in zip(planes, steps, parts, strict=False)
    ]
    return np.concatenate([*between, planes[-1:]])


def _noise(lf: LightField, costs: cla.Array, tables: ShiftTables, spans: Spans) -> Map:
    """Estimate the noise of the samples in levels from the least cost around every pixel."""
    device, channels = lf.device, (*lf.shape, 1)[4]
    lowest = lowest_valley(lf, costs, tables, spans)[2]
    valid = spans[..., 0] <= spans[..., 1]
    blurred = device.empty((2, *lowest.shape), np.float32)
    smooth = Smoother(gaussian_taps(_NOISE_BLUR), device=device)
    smooth(blurred, device.upload(np.stack((lowest, valid), dtype=np.float32)), start=0, count=2)
    mean, share = device.download(blurred)
    return np.asarray(
        mean / np.maximum(share, _MIN_NOISE_SUPPORT) / (channels * _COST_PER_NOISE), np.float32
    )


def _colour_scale(level: float, noise: Map, channels: int) -> Map:
    """Return the scale of squared colour differences, with the noise included."""
    return np.asarray(0.5 / (level**2 + noise**2) / channels, np.float32)


def _distance_scale(noise: Map) -> Map:
    """Return the scale of squared distances; more noise widens the support."""
    sigma = np.clip(_MIN_SIGMA + _SIGMA_GROWTH * (noise - _MAX_QUIET_NOISE), _MIN_SIGMA, _MAX_SIGMA)
    return np.asarray(0.5 / sigma**2, np.float32)


def _refined(
    lf: LightField,
    disparity: Map,
    guide: cla.Array,
    noise: Map,
    normal: tuple[cla.Array, cla.Array],
) -> tuple[Map, Map]:
    """Refine the disparity by one least-squares step; return it with its information A."""
    channels = (*lf.shape, 1)[4]
    prior = _PRIOR * channels * np.maximum(noise, 1) ** 2
    scales = (_colour_scale(_FIT_COLOUR_TOLERANCE, noise, channels), _distance_scale(noise))
    limits = (0.5 / _SURFACE_TOLERANCE**2, _RIDGE, _MAX_STEP)
    return fit_planes(lf, disparity, guide, (*scales, prior.astype(np.float32)), normal, limits)


def combined_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """Estimate the memory of `combined_disparity`, in two passes: brightness, then maps."""
    channels, count = (*source.shape, 1)[4], int(_dense(planes).size)
    plane_count = max(planes.size, point_planes(source, planes)[1].size)
    halves = source.shape[0] * source.shape[1] * channels  # uint16, the detail of all views
    floats = 2 * count + 4 * channels + 30 + halves // 2 + energy_floats(plane_count, channels)
    largest = max(count, min(PICTURES, plane_count) * channels)
    estimate = depth_memory(
        "combined", source, planes, reach=_REACH, floats=floats, largest=largest
    )
    return replace(
        estimate,
        per_pixel=int(DEVICE_FLOAT * floats) + HOST_FLOAT * (18 + 3 * channels + _POINT_FLOATS),
        result_bytes=MAP_BYTES + 1,  # and the mask of mismatches
        before=max(_MERGE_BYTES, 3 * HOST_FLOAT * channels),
        passes=2,
    )


@dataclass(frozen=True)
class SampleLevels:
    """Brightness statistics of a whole light field."""

    gain: float  # Levels a unit of the samples
    # float64, shape (K,): gain of each compared view against vignetting and exposure
    even: Vector


class LevelSurvey:
    """Survey of a light field's gain and vignetting, in bands of full rows."""

    def __init__(self, source: SampledViews) -> None:
        self._views = group_views(source)
        self._centre = np.empty(source.shape[2:], np.float32)
        self._sums = np.empty((source.shape[0] * source.shape[1], source.shape[2]), np.float32)

    def add(self, rows: slice, lf: LightField) -> None:
        """Add some rows of all views."""
        self._centre[rows] = centre_picture(lf, self._views)
        self._sums[:, rows] = row_sums(lf)

    def finish(self) -> SampleLevels:
        """Return gain and view corrections after all rows."""
        means = self._sums.sum(axis=1, dtype=np.float64) / self._centre.size
        means = means[self._views.view]
        gains = _vignetting_gains(means, self._views)
        gains *= _exposure_gains(means * gains, self._views)
        low, high = _range(self._centre)
        if has_sparse_light(self._centre):
            high = float(self._centre.max())
        return SampleLevels(_LEVELS / (high - low) if high > low else 1.0, gains)


def centre_picture(lf: LightField, views: ViewGroups) -> Map:
    """Return the guiding picture, the mean of the views around the middle."""
    pictures = [
        share * lf.device.download(lf.data[divmod(int(views.view[k]), lf.shape[1])])
        for k, share in zip(views.reference, views.share, strict=True)
    ]
    return np.sum(pictures, axis=0, dtype=np.float32)


def _range(centre: Map) -> tuple[float, float]:
    """Return the darkest and brightest sample, outliers excluded where possible."""
    low, high = np.percentile(centre, (_OUTLIERS, 100 - _OUTLIERS))
    if not high > low:
        low, high = centre.min(), centre.max()
    return float(low), float(high)


def _vignetting_gains(means: Vector, views: ViewGroups) -> Vector:
    """Return gains against vignetting, a monotonic fall of brightness from the middle outwards.

    Fits 1 + b r^2, without far darker or brighter views; other differences are odd or random.
    """
    target = means[views.reference] @ views.share
    gains = np.ones_like(means)
    valid = (means > target / _MAX_BRIGHTNESS_RATIO) & (means < target * _MAX_BRIGHTNESS_RATIO)
    square = (views.step**2).sum(axis=1)
    if target <= 0 or np.unique(square[valid]).size < _MIN_RADII:
        return gains
    offset, ratio = square[valid] - square[valid].mean(), means[valid] / target
    b = (offset @ ratio) / (offset @ offset)
    residual = ratio - ratio.mean() - b * offset
    is_clear = (
        b**2 * (offset @ offset) > residual @ residual
        and abs(b) * square[valid].max() > _MIN_VIGNETTING
    )
    if is_clear:
        gains[valid] = 1 / np.maximum(1 + b * square[valid], 1 / _MAX_BRIGHTNESS_RATIO)
    return gains


def _exposure_gains(means: Vector, views: ViewGroups) -> Vector:
    """Return gains against exposures that jump between views or alternate between rows.

    Fits 1, v, u, r^2 to log brightness by least absolute values; residuals over 10 % correct all.
    """
    gains = np.ones_like(means)
    middle = np.median(means)
    valid = (means > middle / _MAX_BRIGHTNESS_RATIO) & (means < middle * _MAX_BRIGHTNESS_RATIO)
    step = views.step[valid]
    basis = np.stack([np.ones(len(step)), *step.T, (step**2).sum(axis=1)], axis=-1)
    rank = np.linalg.matrix_rank(basis) if len(step) else 0
    if (
        middle <= 0
        or not valid[views.reference].all()
        or len(step) <= _MIN_VIEWS_PER_PARAMETER * rank
    ):
        return gains
    logarithm = np.log(means[valid])
    residual = logarithm - np.median(logarithm)
    for _ in range(_ROUNDS):
        weight = 1 / np.sqrt(np.maximum(np.abs(residual), 1e-3))
        fit = np.linalg.lstsq(basis * weight[:, None], logarithm * weight, rcond=None)[0]
        residual = logarithm - basis @ fit
    if np.abs(residual).max() < _MIN_EXPOSURE_STEP:
        return gains
    gains[valid] = np.exp(-residual)
    target, evened = ((means * gain)[views.reference] @ views.share for gain in (1, gains))
    return gains * target / evened


CUE = Cue(match_views, combined_memory, LevelSurvey, merge_confidence)
