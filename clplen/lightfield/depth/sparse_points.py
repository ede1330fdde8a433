"""Detection and depth of bright points on black (beads, stars, lamps).

Diffraction makes a point differ between views behind lenslets, so no plane matches, and the black
around it is no surface. Such areas have few bright pixels (`sparse_pixels`). Their depth is the
sharpest of refocused pictures in steps of the depth of field (`point_disparity`).
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

_WINDOW = 12  # pixels on every side of the window in which sparsity is measured
_MIN_KURTOSIS = 12.0  # kurtosis of a window of 625 pixels whose light falls on at most 52
# Of the brightest, and of the noise: maximum variation of other pixels
_MAX_VARIATION, _MAX_NOISE_VARIATION = 0.05, 1.5
_CORE = 0.5  # of the largest difference in the window: minimum brightness of a point
_NEIGHBOURHOOD = 7  # pixels on every side in which a point outshines others
_MIN_SHARE = 0.1  # of the brightest pixel around it: fainter pixels are diffraction
_ROUNDING = 1e-9  # of the samples: light below it is rounding
_MIN_NOISE_RATIO = 4.0  # standard deviations
_BRIGHTEST = 0.2  # per cent of the pixels, brightest first
_MIN_BRIGHT_SHARE = 0.5  # of the light: minimum in these pixels of a sparse picture,
_MIN_SIGNAL_SHARE = 0.05  # and their minimum share of light and noise together
_NORMAL_MEDIAN = 0.6745  # median of abs(x) of a standard normal distribution
_NORMAL_ROOT = 0.822  # mean of sqrt(abs(x)) of a standard normal distribution
_SECOND = 6.0  # standard deviation of the second difference along both axes for unit noise
_COARSE, _FINE = 1.5, 0.5  # pixels by which the outermost views move apart between planes
_IN_FOCUS = 2.0  # such pixels: range around the focus in which the coarse planes are used


def grey(picture: Map) -> Real:
    """Sum the colours of a picture of shape (y, x[, c])."""
    values = np.asarray(picture, np.float64)
    return values if values.ndim == 2 else values.sum(axis=-1)


def has_sparse_light(picture: Map) -> bool:
    """Return True if the brightest 0.2 % of the pixels hold half of the light.

    Light is measured by its square about the median less that of the noise, which it must exceed.
    """
    values = grey(picture)
    square = (values - np.median(values)) ** 2
    count = math.ceil(_BRIGHTEST / 100 * square.size)
    bright = float(np.partition(square, -count, axis=None)[-count:].sum())
    noise = np.median(np.abs(_second_difference(values))) / _NORMAL_MEDIAN / _SECOND
    total = float(square.sum())
    return (
        bright > _MIN_BRIGHT_SHARE * (total - square.size * noise**2)
        and bright > _MIN_SIGNAL_SHARE * total
    )


def sparse_pixels(picture: Map) -> Mask:
    """Return a mask of the pixels at most 12 from a point.

    A point has half of the largest deviation a from the mean of the surrounding 25 x 25 pixels,
    above the noise, with flat surroundings. The kurtosis <a^4>/<a^2>^2, corrected for noise, must
    exceed 12; n of N equal pixels on black have N/n.
    """
    from scipy.ndimage import maximum_filter  # slow import

    values = grey(picture)
    values = values - np.median(values)
    square = values * values
    first, second, third, fourth = map(_mean, (values, square, square * values, square * square))
    mean_square = first * first
    total = second - mean_square
    central = fourth - 4 * first * third + mean_square * (6 * second - 3 * mean_square)
    noise = _noise_of(values)
    noise_variance = noise * noise
    variance = total - noise_variance  # moments of sums of independent parts
    central = central - noise_variance * (6 * variance + 3 * noise_variance)
    above = values - first
    largest = maximum_filter(np.abs(above), 2 * _WINDOW + 1)
    typical = _robust_deviation(above)
    points = (
        (variance > _MIN_SIGNAL_SHARE * total)
        & (central > _MIN_KURTOSIS * variance * variance)
        & (above >= _CORE * largest)
        & (above > _MIN_NOISE_RATIO * noise)
        & (typical < np.maximum(_MAX_VARIATION * largest, _MAX_NOISE_VARIATION * noise))
    )
    return np.asarray(maximum_filter(points, 2 * _WINDOW + 1))


def lit_pixels(picture: Map) -> Real:
    """Return the confidence, 0 to 1, that light of a point falls on each pixel, shape (y, x).

    It is 0 in the noise and below a tenth of the brightest pixel within 7.
    """
    from scipy.ndimage import maximum_filter  # slow import

    values = grey(picture)
    above = values - _mean(values)
    largest, level = (maximum_filter(a, 2 * _NEIGHBOURHOOD + 1) for a in (above, np.abs(values)))
    threshold = np.maximum(_MIN_SHARE * largest, _MIN_NOISE_RATIO * _noise_of(values))
    threshold = np.maximum(threshold, _ROUNDING * level)
    positive = np.where(threshold > 0, threshold, np.inf)
    return np.asarray(np.clip(above / positive - 1, 0, 1))


def point_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Return the disparity of the sharpest plane, corrected for diffraction, and confidence.

    Diffraction biases the sharpest plane towards the focus by kappa of `CameraOptics`, which is
    divided out. It also widens the focus of a point to planes on which the outermost views move
    less than a pixel apart: planes are 1.5 pixels apart near focus, half a pixel elsewhere.
    """
    optics = camera_optics(lf)
    has_views = lf.camera is not None and lf.camera.kind != "focused"
    kappa = optics.kappa if optics is not None and has_views else 1.0
    coarse, fine = (energy_disparity(lf, values) for values in point_planes(lf, planes))
    near = np.abs(coarse[0]) <= _IN_FOCUS / max(max(lf.shape[:2]) - 1, 1)
    disparity, confidence = (np.where(near, *pair) for pair in zip(coarse, fine, strict=True))
    return (disparity / kappa).astype(np.float32), confidence.astype(np.float32)


