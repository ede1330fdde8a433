"""The slope of a point in phase space: where its spots lie behind the lenslets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clplen.lightfield.depth.camera_optics import Pupil, Real
from clplen.lightfield.depth.window_measures import sample_noise

_SPOT = 0.5  # of a sub-image's maximum: what is above is the spot, not a neighbour's tail
_FAINTEST = 0.03  # of the brightest sub-image: fainter ones are diffraction
_ABOVE_NOISE = 0.5  # of the energy of the noise in a sub-image: fainter ones are noise
_LEAST_SPOTS = 3  # of a line: a point in focus between two lenslets has two spots
_POWER = 0.75  # of a sub-image's energy, its weight: between light and energy
_ROUNDS = 4  # of the line through lenslets that are lit in part
_SAMPLES = 1500  # of the pupil
_FARTHEST = 0.75  # pitches from its centre to the corner of a cell, a little more


@dataclass(frozen=True)
class PhaseSlope:
    """A line fitted to the spots of one point. Made by `fit_slope`."""

    # Pixels a view step along x, nearer positive; 0 where all light lies in one lenslet or two, or
    # the spots show no slope
    disparity: float
    confidence: float  # 0 to 1: share of the spots' scatter in u that the line explains (R squared)
    spots: int  # Sub-images that were used; 0 where noise hides all but one or two
    # Standard deviation of the disparity by the scatter of the spots about the line, as if it were
    # independent (White 1980, "A heteroskedasticity-consistent covariance matrix estimator", eq. 6,
    # times n/(n - 2) for n spots); nan where the disparity is 0
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

    A point lies on x = X - d u in pixels and views (thesis, section 3.4: the slope tells depth,
    its sign nearer or farther). Each lenslet sees one spot, whose centroid in (v, u), of what
    exceeds half of the sub-image's maximum, is free of the tails of its neighbours. Diffraction
    scatters u and hardly x, so u is regressed on x, which is unbiased (errors in variables), by
    least squares weighted with E^(3/4), E the sum of I^2 over the sub-image; along x and y
    together. A lenslet at the rim of the blur is lit in part, and its light comes from nearer to
    the middle than its own centre: with the ``pupil`` x is the centroid of the light on it, where
    the rim is sharp.
    """
    light = np.maximum(window.sum(axis=0), 0)
    noise = sample_noise(window).sum(axis=0)
    energy = (light**2 - noise).sum(axis=(0, 1))
    least = np.maximum(_FAINTEST * energy.max(), _ABOVE_NOISE * noise.sum(axis=(0, 1)))
    weight = np.where(energy >= np.maximum(least, 1e-300), np.maximum(energy, 0) ** _POWER, 0)
    spot = np.maximum(light - _SPOT * light.max(axis=(0, 1)), 0)
    spots = int(np.count_nonzero(weight))
    if spots < _LEAST_SPOTS:
        drowned = least.flat[np.argmax(energy)] > _FAINTEST * energy.max()
        return PhaseSlope(0.0, 0.0, 0 if drowned else spots)
    ny, nx = energy.shape
    y, x = np.arange(ny)[:, None] if y is None else y, np.arange(nx)[None, :] if x is None else x
    centres = np.stack(np.broadcast_arrays(np.asarray(y, float), np.asarray(x, float)))
    total = np.maximum(spot.sum(axis=(0, 1)), 1e-300)
    views = [_centred(light.shape[0]) * aspect, _centred(light.shape[1])]
    seen = np.stack([np.tensordot(views[k], spot.sum(axis=1 - k), 1) / total for k in (0, 1)])
    line = _line(seen, centres, weight)
    for _ in range(_ROUNDS):
        if line is None or pupil is None or pupil.sharpness == 0:
            break
        shift = _lit_places(centres, line, pupil, aspect) - centres
        line = _line(seen, centres + pupil.sharpness * shift, weight)
    if line is None:
        return PhaseSlope(0.0, 0.0, spots)
    few = spots / (spots - _LEAST_SPOTS + 1)
    deviation = math.sqrt(few) * line.error / line.slope**2
    return PhaseSlope(-1 / line.slope, line.confidence, spots, deviation)


@dataclass(frozen=True)
class _Line:
    """u over x: its slope, the standard error of that, and (y, x) where u is 0."""

    slope: float
    error: float
    confidence: float
    crossing: tuple[float, float]


def _line(seen: Real, where: Real, weight: Real) -> _Line | None:
    """A line through (v, u) over (y, x), all of shape (2, y, x); None where there is none."""
    middles = [[float(np.average(a, weights=weight)) for a in both] for both in (seen, where)]
    u, x = (a - np.array(m)[:, None, None] for a, m in zip((seen, where), middles, strict=True))
    cross, spread, scatter = (float((weight * a).sum()) for a in (x * u, x * x, u * u))
    if spread == 0 or cross == 0:
        return None
    slope = cross / spread
    left = (weight * x * (u - slope * x)).sum(axis=0)
    error = float(np.sqrt((left**2).sum())) / spread
    confidence = float(np.clip(cross**2 / (spread * scatter), 0, 1))
    y0, x0 = (at - of / slope for of, at in zip(*middles, strict=True))
    return _Line(slope, error, confidence, (y0, x0))


def _lit_places(centres: Real, line: _Line, pupil: Pupil, aspect: float) -> Real:
    """Centroids of the light of a point on its lenslets, shape (2, y, x).

    Points spread evenly over the pupil are laid on the array along the line, each to the nearest
    lenslet. Lenslets that none reaches keep their centres.
    """
    r = pupil.radius * np.sqrt((np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    angle = np.pi * (3 - math.sqrt(5)) * np.arange(_SAMPLES)  # Vogel 1979, eq. 1
    metric = np.array([aspect, 1.0])[:, None]
    around = metric * r * (np.sin(angle), np.cos(angle)) / line.slope
    lit = np.array(line.crossing)[:, None] + around
    flat = centres.reshape(2, -1)
    off = (lit[:, :, None] - flat[:, None, :]) / metric[:, :, None]
    distance = np.einsum("asl,asl->sl", off, off)
    nearest = distance.argmin(axis=1)
    # light beyond the outermost lenslets of the window, and between round ones, is not seen
    on = distance[np.arange(_SAMPLES), nearest] <= min(pupil.lenslet, _FARTHEST) ** 2
    count = np.bincount(nearest[on], minlength=flat.shape[1])
    sums = [np.bincount(nearest[on], a[on], flat.shape[1]) for a in lit]
    return np.where(count > 0, np.array(sums) / np.maximum(count, 1), flat).reshape(centres.shape)


def _centred(count: int) -> Real:
    return np.arange(count) - (count - 1) / 2
