"""Depth by matching past occlusions, adaptive support and a least-squares refinement."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.cue import (
    MAP_BYTES,
    Cue,
    Mask,
    PartialDepth,
    TwoPasses,
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
from clplen.lightfield.depth.view_detail import REACH, STEPS, is_even, view_detail
from clplen.lightfield.depth.view_matching import (
    WINDOW,
    ShiftTables,
    ViewGroups,
    depth_kernel,
    group_views,
    match_costs,
    row_sums,
    shift_tables,
    support_block,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.refocusing.memory_estimate import DEVICE_FLOAT, HOST_FLOAT, MemoryEstimate

Map = np.ndarray[Any, np.dtype[np.float32]]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_LEVELS = 255.0  # between the darkest and the brightest of the centre view
_OUTLIERS = 0.2  # per cent of its samples left out at either end
_NARROW, _WIDE, _WIDENING = 3.0, 6.0, 0.4  # its Gaussian, in pixels, and its growth with noise
_QUIET = 2.0  # levels of noise up to which it is narrow
_BESIDE = 0.2  # taps beside the middle when the guiding picture is smoothed
_ALIKE = 6.0  # levels a channel: pixels that differ more belong to different things
_NOISE_BLUR = 8.0  # pixels over which noise is taken as even
_COST_PER_NOISE = 0.62  # least cost of a channel over the noise of a sample
_FIT_ALIKE = 8.0
_SAME_SURFACE = 0.2  # pixels a view step
_MOST_STEP = 0.1
_RIDGE = 0.3  # pixels^2
_PRIOR = 100.0  # of the matched disparity, in levels^2 a channel for noise of a level
_LOST = 0.8  # of the truncation: where the least cost is higher the views do not agree,
_SHALLOW = 0.02  # unless what they say is this sure
_STEP = 0.15  # pixels a view step: planes farther apart get others between them
_EVEN = 4.0  # times brighter or darker: views that differ more are left as they are
_RADII = 2  # at which there are views, for a fall of brightness
_VIGNETTED = 0.02  # fall of brightness from the middle to the rim that is evened
_REACH = WINDOW + gaussian_taps(_NOISE_BLUR).size - 1 + REACH  # pixels that a pixel needs
_SPARSE = 24  # float32 values of a pixel while points are looked for
_MERGED = MAP_BYTES + 13  # bytes of a pixel while confidences are merged
_SURE = 0.05  # pixels a view step: standard deviation of a confidence of one half


def combined_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Disparity and confidence of every pixel of the centre view.

    This is done with the samples and with their detail (`view_detail`), which is believed where
    the brightness of the views differs.

    Samples are scaled to 255 levels. On every plane the views are compared with the centre
    (`match_costs`), through an interpolation that treats all fractions of a pixel alike
    (`shift_tables`); the costs are gathered over neighbours that look alike (Yoon and Kweon 2006),
    the more tolerantly the noisier the place. The least cost, refined by a parabola, is then moved
    by a robust Lucas-Kanade step on all views (Lucas and Kanade 1981), in which each pixel takes
    part with the plane that fits its neighbourhood. Where no plane makes the views agree, in strong
    noise or in the diffraction patterns of single points, the sharpest plane is taken
    (`energy_disparity`).

    Parameters
    ----------
    lf : LightField
    planes : numpy.ndarray
        Disparities, rising, shape (P,), at least three.

    Returns
    -------
    tuple of numpy.ndarray
        Disparity and confidence (0 to 1), float32, shape (y, x).

    Raises
    ------
    ValueError
        If fewer than two views have a weight.
    DeviceError
        If what is needed is larger than the device's memory.
    """
    survey = LevelSurvey(lf)
    survey.add(slice(0, lf.shape[2]), lf)
    result = match_views(lf, planes, survey.finish())
    return result.disparity, merge_confidence(result.confidence, result.lost)


@dataclass(frozen=True)
class SampleLevels:
    """What the whole light field says of its samples.

    Attributes
    ----------
    gain : float
        Levels a unit of the samples.
    even : numpy.ndarray
        float64, shape (K,): what undoes the vignetting of each view that is compared.
    """

    gain: float
    even: Vector


class LevelSurvey:
    """Gain and vignetting of a light field, seen in bands of full rows.

    Parameters
    ----------
    source : LightField or StoredLightField
    """

    def __init__(self, source: LightField | StoredLightField) -> None:
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
        gains = _vignetting_gains(means[self._views.view], self._views)
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


def match_views(
    lf: LightField, planes: Vector, levels: SampleLevels, *, inside: tuple[slice, ...] = ()
) -> PartialDepth:
    """Disparity of each pixel from its neighbourhood, `_REACH` pixels wide, in the views.

    Parameters
    ----------
    lf : LightField
        All, or a part of its rows and columns.
    planes : numpy.ndarray
        Disparities, rising, at least three.
    levels : SampleLevels
        Of the whole light field.
    inside : tuple of slice
        Rows and columns that are wanted; default all.

    Returns
    -------
    PartialDepth
        Of the whole of ``lf``.
    """
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
        confidence = np.where(sparse, clear * lit_pixels(centre), confidence)
        lost = lost & ~sparse
    disparity = np.clip(disparity, planes[0], planes[-1]).astype(np.float32)
    return PartialDepth(disparity, confidence.astype(np.float32), lost)