def point_planes(source: SampledViews, planes: Vector) -> tuple[Vector, Vector]:
    """Return the coarse and fine disparities that `point_disparity` searches, ascending."""
    ranges = []
    for apart in (_COARSE, _FINE):
        step = apart / max(max(source.shape[:2]) - 1, 1)
        low, high = math.floor(planes[0] / step), math.ceil(planes[-1] / step)
        values = np.unique(np.clip(step * np.arange(low, high + 1), planes[0], planes[-1]))
        ranges.append(values if values.size >= 3 else planes)
    return ranges[0], ranges[1]


def _mean(values: Real) -> Real:
    """Return the mean of the 25 x 25 pixels around each, bitwise equal for every tiling."""
    from scipy.ndimage import correlate1d  # slow import

    taps = np.full(2 * _WINDOW + 1, 1 / (2 * _WINDOW + 1))
    return np.asarray(correlate1d(correlate1d(values, taps, axis=0), taps, axis=1))


def _second_difference(values: Real) -> Real:
    """Return second differences along both axes (Immerkaer 1996)."""
    from scipy.ndimage import correlate1d  # slow import

    taps = np.array([1.0, -2.0, 1.0])
    return np.asarray(correlate1d(correlate1d(values, taps, axis=0), taps, axis=1))


def _noise_of(values: Real) -> Real:
    """Return the noise around every pixel, robust to a few bright pixels."""
    return _robust_deviation(_second_difference(values)) / _SECOND


def _robust_deviation(values: Real) -> Real:
    """Return the deviation of 25 x 25 pixels around each, by the mean root of their size."""
    return np.asarray((_mean(np.sqrt(np.abs(values))) / _NORMAL_ROOT) ** 2)
