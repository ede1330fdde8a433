"""Sampled curves over the wavelength: light, reflectance, transmission, sensitivity."""

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
A_CONSTANT, A_TEMPERATURE = 1.435e-2, 2848.0  # by which CIE 15:2004 defines illuminant A
BLACKBODY_BAND = (300e-9, 1100e-9)  # where silicon sees
STEP = 5e-9  # of tables that are made
GAUSSIAN_REACH, GAUSSIAN_POINTS = 3.0, 121  # full widths on either side, points


@dataclass(frozen=True, init=False, repr=False)
class SpectralDistribution(OneLine):
    """A curve over the wavelength: linear between its points, 0 outside.

    It is light (power per wavelength, in any unit), or what surfaces, filters and sensors make of
    light (reflectance, transmittance, quantum efficiency). ``illuminant * reflectance`` is the
    light that comes back from a surface.

    Parameters
    ----------
    wavelengths : array_like
        In metres, rising, shape (n,), n >= 2.
    values : array_like
        At least 0 and not all 0, shape (n,).

    Attributes
    ----------
    wavelengths, values : tuple of float
        Without the points at either end that only continue a curve that is 0.

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
        lam, found = spectrum_tables.check_table(wavelengths, values)
        object.__setattr__(self, "wavelengths", tuple(lam.tolist()))
        object.__setattr__(self, "values", tuple(found.tolist()))

    @classmethod
    def blackbody(cls, temperature: float) -> SpectralDistribution:
        """The radiation of a black body from 300 to 1100 nm, its largest value 1.

        Planck's law per wavelength, lam^-5/(exp(c2/(lam T)) - 1) with c2 = .014387768775 m K, every
        5 nm.

        Parameters
        ----------
        temperature : float
            In kelvin, 500 or more.

        Raises
        ------
        ValueError
            If it is no such number.
        """
        if not (is_finite(temperature) and temperature >= 500):
            raise ValueError(
                f"A temperature is a number of kelvin, 500 or more, not {temperature!r}: colder "
                "bodies shine beyond 1100 nm only."
            )
        lam = _equal_steps(*BLACKBODY_BAND)
        log = -5 * np.log(lam) - _log_expm1(SECOND_RADIATION / (lam * temperature))
        return cls(lam, np.exp(log - log.max()))

    @classmethod
    def illuminant(cls, name: Literal["A", "D65", "E"]) -> SpectralDistribution:
        """A standard illuminant from 300 to 830 nm, 100 at 560 nm.

        Parameters
        ----------
        name : {"A", "D65", "E"}
            Incandescent light, average daylight, the same power at all wavelengths. A is
            100 (560/lam)^5 (exp(1.435e7/(2848 560)) - 1)/(exp(1.435e7/(2848 lam)) - 1), lam in nm
            (CIE 15:2004, section 3.1); D65 is the table of CIE 15:2004 every 10 nm, between which
            it is linear by definition.

        Raises
        ------
        ValueError
            If the name is none of these.
        """
        if name not in ("A", "D65", "E"):
            raise ValueError(f"An illuminant is 'A', 'D65' or 'E', not {name!r}.")
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
        """A Gaussian of the wavelength, as of an LED or a colour filter.

        Parameters
        ----------
        wavelength : float
            Of its peak in metres.
        fwhm : float
            Full width at half maximum in metres, below half the wavelength.
        value : float
            At the peak, above 0.

        Raises
        ------
        ValueError
            If they are no such numbers.
        """
        centre = spectrum_tables.check_wavelength(wavelength)
        width = spectrum_tables.check_width(fwhm, centre, "The FWHM")
        if not (is_finite(value) and value > 0):
            raise ValueError(f"The value at the peak is above 0, not {value!r}.")
        lam = centre + width * np.linspace(-GAUSSIAN_REACH, GAUSSIAN_REACH, GAUSSIAN_POINTS)
        lam = lam[lam >= spectrum_tables.SHORTEST]
        return cls(lam, value * np.exp(-4 * np.log(2) * ((lam - centre) / width) ** 2))

    @classmethod
    def read(
        cls, path: str | os.PathLike[str], *, unit: Literal["m", "um", "nm"] | None = None
    ) -> SpectralDistribution:
        """A curve from a text file of two columns; see `Spectrum.read`."""
        return cls(*spectrum_tables.read_table(path, unit))

    @property
    def integral(self) -> float:
        """Over the wavelength, in the unit of the values times metres."""
        lam, values = np.array(self.wavelengths), np.array(self.values)
        return float((values[1:] + values[:-1]) @ np.diff(lam) / 2)

    @property
    def spectrum(self) -> Spectrum:
        """Light of this density per wavelength, of unit power."""
        return Spectrum.tabulated(self.wavelengths, self.values)

    def __call__(self, wavelengths: ArrayLike) -> Vector:
        """Values at wavelengths in metres, float64, of the same shape."""
        lam = real_array(wavelengths, "wavelengths", np.float64)
        return np.asarray(np.interp(lam, self.wavelengths, self.values, left=0.0, right=0.0))

    def __mul__(self, other: SpectralDistribution | float) -> SpectralDistribution:
        """This times another curve, at the points of both, or times a number above 0."""
        if isinstance(other, SpectralDistribution):
            low = max(self.wavelengths[0], other.wavelengths[0])
            high = min(self.wavelengths[-1], other.wavelengths[-1])
            both = np.union1d(self.wavelengths, other.wavelengths)
            lam = both[(both >= low) & (both <= high)]
            values = self(lam) * other(lam)
            if lam.size < 2 or not values.any():
                raise ValueError(
                    f"One curve is above 0 from {_band(self)}, the other from {_band(other)}: "
                    "their product is 0."
                )
            return SpectralDistribution(lam, values)
        if not is_finite(other):
            return NotImplemented
        if other <= 0:
            raise ValueError(f"A curve is multiplied by a number above 0, not {other!r}.")
        return SpectralDistribution(self.wavelengths, np.array(self.values) * float(other))

    __rmul__ = __mul__


def as_spectrum(light: Any, what: str) -> Spectrum:
    """A spectrum, from itself or from a curve."""
    if isinstance(light, SpectralDistribution):
        return light.spectrum
    if isinstance(light, Spectrum):
        return light
    raise TypeError(
        f"{what} is a SpectralDistribution or a Spectrum, such as "
        f"SpectralDistribution.illuminant('D65'), not {type(light).__name__}."
    )


def _equal_steps(low: float, high: float) -> Vector:
    return np.asarray(low + STEP * np.arange(round((high - low) / STEP) + 1), np.float64)


def _log_expm1(x: Vector) -> Vector:
    """log(exp(x) - 1) without overflow."""
    return np.asarray(x + np.log(-np.expm1(-x)))


def _band(curve: SpectralDistribution) -> str:
    return f"{curve.wavelengths[0] * 1e9:.4g} to {curve.wavelengths[-1] * 1e9:.4g} nm"
