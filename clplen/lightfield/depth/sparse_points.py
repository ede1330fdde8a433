"""Bright points on black, as of beads, stars and lamps: where they are, and their depth.

A point behind lenslets differs from view to view by diffraction, so that views agree on no plane,
and black round it is no surface. Such places are told by how few pixels hold the light
(`sparse_pixels`). Their depth is that of the sharpest plane of the pictures refocused in steps of
the depth of field (`point_disparity`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.lightfield.depth.camera_optics import camera_optics
from clplen.lightfield.depth.cue import Map, Mask
from clplen.lightfield.depth.energy_cue import energy_disparity
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews

Real = np.ndarray[Any, np.dtype[np.float64]]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_WINDOW = 12  # pixels on every side in which light is sparse or not
_SPARSE = 12.0  # kurtosis of a window, of 625 pixels, whose light is that of 52 or fewer
_FLAT, _FLAT_NOISE = 0.05, 1.5  # of the brightest, and of the noise: others vary by no more
_CORE = 0.5  # of the largest difference in the window: a point is at least this bright
_ROUND = 7  # pixels on every side in which a point outshines others
_SHARE = 0.1  # of the brightest pixel round it: less is not the point but its diffraction
_ROUNDING = 1e-9  # of the samples: less is no light
_ABOVE_NOISE = 4.0  # standard deviations
_BRIGHTEST = 0.2  # per cent of the pixels,
_MOST = 0.5  # of the light: a picture whose brightest pixels hold this much is sparse,
_NOTICED = 0.05  # if it is this much of light and noise together
_NORMAL_MEDIAN = 0.6745  # of abs(x), for a normal distribution of standard deviation 1
_NORMAL_ROOT = 0.822  # mean of sqrt(abs(x)) for that
_SECOND = 6.0  # standard deviation of the second difference along both axes, of noise of 1
_COARSE, _FINE = 1.5, 0.5  # pixels by which the outermost views move apart from plane to plane
_IN_FOCUS = 2.0  # such pixels: nearer to the focus the coarse planes count


def grey(picture: Map) -> Real:
    """Colours of a picture, shape (y, x[, c]), added."""
    values = np.asarray(picture, np.float64)
    return values if values.ndim == 2 else values.sum(axis=-1)


def has_sparse_light(picture: Map) -> bool:
    """Whether the brightest .2 % of the pixels hold half of the light.

    Light counts by its square about the median, less that of the noise, and has to be above it.
    """
    values = grey(picture)
    square = (values - np.median(values)) ** 2
    count = math.ceil(_BRIGHTEST / 100 * square.size)
    bright = float(np.partition(square, -count, axis=None)[-count:].sum())
    noise = np.median(np.abs(_second_difference(values))) / _NORMAL_MEDIAN / _SECOND
    total = float(square.sum())
    return bright > _MOST * (total - square.size * noise**2) and bright > _NOTICED * total


def sparse_pixels(picture: Map) -> Mask:
    """Pixels at most 12 from a point.

    A point is a pixel with half of the largest difference a from the mean of the 25 x 25 pixels
    round it, above the noise, where the others are flat and their kurtosis, <a^4>/<a^2>^2 without
    that of the noise, is above 12: n of N pixels that are alike, on black, have N/n.
    """
    from scipy.ndimage import maximum_filter  # here: slow to import

    values = grey(picture)
    values = values - np.median(values)
    square = values * values
    first, second, third, fourth = map(_mean, (values, square, square * values, square * square))
    mean_square = first * first
    all_of_it = second - mean_square
    central = fourth - 4 * first * third + mean_square * (6 * second - 3 * mean_square)
    noise = _noise_of(values)
    of_noise = noise * noise
    variance = all_of_it - of_noise  # moments of sums of independent parts
    central = central - of_noise * (6 * variance + 3 * of_noise)
    above = values - first
    largest = maximum_filter(np.abs(above), 2 * _WINDOW + 1)
    usual = _robust_deviation(above)
    points = (
        (variance > _NOTICED * all_of_it)
        & (central > _SPARSE * variance * variance)
        & (above >= _CORE * largest)
        & (above > _ABOVE_NOISE * noise)
        & (usual < np.maximum(_FLAT * largest, _FLAT_NOISE * noise))
    )
    return np.asarray(maximum_filter(points, 2 * _WINDOW + 1))


def lit_pixels(picture: Map) -> Real:
    """How surely the light of a point falls on each pixel, 0 to 1, shape (y, x).

    It is 0 in the noise, and below a tenth of the brightest pixel within 7.
    """
    from scipy.ndimage import maximum_filter  # here: slow to import

    values = grey(picture)
    above = values - _mean(values)
    largest, level = (maximum_filter(a, 2 * _ROUND + 1) for a in (above, np.abs(values)))
    least = np.maximum(_SHARE * largest, _ABOVE_NOISE * _noise_of(values))
    least = np.maximum(least, _ROUNDING * level)
    positive = np.where(least > 0, least, np.inf)
    return np.asarray(np.clip(above / positive - 1, 0, 1))


def point_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Disparity of the sharpest plane, without what diffraction takes from it, and confidence.

    Diffraction pulls the sharpest plane towards the focus by kappa of `CameraOptics`, which is
    divided out, and spreads a point in focus over planes on which the outermost views move less
    than a pixel apart: there planes 1.5 pixels apart are tried, elsewhere half a pixel.
    """
    optics = camera_optics(lf)
    has_views = lf.camera is not None and lf.camera.kind != "focused"
    kappa = optics.kappa if optics is not None and has_views else 1.0
    coarse, fine = (energy_disparity(lf, tried) for tried in point_planes(lf, planes))
    near = np.abs(coarse[0]) <= _IN_FOCUS / max(max(lf.shape[:2]) - 1, 1)
    disparity, confidence = (np.where(near, *both) for both in zip(coarse, fine, strict=True))
    return (disparity / kappa).astype(np.float32), confidence.astype(np.float32)


def point_planes(source: SampledViews, planes: Vector) -> tuple[Vector, Vector]:
    """The disparities that `point_disparity` tries, rising: coarse and fine."""
    found = []
    for apart in (_COARSE, _FINE):
        step = apart / max(max(source.shape[:2]) - 1, 1)
        low, high = math.floor(planes[0] / step), math.ceil(planes[-1] / step)
        tried = np.unique(np.clip(step * np.arange(low, high + 1), planes[0], planes[-1]))
        found.append(tried if tried.size >= 3 else planes)
    return found[0], found[1]


def _mean(values: Real) -> Real:
    """Of 25 x 25 pixels round every one, each summed by itself, so that parts have the same."""
    from scipy.ndimage import correlate1d  # here: slow to import

    taps = np.full(2 * _WINDOW + 1, 1 / (2 * _WINDOW + 1))
    return np.asarray(correlate1d(correlate1d(values, taps, axis=0), taps, axis=1))


def _second_difference(values: Real) -> Real:
    """Along both axes (Immerkaer 1996, "Fast noise variance estimation")."""
    from scipy.ndimage import correlate1d  # here: slow to import

    taps = np.array([1.0, -2.0, 1.0])
    return np.asarray(correlate1d(correlate1d(values, taps, axis=0), taps, axis=1))


def _noise_of(values: Real) -> Real:
    """Standard deviation of the noise round every pixel, whatever a few bright ones do."""
    return _robust_deviation(_second_difference(values)) / _SECOND


def _robust_deviation(values: Real) -> Real:
    """That of 25 x 25 normal values round every one, by the mean square root of their size."""
    return np.asarray((_mean(np.sqrt(np.abs(values))) / _NORMAL_ROOT) ** 2)