def _believed(
    lf: LightField, planes: Vector, levels: SampleLevels, centre: Map
) -> tuple[PartialDepth, Map]:
    """What matching finds, by the samples or, where their brightness differs, by their detail."""
    device = lf.device
    samples = _matched(lf, planes, levels, centre)
    gains = np.zeros(lf.weights.size)
    gains[group_views(lf).view] = levels.gain * levels.even
    of_detail = SampleLevels(1 / STEPS, np.ones_like(levels.even))
    detail = _matched(
        view_detail(lf, gains.reshape(lf.weights.shape)),
        planes,
        of_detail,
        centre * (levels.gain * STEPS),
    )
    even = is_even(
        (samples.least, detail.least),
        (device.download(samples.disparity), device.download(detail.disparity)),
        (*lf.shape, 1)[4],
    )
    if even.all():
        return _refined_match(samples), samples.margin
    found = _refined_match(detail)
    if not even.any():
        return found, detail.margin
    of_samples = _refined_match(samples)
    fused = PartialDepth(
        np.where(even, of_samples.disparity, found.disparity),
        np.where(even, of_samples.confidence, found.confidence),
        np.where(even, of_samples.lost, found.lost),
    )
    return fused, np.where(even, samples.margin, detail.margin)


@dataclass(frozen=True)
class _Match:
    """The lowest valley of the costs at every pixel, before it is refined.

    Attributes
    ----------
    lf : LightField
    views : ViewGroups
    tables : ShiftTables
    picture : pyopencl.array.Array
        Whose likeness guides.
    noise : numpy.ndarray
        In levels.
    disparity, nearest : pyopencl.array.Array
        Of the valley, and the plane next to it.
    least, margin : numpy.ndarray
        Cost in the valley, and how far it lies below the second one.
    """

    lf: LightField
    views: ViewGroups
    tables: ShiftTables
    picture: cla.Array
    noise: Map
    disparity: cla.Array
    nearest: cla.Array
    least: Map
    margin: Map


def _matched(lf: LightField, planes: Vector, levels: SampleLevels, centre: Map) -> _Match:
    device = lf.device
    ny, nx = lf.shape[2:4]
    device.require_memory(
        lf.data.nbytes + 8 * ny * nx * (planes.size + 8),
        "This depth map with its light field",
    )
    views = group_views(lf)
    picture = device.upload(_smoothed(centre * np.float32(levels.gain)))
    tables = shift_tables(views, planes, levels.gain * levels.even, device=device)
    costs = match_costs(lf, views, tables)
    noise = _noise(lf, costs, tables)
    gathered = device.empty(costs.shape, np.float32)
    _gather(lf, gathered, costs, picture, noise)
    disparity, nearest, least, margin = _valley(lf, gathered, tables)
    return _Match(lf, views, tables, picture, noise, disparity, nearest, least, margin)


def _refined_match(found: _Match) -> PartialDepth:
    """A valley moved by least squares, how sure it is, and where the views do not agree."""
    channels = (*found.lf.shape, 1)[4]
    refined, known = _refined(
        found.lf,
        found.views,
        found.tables,
        found.disparity,
        found.nearest,
        found.picture,
        found.noise,
    )
    sure = known * len(found.views.view) / np.maximum(found.noise, 1) ** 2
    confidence = found.margin * sure / (sure + 1 / _SURE**2)
    lost = (found.least > _LOST * thresholds(channels)[0]) & (confidence < _SHALLOW)
    return PartialDepth(refined, confidence, lost)


def merge_confidence(confidence: Map, lost: Mask) -> Map:
    """Confidence of the whole map: what was matched is surer than what is only sharpest."""
    usual = np.median(confidence[~lost]) if lost.any() and not lost.all() else 0.0
    return np.where(lost, confidence * usual, confidence) if usual > _SHALLOW else confidence


def _range(centre: Map) -> tuple[float, float]:
    """The darkest and the brightest sample, without outliers unless there is nothing else."""
    low, high = np.percentile(centre, (_OUTLIERS, 100 - _OUTLIERS))
    if not high > low:
        low, high = centre.min(), centre.max()
    return float(low), float(high)


def _smoothed(picture: Map) -> Map:
    """A picture blurred a little along both axes, so that noise hides no likeness."""
    for axis in (0, 1):
        pad = [(1, 1) if i == axis else (0, 0) for i in range(picture.ndim)]
        wide = np.pad(picture, pad, mode="edge")
        n = picture.shape[axis]
        before, after = (np.take(wide, np.arange(n) + i, axis=axis) for i in (0, 2))
        picture = (1 - 2 * _BESIDE) * picture + _BESIDE * (before + after)
    return np.ascontiguousarray(picture, np.float32)


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


