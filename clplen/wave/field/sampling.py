"""What the samples of a grid carry: the one owner of a field's band and of the limits behind it.

Elements, sources and propagations ask here how fine a frequency, a slope or a curvature may be.
"""

from __future__ import annotations

import math

SLACK = 1e-9  # part of a limit by which rounded lengths may exceed it


def exceeds(value: float, limit: float) -> bool:
    """Return whether a value is beyond a limit by more than rounding."""
    return value > limit * (1 + SLACK)


def nyquist(pitch: float) -> float:
    """Largest spatial frequency of samples, 1/(2 dx), in cycles a metre."""
    return 1 / (2 * pitch)


def steepest_slope(pitch: float, wavelength: float) -> float:
    """Sine q = lam/(2 dx) of the steepest ray that samples carry; above 1 they carry all."""
    return wavelength / (2 * pitch)


def sampled_radius(
    z: float, pitch: float, wavelength: float, *, is_paraxial: bool = False
) -> float:
    """Largest radius up to which a lens or a sphere changes by at most pi a sample, in metres.

    R_max = z q/sqrt(1 - q^2) of a spherical phase, any for q >= 1; z q of a paraxial one.
    """
    sine = steepest_slope(pitch, wavelength)
    if is_paraxial:
        return wavelength * abs(z) / (2 * pitch)
    return math.inf if sine >= 1 else abs(z) * sine / math.sqrt(1 - sine**2)


def sampled_from(
    radius: float, pitch: float, wavelength: float, *, is_paraxial: bool = False
) -> float:
    """Smallest abs(z) for which `sampled_radius` reaches a radius, in metres."""
    sine = steepest_slope(pitch, wavelength)
    if is_paraxial:
        return 2 * radius * pitch / wavelength
    return 0.0 if sine >= 1 else radius * math.sqrt(1 - sine**2) / sine
