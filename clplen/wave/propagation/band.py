"""The band of spatial frequencies that a propagation needs, and how finely it is sampled.

One axis at a time. A ray of spatial frequency f moves sideways by z tan(asin(lam f)); what matters
in the output window is the band whose rays land there, widened by a smooth guard of a few Fresnel
widths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.wave.field.sampling import nyquist, steepest_slope

Vector = np.ndarray[Any, Any]

GUARD = 6.0  # Fresnel widths by which the band is widened
FAR_GUARD = 8.0  # the same so far away that few frequencies are left
EVANESCENT_MARGIN = 64  # times z, around both windows where grazing waves are sampled
WINDOW_GUARD = 3.0  # units of sqrt(lam z) by which the window is widened
ROUNDING = 1e-12  # of a frequency: the last one of an FFT is the Nyquist frequency
EVANESCENT_REACH = 3  # wavelengths; farther on evanescent waves are below 1e-4
# Steepness of the taper for a guard: where a wider guard lets the weight end nearer to 0 and 1.
_GUARDS, _STEEPNESS = (2.0, 3.0, 4.0, 6.0, 8.0), (2.5, 3.0, 3.5, 4.0, 5.0)


@dataclass(frozen=True)
class AxisSpan:
    """One axis of a propagation: where light comes from and where it is wanted."""

    n: int  # samples of the input; 1: nothing varies along the axis
    pitch: float  # of the input in metres
    z: float  # in metres
    wavelength: float
    lit: float  # width that carries light, centred on the input's central sample, in metres
    wanted: float  # width of the output window in metres
    offset: float = 0.0  # centre of the output window less that of the input, in metres
    # smallest and largest sideways displacement along the other axis, at least 0, in metres
    across: tuple[float, float] = (0.0, 0.0)

    @property
    def nyquist(self) -> float:
        """Nyquist frequency in cycles a metre."""
        return nyquist(self.pitch)

    @property
    def reach(self) -> float:
        """Largest sideways displacement of light that is wanted, in metres."""
        return (self.lit + self.wanted) / 2 + abs(self.offset)

    def geometric(self, displacement: float, across: float = 0.0) -> float:
        """Spatial frequency of the ray that moves sideways by a displacement, and by another."""
        distance = math.hypot(displacement, across, self.z)
        return displacement / (self.wavelength * distance) if distance else 0.0

    def displacement(self, frequency: float, across: float = 0.0) -> float:
        """How far a ray of a spatial frequency moves sideways; infinite from 1/lam on."""
        sine = self.wavelength * frequency
        if abs(sine) >= 1:
            return math.copysign(math.inf, sine)
        return math.hypot(self.z, across) * sine / math.sqrt(1 - sine * sine)

    def fresnel_width(self, displacement: float, across: float = 0.0) -> float:
        """Frequencies that interfere at one place, in cycles a metre.

        sqrt(cos^3 theta/(lam z)) in the plane of the axis; the square root of the second derivative
        of the path by the displacement, over lam.
        """
        distance = math.hypot(displacement, across, self.z)
        if not distance:
            return 0.0
        return math.hypot(self.z, across) / distance / math.sqrt(self.wavelength * distance)

    def low_end(self, displacement: float) -> float:
        """The displacement along the other axis with which a ray has its lowest frequency."""
        return self.across[0] if displacement < 0 else self.across[1]

    def high_end(self, displacement: float) -> float:
        """The displacement along the other axis with which a ray has its highest frequency."""
        return self.across[1] if displacement < 0 else self.across[0]

    @property
    def is_evanescent(self) -> bool:
        """Whether waves that decay are sampled and still there."""
        near = abs(self.z) <= EVANESCENT_REACH * self.wavelength
        return self.n > 1 and near and self.wavelength * self.nyquist > 1

    @property
    def highest(self) -> float:
        """Largest frequency that geometry and sampling let through, in cycles a metre."""
        return 0.0 if self.n == 1 else min(self.geometric(self.reach), self.nyquist)


@dataclass(frozen=True)
class Band:
    """The guarded band of one axis."""

    low: float  # ends of the band in cycles a metre; empty where ``low >= high``
    high: float
    inner: tuple[float, float]  # frequencies between which the weight is 1
    # whether the Nyquist frequency cuts the lower and the upper end, without a taper
    clipped: tuple[bool, bool]
    window: float  # width of the computation window, 1 over the frequency step, in metres
    guard: float  # in Fresnel widths
    nyquist: float  # in cycles a metre
    # whether waves of the band leave the window and come back: grazing ones, which leave every
    # window
    grazing: bool = False

    @property
    def is_whole(self) -> bool:
        """Whether all that is sampled is needed."""
        return all(self.clipped)

    @property
    def is_empty(self) -> bool:
        """Whether no frequency that is sampled reaches the output window."""
        return self.low >= self.high

    def weights(self, f: Vector) -> Vector:
        """Weights of frequencies, shape of ``f``, float64, 0 outside the band.

        0.5 erfc(-(2 t - 1) k) across the guard, t from 0 at its outer end to 1 at its inner one.
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
                weights[taper] *= [math.erfc((1 - 2 * one) * steepness) / 2 for one in t[taper]]
        return weights


