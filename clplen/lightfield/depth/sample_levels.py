"""Samples in levels of the centre view, and vignetting of views undone, for depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.depth.sparse_points import has_sparse_light
from clplen.lightfield.matching.view_matching import ViewGroups, group_views, row_sums
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews

Map = np.ndarray[Any, np.dtype[np.float32]]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_LEVELS = 255.0  # between the darkest and the brightest of the centre view
_OUTLIERS = 0.2  # per cent of its samples left out at either end
_EVEN = 4.0  # times brighter or darker: views that differ more are left as they are
_RADII = 2  # at which there are views, for a fall of brightness
_EXPOSED = 0.1  # of its brightness: views that stand out by more were exposed otherwise
_SPARE = 2  # views a parameter that a fit over the aperture takes at least
_ROUNDS = 20  # of a fit by least absolute values
_VIGNETTED = 0.02  # fall of brightness from the middle to the rim that is evened


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