def _dense(planes: Vector) -> Vector:
    """Planes with others between those that lie far apart."""
    steps = np.diff(planes)
    parts = np.maximum(np.ceil(steps / _STEP - 1e-9), 1).astype(int)
    between = [
        low + step * np.arange(n) / n for low, step, n in zip(planes, steps, parts, strict=False)
    ]
    return np.concatenate([*between, planes[-1:]])


def _noise(lf: LightField, costs: cla.Array, tables: ShiftTables) -> Map:
    """Standard deviation of the samples in levels, from the least cost round every pixel."""
    device, channels = lf.device, (*lf.shape, 1)[4]
    least = _valley(lf, costs, tables)[2]
    blurred = device.empty((1, *least.shape), np.float32)
    smooth = Smoother(gaussian_taps(_NOISE_BLUR), device=device)
    smooth(blurred, device.upload(least[None]), start=0, count=1)
    return np.asarray(device.download(blurred)[0] / (channels * _COST_PER_NOISE), np.float32)


def _colour_scale(level: float, noise: Map, channels: int) -> Map:
    """Scale of squared differences of colour, with the noise in it."""
    return np.asarray(0.5 / (level**2 + noise**2) / channels, np.float32)


def _distance_scale(noise: Map) -> Map:
    """Scale of squared distances: the noisier, the farther neighbours count."""
    sigma = np.clip(_NARROW + _WIDENING * (noise - _QUIET), _NARROW, _WIDE)
    return np.asarray(0.5 / sigma**2, np.float32)


def _gather(
    lf: LightField, out: cla.Array, costs: cla.Array, picture: cla.Array, noise: Map
) -> None:
    device, channels = lf.device, (*lf.shape, 1)[4]
    planes, ny, nx = (int(n) for n in costs.shape)
    device.launch(
        depth_kernel(lf, "gather"),
        (-(-nx // support_block(device)), ny),
        out,
        costs,
        picture,
        device.upload(_distance_scale(noise)),
        device.upload(_colour_scale(_ALIKE, noise, channels)),
        *(np.int32(n) for n in (planes, ny, nx)),
    )


def _valley(
    lf: LightField, costs: cla.Array, tables: ShiftTables
) -> tuple[cla.Array, cla.Array, Map, Map]:
    """Disparity of the least cost, its plane, the cost, and its depth below the second, 0 to 1."""
    device = lf.device
    _, ny, nx = (int(n) for n in costs.shape)
    position, least, second, mean = (device.empty((ny, nx), np.float32) for _ in range(4))
    nearest = device.empty((ny, nx), np.int32)
    device.launch_rows(
        depth_kernel(lf, "valley"),
        (ny, nx),
        position,
        nearest,
        least,
        second,
        mean,
        costs,
        tables.planes,
        *(np.int32(n) for n in (tables.count, ny, nx)),
    )
    low, next_low, usual = (device.download(a) for a in (least, second, mean))
    rise = np.minimum(next_low, usual) - low
    return position, nearest, low, np.clip(rise / np.maximum(usual, 1e-6), 0, 1)


def _refined(
    lf: LightField,
    views: ViewGroups,
    tables: ShiftTables,
    disparity: cla.Array,
    nearest: cla.Array,
    picture: cla.Array,
    noise: Map,
) -> tuple[Map, Map]:
    """Disparity moved by one step of least squares, and what the views know of it, A."""
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    A, B = _normal(lf, views, tables, disparity, nearest)
    out, known = (device.empty((ny, nx), np.float32) for _ in range(2))
    prior = _PRIOR * channels * np.maximum(noise, 1) ** 2
    device.launch(
        depth_kernel(lf, "fit"),
        (-(-nx // support_block(device)), ny),
        out,
        known,
        A,
        B,
        disparity,
        picture,
        device.upload(_colour_scale(_FIT_ALIKE, noise, channels)),
        device.upload(_distance_scale(noise)),
        device.upload(prior.astype(np.float32)),
        np.float32(0.5 / _SAME_SURFACE**2),
        np.float32(_RIDGE),
        np.float32(_MOST_STEP),
        *(np.int32(n) for n in (ny, nx)),
    )
    return device.download(out), device.download(known)


def _normal(
    lf: LightField, views: ViewGroups, tables: ShiftTables, disparity: cla.Array, nearest: cla.Array
) -> tuple[cla.Array, cla.Array]:
    """A and B of kernels/refine.cl at every pixel."""
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    A, B = (device.empty((ny, nx), np.float32) for _ in range(2))
    device.launch_rows(
        depth_kernel(lf, "normal"),
        (ny, nx),
        A,
        B,
        lf.data,
        disparity,
        nearest,
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
    return A, B


def combined_memory(source: StoredLightField, planes: Vector) -> MemoryEstimate:
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


CUE = Cue(
    combined_disparity,
    combined_memory,
    TwoPasses(LevelSurvey, match_views, merge_confidence),
)
