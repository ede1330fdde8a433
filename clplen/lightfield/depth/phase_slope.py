"""Slope of a point in phase space, from its spots behind the lenslets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clplen.lightfield.depth.camera_optics import Pupil, Real
from clplen.lightfield.depth.window_measures import sample_noise

_SPOT_THRESHOLD = 0.5  # of a sub-image's maximum: threshold of the spot against a neighbour's tail
_MIN_ENERGY = 0.03  # of the brightest sub-image: fainter spots are diffraction
_MIN_NOISE_RATIO = 0.5  # of the energy of the noise in a sub-image: fainter spots are noise
_MIN_SPOTS = 3  # minimum for a line: a focused point between two lenslets has two spots
_POWER = 0.75  # exponent of a sub-image's energy in its weight
_ROUNDS = 4  # iterations of the correction for partly lit lenslets
_SAMPLES = 1500  # samples of the pupil
_MAX_DISTANCE = 0.75  # pitches: slightly above the distance from centre to corner of a cell


@dataclass(frozen=True)
class PhaseSlope:
    """A line fitted to the spots of one point, the result of `fit_slope`."""

    # Pixels a view step along x, nearer positive; 0 if all light falls in one or two lenslets or
    # the spots show no slope
    disparity: float
    confidence: float  # 0 to 1: share of the spots' scatter in u that the line explains (R squared)
    spots: int  # Number of sub-images used; 0 where noise hides all but one or two
    # Standard deviation of the disparity from independent scatter of the spots about the line
    # (White 1980, "A heteroskedasticity-consistent covariance matrix estimator", eq. 6, times n/(n
    # - 2) for n spots); nan where the disparity is 0
    deviation: float = math.nan


def fit_slope(
    window: Real,
    *,
    aspect: float = 1.0,
    y: Real | None = None,
    x: Real | None = None,
    pupil: Pupil | None = None,
) -> PhaseSlope:
    """Regress the position of the spot in a sub-image on the position of its lenslet.

    A point lies on x = X - d u in pixels and views (thesis, section 3.4: the slope gives depth,
    its sign nearer or farther). Each lenslet sees one spot; the centroid in (v, u) of the part
    above half of the sub-image's maximum excludes the tails of neighbours. Diffraction scatters u
    much more than x, so u is regressed on x without bias (errors in variables), by least squares
    weighted with E^(3/4), E the sum of I^2 over the sub-image, jointly along x and y. A lenslet at
    the rim of the blur is partly lit and receives light from nearer to the middle than its centre.
    With ``pupil``, x is therefore the centroid of the light on the lenslet where the rim is sharp.
    """
    light = np.maximum(window.sum(axis=0), 0)
    noise = sample_noise(window).sum(axis=0)
    energy = (light**2 - noise).sum(axis=(0, 1))
    threshold = np.maximum(_MIN_ENERGY * energy.max(), _MIN_NOISE_RATIO * noise.sum(axis=(0, 1)))
    weight = np.where(energy >= np.maximum(threshold, 1e-300), np.maximum(energy, 0) ** _POWER, 0)
    spot = np.maximum(light - _SPOT_THRESHOLD * light.max(axis=(0, 1)), 0)
    spots = int(np.count_nonzero(weight))
    if spots < _MIN_SPOTS:
        drowned = threshold.flat[np.argmax(energy)] > _MIN_ENERGY * energy.max()
        return PhaseSlope(0.0, 0.0, 0 if drowned else spots)
    ny, nx = energy.shape
    y, x = np.arange(ny)[:, None] if y is None else y, np.arange(nx)[None, :] if x is None else x
    centres = np.stack(np.broadcast_arrays(np.asarray(y, float), np.asarray(x, float)))
    total = np.maximum(spot.sum(axis=(0, 1)), 1e-300)
    views = [_centred(light.shape[0]) * aspect, _centred(light.shape[1])]
    spot_views = np.stack([np.tensordot(views[k], spot.sum(axis=1 - k), 1) / total for k in (0, 1)])
    line = _line(spot_views, centres, weight)
    for _ in range(_ROUNDS):
        if line is None or pupil is None or pupil.sharpness == 0:
            break
        shift = _light_centroids(centres, line, pupil, aspect) - centres
        line = _line(spot_views, centres + pupil.sharpness * shift, weight)
    if line is None:
        return PhaseSlope(0.0, 0.0, spots)
    correction = spots / (spots - _MIN_SPOTS + 1)
    deviation = math.sqrt(correction) * line.error / line.slope**2
    return PhaseSlope(-1 / line.slope, line.confidence, spots, deviation)


@dataclass(frozen=True)
class _Line:
    """Line of u over x: slope, its standard error, and (y, x) of u = 0."""

    slope: float
    error: float
    confidence: float
    crossing: tuple[float, float]


def _line(views: Real, positions: Real, weight: Real) -> _Line | None:
    """Fit a line through (v, u) over (y, x), all of shape (2, y, x); None if undefined."""
    middles = [[float(np.average(a, weights=weight)) for a in pair] for pair in (views, positions)]
    u, x = (
        a - np.array(m)[:, None, None] for a, m in zip((views, positions), middles, strict=True)
    )
    cross, spread, scatter = (float((weight * a).sum()) for a in (x * u, x * x, u * u))
    if spread == 0 or cross == 0:
        return None
    slope = cross / spread
    scores = (weight * x * (u - slope * x)).sum(axis=0)
    error = float(np.sqrt((scores**2).sum())) / spread
    confidence = float(np.clip(cross**2 / (spread * scatter), 0, 1))
    y0, x0 = (position - value / slope for value, position in zip(*middles, strict=True))
    return _Line(slope, error, confidence, (y0, x0))


def _light_centroids(centres: Real, line: _Line, pupil: Pupil, aspect: float) -> Real:
    """Return centroids of a point's light on its lenslets, shape (2, y, x).

    Even samples of the pupil go along the line to the nearest lenslets; others keep centres.
    """
    r = pupil.radius * np.sqrt((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    angle = np.pi * (3 - math.sqrt(5)) * np.arange(_SAMPLES)  # Vogel 1979, eq. 1
    metric = np.array([aspect, 1.0])[:, None]
    spread_points = metric * r * (np.sin(angle), np.cos(angle)) / line.slope
    lit = np.array(line.crossing)[:, None] + spread_points
    flat = centres.reshape(2, -1)
    offsets = (lit[:, :, None] - flat[:, None, :]) / metric[:, :, None]
    distance = np.einsum("asl,asl->sl", offsets, offsets)
    nearest = distance.argmin(axis=1)
    # light outside the window's lenslets and between round ones is ignored
    hit = distance[np.arange(_SAMPLES), nearest] <= min(pupil.lenslet, _MAX_DISTANCE) ** 2
    count = np.bincount(nearest[hit], minlength=flat.shape[1])
    sums = [np.bincount(nearest[hit], a[hit], flat.shape[1]) for a in lit]
    return np.where(count > 0, np.array(sums) / np.maximum(count, 1), flat).reshape(centres.shape)


def _centred(count: int) -> Real:
    return np.arange(count) - (count - 1) / 2
