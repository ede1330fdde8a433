"""Two-point resolution: contrast and smallest resolved separation of two points.

Goodman, Introduction to Fourier Optics, 3rd edition, 2005, section 6.5.2; Born and Wolf, Principles
of Optics, 7th edition, 1999, sections 7.6.3 and 8.6.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.point.psf import OVERSAMPLING, PSF
from clplen.analysis.point.samples import Pair, Values, check_axis, interpolated_line, line_of
from clplen.checks import real_array

RAYLEIGH = 0.73503  # mid/peak of two Airy patterns, each maximum on the other's first zero
SLIT = 0.81057  # 8/pi^2, mid/peak of two sinc^2 (slit, side of a square), as for RAYLEIGH
_SEARCH_SAMPLES = 257  # samples on each side of the middle in the search for a maximum


@dataclass(frozen=True, eq=False, repr=False)
class TwoPoints:
    """Image of two equal points on the line through both, from the image of a single point.

    Create it with `incoherent` or `coherent`.

    Attributes
    ----------
    pattern : callable
        Function that returns the image of one point, intensity or amplitude, at metres from its
        centre.
    phase : float or None
        Phase of the second point over the first in radians; None for incoherent points.
    pitch : float
        Sample pitch of the image in metres.
    reach : float
        Largest distance from the centre that the pattern covers, in metres.

    Examples
    --------
    >>> line = np.sinc((np.arange(64) - 32) / 4) ** 2  # a slit: first zeros 2 um off the middle
    >>> psf = clplen.analysis.PSF(np.outer(line, line), 0.5e-6)
    >>> two = clplen.analysis.TwoPoints.incoherent(psf, axis=1)
    >>> f"mid/peak {two.contrast(2e-6):.2f}, Rayleigh {two.rayleigh(8 / np.pi**2) * 1e6:.2f} um"
    'mid/peak 0.81, Rayleigh 2.00 um'
    """

    pattern: Callable[[Any], Any]
    phase: float | None
    pitch: float
    reach: float

    @classmethod
    def incoherent(cls, psf: PSF, *, axis: int) -> TwoPoints:
        """Create two incoherent points, separated along an axis.

        Parameters
        ----------
        psf : PSF
            Point spread function, sampled finely enough for its highest frequency (lam F/(2 D) or
            less).
        axis : int
            Axis: 0 for y, 1 for x.
        """
        return _of(psf.values, psf, check_axis(axis), None)

    @classmethod
    def coherent(
        cls, amplitude: Any, *, pitch: float | Pair, axis: int, phase: float = 0.0
    ) -> TwoPoints:
        """Create two mutually coherent points, whose amplitudes add up.

        Parameters
        ----------
        amplitude : array_like
            Complex image of one point [y, x], sampled finely enough.
        pitch : float or tuple of float
            Sample pitch (dy, dx) in metres.
        axis : int
            Axis: 0 for y, 1 for x.
        phase : float
            Phase of the second point over the first, in radians.

        Raises
        ------
        ShapeError, ValueError
            If `PSF` raises it, or the phase is not finite.
        """
        field = np.asarray(amplitude, np.complex128)
        if not np.isfinite(phase):
            raise ValueError(f"phase must be finite, got {phase!r}.")
        psf = PSF(np.abs(field) ** 2, pitch)  # type: ignore[arg-type]
        return _of(field, psf, check_axis(axis), float(phase))

    def image(self, separation: Any, at: Any) -> Values:
        """Compute the intensity on the line through both points.

        Incoherent: P(t + s/2) + P(t - s/2); coherent: abs(h(t + s/2) + exp(i phase) h(t - s/2))^2
        (Goodman 2005, eq. of section 6.5.2).

        Parameters
        ----------
        separation : array_like
            Distance s between the points, in metres.
        at : array_like
            Position t in metres from the middle between the points; broadcast against
            ``separation``.

        Raises
        ------
        ValueError
            If a position is beyond the pattern's reach.
        """
        s, t = np.asarray(separation, np.float64), np.asarray(at, np.float64)
        far = float(np.max(np.abs(t) + np.abs(s) / 2, initial=0.0))
        if not far <= self.reach * (1 + 1e-9):
            raise ValueError(
                f"The pattern reaches {self.reach:.4g} m from its centre, but {far:.4g} m is "
                "requested; take a wider window."
            )
        first, second = self.pattern(t + s / 2), self.pattern(t - s / 2)
        if self.phase is None:
            return np.asarray(first + second, np.float64)
        return np.asarray(np.abs(first + np.exp(1j * self.phase) * second) ** 2)

    def contrast(self, separations: Any) -> Any:
        """Compute the intensity midway between the points over the lower of both maxima.

        It is 1 for unresolved points: one side then has no value above the middle.

        Parameters
        ----------
        separations : array_like
            Separations in metres, positive, at most two thirds of the reach.

        Returns
        -------
        numpy.ndarray or float
            Ratios, float64, in the shape of ``separations``.

        Raises
        ------
        ValueError
            If a separation is not positive or too large.
        """
        s = real_array(separations, "separations", np.float64)
        if not (s > 0).all():
            raise ValueError(f"separations must be positive, in metres, got {separations!r}.")
        t = np.linspace(0, 1, _SEARCH_SAMPLES) * s[..., None]
        sides = [self.image(s[..., None], sign * t) for sign in (-1, 1)]
        lower = np.minimum(sides[0].max(axis=-1), sides[1].max(axis=-1))
        ratio = np.clip(sides[0][..., 0], 0, None) / lower
        return float(ratio) if ratio.ndim == 0 else ratio

    def rayleigh(self, contrast: float = RAYLEIGH) -> float:
        """Return the smallest separation in metres at which mid/peak falls to a value.

        Two Airy patterns at Rayleigh's distance of 0.610 lam/NA have 0.73503 (Born and Wolf 1999,
        section 7.6.3), two sinc^2 at lam/(2 NA) have `SLIT`.

        Parameters
        ----------
        contrast : float
            Ratio mid/peak between 0 and 1.

        Raises
        ------
        ValueError
            If the contrast is outside, or is not reached within the window.
        """
        if not 0 < contrast < 1:
            raise ValueError(f"contrast must be between 0 and 1, got {contrast!r}.")
        return self._root(lambda s: contrast - self.contrast(s), f"fall to mid/peak {contrast:.4g}")

    def sparrow(self) -> float:
        """Return the smallest separation in metres without a maximum midway (Sparrow 1916).

        It is the root of the curvature midway, from three points 1/16 of a sample apart, for
        patterns symmetric about their centre. Airy patterns have 0.473 lam/NA.

        Raises
        ------
        ValueError
            If the window contains no such separation.
        """
        h = self.pitch / OVERSAMPLING

        def curvature(s: Any) -> Any:
            left, middle, right = (self.image(s, t) for t in (-h, 0.0, h))
            return left + right - 2 * middle

        return self._root(curvature, "part into two maxima")

    def _root(self, rising: Callable[[Any], Any], event: str) -> float:
        """Return the first separation at which a function changes from negative to positive."""
        from scipy.optimize import brentq

        grid = np.arange(self.pitch / 4, self.reach / 1.5, self.pitch / 2)
        values = np.asarray(rising(grid)) if grid.size else np.empty(0)
        crossings = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
        if not crossings.size:
            raise ValueError(
                f"Two points do not {event} at separations from {self.pitch / 4:.3g} to "
                f"{self.reach / 1.5:.3g} m: take a wider or finer image of a point."
            )
        k = int(crossings[0])
        return float(brentq(rising, grid[k], grid[k + 1], xtol=1e-9 * self.pitch))


def _of(values: Any, psf: PSF, axis: int, phase: float | None) -> TwoPoints:
    """Create the pattern on the line through the centroid of the intensity squared."""
    from scipy.interpolate import make_interp_spline

    centre, other = psf.centroid(), 1 - axis
    starts = [psf.coordinates(k)[0] - centre[k] for k in (0, 1)]
    line = line_of(values, axis, -starts[other] / psf.pitch[other])
    fine = starts[axis] + np.arange((line.size - 1) * OVERSAMPLING + 1) * (
        psf.pitch[axis] / OVERSAMPLING
    )
    spline = make_interp_spline(fine, interpolated_line(line, OVERSAMPLING), k=5)
    reach = float(min(-fine[0], fine[-1]))
    return TwoPoints(spline, phase, psf.pitch[axis], reach)
