"""Band of spatial frequencies that a propagation needs, and its sampling, for a single axis.

A ray of spatial frequency f moves sideways by z tan(asin(lam f)). The band consists of the rays
that arrive in the output window, plus a smooth guard of a few Fresnel widths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.wave.field.sampling import nyquist, steepest_slope

Vector = np.ndarray[Any, Any]

GUARD = 6.0  # width of the guard in Fresnel widths
FAR_GUARD = 8.0  # width of the guard at distances with few frequencies
EVANESCENT_MARGIN = 64  # margin of both windows in units of z if grazing waves are sampled
WINDOW_GUARD = 3.0  # margin of the computation window in units of sqrt(lam z)
ROUNDING = 1e-12  # relative tolerance of the Nyquist frequency, the last frequency of an FFT
EVANESCENT_REACH = 3  # wavelengths, beyond which evanescent waves are below 1e-4
# Steepness of the taper by guard: the weight ends nearer to 0 and 1 for a wider guard.
_GUARDS, _STEEPNESS = (2.0, 3.0, 4.0, 6.0, 8.0), (2.5, 3.0, 3.5, 4.0, 5.0)


@dataclass(frozen=True)
class AxisSpan:
    """Axis of a propagation: widths of the input and of the output."""

    n: int  # samples of the input; 1: no variation along the axis
    pitch: float  # of the input in metres
    z: float  # in metres
    wavelength: float
    lit: float  # width of the light, centred on the input's central sample, in metres
    output: float  # width of the output window in metres
    offset: float = 0.0  # centre of the output window relative to the input, in metres
    # smallest and largest displacement along the other axis, at least 0, in metres
    across: tuple[float, float] = (0.0, 0.0)

    @property
    def nyquist(self) -> float:
        """Nyquist frequency in cycles per metre."""
        return nyquist(self.pitch)

    @property
    def reach(self) -> float:
        """Largest sideways displacement from the input to the output, in metres."""
        return (self.lit + self.output) / 2 + abs(self.offset)

    def geometric(self, displacement: float, across: float = 0.0) -> float:
        """Return the spatial frequency of a ray by displacements along this and the other axis."""
        distance = math.hypot(displacement, across, self.z)
        return displacement / (self.wavelength * distance) if distance else 0.0

    def displacement(self, frequency: float, across: float = 0.0) -> float:
        """Return the displacement of a ray of a spatial frequency; infinite from 1/lam on."""
        sine = self.wavelength * frequency
        if abs(sine) >= 1:
            return math.copysign(math.inf, sine)
        return math.hypot(self.z, across) * sine / math.sqrt(1 - sine * sine)

    def fresnel_width(self, displacement: float, across: float = 0.0) -> float:
        """Return the width of the band that interferes at a point, in cycles per metre.

        It is sqrt(cos^3 theta/(lam z)) in the plane of the axis: the square root of the second
        derivative of the path by the displacement, over lam.
        """
        distance = math.hypot(displacement, across, self.z)
        if not distance:
            return 0.0
        return math.hypot(self.z, across) / distance / math.sqrt(self.wavelength * distance)

    def low_end(self, displacement: float) -> float:
        """Return the displacement along the other axis of the ray of lowest frequency."""
        return self.across[0] if displacement < 0 else self.across[1]

    def high_end(self, displacement: float) -> float:
        """Return the displacement along the other axis of the ray of highest frequency."""
        return self.across[1] if displacement < 0 else self.across[0]

    @property
    def is_evanescent(self) -> bool:
        """True if evanescent waves are sampled and not yet decayed."""
        near = abs(self.z) <= EVANESCENT_REACH * self.wavelength
        return self.n > 1 and near and self.wavelength * self.nyquist > 1

    @property
    def highest(self) -> float:
        """Largest frequency that geometry and sampling admit, in cycles per metre."""
        return 0.0 if self.n == 1 else min(self.geometric(self.reach), self.nyquist)


@dataclass(frozen=True)
class Band:
    """Guarded band of an axis."""

    low: float  # ends of the band in cycles per metre; it is empty for ``low >= high``
    high: float
    inner: tuple[float, float]  # range of frequencies of weight 1
    # True if the Nyquist frequency truncates the lower and the upper end, without a taper
    clipped: tuple[bool, bool]
    window: float  # width of the computation window, 1 over the frequency step, in metres
    guard: float  # in Fresnel widths
    nyquist: float  # in cycles per metre
    # True if the band has grazing waves, which leave every window and return as aliases
    grazing: bool = False

    @property
    def is_whole(self) -> bool:
        """True if the band contains all sampled frequencies."""
        return all(self.clipped)

    @property
    def is_empty(self) -> bool:
        """True if no sampled frequency reaches the output window."""
        return self.low >= self.high

    def weights(self, f: Vector) -> Vector:
        """Return weights of frequencies, float64, with the shape of ``f``, 0 outside the band.

        They are 0.5 erfc(-(2 t - 1) k) in the guard, with t from 0 at its outer to 1 at its inner
        end.
        """
        slack = ROUNDING * self.nyquist
        inside = (f >= self.low - slack) & (f <= self.high + slack)
        weights = np.where(inside, 1.0, 0.0)
        if self.guard == 0:
            return weights
        steepness = float(np.interp(self.guard, _GUARDS, _STEEPNESS))
        ends = ((self.low, self.inner[0]), (self.high, self.inner[1]))
        for (outer, inner), clipped in zip(ends, self.clipped, strict=True):
            if not clipped and outer != inner:
                t = (f - outer) / (inner - outer)
                taper = inside & (t < 1)
                weights[taper] *= [math.erfc((1 - 2 * s) * steepness) / 2 for s in t[taper]]
        return weights


def guarded_band(span: AxisSpan, guard: float = GUARD) -> Band:
    """Return the band and the computation window of an axis.

    Each end of the band of geometric optics (Matsushima and Shimobaba 2009, eq. 13, for the true
    windows) is extended by ``guard`` Fresnel widths. The computation window is wide enough for
    aliases to miss the output. With evanescent waves the band has all sampled frequencies.
    """
    spread = math.sqrt(span.wavelength * abs(span.z))
    cap = 4 * (span.lit + span.output + abs(span.offset)) + 2 * (guard + WINDOW_GUARD) * spread
    if span.is_evanescent:
        window = span.lit + span.output + 2 * abs(span.offset) + EVANESCENT_MARGIN * abs(span.z)
        return replace(whole_band(span), window=min(window, cap), grazing=True)
    offset = span.offset if span.z >= 0 else -span.offset
    half = (span.lit + span.output) / 2
    near, far = offset - half, offset + half
    ends = (near, span.low_end(near)), (far, span.high_end(far))
    low, high = (span.geometric(*end) for end in ends)
    outer_low = low - guard * span.fresnel_width(*ends[0])
    outer_high = high + guard * span.fresnel_width(*ends[1])
    clipped = (outer_low <= -span.nyquist, outer_high >= span.nyquist)
    f_low, f_high = max(outer_low, -span.nyquist), min(outer_high, span.nyquist)
    # Off the axis, displacements of a ray along both axes grow together.
    across = span.across if span.across[0] > 0 else (0.0, 0.0)
    back = min(span.displacement(f_low, other) for other in across)
    ahead = max(span.displacement(f_high, other) for other in across)
    needed = max(max(far - back, ahead - near) + WINDOW_GUARD * spread, span.lit + span.output)
    grazing = span.n > 1 and needed > cap
    window = min(needed, cap)
    return Band(f_low, f_high, (low, high), clipped, window, guard, span.nyquist, grazing)


def whole_band(span: AxisSpan) -> Band:
    """Return the band of all sampled frequencies, including evanescent waves."""
    ends = (-span.nyquist, span.nyquist)
    return Band(*ends, ends, (True, True), math.inf, 0.0, span.nyquist)


def blas_limit(n: int, d: float, z: float, wavelength: float) -> float:
    """Return the band limit of an axis in cycles per metre, infinite for n = 1 or z = 0.

    1/(lam sqrt((2 df z)^2 + 1)), df = 1/(n d): Matsushima and Shimobaba (2009), eq. 13.
    """
    if n == 1 or z == 0:
        return math.inf
    return 1 / (wavelength * math.hypot(2 * z / (n * d), 1))


def fully_sampled_distance(n: int, d: float, wavelength: float) -> float:
    """Return the largest abs(z) in metres at which H is sampled over the full band of an axis.

    At z tan(asin(lam f_nyq)) <= W/2 the steepest phase of H changes by at most pi per sample. Below
    a pitch of lam/2 grazing waves are never sampled. Up to three wavelengths, evanescent waves
    matter more than they do; the limit is then 3 lam.
    """
    sine = steepest_slope(d, wavelength)
    if n == 1:
        return math.inf
    if sine >= 1:
        return EVANESCENT_REACH * wavelength
    return n * d / 2 * math.sqrt(1 - sine**2) / sine


def kernel_sampled_distance(span: AxisSpan) -> float:
    """Return the smallest abs(z) at which the Rayleigh-Sommerfeld kernel is sampled.

    The conditions are f_geo <= f_nyq, and two samples for the kernel's peak of width z.
    """
    sine = span.wavelength * span.nyquist
    if span.n == 1:
        return 0.0
    return max(2 * span.pitch, span.reach * math.sqrt(max(1 / sine**2 - 1, 0.0)))
