"""Spectra of light and what follows from them: temporal coherence, and wavelengths to sample.

    gamma(tau) = int S(nu) exp(-2 pi i nu tau) dnu,   int S dnu = 1

is the complex degree of temporal coherence of light of spectral density S (Goodman, Statistical
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

PER_TURN = 32  # delays at which |gamma| is looked at while the band turns once
LONGEST_BEAT = 1000  # turns of the band, after which sharp lines are not searched any further
BLOCK, FEW = 4096, 256  # delays at a time
CLOSER, TIMES = 16, 14  # a delay is found to 16^-14 of a step, that is to rounding

Definition = Literal["goodman", "fwhm", "oct"]


@dataclass(frozen=True, repr=False)
class Spectrum(OneLine):
    """The spectrum of a light source.

    Made by `gaussian`, `rectangular`, `tabulated`, `lines`, `monochromatic`, `mercury`,
    `white_led` or `read`. Wavelengths are in metres, 1e-10 to 1e-3, and nu = c/wavelength.

    Parameters
    ----------
    shape : Lines, Rectangle or Table
        Its spectral density.

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
        """Light whose spectral density is a Gaussian of frequency.

        Parameters
        ----------
        wavelength : float
            Of its centre in metres.
        fwhm : float
            Full width at half maximum in metres, below half the wavelength. It stands for the
            width dnu = c fwhm/wavelength^2 in frequency.

        Raises
        ------
        ValueError
            If they are no such lengths.
        """
        return cls.lines([wavelength], [1.0], fwhm=_width(fwhm, wavelength, "The FWHM"))

    @classmethod
    def rectangular(cls, wavelength: float, width: float) -> Spectrum:
        """Light of the same spectral density at all frequencies of a band.

        Parameters
        ----------
        wavelength : float
            Of the middle of the band in metres: its mean frequency is c/wavelength.
        width : float
            Full width in metres, below half the wavelength; c width/wavelength^2 in frequency.

        Raises
        ------
        ValueError
            If they are no such lengths.
        """
        half = C * _width(width, wavelength, "The width") / wavelength**2 / 2
        return cls(Rectangle(C / wavelength - half, C / wavelength + half))

    @classmethod
    def monochromatic(cls, wavelength: float) -> Spectrum:
        """Light of one wavelength in metres; ValueError if it is none."""
        return cls.lines([wavelength], [1.0])

    @classmethod
    def lines(cls, wavelengths: ArrayLike, powers: ArrayLike, *, fwhm: float = 0.0) -> Spectrum:
        """Spectral lines, sharp or Gaussian.

        Parameters
        ----------
        wavelengths : array_like
            In metres, in any order, shape (n,).
        powers : array_like
            Relative powers, none negative, shape (n,); lines without power are left out.
        fwhm : float, optional
            Full width at half maximum of every line in metres, below half of each wavelength.

        Raises
        ------
        ValueError
            If they are no such numbers.
        """
        lam, shares = spectrum_tables.check_powers(wavelengths, powers)
        if not is_finite(fwhm) or fwhm != 0:
            for value in lam:
                spectrum_tables.check_width(fwhm, value, "The FWHM")
        widths = tuple(C * fwhm / value**2 for value in lam)
        return cls(Lines(tuple(C / value for value in lam), widths, tuple(shares)))

    @classmethod
    def tabulated(cls, wavelengths: ArrayLike, values: ArrayLike) -> Spectrum:
        """A measured spectrum.

        Parameters
        ----------
        wavelengths : array_like
            In metres, rising, shape (n,), n >= 2.
        values : array_like
            Spectral density per wavelength in any unit, at least 0, shape (n,): linear between
            the points, 0 outside. Its mean frequency and all else is that of the density per
            frequency, lam^2/c times this.

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
        """A measured spectrum from a text file.

        Parameters
        ----------
        path : path-like
            Two columns, rising wavelengths and density per wavelength, separated by commas,
            spaces or tabs. What follows # is left out, and so are lines ahead of the first
            numbers that do not begin like a number.
        unit : {"m", "um", "nm"}, optional
            Of the wavelengths. Without it they are taken for nm if all lie within 100 to 2600,
            for um within 0.1 to 20 and for m within 1e-7 to 2e-5.

        Raises
        ------
        FormatError
            If there is no such file, it is not text, or a line (named) is not as it should be;
            if the unit is not given and cannot be told.
        ValueError
            If the unit is none of these.
        """
        return cls.tabulated(*spectrum_tables.read_table(path, unit))

    @classmethod
    def mercury(cls, *, fwhm: float = 0.0) -> Spectrum:
        """The six strongest visible lines of a low-pressure mercury lamp.

        404.77, 407.90, 435.96, 546.23, 577.12 and 579.23 nm in vacuum, with the relative
        intensities of a pencil lamp in the NIST Atomic Spectra Database (wavelengths: Sansonetti,
        Salit & Reader, Appl. Opt. 35, 74 (1996)); these are rough, and differ from lamp to lamp.

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
        """A cold white LED: a blue die and a yellow phosphor, tabulated from 380 to 780 nm.

        Gaussians of wavelength, 445 nm with a FWHM of 25 nm and 560 nm with 125 nm, of heights 1
        and 0.5, every 5 nm. Chromaticity (0.30, 0.31), 7400 K (Blue-light hazard of light-
        emitting diodes assessed with Gaussian functions, Int. J. Environ. Res. Public Health 18,
        680 (2021), eq. 1 and fig. 1).
        """
        return cls.tabulated(*spectrum_tables.white_led())

    @property
    def centre(self) -> float:
        """Wavelength of the mean frequency in metres, each frequency weighted by its power."""
        return C / self.shape.mean

    def density(self, nu: ArrayLike) -> Vector:
        """Spectral density at frequencies in Hz, per Hz, of integral 1; float64, shape of ``nu``.

        Raises
        ------
        ValueError
            If the lines have no width.
        """
        if math.isinf(self.shape.square):
            raise ValueError("Lines without a width have no finite density: give them a fwhm.")
        return self.shape.density(real_array(nu, "nu", float))

    def gamma(self, tau: ArrayLike) -> Complex:
        """Complex degree of temporal coherence at delays in seconds.

        Closed form for Gaussians, exp(-(pi dnu tau/(2 sqrt(ln 2)))^2 - 2 pi i nu tau), and for the
        rectangle, sinc(dnu tau) exp(-2 pi i nu tau) (Goodman, 1985, section 5.1); the integral
        over a table piece by piece, exact to rounding.

        Parameters
        ----------
        tau : array_like
            Delays in seconds, of any shape.

        Returns
        -------
        numpy.ndarray
            complex128, the shape of ``tau``; gamma(0) = 1, gamma(-tau) = conj gamma(tau).
        """
        delays = real_array(tau, "tau", float)
        return self.shape.gamma(delays.ravel()).reshape(delays.shape)

    def degree(self, path: ArrayLike) -> Vector:
        """abs(gamma) at path differences in metres: the fringe visibility of equal beams."""
        return np.abs(self.gamma(real_array(path, "path", float) / C))

    def coherence_length(self, definition: Definition = "goodman") -> float:
        """Path difference up to which two copies of this light interfere.

        Parameters
        ----------
        definition : {"goodman", "fwhm", "oct"}
            "goodman": c int abs(gamma)^2 dtau (Goodman, 1985, section 5.1), for a Gaussian
            0.6643 lam^2/dlam. "fwhm": full width over path of abs(gamma) where it first falls to
            1/2, 0.8825 lam^2/dlam. "oct": half of that, the resolution of optical coherence
            tomography, where light goes there and back, 0.4413 lam^2/dlam.

        Returns
        -------
        float
            In metres; infinite for one sharp line. Sharp lines have an infinite "goodman" length
            and are searched over 1000 beats of the outermost ones for the other two.

        Raises
        ------
        ValueError
            If the definition is none of these.
        """
        if definition not in ("goodman", "fwhm", "oct"):
            raise ValueError(f"A definition is 'goodman', 'fwhm' or 'oct', not {definition!r}.")
        if definition == "goodman":
            return C * self.shape.square
        return C * self._half_time() * (2 if definition == "fwhm" else 1)

    def sample(self, n: int, *, span: float = 2.0) -> SpectralSamples:
        """Wavelengths that stand for the spectrum.

        Parameters
        ----------
        n : int
            How many. Lines with a width share them evenly, those left over going to the
            strongest, and each has at least one: 12 lines take 12 samples where fewer are asked
            for. Sharp lines take one each, whatever n is, and dark cells of a table none.
        span : float, optional
            A Gaussian is sampled in equal steps of frequency from -span to +span times its FWHM,
            the ends included, with its density as weights: 2 to follow abs(gamma) (error 3.1e-4
            within 3 coherence lengths at n = 15, 1.1e-6 at 21), 1.5 for images (9 samples). It
            does not count where there are few samples, see below. A table or a rectangle is cut
            into n cells, each at its middle with the power that it holds.

        Returns
        -------
        SpectralSamples

        Raises
        ------
        ValueError
            If n is not a positive whole number; if the span is not positive or reaches
            frequency 0.

        Notes
        -----
        Up to 4 samples of a single Gaussian, and up to 8 of each of several lines, are the nodes
        of Gauss-Hermite quadrature (Abramowitz & Stegun, 1964, eq. 25.4.46), which keep the mean
        and, from two on, the width. Largest errors of the abs(gamma) of a line, by its samples:

        =======================  ====  =====  ======  ======  ======  ======
        within                   1     2      3       4       6       8
        =======================  ====  =====  ======  ======  ======  ======
        half a coherence length  .32   .043   .0034   1.9e-4  2.9e-7  2e-10
        one coherence length     .79   .29    .13     .028    6.9e-4  9e-6
        =======================  ====  =====  ======  ======  ======  ======

        A coherence length is that of the line, .6643 lam^2/fwhm. Of several lines each adds its
        error times its power: 9 samples of ``mercury(fwhm=4e-9)`` err by .07 within 20 um.
        Equal steps over too wide a span are worse: a single Gaussian's 5 over +-2 FWHM err by .62
        within a coherence length, over +-1.5 by .20. `error` measures, `needed` tells how many.
        """
        n = spectrum_tables.check_count(n)
        if not (is_finite(span) and span > 0):
            raise ValueError(f"A span is a positive number of widths, not {span!r}.")
        nu, weights, step = self.shape.sample(n, span)
        if nu.min() <= 0:
            raise ValueError(f"span={span:g} widths of this spectrum reach frequency 0: lower it.")
        return SpectralSamples(C / nu, weights, step)

    def error(self, n: int, path: float, *, span: float = 2.0) -> float:
        """Largest difference of abs(gamma) between the spectrum and its samples.

        Parameters
        ----------
        n, span
            As for `sample`.
        path : float
            Path difference in metres up to which it is looked for, 32 times a turn of the band.

        Returns
        -------
        float
            Between 0 and 1.

        Raises
        ------
        ValueError
            As `sample`, or if the path is negative or not finite.
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
        """Samples for path differences up to one: 1 + band (path + 1.5 l_c)/c, rounded up.

        So many that the samples' coherence comes back (at c/step) 1.5 coherence lengths (as
        Goodman has them) beyond the path. For lines with a width as many for each as the widest
        one takes; sharp lines take one each.

        Parameters
        ----------
        path : float
            Largest path difference in metres.
        span : float, optional
            As for `sample`; the band of a Gaussian is 2 span FWHM.

        Raises
        ------
        ValueError
            If the path is negative or not finite.
        """
        return self.shape.needed(spectrum_tables.check_path(path) / C, span)

    def _half_time(self) -> float:
        """The first delay at which abs(gamma) is 1/2; infinite if there is none."""
        width, square = self.shape.width, self.shape.square
        if width == 0:
            return math.inf
        # Where |gamma| stays above 1/2 up to T, int |gamma|^2 is above T/2.
        longest = LONGEST_BEAT / width if math.isinf(square) else 2 * square
        step = 1 / (PER_TURN * width)
        for start in range(0, math.ceil(longest / step) + 1, FEW):
            tau: Vector = step * np.arange(start, start + FEW + 1, dtype=np.float64)
            if np.abs(self.gamma(tau)).min() <= 0.5:
                return self._fall(tau)
        return math.inf

    def _fall(self, tau: Vector) -> float:
        """Where abs(gamma) first falls to 1/2 within rising delays, each time looked at closer."""
        for _ in range(TIMES):
            first = max(1, int(np.argmax(np.abs(self.gamma(tau)) <= 0.5)))
            tau = np.linspace(tau[first - 1], tau[first], CLOSER + 1)
        return float(tau[CLOSER // 2])


def _width(width: float, wavelength: float, what: str) -> float:
    return spectrum_tables.check_width(width, spectrum_tables.check_wavelength(wavelength), what)
