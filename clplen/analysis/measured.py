"""What is measured of one plenoptic camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.analysis.curve import Curve
from clplen.analysis.deptherror import DepthErrors
from clplen.analysis.psf import PSF
from clplen.analysis.rendered import Rendered
from clplen.analysis.samples import Values
from clplen.analysis.sampling import Sampling
from clplen.analysis.transfer import DepthTransfer, line_curve
from clplen.analysis.twopoint import SLIT, TwoPoints
from clplen.cameras.optics.camera_aberrations import circumscribed

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic

HIGHEST = 1.05  # of the diffraction cut-off: where a cut-off that is measured may lie
_STEPS = 61  # of separations and radii
_WIDTHS = 4  # FWHM up to which they go


@dataclass(frozen=True, eq=False, repr=False)
class Measured:
    """What was measured of one camera; None was not asked for.

    Attributes
    ----------
    name : str
    camera : Plenoptic
    sampling : Sampling
        Along x.
    psf : PSF or None
        On the main lens' image.
    crosstalk : float or None
        As `camera_crosstalk`.
    transfer : DepthTransfer or None
    depth : DepthErrors or None
    picture : Rendered or None
        Of the scene that was given.
    """

    name: str
    camera: Plenoptic
    sampling: Sampling
    psf: PSF | None = None
    crosstalk: float | None = None
    transfer: DepthTransfer | None = None
    depth: DepthErrors | None = None
    picture: Rendered | None = None

    def __repr__(self) -> str:
        return f"<Measured {self.name}>"

    def mtf(self, axis: int = 1) -> Curve:
        """Contrast against cycles a metre on the main lens' image, along y (0) or x (1).

        Raises
        ------
        ValueError
            If the point spread function was not measured.
        """
        _, line = self._psf.line_spread(axis)
        return line_curve(line, self._psf.pitch[axis])

    def mtf_cutoff(self, axis: int = 1) -> float:
        """Cut-off of `mtf`, cycles a metre, as `Curve.cutoff`.

        NaN where contrast stays above .01 beyond what diffraction passes: that is no signal, but
        what pixels and their interpolation leave of it.
        """
        found = self.mtf(axis).cutoff()
        mla, passed = self.camera.mla, self.sampling.diffraction_cutoff
        if mla.lattice == "hexagonal" or mla.rotation:  # corners reach farther along the axes
            passed *= circumscribed(mla) / mla.diameter
        return found if found <= HIGHEST * passed else math.nan

    def fwhm(self, axis: int = 1) -> float:
        """`PSF.fwhm` in metres; NaN where the window is too narrow."""
        try:
            return self._psf.fwhm(axis)
        except ValueError:
            return math.nan

    def separations(self) -> Values:
        """For `mid_over_peak`: from 0 to four times the point's width, metres."""
        return np.linspace(0, _WIDTHS * self._width, _STEPS)

    def mid_over_peak(self, separations: Any, axis: int = 1) -> Values:
        """Contrast of two incoherent points, as `TwoPoints.contrast`; NaN beyond the window."""
        two = TwoPoints.incoherent(self._psf, axis=axis)
        s = np.asarray(separations, np.float64)
        known = (s > 0) & (s <= two.reach / 1.5)
        found = np.where(s == 0, 1.0, np.nan)
        if known.any():
            found[known] = two.contrast(s[known])
        return found

    def two_point_limit(self, axis: int = 1) -> float:
        """The least separation in metres with mid/peak of 8/pi^2, two square lenslets' Rayleigh.

        NaN where the window is too narrow to find it.
        """
        try:
            return TwoPoints.incoherent(self._psf, axis=axis).rayleigh(SLIT)
        except ValueError:
            return math.nan

    def encircled(self) -> tuple[Values, Values]:
        """Radii in metres, to four times the point's width, and shares of the window's energy."""
        near = self._near
        centre = near.centroid()
        reach = min(n // 2 * d for n, d in zip(near.values.shape, near.pitch, strict=True))
        radii = np.linspace(0, min(_WIDTHS * self._width, 0.98 * reach), _STEPS)
        shares = near.encircled_energy(radii, centre=centre, total=self._psf.energy)
        return radii, np.asarray(shares, np.float64)

    def radius(self, share: float) -> float:
        """Radius in metres of the circle with a share of the window's energy; NaN where unknown."""
        radii, shares = self.encircled()
        past = np.flatnonzero(shares >= share)
        if not past.size or past[0] == 0:
            return math.nan
        k = slice(int(past[0]) - 1, int(past[0]) + 1)
        return float(np.interp(share, shares[k], radii[k]))

    def strehl(self) -> float:
        """Peak over that of the main lens alone, for equal energy.

        Without aberrations the latter is pi D^2/(4 lam^2 F^2) for an energy of 1 (Born and Wolf
        1999, section 8.5.2): what lenslets and pixels leave of the main lens' resolution.
        """
        c = self.camera
        alone = np.pi / 4 * (c.aperture_diameter / (c.wavelength * c.image_distance)) ** 2
        return float(self._psf.peak / self._psf.energy / alone)

    @property
    def _psf(self) -> PSF:
        if self.psf is None:
            raise ValueError(
                f"The point spread function of {self.name!r} was not measured: ask for 'psf'."
            )
        return self.psf

    @property
    def _width(self) -> float:
        """The larger FWHM, or a quarter of the window where there is none."""
        sides = zip(self._psf.values.shape, self._psf.pitch, strict=True)
        least = min(n * d for n, d in sides) / (2 * _WIDTHS)
        return float(np.nanmin([least, np.nanmax([self.fwhm(0), self.fwhm(1), 0.0]) or least]))

    @property
    def _near(self) -> PSF:
        """The middle of the window, half as far again as the radii go."""
        psf, centre = self._psf, self._psf.centroid()
        half = [math.ceil(1.5 * _WIDTHS * self._width / d) for d in psf.pitch]
        at = [
            round((c - first) / d)
            for c, first, d in zip(centre, (psf.grid.y[0], psf.grid.x[0]), psf.pitch, strict=True)
        ]
        room = [min(h, i, n - 1 - i) for h, i, n in zip(half, at, psf.values.shape, strict=True)]
        return psf.cut(centre, (2 * room[0] + 1, 2 * room[1] + 1))
