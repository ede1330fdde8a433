"""Two points beside each other: how far apart they are seen as two.

Goodman, Introduction to Fourier Optics, 3rd edition, 2005, section 6.5.2; Born and Wolf, Principles
of Optics, 7th edition, 1999, sections 7.6.3 and 8.6.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.point.psf import FINER, PSF
from clplen.analysis.point.samples import Pair, Values, check_axis, finer, line_of
from clplen.checks import float64_array

RAYLEIGH = 0.73503  # mid/peak of two Airy patterns whose maximum lies on the other's first zero
SLIT = 0.81057  # 8/pi^2, the same of two sinc^2: a slit, or a square along one of its sides
_BESIDE = 257  # places on each side of the middle where a maximum is looked for


@dataclass(frozen=True, eq=False, repr=False)
class TwoPoints:
    """The image of two equal points, from the image of one, on the line through both.

    Made by `incoherent` or `coherent`.

    Attributes
    ----------
    pattern : callable
        The image of one point, intensity or amplitude, at metres from its centre.
    phase : float or None
        Of the second point over the first in radians; None of incoherent points.
    pitch : float
        Of the samples that it came from, in metres.
    reach : float
        How far from the centre the pattern is known, in metres.

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
        """Two points that send light independently, beside each other along an axis.

        Parameters
        ----------
        psf : PSF
            Sampled finely enough for its highest frequency (lam F/(2 D) or less).
        axis : int
            0 along y, 1 along x.
        """
        return _of(psf.values, psf, check_axis(axis), None)

    @classmethod
    def coherent(
        cls, amplitude: Any, *, pitch: float | Pair, axis: int, phase: float = 0.0
    ) -> TwoPoints:
        """Two points of one laser: their amplitudes add up.

        Parameters
        ----------
        amplitude : array_like
            The complex image of one point [y, x], sampled finely enough.
        pitch : float or tuple of float
            (dy, dx) in metres.
        axis : int
            0 along y, 1 along x.
        phase : float
            Of the second point over the first, in radians.

        Raises
        ------
        ShapeError, ValueError
            As of `PSF`; or if the phase is not finite.
        """
        field = np.asarray(amplitude, np.complex128)
        if not np.isfinite(phase):
            raise ValueError(f"The phase between two points is finite, not {phase!r}.")
        psf = PSF(np.abs(field) ** 2, pitch)  # type: ignore[arg-type]
        return _of(field, psf, check_axis(axis), float(phase))

    def image(self, separation: Any, at: Any) -> Values:
        """Intensity on the line through both points.

        Incoherent: P(t + s/2) + P(t - s/2); coherent: abs(h(t + s/2) + exp(i phase) h(t - s/2))^2
        (Goodman 2005, eq. of section 6.5.2).

        Parameters
        ----------
        separation : array_like
            s in metres.
        at : array_like
            t in metres from the middle between the points; broadcast against ``separation``.

        Raises
        ------
        ValueError
            If a place lies beyond what is known of the pattern.
        """
        s, t = np.asarray(separation, np.float64), np.asarray(at, np.float64)
        far = float(np.max(np.abs(t) + np.abs(s) / 2, initial=0.0))
        if not far <= self.reach * (1 + 1e-9):
            raise ValueError(
                f"{far:.4g} m from a point nothing is known: its window reaches {self.reach:.4g} m "
                "from its centre; take a wider one."
            )
        first, second = self.pattern(t + s / 2), self.pattern(t - s / 2)
        if self.phase is None:
            return np.asarray(first + second, np.float64)
        return np.asarray(np.abs(first + np.exp(1j * self.phase) * second) ** 2)

    def contrast(self, separations: Any) -> Any:
        """Intensity midway between the points over the lower of the two maxima beside it.

        It is 1 where the two are not told apart: one side then has no higher value than the
        middle.

        Parameters
        ----------
        separations : array_like
            In metres, positive, at most two thirds of the reach.

        Returns
        -------
        numpy.ndarray or float
            float64, of the shape of ``separations``.

        Raises
        ------
        ValueError
            If a separation is not positive, or larger.
        """
        s = float64_array(separations)
        if not (s > 0).all():
            raise ValueError(f"Separations are positive, in metres, not {separations!r}.")
        t = np.linspace(0, 1, _BESIDE) * s[..., None]
        sides = [self.image(s[..., None], sign * t) for sign in (-1, 1)]
        lower = np.minimum(sides[0].max(axis=-1), sides[1].max(axis=-1))
        found = np.clip(sides[0][..., 0], 0, None) / lower
        return float(found) if found.ndim == 0 else found

    def rayleigh(self, contrast: float = RAYLEIGH) -> float:
        """The least separation in metres at which mid/peak has fallen to a value.

        Found by bisection. Two Airy patterns at Rayleigh's distance of 0.610 lam/NA have .73503
        (Born and Wolf 1999, section 7.6.3), two sinc^2 at lam/(2 NA) have `SLIT`.

        Parameters
        ----------
        contrast : float
            Between 0 and 1.

        Raises
        ------
        ValueError
            For another contrast, or if it is not reached within the window.
        """
        if not 0 < contrast < 1:
            raise ValueError(f"A contrast to look for lies between 0 and 1, not {contrast!r}.")
        return self._root(lambda s: contrast - self.contrast(s), f"fall to mid/peak {contrast:.4g}")

    def sparrow(self) -> float:
        """The least separation in metres at which the middle is no maximum (Sparrow 1916).

        Found by bisection on the curvature there, from three places 1/16 of a sample apart;
        meant for patterns that are symmetric about their centre. 0.473 lam/NA for Airy patterns.

        Raises
        ------
        ValueError
            If there is none within the window, or in the middle is never a maximum.
        """
        h = self.pitch / FINER

        def curvature(s: Any) -> Any:
            left, middle, right = (self.image(s, t) for t in (-h, 0.0, h))
            return left + right - 2 * middle

        return self._root(curvature, "part into two maxima")

    def _root(self, rising: Callable[[Any], Any], what: str) -> float:
        """The first separation at which a function goes from negative to positive."""
        from scipy.optimize import brentq

        grid = np.arange(self.pitch / 4, self.reach / 1.5, self.pitch / 2)
        values = np.asarray(rising(grid)) if grid.size else np.empty(0)
        passed = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
        if not passed.size:
            raise ValueError(
                f"Two points do not {what} at separations from {self.pitch / 4:.3g} to "
                f"{self.reach / 1.5:.3g} m: take a wider or finer image of one."
            )
        k = int(passed[0])
        return float(brentq(rising, grid[k], grid[k + 1], xtol=1e-9 * self.pitch))


def _of(values: Any, psf: PSF, axis: int, phase: float | None) -> TwoPoints:
    """The pattern on the line through the centroid of the intensity squared."""
    from scipy.interpolate import make_interp_spline

    centre, other = psf.centroid(), 1 - axis
    away = [psf.coordinates(k)[0] - centre[k] for k in (0, 1)]
    line = line_of(values, axis, -away[other] / psf.pitch[other])
    fine = away[axis] + np.arange((line.size - 1) * FINER + 1) * (psf.pitch[axis] / FINER)
    spline = make_interp_spline(fine, finer(line, FINER), k=5)
    reach = float(min(-fine[0], fine[-1]))
    return TwoPoints(spline, phase, psf.pitch[axis], reach)
