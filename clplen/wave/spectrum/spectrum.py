"""Spectra of light, their temporal coherence, and wavelengths for sampling.

    gamma(tau) = int S(nu) exp(-2 pi i nu tau) dnu,   int S dnu = 1

is the complex degree of temporal coherence of light with spectral density S (Goodman, Statistical
Optics, 1985, section 5.1.3). An image in that light is the sum of images at single frequencies.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import is_finite, real_array
from clplen.reprs import OneLine
from clplen.wave.spectrum import spectrum_tables
from clplen.wave.spectrum.lineshapes import (
    C,
    Complex,
    Lines,
    Rectangle,
    Shape,
    SpectralSamples,
    Table,
    Vector,
)

PER_TURN = 32  # sampled delays per turn of the band
LONGEST_BEAT = 1000  # turns of the band within which coherence of sharp lines is searched
BLOCK, SEARCH_BLOCK = 4096, 256  # delays in a block of `error` and of a search
REFINEMENT, MAX_REFINEMENTS = 16, 14  # a search ends at 16^-14 of a step, below rounding

Definition = Literal["goodman", "fwhm", "oct"]


@dataclass(frozen=True, repr=False)
class Spectrum(OneLine):
    """Spectrum of a light source.

    Constructors are `gaussian`, `rectangular`, `tabulated`, `lines`, `monochromatic`, `mercury`,
    `white_led` and `read`. Wavelengths are in metres, 1e-10 to 1e-3, and nu = c/wavelength.

    Parameters
    ----------
    shape : Lines, Rectangle or Table
        Spectral density.

    Examples
    --------
    >>> led = clplen.Spectrum.gaussian(550e-9, 30e-9)
    >>> f"{led.centre * 1e9:.0f} nm"
    '550 nm'
    >>> f"{led.coherence_length() * 1e6:.1f} um"  # 0.6643 lam^2/dlam
    '6.7 um'
    """

    shape: Shape

    @classmethod
    def gaussian(cls, wavelength: float, fwhm: float) -> Spectrum:
        """Return light whose spectral density is a Gaussian of frequency.

        Parameters
        ----------
        wavelength : float
            Centre wavelength in metres.
        fwhm : float
            Full width at half maximum in metres, below half the wavelength; the width in frequency
            is dnu = c fwhm/wavelength^2.

        Raises
        ------
        ValueError
            If a length is out of range.
        """
        return cls.lines([wavelength], [1.0], fwhm=_width(fwhm, wavelength, "The FWHM"))

    @classmethod
    def rectangular(cls, wavelength: float, width: float) -> Spectrum:
        """Return light of constant spectral density over a band of frequencies.

        Parameters
        ----------
        wavelength : float
            Centre wavelength in metres; the mean frequency is c/wavelength.
        width : float
            Full width in metres, below half the wavelength; c width/wavelength^2 in frequency.

        Raises
        ------
        ValueError
            If a length is out of range.
        """
        half = C * _width(width, wavelength, "The width") / wavelength**2 / 2
        return cls(Rectangle(C / wavelength - half, C / wavelength + half))

    @classmethod
    def monochromatic(cls, wavelength: float) -> Spectrum:
        """Return light of a single wavelength in metres."""
        return cls.lines([wavelength], [1.0])

    @classmethod
    def lines(cls, wavelengths: ArrayLike, powers: ArrayLike, *, fwhm: float = 0.0) -> Spectrum:
        """Return spectral lines, sharp or Gaussian.

        Parameters
        ----------
        wavelengths : array_like
            Wavelengths in metres, in any order, shape (n,).
        powers : array_like
            Relative powers, not negative, shape (n,); lines without power are dropped.
        fwhm : float, optional
            Full width at half maximum of every line in metres, below half of each wavelength.

        Raises
        ------
        ValueError
            If a number is out of range.
        """
        lam, shares = spectrum_tables.check_powers(wavelengths, powers)
        if not is_finite(fwhm) or fwhm != 0:
            for value in lam:
                spectrum_tables.check_width(fwhm, value, "The FWHM")
        widths = tuple(C * fwhm / value**2 for value in lam)
        return cls(Lines(tuple(C / value for value in lam), widths, tuple(shares)))

    @classmethod
    def tabulated(cls, wavelengths: ArrayLike, values: ArrayLike) -> Spectrum:
        """Return a measured spectrum.

        Parameters
        ----------
        wavelengths : array_like
            Wavelengths in metres, rising, shape (n,), n >= 2.
        values : array_like
            Spectral density per wavelength in any unit, at least 0, shape (n,), linear between the
            points and 0 outside. The mean frequency and all other properties refer to the density
            per frequency, lam^2/c times this.

        Raises
        ------
        ValueError
            If a number is negative or not finite, the wavelengths do not rise or are not in
            metres, the lengths differ, or there is no light at all.
        """
        lam, density = spectrum_tables.check_table(wavelengths, values)
        return cls(Table(tuple(lam.tolist()), tuple(density.tolist())))

    @classmethod
    def read(cls, path: str | os.PathLike[str], *, unit: str | None = None) -> Spectrum:
        """Read a measured spectrum from a text file.

        Parameters
        ----------
        path : path-like
            File of two columns, rising wavelengths and density per wavelength, separated by commas,
            spaces or tabs. Comments after # and header lines that do not begin like a number are
            ignored.
        unit : {"m", "um", "nm"}, optional
            Unit of the wavelengths. None assumes nm if all are within 100 to 2600, um within 0.1 to
            20, and m within 1e-7 to 2e-5.

        Raises
        ------
        FormatError
            If the file does not exist or is not text, a line (named) is invalid, or the unit is
            None and ambiguous.
        ValueError
            If the unit is unknown.
        """
        return cls.tabulated(*spectrum_tables.read_table(path, unit))

    @classmethod
    def mercury(cls, *, fwhm: float = 0.0) -> Spectrum:
        """Return the six strongest visible lines of a low-pressure mercury lamp.

        The lines are 404.77, 407.90, 435.96, 546.23, 577.12 and 579.23 nm in vacuum (Sansonetti,
        Salit & Reader, Appl. Opt. 35, 74 (1996)). Their relative intensities are those of a pencil
        lamp in the NIST Atomic Spectra Database; they are rough and differ between lamps.

        Parameters
        ----------
        fwhm : float, optional
            Full width at half maximum of every line in metres.

        Raises
        ------
        ValueError
            If the width is negative or not below half of each wavelength.
        """
        return cls.lines(
            list(spectrum_tables.MERCURY), list(spectrum_tables.MERCURY.values()), fwhm=fwhm
        )

    @classmethod
    def white_led(cls) -> Spectrum:
        """Return a cold white LED: a blue die and a yellow phosphor, tabulated from 380 to 780 nm.

        The peaks are Gaussians of wavelength, 445 nm with a FWHM of 25 nm and 560 nm with 125 nm,
        of heights 1 and 0.5, in steps of 5 nm. The chromaticity is (0.30, 0.31), 7400 K (Blue-light
        hazard of light-emitting diodes assessed with Gaussian functions, Int. J. Environ. Res.
        Public Health 18, 680 (2021), eq. 1 and fig. 1).
        """
        return cls.tabulated(*spectrum_tables.white_led())

    @property
    def centre(self) -> float:
        """Wavelength in metres of the mean frequency, weighted by power."""
        return C / self.shape.mean

    def density(self, nu: ArrayLike) -> Vector:
        """Return the spectral density at frequencies in Hz, per Hz, of integral 1, in float64.

        Raises
        ------
        ValueError
            If the lines have no width.
        """
        if math.isinf(self.shape.square):
            raise ValueError("Lines without a width have no finite density; set fwhm=.")
        return self.shape.density(real_array(nu, "nu", float))

    def gamma(self, tau: ArrayLike) -> Complex:
        """Return the complex degree of temporal coherence at delays in seconds.

        Gaussians have the closed form exp(-(pi dnu tau/(2 sqrt(ln 2)))^2 - 2 pi i nu tau),
        rectangles sinc(dnu tau) exp(-2 pi i nu tau) (Goodman, 1985, section 5.1). Tables are
        integrated piece by piece, exact to rounding.

        Parameters
        ----------
        tau : array_like
            Delays in seconds, of any shape.

        Returns
        -------
        numpy.ndarray
            Degree, complex128, with the shape of ``tau``; gamma(0) = 1, gamma(-tau) = conj
            gamma(tau).
        """
        delays = real_array(tau, "tau", float)
        return self.shape.gamma(delays.ravel()).reshape(delays.shape)

    def degree(self, path: ArrayLike) -> Vector:
        """Return abs(gamma) at path differences in metres: the fringe visibility of equal beams."""
        return np.abs(self.gamma(real_array(path, "path", float) / C))

    def coherence_length(self, definition: Definition = "goodman") -> float:
        """Return the path difference in metres up to which two copies of this light interfere.

        Parameters
        ----------
        definition : {"goodman", "fwhm", "oct"}
            Definition. "goodman": c int abs(gamma)^2 dtau (Goodman, 1985, section 5.1), for a
            Gaussian 0.6643 lam^2/dlam. "fwhm": full width over path of abs(gamma) at its first fall
            to 1/2, 0.8825 lam^2/dlam. "oct": half of that width, 0.4413 lam^2/dlam, the resolution
            of optical coherence tomography, in which light travels both ways.

        Returns
        -------
        float
            Length in metres, infinite for a single sharp line. Sharp lines have an infinite
            "goodman" length; the other definitions search 1000 beats of the outermost lines.

        Raises
        ------
        ValueError
            If the definition is unknown.
        """
        if definition not in ("goodman", "fwhm", "oct"):
            raise ValueError(f"definition must be 'goodman', 'fwhm' or 'oct', got {definition!r}.")
        if definition == "goodman":
            return C * self.shape.square
        return C * self._half_time() * (2 if definition == "fwhm" else 1)

    def sample(self, n: int, *, span: float = 2.0) -> SpectralSamples:
        """Return wavelengths that represent the spectrum.

        Parameters
        ----------
        n : int
            Number of samples. Lines with a width share them evenly: each gets at least one, and the
            strongest get the remainder. Sharp lines get one sample each for any n, and dark
            cells of a table get none.
        span : float, optional
            Half range of a Gaussian in FWHM, sampled in equal steps of frequency from -span to
            +span with its density as weights. Use 2 to follow abs(gamma) (error 3.1e-4 within 3
            coherence lengths at n = 15, 1.1e-6 at 21), 1.5 for images (9 samples). It is ignored
            for few samples (see Notes), and for a table or rectangle, which has n cells, each
            represented by its centre and its power.

        Returns
        -------
        SpectralSamples
            Wavelengths with their weights.

        Raises
        ------
        ValueError
            If n is not a positive integer, or the span is not positive or reaches frequency 0.

        Notes
        -----
        Up to 4 samples of a single Gaussian, and up to 8 of each of several lines, are the nodes
        of Gauss-Hermite quadrature (Abramowitz & Stegun, 1964, eq. 25.4.46). They preserve the mean
        and, from two samples on, the width. Largest errors of abs(gamma) by samples of a line:

        =======================  ====  =====  ======  ======  ======  ======
        within                   1     2      3       4       6       8
        =======================  ====  =====  ======  ======  ======  ======
        half a coherence length  0.32  0.043  0.0034  1.9e-4  2.9e-7  2e-10
        one coherence length     0.79  0.29   0.13    0.028   6.9e-4  9e-6
        =======================  ====  =====  ======  ======  ======  ======

        The coherence length is that of the line, 0.6643 lam^2/fwhm. Errors of several lines add,
        weighted by their powers: 0.07 within 20 um for 9 samples of ``mercury(fwhm=4e-9)``. Equal
        steps over too wide a span are worse: 5 samples of a Gaussian over +-2 FWHM have an error of
        0.62 within a coherence length, over +-1.5 of 0.20. `error` measures the error, `needed`
        estimates the number of samples.
        """
        n = spectrum_tables.check_count(n)
        if not (is_finite(span) and span > 0):
            raise ValueError(f"span must be a positive number of widths, got {span!r}.")
        nu, weights, step = self.shape.sample(n, span)
        if nu.min() <= 0:
            raise ValueError(f"span={span:g} widths of this spectrum reach frequency 0; reduce it.")
        return SpectralSamples(C / nu, weights, step)

    def error(self, n: int, path: float, *, span: float = 2.0) -> float:
        """Return the largest difference of abs(gamma) between the spectrum and its samples.

        Parameters
        ----------
        n, span
            Arguments of `sample`.
        path : float
            Largest path difference in metres, sampled 32 times per turn of the band.

        Returns
        -------
        float
            Error, between 0 and 1.

        Raises
        ------
        ValueError
            In the cases of `sample`, or if the path is negative or not finite.
        """
        delay, samples = spectrum_tables.check_path(path) / C, self.sample(n, span=span)
        if samples.step == 0:
            return 0.0
        count = 256 + math.ceil(PER_TURN * self.shape.width * delay)
        tau = np.linspace(0.0, delay, count)
        return max(
            float(np.abs(np.abs(samples.gamma(part)) - np.abs(self.gamma(part))).max())
            for part in np.array_split(tau, math.ceil(count / BLOCK))
        )

    def needed(self, path: float, *, span: float = 2.0) -> int:
        """Return the number of samples for path differences up to ``path``.

        Equally spaced samples become coherent again at the path difference c/step. The number, 1 +
        band (path + 1.5 l_c)/c rounded up, puts this 1.5 coherence lengths l_c (Goodman's
        definition) beyond ``path``. Each line gets the number of the widest; sharp lines get 1.

        Parameters
        ----------
        path : float
            Largest path difference in metres.
        span : float, optional
            Half range of a Gaussian, as in `sample`; its band is 2 span FWHM.

        Raises
        ------
        ValueError
            If the path is negative or not finite.
        """
        return self.shape.needed(spectrum_tables.check_path(path) / C, span)

    def _half_time(self) -> float:
        """Return the first delay at which abs(gamma) is 1/2, or infinity."""
        width, square = self.shape.width, self.shape.square
        if width == 0:
            return math.inf
        # Where |gamma| stays above 1/2 up to T, int |gamma|^2 is above T/2.
        longest = LONGEST_BEAT / width if math.isinf(square) else 2 * square
        step = 1 / (PER_TURN * width)
        for start in range(0, math.ceil(longest / step) + 1, SEARCH_BLOCK):
            tau: Vector = step * np.arange(start, start + SEARCH_BLOCK + 1, dtype=np.float64)
            if np.abs(self.gamma(tau)).min() <= 0.5:
                return self._fall(tau)
        return math.inf

    def _fall(self, tau: Vector) -> float:
        """Return the first delay with abs(gamma) of 1/2 within rising delays, by refinement."""
        for _ in range(MAX_REFINEMENTS):
            first = max(1, int(np.argmax(np.abs(self.gamma(tau)) <= 0.5)))
            tau = np.linspace(tau[first - 1], tau[first], REFINEMENT + 1)
        return float(tau[REFINEMENT // 2])


def _width(width: float, wavelength: float, what: str) -> float:
    return spectrum_tables.check_width(width, spectrum_tables.check_wavelength(wavelength), what)
