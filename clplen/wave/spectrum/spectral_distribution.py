"""Curves over the wavelength: light, reflectance, transmission, sensitivity."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import is_finite, real_array
from clplen.reprs import OneLine
from clplen.wave.spectrum import spectrum_tables
from clplen.wave.spectrum.lineshapes import Vector
from clplen.wave.spectrum.spectrum import Spectrum

SECOND_RADIATION = 0.014387768775  # m K, h c/k of the SI since 2019
A_CONSTANT, A_TEMPERATURE = 1.435e-2, 2848.0  # illuminant A in CIE 15:2004, m K and K
BLACKBODY_BAND = (300e-9, 1100e-9)  # spectral range of silicon in metres
STEP = 5e-9  # wavelength step of computed tables in metres
GAUSSIAN_REACH, GAUSSIAN_POINTS = 3.0, 121  # half range in full widths, number of points


@dataclass(frozen=True, init=False, repr=False)
class SpectralDistribution(OneLine):
    """Curve over the wavelength, linear between its points, 0 outside.

    It describes light (power per wavelength, in any unit), or a reflectance, transmittance or
    quantum efficiency. ``illuminant * reflectance`` is the light reflected by a surface.

    Parameters
    ----------
    wavelengths : array_like
        Wavelengths in metres, rising, shape (n,), n >= 2.
    values : array_like
        Values, at least 0 and not all 0, shape (n,).

    Attributes
    ----------
    wavelengths, values : tuple of float
        Points of the curve without redundant zeros at the ends.

    Raises
    ------
    ValueError
        If a number is negative or not finite, the wavelengths do not rise or are not in metres,
        the lengths differ, or every value is 0.

    Examples
    --------
    >>> daylight = clplen.wave.SpectralDistribution.illuminant("D65")
    >>> leaf = clplen.wave.SpectralDistribution([400e-9, 550e-9, 700e-9], [0.05, 0.15, 0.4])
    >>> green = daylight * leaf
    >>> f"{green.integral / daylight.integral:.2f}"
    '0.12'
    """

    wavelengths: tuple[float, ...]
    values: tuple[float, ...]

    def __init__(self, wavelengths: ArrayLike, values: ArrayLike) -> None:
        lam, density = spectrum_tables.check_table(wavelengths, values)
        object.__setattr__(self, "wavelengths", tuple(lam.tolist()))
        object.__setattr__(self, "values", tuple(density.tolist()))

    @classmethod
    def blackbody(cls, temperature: float) -> SpectralDistribution:
        """Return the radiation of a black body from 300 to 1100 nm with a maximum of 1.

        It follows Planck's law per wavelength, lam^-5/(exp(c2/(lam T)) - 1) with
        c2 = 0.014387768775 m K, in steps of 5 nm.

        Parameters
        ----------
        temperature : float
            Temperature in kelvin, at least 500.

        Raises
        ------
        ValueError
            If the temperature is below 500 K or not finite.
        """
        if not (is_finite(temperature) and temperature >= 500):
            raise ValueError(
                f"temperature must be at least 500 K, got {temperature!r}: colder bodies radiate "
                "beyond 1100 nm only."
            )
        lam = _equal_steps(*BLACKBODY_BAND)
        log = -5 * np.log(lam) - _log_expm1(SECOND_RADIATION / (lam * temperature))
        return cls(lam, np.exp(log - log.max()))

    @classmethod
    def illuminant(cls, name: Literal["A", "D65", "E"]) -> SpectralDistribution:
        """Return a standard illuminant from 300 to 830 nm, with the value 100 at 560 nm.

        Parameters
        ----------
        name : {"A", "D65", "E"}
            Incandescent light ("A"), average daylight ("D65") or equal power at all wavelengths
            ("E"). A is 100 (560/lam)^5 (exp(1.435e7/(2848 560)) - 1)/(exp(1.435e7/(2848 lam)) - 1),
            lam in nm (CIE 15:2004, section 3.1). D65 is the table of CIE 15:2004 in steps of 10 nm,
            with linear interpolation by definition.

        Raises
        ------
        ValueError
            If the name is unknown.
        """
        if name not in ("A", "D65", "E"):
            raise ValueError(f"name must be 'A', 'D65' or 'E', got {name!r}.")
        if name == "D65":
            return cls(*spectrum_tables.daylight())
        lam = _equal_steps(300e-9, 830e-9)
        if name == "E":
            return cls(lam, np.full(lam.shape, 100.0))
        exponent = A_CONSTANT / A_TEMPERATURE
        planck = (560e-9 / lam) ** 5 * np.expm1(exponent / 560e-9) / np.expm1(exponent / lam)
        return cls(lam, 100 * planck)

    @classmethod
    def gaussian(cls, wavelength: float, fwhm: float, value: float = 1.0) -> SpectralDistribution:
        """Return a Gaussian over the wavelength, such as an LED or a colour filter.

        Parameters
        ----------
        wavelength : float
            Wavelength of the peak in metres.
        fwhm : float
            Full width at half maximum in metres, below half the wavelength.
        value : float
            Value at the peak, above 0.

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        centre = spectrum_tables.check_wavelength(wavelength)
        width = spectrum_tables.check_width(fwhm, centre, "The FWHM")
        if not (is_finite(value) and value > 0):
            raise ValueError(f"value must be above 0, got {value!r}.")
        lam = centre + width * np.linspace(-GAUSSIAN_REACH, GAUSSIAN_REACH, GAUSSIAN_POINTS)
        lam = lam[lam >= spectrum_tables.SHORTEST]
        return cls(lam, value * np.exp(-4 * np.log(2) * ((lam - centre) / width) ** 2))

    @classmethod
    def read(
        cls, path: str | os.PathLike[str], *, unit: Literal["m", "um", "nm"] | None = None
    ) -> SpectralDistribution:
        """Read a curve from a text file of two columns; see `Spectrum.read`."""
        return cls(*spectrum_tables.read_table(path, unit))

    @property
    def integral(self) -> float:
        """Integral over the wavelength, in the unit of the values times metres."""
        lam, values = np.array(self.wavelengths), np.array(self.values)
        return float((values[1:] + values[:-1]) @ np.diff(lam) / 2)

    @property
    def spectrum(self) -> Spectrum:
        """Light of this density per wavelength with unit power."""
        return Spectrum.tabulated(self.wavelengths, self.values)

    def __call__(self, wavelengths: ArrayLike) -> Vector:
        """Return values at wavelengths in metres, float64, with equal shape."""
        lam = real_array(wavelengths, "wavelengths", np.float64)
        return np.asarray(np.interp(lam, self.wavelengths, self.values, left=0.0, right=0.0))

    def __mul__(self, other: SpectralDistribution | float) -> SpectralDistribution:
        """Multiply by another curve, at the points of both, or by a number above 0."""
        if isinstance(other, SpectralDistribution):
            low = max(self.wavelengths[0], other.wavelengths[0])
            high = min(self.wavelengths[-1], other.wavelengths[-1])
            both = np.union1d(self.wavelengths, other.wavelengths)
            lam = both[(both >= low) & (both <= high)]
            values = self(lam) * other(lam)
            if lam.size < 2 or not values.any():
                raise ValueError(
                    f"The bands of two curves must overlap, got {_band(self)} and {_band(other)}."
                )
            return SpectralDistribution(lam, values)
        if not is_finite(other):
            return NotImplemented
        if other <= 0:
            raise ValueError(f"The factor of a curve must be above 0, got {other!r}.")
        return SpectralDistribution(self.wavelengths, np.array(self.values) * float(other))

    __rmul__ = __mul__


def as_spectrum(light: Any, what: str) -> Spectrum:
    """Return the spectrum of a `Spectrum` or a `SpectralDistribution`."""
    if isinstance(light, SpectralDistribution):
        return light.spectrum
    if isinstance(light, Spectrum):
        return light
    raise TypeError(
        f"{what} must be a SpectralDistribution or a Spectrum, such as "
        f"SpectralDistribution.illuminant('D65'), got {type(light).__name__}."
    )


def _equal_steps(low: float, high: float) -> Vector:
    return np.asarray(low + STEP * np.arange(round((high - low) / STEP) + 1), np.float64)


def _log_expm1(x: Vector) -> Vector:
    """Return log(exp(x) - 1) without overflow."""
    return np.asarray(x + np.log(-np.expm1(-x)))


def _band(curve: SpectralDistribution) -> str:
    return f"{curve.wavelengths[0] * 1e9:.4g} to {curve.wavelengths[-1] * 1e9:.4g} nm"
