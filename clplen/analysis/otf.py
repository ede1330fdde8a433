"""Optical transfer functions of point spread functions, and what they are in closed form.

Goodman, Introduction to Fourier Optics, 3rd edition, 2005, sections 2.1 and 6.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.analysis.curve import Curve
from clplen.analysis.psf import PSF
from clplen.analysis.samples import Pair, Values, check_axis, check_positive
from clplen.compute.arrays import HostArray
from clplen.wave.systems.pupil_filter import otf as ideal_otf

Complex = np.ndarray[Any, np.dtype[np.complex128]]


@dataclass(frozen=True, eq=False, repr=False)
class OTF(HostArray):
    """Fourier transform of an intensity over its value at frequency 0 (Goodman 2005, sec. 6.3.1).

    Made by `OTF.of`.

    Attributes
    ----------
    values : numpy.ndarray
        complex128, shape (ny, nx), frequencies ascending, 0 at (ny//2, nx//2).
    fy, fx : numpy.ndarray
        Cycles a metre, float64, shapes (ny,) and (nx,).
    centre : tuple of float
        (y, x) in metres, to which phases refer.
    """

    _samples: ClassVar[str] = "values"

    values: Complex
    fy: Values
    fx: Values
    centre: Pair

    @classmethod
    def of(cls, psf: PSF, *, pad: float = 2, centre: Pair | None = None) -> OTF:
        """The transfer function int I(x) exp(-2 pi i f (x - centre)) dx / int I(x) dx.

        Parameters
        ----------
        psf : PSF
        pad : float
            Length of the transform over that of the window, at least 1: how finely it is sampled.
        centre : tuple of float, optional
            (y, x) in metres; default the centroid of I^2, so that of a symmetric function no phase
            is left.

        Raises
        ------
        ValueError
            If ``pad`` is less than 1.
        """
        if not (np.isfinite(pad) and pad >= 1):
            raise ValueError(f"pad is at least 1, not {pad!r}.")
        middle = psf.centroid() if centre is None else centre
        ny, nx = (int(np.ceil(n * pad)) for n in psf.values.shape)
        fy, fx = (np.fft.fftfreq(n, d) for n, d in zip((ny, nx), psf.pitch, strict=True))
        spectrum = np.fft.fft2(psf.values, (ny, nx))
        y, x = middle[0] - psf.grid.y[0], middle[1] - psf.grid.x[0]
        spectrum *= np.multiply.outer(np.exp(2j * np.pi * fy * y), np.exp(2j * np.pi * fx * x))
        values = np.fft.fftshift(spectrum / psf.values.sum())
        return cls(values, np.fft.fftshift(fy), np.fft.fftshift(fx), (middle[0], middle[1]))

    def __repr__(self) -> str:
        ny, nx = self.values.shape
        return f"<OTF {ny} x {nx}, up to {-self.fy[0]:.4g} x {-self.fx[0]:.4g} cycles/m>"

    def mtf(self, axis: int) -> Curve:
        """Modulus along one axis, at frequency 0 of the other one.

        Parameters
        ----------
        axis : int
            0 along y, 1 along x.

        Returns
        -------
        Curve
            From 0 to half a cycle a sample of the point spread function.
        """
        axis = check_axis(axis)
        ny, nx = self.values.shape
        line = self.values[ny // 2] if axis == 1 else self.values[:, nx // 2]
        f = self.fx if axis == 1 else self.fy
        kept = (np.arange(f.size // 2 + 1) + f.size // 2) % f.size
        return Curve(np.abs(f[kept]), np.abs(line[kept]))


def square_mtf(frequency: Any, *, wavelength: float, distance: float, width: float) -> Values:
    """Transfer function of a square aperture along one of its sides: 1 - f lam a/d.

    Goodman 2005, section 6.3.3; 0 from the cut-off d/(lam a) on.

    Parameters
    ----------
    frequency : array_like
        Cycles a metre, on the plane from which the aperture is seen.
    wavelength : float
        lam in metres.
    distance : float
        a in metres, from the aperture to that plane.
    width : float
        d in metres.

    Returns
    -------
    numpy.ndarray
        float64, of the shape of ``frequency``.

    Raises
    ------
    ValueError
        If a length is not positive.
    """
    return ideal_otf(_fraction(frequency, wavelength, distance, width), shape="square")


def circular_mtf(frequency: Any, *, wavelength: float, distance: float, width: float) -> Values:
    """Transfer function of a circular aperture: (2/pi)(acos s - s sqrt(1 - s^2)), s = f lam a/d.

    Goodman 2005, section 6.3.3; parameters as in `square_mtf`, ``width`` the diameter.
    """
    return ideal_otf(_fraction(frequency, wavelength, distance, width))


def pixel_mtf(frequency: Any, *, width: float) -> Values:
    """Transfer function of a pixel that is evenly sensitive over its width: abs(sinc(f w)).

    Goodman 2005, section 2.1: the transform of a rectangle.

    Parameters
    ----------
    frequency : array_like
        Cycles a metre.
    width : float
        w in metres, along the frequency.

    Raises
    ------
    ValueError
        If the width is not positive.
    """
    check_positive(width=width)
    return np.abs(np.sinc(np.asarray(frequency, np.float64) * width))


def _fraction(frequency: Any, wavelength: float, distance: float, width: float) -> Values:
    """Frequency over the incoherent cut-off."""
    check_positive(wavelength=wavelength, distance=distance, width=width)
    return np.asarray(frequency, np.float64) * (wavelength * distance / width)
