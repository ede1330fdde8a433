"""float64 twins of light in time: spectra, temporal coherence, the polychromatic Airy pattern.

Light in space is in reference_masks.py, imaging in it in reference_abbe.py. Nothing here imports
the package under test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from reference_optics import Complex, Real
from scipy.special import j1

C = 299_792_458.0  # speed of light, m/s
COHERENCE_LENGTHS = {  # of a Gaussian spectrum, in lam0^2/dlam
    "goodman": np.sqrt(2 * np.log(2) / np.pi),  # c int |gamma|^2 dtau
    "fwhm": 4 * np.log(2) / np.pi,  # FWHM of |gamma| in path
    "oct": 2 * np.log(2) / np.pi,  # half of it: in depth, there and back
}


def frequency_width(wavelength: float, fwhm: float) -> float:
    """c dlam/lam0^2 in Hz: the FWHM in frequency of a spectrum of FWHM dlam in wavelength."""
    return C * fwhm / wavelength**2


def gaussian_gamma(path: ArrayLike, wavelength: float, fwhm: float) -> Real:
    """|gamma| of a Gaussian spectrum at path differences c tau (m).

    exp(-(pi dnu tau/(2 sqrt(ln 2)))^2) (Goodman, Statistical Optics, 5.1).
    """
    tau = np.asarray(path, float) / C
    width = frequency_width(wavelength, fwhm)
    return np.exp(-((np.pi * width * tau / (2 * np.sqrt(np.log(2)))) ** 2))


def rectangular_gamma(path: ArrayLike, wavelength: float, width: float) -> Real:
    """|gamma| = |sinc(dnu tau)| of a spectrum even over dnu = c width/lam0^2."""
    tau = np.asarray(path, float) / C
    return np.abs(np.sinc(frequency_width(wavelength, width) * tau))


def gaussian_samples(n: int, wavelength: float, fwhm: float, half: float) -> tuple[Real, Real]:
    """Frequencies (Hz), evenly over +-half FWHM and n >= 2, and weights of sum 1."""
    if n < 2:
        raise ValueError(f"{n} samples do not span the spectrum: at least 2")
    u = np.linspace(-half, half, n)
    weights = np.exp(-4 * np.log(2) * u**2)
    return C / wavelength + frequency_width(wavelength, fwhm) * u, weights / weights.sum()


def sampled_gamma(path: ArrayLike, frequencies: Real, weights: Real, *, centre: float) -> Complex:
    """gamma(tau) = sum w exp(-2 pi i (nu - centre) tau) at path differences c tau (m)."""
    tau = np.asarray(path, float) / C
    return np.exp(-2j * np.pi * np.multiply.outer(tau, frequencies - centre)) @ weights


def airy(radius: ArrayLike, wavelength: float, f_number: float) -> Real:
    """(2 J1(v)/v)^2, v = pi r/(lam F): the image of a point, 1 at its centre."""
    v = np.pi * np.asarray(radius, float) / (wavelength * f_number)
    safe = np.where(v == 0, 1.0, v)
    return np.where(v == 0, 1.0, 2 * j1(safe) / safe) ** 2


def polychromatic_airy(
    radius: ArrayLike, frequencies: Real, weights: Real, *, centre: float, f_number: float
) -> Real:
    """sum w (nu/centre)^2 airy: the focus of equal pupils, so its peak goes as 1/lam^2."""
    parts = [
        w * (nu / centre) ** 2 * airy(radius, C / nu, f_number)
        for nu, w in zip(frequencies, weights, strict=True)
    ]
    return np.sum(parts, axis=0)
