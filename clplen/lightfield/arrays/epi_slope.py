"""Depth of one point from the slope of its line in phase space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Real = np.ndarray[Any, np.dtype[np.float64]]

_SPOT = 0.5  # of a sub-image's maximum: what is above is the spot, not a neighbour's tail
_FAINTEST = 0.03  # of the brightest sub-image: fainter ones are diffraction
_POWER = 0.75  # of a sub-image's energy, its weight: between light and energy


@dataclass(frozen=True)
class PhaseSlope:
    """A line fitted to the spots of one point. Made by `fit_slope`.

    Attributes
    ----------
    disparity : float
        Pixels a view step along x, nearer positive; 0 where all light lies in one lenslet, or the
        spots show no slope.
    confidence : float
        0 to 1: share of the spots' scatter in u that the line explains (R squared).
    spots : int
        Sub-images that were used.
    """

    disparity: float
    confidence: float
    spots: int


def fit_slope(window: Real, *, aspect: float = 1.0) -> PhaseSlope:
    """Regress the place of the spot in a sub-image on the place of its lenslet.

    A point lies on x = X - d u in pixels and views (thesis, section 3.4: the slope tells depth,
    its sign nearer or farther). Each lenslet sees one spot, whose centroid in (v, u), of what
    exceeds half of the sub-image's maximum, is free of the tails of its neighbours. Diffraction
    scatters u and hardly x, so u is regressed on x, which is unbiased (errors in variables), by
    least squares weighted with E^(3/4), E the sum of I^2 over the sub-image; along x and y
    together.

    Parameters
    ----------
    window : numpy.ndarray
        float64, shape (c, v, u, y, x): about one point that lies alone in it.
    aspect : float
        Disparity along y over that along x.

    Returns
    -------
    PhaseSlope
    """
    light = np.maximum(window.sum(axis=0), 0)
    energy = (light**2).sum(axis=(0, 1))
    weight = np.where(energy >= _FAINTEST * energy.max(), energy**_POWER, 0)
    spot = np.maximum(light - _SPOT * light.max(axis=(0, 1)), 0)
    cross = spread = scatter = 0.0
    for axis, unit in ((0, aspect), (1, 1.0)):
        views = unit * (np.arange(light.shape[axis]) - (light.shape[axis] - 1) / 2)
        pixels = np.arange(light.shape[2 + axis], dtype=float)
        total = np.maximum(spot.sum(axis=(0, 1)), 1e-300)
        u = np.tensordot(views, spot.sum(axis=1 - axis), 1) / total
        x = np.broadcast_to(pixels[:, None] if axis == 0 else pixels, u.shape)
        u, x = (a - np.average(a, weights=weight) for a in (u, x))
        cross += float((weight * x * u).sum())
        spread += float((weight * x * x).sum())
        scatter += float((weight * u * u).sum())
    spots = int(np.count_nonzero(weight))
    if spread == 0 or cross == 0:
        return PhaseSlope(0.0, 0.0, spots)
    confidence = cross**2 / (spread * scatter)
    return PhaseSlope(-spread / cross, float(np.clip(confidence, 0, 1)), spots)
