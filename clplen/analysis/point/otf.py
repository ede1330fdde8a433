"""Optical transfer functions of point spread functions, and closed forms of ideal apertures.

Goodman, Introduction to Fourier Optics, 3rd edition, 2005, sections 2.1 and 6.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.analysis.point.psf import PSF
from clplen.analysis.point.samples import Pair, Values, check_axis, first_fall
from clplen.checks import check_positive, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.reprs import OneLine
from clplen.results import Plottable
from clplen.wave.systems.pupil_filter import otf as ideal_otf


@dataclass(frozen=True, eq=False, repr=False)
class Curve(OneLine, Plottable):
    """Contrast over spatial frequency.

    Attributes
    ----------
    frequency : numpy.ndarray
        Frequencies in cycles a metre, ascending from 0, float64, shape (n,).
    value : numpy.ndarray
        Contrast, 1 at frequency 0, float64, shape (n,).

    Raises
    ------
    ShapeError
        If the arrays differ in length or have fewer than 2 samples.
    ValueError
        If a value is not finite or the frequencies do not ascend.

    Examples
    --------
    >>> f = np.linspace(0, 200e3, 33)
    >>> lens = clplen.analysis.circular_mtf(f, wavelength=500e-9, distance=0.1, width=10e-3)
    >>> curve = clplen.analysis.Curve(f, lens)
    >>> f"MTF50 {curve.at(0.5) / 1e3:.0f}, cut-off {curve.cutoff() / 1e3:.0f} cycles/mm"
    'MTF50 81, cut-off 192 cycles/mm'
    """

    _figure: ClassVar[str] = "curve"

    frequency: Values
    value: Values

    def __post_init__(self) -> None:
        f, v = (np.array(a, np.float64) for a in (self.frequency, self.value))
        if f.ndim != 1 or f.shape != v.shape or f.size < 2:
            raise ShapeError(
                f"frequency and value must have equal lengths of at least 2, got {f.shape} and "
                f"{v.shape}."
            )
        if not (np.isfinite(f).all() and np.isfinite(v).all() and (np.diff(f) > 0).all()):
            raise ValueError("frequency and value must be finite, and frequency must ascend.")
        object.__setattr__(self, "frequency", f)
        object.__setattr__(self, "value", v)

    def at(self, value: float) -> float:
        """Return the frequency at which the curve first falls below a contrast.

        Samples are interpolated linearly. MTF50 is ``at(0.5)``, MTF10 ``at(0.1)``.

        Parameters
        ----------
        value : float
            Contrast between 0 and 1.

        Returns
        -------
        float
            Frequency in cycles a metre; NaN if the curve does not reach the contrast.

        Raises
        ------
        ValueError
            If the contrast is not between 0 and 1.
        """
        if not 0 < value < 1:
            raise ValueError(f"value must be a contrast between 0 and 1, got {value!r}.")
        return first_fall(self.frequency, self.value, value)

    def contrast(self, frequency: Any) -> Any:
        """Interpolate the contrast linearly at frequencies.

        Parameters
        ----------
        frequency : array_like
            Frequencies in cycles a metre.

        Returns
        -------
        numpy.ndarray or float
            Contrast; NaN outside the curve.
        """
        values = np.interp(frequency, self.frequency, self.value, left=np.nan, right=np.nan)
        return float(values) if np.ndim(values) == 0 else values

    def floor(self, beyond: float) -> float:
        """Compute the noise floor: the rms of the curve beyond the signal's highest frequency.

        Parameters
        ----------
        beyond : float
            Highest frequency of the signal, in cycles a metre.

        Raises
        ------
        ValueError
            If the curve ends before this frequency.
        """
        tail = self.value[self.frequency > beyond]
        if not tail.size:
            raise ValueError(
                f"beyond must be below {self.frequency[-1]:.6g} cycles/m, got {beyond!r}."
            )
        return float(np.sqrt(np.mean(tail**2)))

    def cutoff(self, *, level: float = 0.01, noise: float = 0.0) -> float:
        """Return the frequency beyond which the curve stays at or below ``level + noise``.

        Unlike `at`, it skips zeros between lobes.

        Parameters
        ----------
        level : float
            Contrast that counts as zero.
        noise : float
            Noise floor, such as `floor` returns.

        Returns
        -------
        float
            Frequency in cycles a metre, interpolated linearly; NaN if the curve ends above.

        Raises
        ------
        ValueError
            If a value is negative, or the sum is 0 or not below 1.
        """
        threshold = level + noise
        if not (level >= 0 and noise >= 0 and 0 < threshold < 1):
            raise ValueError(
                f"level and noise must not be negative and sum to between 0 and 1, got {level!r} "
                f"and {noise!r}."
            )
        above = np.flatnonzero(self.value > threshold)
        if not above.size:
            return float(self.frequency[0])
        k = int(above[-1])
        if k + 1 == self.value.size:
            return float("nan")
        (f0, f1), (v0, v1) = self.frequency[k : k + 2], self.value[k : k + 2]
        return float(f0 + (f1 - f0) * (v0 - threshold) / (v0 - v1))


Complex = np.ndarray[Any, np.dtype[np.complex128]]


@dataclass(frozen=True, eq=False, repr=False)
class OTF(Plottable, HostArray):
    """Optical transfer function, normalised to 1 at frequency 0 (Goodman 2005, sec. 6.3.1).

    Create it with `OTF.of`.

    Attributes
    ----------
    values : numpy.ndarray
        Transfer function, complex128, shape (ny, nx), frequencies ascending, 0 at (ny//2, nx//2).
    fy, fx : numpy.ndarray
        Frequencies in cycles a metre, float64, shapes (ny,) and (nx,).
    centre : tuple of float
        Origin (y, x) of the phases, in metres.

    Examples
    --------
    >>> line = np.exp(-(((np.arange(32) - 16) / 2) ** 2) / 2)  # Gaussian, 1 um rms
    >>> otf = clplen.analysis.OTF.of(clplen.analysis.PSF(np.outer(line, line), 0.5e-6))
    >>> otf.values.shape, f"MTF50 {otf.mtf(1).at(0.5) / 1e3:.0f} cycles/mm"
    ((64, 64), 'MTF50 187 cycles/mm')
    """

    _figure: ClassVar[str] = "modulation"
    _samples: ClassVar[str] = "values"

    values: Complex
    fy: Values
    fx: Values
    centre: Pair

    @classmethod
    def of(cls, psf: PSF, *, pad: float = 2, centre: Pair | None = None) -> OTF:
        """Compute the transfer function int I(x) exp(-2 pi i f (x - centre)) dx / int I(x) dx.

        Parameters
        ----------
        psf : PSF
            Point spread function.
        pad : float
            Length of the transform over that of the window, at least 1; it sets the frequency step.
        centre : tuple of float, optional
            Origin (y, x) in metres; default the centroid of I^2, so that a symmetric function has
            no phase.

        Raises
        ------
        ValueError
            If ``pad`` is less than 1.
        """
        if not (np.isfinite(pad) and pad >= 1):
            raise ValueError(f"pad must be at least 1, got {pad!r}.")
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
        """Return the modulus along one axis, at frequency 0 of the other axis.

        Parameters
        ----------
        axis : int
            Axis: 0 for y, 1 for x.

        Returns
        -------
        Curve
            Contrast from 0 to half a cycle per sample of the point spread function.
        """
        axis = check_axis(axis)
        ny, nx = self.values.shape
        line = self.values[ny // 2] if axis == 1 else self.values[:, nx // 2]
        f = self.fx if axis == 1 else self.fy
        indices = (np.arange(f.size // 2 + 1) + f.size // 2) % f.size
        return Curve(np.abs(f[indices]), np.abs(line[indices]))


def square_mtf(frequency: Any, *, wavelength: float, distance: float, width: float) -> Values:
    """Compute the transfer function 1 - f lam a/d of a square aperture along its side.

    Goodman 2005, section 6.3.3; 0 from the cut-off d/(lam a) on.

    Parameters
    ----------
    frequency : array_like
        Frequency f in cycles a metre, on the image plane.
    wavelength : float
        Wavelength lam in metres.
    distance : float
        Distance a from the aperture to the image plane, in metres.
    width : float
        Side d of the square in metres.

    Returns
    -------
    numpy.ndarray
        Contrast from 0 to 1, float64, of the shape of ``frequency``.

    Raises
    ------
    ValueError
        If a length is not positive.

    Examples
    --------
    >>> f = [0.0, 50e3, 100e3, 200e3]
    >>> mtf = clplen.analysis.square_mtf(f, wavelength=500e-9, distance=0.1, width=10e-3)
    >>> np.round(mtf, 3).tolist()
    [1.0, 0.75, 0.5, 0.0]
    """
    return ideal_otf(_fraction(frequency, wavelength, distance, width), shape="square")


def circular_mtf(frequency: Any, *, wavelength: float, distance: float, width: float) -> Values:
    """Compute the transfer function of a circular aperture.

    It is (2/pi)(acos s - s sqrt(1 - s^2)) with s = f lam a/d (Goodman 2005, section 6.3.3); 0 from
    the cut-off d/(lam a) on.

    Parameters
    ----------
    frequency : array_like
        Frequency f in cycles a metre, on the image plane.
    wavelength : float
        Wavelength lam in metres.
    distance : float
        Distance a from the aperture to the image plane, in metres.
    width : float
        Diameter d in metres.

    Returns
    -------
    numpy.ndarray
        Contrast from 0 to 1, float64, of the shape of ``frequency``.

    Raises
    ------
    ValueError
        If a length is not positive.

    Examples
    --------
    >>> f = [0.0, 50e3, 100e3, 200e3]
    >>> mtf = clplen.analysis.circular_mtf(f, wavelength=500e-9, distance=0.1, width=10e-3)
    >>> np.round(mtf, 3).tolist()
    [1.0, 0.685, 0.391, 0.0]
    """
    return ideal_otf(_fraction(frequency, wavelength, distance, width))


def pixel_mtf(frequency: Any, *, width: float) -> Values:
    """Compute the transfer function abs(sinc(f w)) of a uniformly sensitive pixel.

    Goodman 2005, section 2.1: the transform of a rectangle.

    Parameters
    ----------
    frequency : array_like
        Frequency f in cycles a metre.
    width : float
        Width w of the pixel in metres, along the frequency.

    Returns
    -------
    numpy.ndarray
        Contrast from 0 to 1, float64, of the shape of ``frequency``.

    Raises
    ------
    ValueError
        If the width is not positive.

    Examples
    --------
    >>> mtf = clplen.analysis.pixel_mtf([0.0, 100e3, 200e3], width=5e-6)
    >>> np.round(mtf, 3).tolist()  # 100 cycles/mm is the Nyquist frequency of such pixels
    [1.0, 0.637, 0.0]
    """
    check_positive(width=width)
    with np.errstate(invalid="ignore"):  # infinite frequencies
        return np.abs(np.sinc(real_array(frequency, "frequency", np.float64) * width))


def _fraction(frequency: Any, wavelength: float, distance: float, width: float) -> Values:
    """Return the frequency over the incoherent cut-off."""
    check_positive(wavelength=wavelength, distance=distance, width=width)
    return real_array(frequency, "frequency", np.float64) * (wavelength * distance / width)
