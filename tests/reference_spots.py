"""Spots that lenslets make of a point, measured in a raw image."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.cameras.focused_camera import Plenoptic2

Array = Any


def spot(image: Array, camera: Plenoptic2, place: Array, m: float) -> tuple[float, Array]:
    """Energy and I^2 centroid (y, x) in the window of one spot: half-way to the next."""
    y, x, rows, columns = _window(camera, place, m)
    part = image[np.ix_(rows, columns)]
    return float(part.sum()), _centroid(part, y, x)


def _window(camera: Plenoptic2, place: Array, m: float) -> tuple[Array, ...]:
    half = min(1.0, 1 + m) * camera.mla.pitch / 2
    y, x = camera.grid.y, camera.grid.x
    rows, columns = np.abs(y - place[0]) <= half, np.abs(x - place[1]) <= half
    return y[rows], x[columns], rows, columns


def _centroid(part: Array, y: Array, x: Array) -> Array:
    squares = part**2
    return np.array([squares.sum(1) @ y, squares.sum(0) @ x]) / squares.sum()


def slope(weight: Array, x: Array, y: Array) -> float:
    """Of a straight line y(x) through weighted points."""
    away = x - np.average(x, weights=weight)
    return float((weight * away * y).sum() / (weight * away**2).sum())


def width(profile: Array) -> float:
    """Full width at half maximum in samples, between linear crossings."""
    half = profile.max() / 2
    above = np.flatnonzero(profile > half)
    first, last = above[0], above[-1]
    left = (profile[first] - half) / (profile[first] - profile[first - 1])
    right = (profile[last] - half) / (profile[last] - profile[last + 1])
    return float(last - first + left + right)
