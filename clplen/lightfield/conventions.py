"""Conversion between this package's disparity d and the numbers of other tools.

d is in pixels a view step, larger for nearer objects: a plane of disparity d lies at
x - d (u - (U - 1)/2) in view u. Functions come in pairs, ``from_TOOL(number) -> d`` and
``to_TOOL(d) -> number``, and accept numbers and arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import float64_array

Real = np.ndarray[Any, np.dtype[np.float64]]


def from_plenopticam(a: ArrayLike) -> Real:
    """Convert plenopticam's refocusing parameter a, an integer: d = a."""
    return float64_array(a)


def to_plenopticam(d: ArrayLike) -> Real:
    """Convert to plenopticam's a, the integer nearest to d."""
    return np.rint(float64_array(d))


def from_plenpy(slope: ArrayLike, *, views: int) -> Real:
    """Convert plenpy's slope, which spans N steps instead of N - 1: d = slope N/(N - 1)."""
    return float64_array(slope) / _span(views)


def to_plenpy(d: ArrayLike, *, views: int) -> Real:
    """Convert to plenpy's slope, d (N - 1)/N."""
    return float64_array(d) * _span(views)


def from_lftoolbox(slope: ArrayLike, *, views: int) -> Real:
    """Convert LFFiltShiftSum's Slope (LFToolbox): d = -Slope N/(N - 1), N as in `from_plenpy`."""
    return -from_plenpy(slope, views=views)


def to_lftoolbox(d: ArrayLike, *, views: int) -> Real:
    """Convert to the Slope of LFFiltShiftSum, -d (N - 1)/N."""
    return -to_plenpy(d, views=views)


def from_plenoptomos(alpha: ArrayLike) -> Real:
    """Convert plenoptomos' alpha > 0, which treats the view index as a length: d = 1/alpha - 1."""
    return 1 / _positive("alpha", alpha) - 1


def to_plenoptomos(d: ArrayLike) -> Real:
    """Convert to plenoptomos' alpha, 1/(1 + d), for d > -1."""
    return 1 / _positive("1 + d", 1 + float64_array(d))


def from_ng(alpha: ArrayLike, *, kappa: float) -> Real:
    """Convert Ng's alpha = F'/F > 0: d = kappa (1 - 1/alpha)."""
    return _positive("kappa", kappa) * (1 - 1 / _positive("alpha", alpha))


def to_ng(d: ArrayLike, *, kappa: float) -> Real:
    """Convert to Ng's alpha, 1/(1 - d/kappa), for d < kappa."""
    ratio = float64_array(d) / _positive("kappa", kappa)
    return 1 / _positive("1 - d/kappa", 1 - ratio)


def from_lightfieldlab(shift: ArrayLike) -> Real:
    """Convert LightFieldLab's shift: d = -shift."""
    return -float64_array(shift)


def to_lightfieldlab(d: ArrayLike) -> Real:
    """Convert to LightFieldLab's shift, -d."""
    return -float64_array(d)


def from_epi_slope(slope: ArrayLike) -> Real:
    """Convert the slope dx/du of a line in an epipolar-plane image: d = -dx/du."""
    return -float64_array(slope)


def to_epi_slope(d: ArrayLike) -> Real:
    """Convert to the slope dx/du in pixels a view, -d."""
    return -float64_array(d)


def from_virtual_depth(virtual_depth: ArrayLike, *, pitch: float) -> Real:
    """Return the shift between neighbouring micro-images of plenoptic 2.0, pitch/v in pixels.

    The shift is the patch size of basic rendering.
    """
    return _positive("pitch", pitch) / _not_zero("The virtual depth", virtual_depth)


def to_virtual_depth(shift: ArrayLike, *, pitch: float) -> Real:
    """Return the virtual depth v = pitch/shift of a shift in pixels other than 0."""
    return _positive("pitch", pitch) / _not_zero("The shift", shift)


def disparity_of_distance(
    z: ArrayLike, *, kappa: float, image_distance: float, focus: float
) -> Real:
    """Return d = kappa F (1/z - 1/z0) of an object at the distance z from the main lens.

    The formula follows from 1/z = 1/f - alpha/F and d = kappa (1 - alpha).
    """
    scale = _positive("kappa", kappa) * _positive("image_distance", image_distance)
    return scale * (1 / _positive("z", z, infinite=True) - 1 / _positive("focus", focus))


def distance_of_disparity(
    d: ArrayLike, *, kappa: float, image_distance: float, focus: float
) -> Real:
    """Return the distance z in metres of a disparity; infinite at and beyond infinity.

    The parameters are those of `disparity_of_distance`.
    """
    scale = _positive("kappa", kappa) * _positive("image_distance", image_distance)
    near = float64_array(d) / scale + 1 / _positive("focus", focus)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.maximum(near, 0))


def hci_disparity(
    z: ArrayLike,
    *,
    baseline: float,
    focal_length: float,
    focus: float,
    sensor_size: float,
    pixels: int,
) -> Real:
    """Return d = (b f W/Z - b f W/Z0)/s of the HCI 4D light-field benchmark.

    This is `disparity_of_distance` with kappa F = b f W/s (Honauer et al. 2016). Its
    ``parameters.cfg`` gives millimetres.
    """
    scale = hci_scale(baseline, focal_length, sensor_size=sensor_size, pixels=pixels)
    return disparity_of_distance(z, kappa=scale, image_distance=1, focus=focus)


def hci_distance(
    d: ArrayLike,
    *,
    baseline: float,
    focal_length: float,
    focus: float,
    sensor_size: float,
    pixels: int,
) -> Real:
    """Return the distance Z in metres of a disparity; parameters as in `hci_disparity`."""
    scale = hci_scale(baseline, focal_length, sensor_size=sensor_size, pixels=pixels)
    return distance_of_disparity(d, kappa=scale, image_distance=1, focus=focus)


def hci_scale(baseline: float, focal_length: float, *, sensor_size: float, pixels: int) -> float:
    """Return b f W/s, the kappa F of the HCI benchmark, in disparity times metres."""
    size = float(_positive("sensor_size", sensor_size))
    return float(_positive("baseline", baseline) * _positive("focal_length", focal_length)) * (
        float(_positive("pixels", pixels)) / size
    )


def _span(views: int) -> float:
    if not views >= 2:
        raise ValueError(f"views must be at least 2 along an axis, got {views!r}.")
    return (views - 1) / views


def _positive(name: str, value: ArrayLike, *, infinite: bool = False) -> Real:
    values = float64_array(value)
    limit = np.isfinite(values) | (infinite & np.isposinf(values))
    if not ((values > 0) & limit).all():
        raise ValueError(f"{name} must be positive and finite, got {value!r}.")
    return values


def _not_zero(name: str, value: ArrayLike) -> Real:
    values = float64_array(value)
    if not (np.isfinite(values) & (values != 0)).all():
        raise ValueError(f"{name} must be finite and other than 0, got {value!r}.")
    return values
