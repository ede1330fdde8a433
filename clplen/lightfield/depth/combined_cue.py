"""Depth by matching past occlusions, adaptive support and a least-squares refinement."""

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
Whole = np.ndarray[Any, np.dtype[np.int32]]

_NARROW, _WIDE, _WIDENING = 3.0, 6.0, 0.4  # its Gaussian, in pixels, and its growth with noise
_QUIET = 2.0  # levels of noise up to which it is narrow
_BESIDE = 0.2  # taps beside the middle when the guiding picture is smoothed
_ALIKE = 6.0  # levels a channel: pixels that differ more belong to different things
_NOISE_BLUR = 8.0  # pixels over which noise is taken as even
_FEW = 1e-3  # of the pixels round one: least share that noise is taken from
_COST_PER_NOISE = 0.62  # least cost of a channel over the noise of a sample
_FIT_ALIKE = 8.0
_SAME_SURFACE = 0.2  # pixels a view step
_MOST_STEP = 0.1
_RIDGE = 0.3  # pixels^2
_PRIOR = 100.0  # of the matched disparity, in levels^2 a channel for noise of a level
_LOST = 0.8  # of the truncation: where the least cost is higher the views do not agree,
_SHALLOW = 0.02  # unless what they say is this sure
_STEP = 0.15  # pixels a view step: planes farther apart get others between them
# Pixels that a pixel needs: of the fit, of what is even, twice of noise and gathered costs (of
# detail, and of samples where detail has outlines), of the planes that are tried, and of detail.
_NOISY = gaussian_taps(_NOISE_BLUR).size - 1 + WINDOW
_REACH = WINDOW + OUTLINE_REACH + 2 * _NOISY + SPAN_REACH + DETAIL_REACH
_SPARSE = 24  # float32 values of a pixel while points are looked for
_MERGED = MAP_BYTES + 13  # bytes of a pixel while confidences are merged
_ROUNDING = 1e-9  # pixels^-2: what is known of a blank light field
_SURE = 0.05  # pixels a view step: standard deviation of a confidence of one half
_LEVELS = 255.0  # between the darkest and the brightest of the centre view
_OUTLIERS = 0.2  # per cent of its samples left out at either end
_EVEN = 4.0  # times brighter or darker: views that differ more are left as they are
_RADII = 2  # at which there are views, for a fall of brightness
_EXPOSED = 0.1  # of its brightness: views that stand out by more were exposed otherwise
_SPARE = 2  # views a parameter that a fit over the aperture takes at least
_ROUNDS = 20  # of a fit by least absolute values
_VIGNETTED = 0.02  # fall of brightness from the middle to the rim that is evened