def guarded_band(span: AxisSpan, guard: float = GUARD) -> Band:
    """The band and window that one axis needs.

    Each end of the band of geometric optics (Matsushima and Shimobaba 2009, eq. 13, for the true
    windows) is widened by ``guard`` Fresnel widths. The window keeps the aliases of the output,
    one window apart, clear of it. Where evanescent waves count the band is all that is sampled.
    """
    spread = math.sqrt(span.wavelength * abs(span.z))
    cap = 4 * (span.lit + span.wanted + abs(span.offset)) + 2 * (guard + WINDOW_GUARD) * spread
    if span.is_evanescent:
        window = span.lit + span.wanted + 2 * abs(span.offset) + EVANESCENT_MARGIN * abs(span.z)
        return replace(whole_band(span), window=min(window, cap), grazing=True)
    offset = span.offset if span.z >= 0 else -span.offset
    half = (span.lit + span.wanted) / 2
    near, far = offset - half, offset + half
    ends = (near, span.low_end(near)), (far, span.high_end(far))
    low, high = (span.geometric(*end) for end in ends)
    outer_low = low - guard * span.fresnel_width(*ends[0])
    outer_high = high + guard * span.fresnel_width(*ends[1])
    clipped = (outer_low <= -span.nyquist, outer_high >= span.nyquist)
    f_low, f_high = max(outer_low, -span.nyquist), min(outer_high, span.nyquist)
    # Beside the axis a ray that goes farther along the other axis goes farther along this one, too.
    across = span.across if span.across[0] > 0 else (0.0, 0.0)
    back = min(span.displacement(f_low, one) for one in across)
    ahead = max(span.displacement(f_high, one) for one in across)
    needed = max(max(far - back, ahead - near) + WINDOW_GUARD * spread, span.lit + span.wanted)
    grazing = span.n > 1 and needed > cap
    window = min(needed, cap)
    return Band(f_low, f_high, (low, high), clipped, window, guard, span.nyquist, grazing)


def whole_band(span: AxisSpan) -> Band:
    """No limit: every sampled frequency, evanescent ones too."""
    ends = (-span.nyquist, span.nyquist)
    return Band(*ends, ends, (True, True), math.inf, 0.0, span.nyquist)


def blas_limit(n: int, d: float, z: float, wavelength: float) -> float:
    """Band limit of one axis in cycles a metre, infinite where n = 1 or z = 0.

    1/(lam sqrt((2 df z)^2 + 1)), df = 1/(n d): Matsushima and Shimobaba (2009), eq. 13.
    """
    if n == 1 or z == 0:
        return math.inf
    return 1 / (wavelength * math.hypot(2 * z / (n * d), 1))


def fully_sampled_distance(n: int, d: float, wavelength: float) -> float:
    """Largest abs(z) at which H is sampled over the whole band of one axis, in metres.

    z tan(asin(lam f_nyq)) <= W/2: the steepest phase of H then changes by at most pi a sample. On
    samples below lam/2 grazing waves are never sampled, but up to three wavelengths evanescent
    waves, which a band limit would drop, matter more: there it is 3 lam.
    """
    sine = steepest_slope(d, wavelength)
    if n == 1:
        return math.inf
    if sine >= 1:
        return EVANESCENT_REACH * wavelength
    return n * d / 2 * math.sqrt(1 - sine**2) / sine


def kernel_sampled_distance(span: AxisSpan) -> float:
    """Smallest abs(z) at which the Rayleigh-Sommerfeld kernel is sampled.

    f_geo <= f_nyq, and its peak of width z takes two samples.
    """
    sine = span.wavelength * span.nyquist
    if span.n == 1:
        return 0.0
    return max(2 * span.pitch, span.reach * math.sqrt(max(1 / sine**2 - 1, 0.0)))
