"""Limits of the samples of a grid: band, slopes and curvatures.

Elements, sources and propagations use these functions for all sampling limits.
"""

from __future__ import annotations

import math

SLACK = 1e-9  # relative excess over a limit that counts as rounding


def exceeds(value: float, limit: float) -> bool:
    """Return True if a value exceeds a limit by more than rounding."""
    return value > limit * (1 + SLACK)


def nyquist(pitch: float) -> float:
    """Return the largest spatial frequency of samples, 1/(2 dx), in cycles per metre."""
    return 1 / (2 * pitch)


def steepest_slope(pitch: float, wavelength: float) -> float:
    """Return the sine q = lam/(2 dx) of the steepest sampled ray; 1 or more admits all rays."""
    return wavelength / (2 * pitch)


def sampled_radius(
    z: float, pitch: float, wavelength: float, *, is_paraxial: bool = False
) -> float:
    """Return the radius in metres up to which a lens or sphere changes by at most pi per sample.

    R_max = z q/sqrt(1 - q^2) for a spherical phase (any radius for q >= 1), z q for a paraxial
    phase.
    """
    sine = steepest_slope(pitch, wavelength)
    if is_paraxial:
        return wavelength * abs(z) / (2 * pitch)
    return math.inf if sine >= 1 else abs(z) * sine / math.sqrt(1 - sine**2)


def sampled_from(
    radius: float, pitch: float, wavelength: float, *, is_paraxial: bool = False
) -> float:
    """Return the smallest abs(z) in metres for which `sampled_radius` reaches a radius."""
    sine = steepest_slope(pitch, wavelength)
    if is_paraxial:
        return 2 * radius * pitch / wavelength
    return 0.0 if sine >= 1 else radius * math.sqrt(1 - sine**2) / sine