def combined_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Disparity and confidence of every pixel of the centre view of a whole light field.

    docs/depth.md has the steps: `match_costs`, gathered over neighbours that look alike, the lowest
    valley, least squares on all views, and the sharpest plane where no plane makes them agree.
    """
    survey = LevelSurvey(lf)
    survey.add(slice(0, lf.shape[2]), lf)
    result = match_views(lf, planes, survey.finish())
    return result.disparity, merge_confidence(result.confidence, result.lost)


def match_views(
    lf: LightField, planes: Vector, levels: SampleLevels, *, inside: tuple[slice, ...] = ()
) -> PartialDepth:
    """Disparity of each pixel from its neighbourhood, `_REACH` pixels wide, in the views."""
    dense = _dense(planes)
    centre = centre_picture(lf, group_views(lf))
    result, margin = _believed(lf, dense, levels, centre)
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
        of_points, clear = point_disparity(lf, planes)
        disparity = np.where(sparse, of_points, disparity)
        # over the black beside a point its detail spreads
        beside = maximum_filter(sparse, 2 * DETAIL_REACH + 1)
        lit = np.where(beside, lit_pixels(centre), 1)
        confidence = np.where(sparse, clear, confidence) * lit
        lost = lost & ~sparse
    disparity = np.clip(disparity, planes[0], planes[-1]).astype(np.float32)
    return PartialDepth(disparity, confidence.astype(np.float32), lost)


def _believed(
    lf: LightField, planes: Vector, levels: SampleLevels, centre: Map
) -> tuple[PartialDepth, Map]:
    """What matching finds: of the detail of views, and near outlines of their samples."""
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
    around = Surroundings.of(match.disparity)
    even = np.zeros_like(around.near)
    if around.near.any():
        of_samples = shift_tables(views, planes, gains[views.view], device=device)
        there = likely.only(around, planes)
        samples, of_noise = _matched(lf, views, of_samples, guide, there)
        costs = (samples.least, match.least)
        even = is_even(costs, samples.disparity, around, (*lf.shape, 1)[4])
        match = samples.where(even, match)
        noise = np.where(even, of_noise, noise)
        normal_equations(lf, views, of_samples, match.disparity, match.nearest, even, (A, B))
    normal_equations(detail, views, tables, match.disparity, match.nearest, ~even, (A, B))
    return _refined_match(lf, match, guide, noise, (A, B)), match.margin


@dataclass(frozen=True)
class _Match:
    """The lowest valley of the costs at every pixel, before it is refined; shape (y, x)."""

    disparity: Map  # disparity, nearest: Of the valley, and the plane next to it
    nearest: Whole
    # least, margin: Cost in the valley, and how far it lies below the second one, 0 to 1
    least: Map
    margin: Map

    def where(self, mask: Mask, other: _Match) -> _Match:
        """This match where the mask is set, the other elsewhere."""
        return _Match(
            np.where(mask, self.disparity, other.disparity),
            np.where(mask, self.nearest, other.nearest),
            np.where(mask, self.least, other.least),
            np.where(mask, self.margin, other.margin),
        )


def _matched(
    lf: LightField,
    views: ViewGroups,
    tables: ShiftTables,
    guide: cla.Array,
    likely: LikelyPlanes,
) -> tuple[_Match, Map]:
    """The valley of the costs of likely planes, 0 where none is tried, and the noise in levels."""
    spans, count = likely.spans, tables.count
    around = gathered_spans(spans, count)
    costs = match_costs(lf, views, tables, block_spans(around, count))
    noise = _noise(lf, costs, tables, around)
    gathered = lf.device.empty(costs.shape, np.float32)
    scales = (_distance_scale(noise), _colour_scale(_ALIKE, noise, (*lf.shape, 1)[4]))
    gather_costs(lf, gathered, costs, guide, scales, block_spans(spans, count))
    return _Match(*lowest_valley(lf, gathered, tables, spans, likely.usual)), noise


def _refined_match(
    lf: LightField, match: _Match, guide: cla.Array, noise: Map, normal: tuple[cla.Array, cla.Array]
) -> PartialDepth:
    """A valley moved by least squares, how sure it is, and where the views do not agree."""
    channels, views = (*lf.shape, 1)[4], int(np.count_nonzero(lf.weights > 0))
    refined, known = _refined(lf, match.disparity, guide, noise, normal)
    sure = known * views / np.maximum(noise, 1) ** 2
    sure = np.where(sure > _ROUNDING, sure, 0)
    confidence = match.margin * sure / (sure + 1 / _SURE**2)
    lost = (match.least > _LOST * thresholds(channels)[0]) & (confidence < _SHALLOW)
    return PartialDepth(refined, confidence.astype(np.float32), lost)


def merge_confidence(confidence: Map, lost: Mask) -> Map:
    """Confidence of the whole map: what was matched is surer than what is only sharpest."""
    usual = np.median(confidence[~lost]) if lost.any() and not lost.all() else 0.0
    return np.where(lost, confidence * usual, confidence) if usual > _SHALLOW else confidence


def _guide(picture: Map) -> Map:
    """The picture whose likeness guides, smoothed, colours first."""
    smooth = _smoothed(picture)
    return smooth if smooth.ndim == 2 else np.ascontiguousarray(np.moveaxis(smooth, -1, 0))


def _smoothed(picture: Map) -> Map:
    """A picture blurred a little along both axes, so that noise hides no likeness."""
    for axis in (0, 1):
        pad = [(1, 1) if i == axis else (0, 0) for i in range(picture.ndim)]
        wide = np.pad(picture, pad, mode="edge")
        n = picture.shape[axis]
        before, after = (np.take(wide, np.arange(n) + i, axis=axis) for i in (0, 2))
        picture = (1 - 2 * _BESIDE) * picture + _BESIDE * (before + after)
    return np.ascontiguousarray(picture, np.float32)


def _dense(planes: Vector) -> Vector:
    """Planes with others between those that lie far apart."""
    steps = np.diff(planes)
    parts = np.maximum(np.ceil(steps / _STEP - 1e-9), 1).astype(int)
    between = [
        low + step * np.arange(n) / n for low, step, n in zip(planes, steps, parts, strict=False)
    ]
    return np.concatenate([*between, planes[-1:]])


def _noise(lf: LightField, costs: cla.Array, tables: ShiftTables, spans: Spans) -> Map:
    """Standard deviation of the samples in levels, from the least cost round every pixel."""
    device, channels = lf.device, (*lf.shape, 1)[4]
    least = lowest_valley(lf, costs, tables, spans)[2]
    there = spans[..., 0] <= spans[..., 1]
    blurred = device.empty((2, *least.shape), np.float32)
    smooth = Smoother(gaussian_taps(_NOISE_BLUR), device=device)
    smooth(blurred, device.upload(np.stack((least, there), dtype=np.float32)), start=0, count=2)
    mean, share = device.download(blurred)
    return np.asarray(mean / np.maximum(share, _FEW) / (channels * _COST_PER_NOISE), np.float32)


def _colour_scale(level: float, noise: Map, channels: int) -> Map:
    """Scale of squared differences of colour, with the noise in it."""
    return np.asarray(0.5 / (level**2 + noise**2) / channels, np.float32)


def _distance_scale(noise: Map) -> Map:
    """Scale of squared distances: the noisier, the farther neighbours count."""
    sigma = np.clip(_NARROW + _WIDENING * (noise - _QUIET), _NARROW, _WIDE)
    return np.asarray(0.5 / sigma**2, np.float32)


def _refined(
    lf: LightField,
    disparity: Map,
    guide: cla.Array,
    noise: Map,
    normal: tuple[cla.Array, cla.Array],
) -> tuple[Map, Map]:
    """Disparity moved by one step of least squares, and what the views know of it, A."""
    channels = (*lf.shape, 1)[4]
    prior = _PRIOR * channels * np.maximum(noise, 1) ** 2
    scales = (_colour_scale(_FIT_ALIKE, noise, channels), _distance_scale(noise))
    limits = (0.5 / _SAME_SURFACE**2, _RIDGE, _MOST_STEP)
    return fit_planes(lf, disparity, guide, (*scales, prior.astype(np.float32)), normal, limits)


def combined_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """What `combined_disparity` needs, in two passes: gain and vignetting first, then the maps."""
    channels, count = (*source.shape, 1)[4], int(_dense(planes).size)
    tried = max(planes.size, point_planes(source, planes)[1].size)
    halves = source.shape[0] * source.shape[1] * channels  # uint16, the detail of all views
    floats = 2 * count + 4 * channels + 30 + halves // 2 + energy_floats(tried, channels)
    largest = max(count, min(PICTURES, tried) * channels)
    once = depth_memory("combined", source, planes, reach=_REACH, floats=floats, largest=largest)
    return replace(
        once,
        per_pixel=int(DEVICE_FLOAT * floats) + HOST_FLOAT * (18 + 3 * channels + _SPARSE),
        kept=MAP_BYTES + 1,  # and which pixels are lost
        before=max(_MERGED, 3 * HOST_FLOAT * channels),
        passes=2,
    )


@dataclass(frozen=True)
class SampleLevels:
    """What the whole light field says of its samples."""

    gain: float  # Levels a unit of the samples
    # float64, shape (K,): what undoes vignetting and exposure of each view that is compared
    even: Vector


class LevelSurvey:
    """Gain and vignetting of a light field, seen in bands of full rows."""

    def __init__(self, source: SampledViews) -> None:
        self._views = group_views(source)
        self._centre = np.empty(source.shape[2:], np.float32)
        self._sums = np.empty((source.shape[0] * source.shape[1], source.shape[2]), np.float32)

    def add(self, rows: slice, lf: LightField) -> None:
        """Look at some rows of all views."""
        self._centre[rows] = centre_picture(lf, self._views)
        self._sums[:, rows] = row_sums(lf)

    def finish(self) -> SampleLevels:
        """Gain and evenness, when all rows were added."""
        means = self._sums.sum(axis=1, dtype=np.float64) / self._centre.size
        means = means[self._views.view]
        gains = _vignetting_gains(means, self._views)
        gains *= _exposure_gains(means * gains, self._views)
        low, high = _range(self._centre)
        if has_sparse_light(self._centre):
            high = float(self._centre.max())
        return SampleLevels(_LEVELS / (high - low) if high > low else 1.0, gains)


def centre_picture(lf: LightField, views: ViewGroups) -> Map:
    """The picture whose likeness guides: the mean of the views round the middle."""
    pictures = [
        share * lf.device.download(lf.data[divmod(int(views.view[k]), lf.shape[1])])
        for k, share in zip(views.reference, views.share, strict=True)
    ]
    return np.sum(pictures, axis=0, dtype=np.float32)


def _range(centre: Map) -> tuple[float, float]:
    """The darkest and the brightest sample, without outliers unless there is nothing else."""
    low, high = np.percentile(centre, (_OUTLIERS, 100 - _OUTLIERS))
    if not high > low:
        low, high = centre.min(), centre.max()
    return float(low), float(high)


def _vignetting_gains(means: Vector, views: ViewGroups) -> Vector:
    """What undoes vignetting: views that get darker, or brighter, from the middle outwards.

    Their brightness is fitted by 1 + b r^2, without views that are far darker or brighter than the
    middle, as one that failed. What else makes views differ, content that moves
    across their edges for one, is odd or random over the aperture, and harmless.
    """
    target = means[views.reference] @ views.share
    even = np.ones_like(means)
    like = (means > target / _EVEN) & (means < target * _EVEN)
    square = (views.step**2).sum(axis=1)
    if target <= 0 or np.unique(square[like]).size < _RADII:
        return even
    away, ratio = square[like] - square[like].mean(), means[like] / target
    b = (away @ ratio) / (away @ away)
    left = ratio - ratio.mean() - b * away
    is_clear = b**2 * (away @ away) > left @ left and abs(b) * square[like].max() > _VIGNETTED
    if is_clear:
        even[like] = 1 / np.maximum(1 + b * square[like], 1 / _EVEN)
    return even


def _exposure_gains(means: Vector, views: ViewGroups) -> Vector:
    """What undoes exposures that jump from view to view: single views, or rows by turns.

    The logarithm of the brightness is fitted by a plane and a fall, 1, v, u and r^2, with the least
    absolute residuals: content that moves across the edges of the views changes their means that
    smoothly. If a residual is above 10 %, all are undone, with the middle left as it is. Views that
    are far darker or brighter than the median are left alone.
    """
    even = np.ones_like(means)
    middle = np.median(means)
    like = (means > middle / _EVEN) & (means < middle * _EVEN)
    step = views.step[like]
    basis = np.stack([np.ones(len(step)), *step.T, (step**2).sum(axis=1)], axis=-1)
    rank = np.linalg.matrix_rank(basis) if len(step) else 0
    if middle <= 0 or not like[views.reference].all() or len(step) <= _SPARE * rank:
        return even
    logarithm = np.log(means[like])
    left = logarithm - np.median(logarithm)
    for _ in range(_ROUNDS):
        weight = 1 / np.sqrt(np.maximum(np.abs(left), 1e-3))
        fit = np.linalg.lstsq(basis * weight[:, None], logarithm * weight, rcond=None)[0]
        left = logarithm - basis @ fit
    if np.abs(left).max() < _EXPOSED:
        return even
    even[like] = np.exp(-left)
    target, evened = ((means * gain)[views.reference] @ views.share for gain in (1, even))
    return even * target / evened


CUE = Cue(match_views, combined_memory, LevelSurvey, merge_confidence)
