"""Point spread functions: position, width, encircled energy and Strehl ratio."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from clplen.analysis.point.samples import (
    Pair,
    Values,
    check_axis,
    checked,
    first_fall,
    interpolated_line,
    interpolated_picture,
    line_of,
)
from clplen.checks import is_integer, masked_array, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.results import Plottable
from clplen.wave.field.field import Grid

OVERSAMPLING = 16  # interpolated samples per sample, for widths
_STEPS = 16  # radii per sample in sums of encircled energy
_CHUNK = 64  # radii per chunk, which bounds the memory
_PER_PERIOD = 40  # frequency bins per period of the largest circle's transform


class MonotoneCurve:
    """Monotone cubic curve from 0 on.

    On the steps it has the running maximum of the values. Between them it is a Hermite cubic with
    the given slopes, limited so that it never falls (Fritsch and Carlson 1980, eq. 4).
    """

    def __init__(self, steps: Values, values: Values, slopes: Values) -> None:
        from scipy.interpolate import CubicHermiteSpline

        high = np.maximum.accumulate(np.maximum(values, 0))
        rise = np.diff(high) / np.diff(steps)
        max_slopes = 3 * np.minimum(np.append(rise, rise[-1]), np.insert(rise, 0, rise[0]))
        self._curve = CubicHermiteSpline(steps, high, np.clip(slopes, 0, max_slopes))
        self._steps, self._high = steps, high

    def __call__(self, x: Any) -> Any:
        k = np.clip(np.searchsorted(self._steps, x, side="right") - 1, 0, self._steps.size - 2)
        return np.clip(self._curve(x), self._high[k], self._high[k + 1])  # against rounding


@dataclass(frozen=True, eq=False, repr=False)
class PSF(Plottable, HostArray):
    """Intensity image of a point, on the host.

    Fourier interpolation between samples is exact if the samples resolve the image and the window
    contains all of it. No background is subtracted.

    Attributes
    ----------
    values : numpy.ndarray
        Intensities [y, x], float64, at least 4 samples a side.
    pitch : tuple of float
        Sample pitch (dy, dx) in metres; a single number sets both.
    origin : tuple of float
        Position (y, x) of sample (ny//2, nx//2) in metres.

    Raises
    ------
    ShapeError
        If the values are not two-dimensional, or too few.
    ValueError
        If values are not finite and real, their sum is not positive, or the pitch or origin is not
        a pair of finite numbers.

    Examples
    --------
    >>> line = np.sinc((np.arange(64) - 32) / 4) ** 2  # a slit: first zeros 2 um off the middle
    >>> psf = clplen.analysis.PSF(np.outer(line, line), 0.5e-6)
    >>> psf
    <PSF 64 x 64, pitch 5e-07 x 5e-07 m>
    >>> f"{psf.fwhm(1) * 1e6:.2f} um"
    '1.77 um'
    """

    _figure: ClassVar[str] = "psf"
    _samples: ClassVar[str] = "values"

    values: Values
    pitch: Pair
    origin: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = checked(self.values, "A point spread function", min_samples=4)
        grid = Grid((values.shape[0], values.shape[1]), self.pitch, origin=self.origin)
        if not values.sum() > 0:
            raise ValueError(
                f"The sum of a point spread function must be positive, got {values.sum():.4g}: "
                "check the background subtraction."
            )
        values.flags.writeable = False
        for name, value in (("values", values), ("pitch", grid.pitch), ("origin", grid.origin)):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        ny, nx = self.values.shape
        return f"<PSF {ny} x {nx}, pitch {self.pitch[0]:g} x {self.pitch[1]:g} m>"

    @property
    def grid(self) -> Grid:
        """Grid of the samples."""
        ny, nx = self.values.shape
        return Grid((ny, nx), self.pitch, origin=self.origin)

    @property
    def energy(self) -> float:
        """Integral over the window, in units of the values times m^2."""
        return float(self.values.sum() * self.pitch[0] * self.pitch[1])

    def cut(self, centre: Pair, shape: tuple[int, int]) -> PSF:
        """Crop a window about a position.

        Parameters
        ----------
        centre : tuple of float
            Position (y, x) in metres; the nearest sample becomes sample (ny//2, nx//2) of the
            window.
        shape : tuple of int
            Number of samples (ny, nx).

        Raises
        ------
        ValueError
            If the window leaves this one.
        """
        near = [round(float(i)) for i in self._indices(centre)]
        first = [i - n // 2 for i, n in zip(near, shape, strict=True)]
        size = self.values.shape
        if any(a < 0 or a + n > length for a, n, length in zip(first, shape, size, strict=True)):
            raise ValueError(
                f"A window of {tuple(shape)} samples about {tuple(centre)} m does not lie within "
                f"{size} samples: choose a smaller shape."
            )
        part = self.values[first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]
        return PSF(part, self.pitch, (float(self.grid.y[near[0]]), float(self.grid.x[near[1]])))

    def centroid(self, power: float = 2) -> Pair:
        """Compute the centroid (y, x) in metres, weighted by a power of the intensity.

        Parameters
        ----------
        power : float
            Exponent, by default 2: first moments of the sinc^2 and Airy tails of a sharp aperture
            diverge with the window. Negative samples count as 0.

        Raises
        ------
        ValueError
            If the power is not positive.
        """
        if not power > 0:
            raise ValueError(f"power must be positive, got {power!r}.")
        weights = np.maximum(self.values / self.values.max(), 0) ** power
        grid, total = self.grid, weights.sum()
        y, x = weights.sum(axis=1) @ grid.y, weights.sum(axis=0) @ grid.x
        return float(y / total), float(x / total)

    @cached_property
    def peak(self) -> float:
        """Highest intensity, between samples too, by Fourier interpolation."""
        position = np.array(np.unravel_index(np.argmax(self.values), self.values.shape), np.float64)
        best = float(self.values.max())
        for step in (1 / 8, 1 / 64, 1 / 512):
            rows, columns = (i + step * np.arange(-8, 9) for i in position)
            near = interpolated_picture(self.values, rows, columns)
            k, m = np.unravel_index(np.argmax(near), near.shape)
            position, best = np.array((rows[k], columns[m])), max(best, float(near[k, m]))
        return best

    def coordinates(self, axis: int) -> Values:
        """Return coordinates of the samples along y (0) or x (1), in metres."""
        return np.asarray(self.grid.x if check_axis(axis) else self.grid.y, np.float64)

    def profile(
        self, axis: int, *, centre: Pair | None = None, oversampling: int = 1
    ) -> tuple[Values, Values]:
        """Return the line profile through the centre.

        Parameters
        ----------
        axis : int
            Axis: 0 for y, 1 for x.
        centre : tuple of float, optional
            Position (y, x) in metres; default `centroid`.
        oversampling : int
            Number of interpolated samples per sample.

        Returns
        -------
        tuple of numpy.ndarray
            Coordinates along the axis in metres, as in `grid`, and intensities.
        """
        axis = check_axis(axis)
        line = line_of(self.values, axis, self._indices(centre)[1 - axis])
        return self._finer(line, axis, oversampling)

    def line_spread(self, axis: int, *, oversampling: int = 1) -> tuple[Values, Values]:
        """Compute the line spread function: the integral over the other axis.

        Its Fourier transform is the transfer function along the axis (Bracewell 1956).

        Parameters
        ----------
        axis : int
            Axis: 0 for y, 1 for x.
        oversampling : int
            Number of interpolated samples per sample.

        Returns
        -------
        tuple of numpy.ndarray
            Coordinates along the axis in metres, and intensities times metres.
        """
        other = 1 - check_axis(axis)
        return self._finer(self.values.sum(axis=other) * self.pitch[other], axis, oversampling)

    def fwhm(self, axis: int, *, centre: Pair | None = None) -> float:
        """Return the full width at half maximum of `profile`, in metres.

        The profile is Fourier-interpolated by a factor of 16, and linearly between these samples.

        Raises
        ------
        ValueError
            If the line does not fall to half of its maximum within the window.
        """
        x, line = self.profile(axis, centre=centre, oversampling=OVERSAMPLING)
        k, half = int(np.argmax(line)), line.max() / 2
        right = first_fall(x[k:], line[k:], half)
        left = first_fall(x[k::-1], line[k::-1], half)
        if math.isnan(right - left):
            raise ValueError(
                f"The profile along axis {axis} does not fall to half of its maximum within the "
                f"window of {x.size // OVERSAMPLING + 1} samples: take a wider window."
            )
        return right - left

    def encircled_energy(
        self, radii: Any, *, centre: Pair | None = None, total: float | None = None
    ) -> Any:
        """Compute the share of the energy within circles (Born and Wolf 1999, section 8.5.2).

        It integrates the Fourier interpolation: each frequency f adds its amplitude at the centre
        times r J1(2 pi r f)/f, the transform of a disc. Pixels cut by a circle count in part;
        negative values (from a subtracted background) count as they are. The running maximum over
        the radius removes decreases caused by noise, negative values or undersampling.

        Parameters
        ----------
        radii : array_like
            Radii in metres, not negative, of circles within the window.
        centre : tuple of float, optional
            Position (y, x) in metres; default `centroid`.
        total : float, optional
            Energy that counts as 1, in units of `energy`; default that of the window.

        Returns
        -------
        numpy.ndarray or float
            Shares, float64, in the shape of ``radii``.

        Raises
        ------
        ValueError
            If a radius is negative or leaves the window.
        """
        r = self._within(radii, centre, "A radius")
        return self._shares(self._circles(centre, r.max(initial=0.0))(r), total)

    def ensquared_energy(
        self, widths: Any, *, centre: Pair | None = None, total: float | None = None
    ) -> Any:
        """Compute the share of the energy within upright squares, as `encircled_energy`.

        It never falls with the width either.

        Parameters
        ----------
        widths : array_like
            Side lengths in metres, not negative, of squares within the window.
        centre, total
            Centre and energy of `encircled_energy`.

        Raises
        ------
        ValueError
            If a width is negative or leaves the window.
        """
        w = 2 * self._within(np.asarray(widths, np.float64) / 2, centre, "Half a width")
        return self._shares(self._squares(centre, w.max(initial=0.0))(w), total)

    def radius(
        self, fraction: float, *, centre: Pair | None = None, total: float | None = None
    ) -> float:
        """Return the radius in metres of the circle with a share of the energy.

        Parameters
        ----------
        fraction : float
            Share between 0 and 1.
        centre, total
            Centre and energy of `encircled_energy`.

        Raises
        ------
        ValueError
            If the fraction is outside, or the largest circle in the window contains less.
        """
        from scipy.optimize import brentq

        if not 0 < fraction < 1:
            raise ValueError(f"fraction must be between 0 and 1, got {fraction!r}.")
        middle = self.centroid() if centre is None else centre
        far = self._reach(middle)
        energy_within = self._circles(middle, far)

        def missing(r: float) -> float:
            return float(self._shares(energy_within(r), total)) - fraction

        if missing(far) < 0:
            raise ValueError(
                f"The largest circle in the window contains {missing(far) + fraction:.4g} of the "
                f"energy, less than {fraction:.4g}: take a wider window."
            )
        return float(brentq(missing, 0, far, xtol=1e-6 * far, rtol=1e-9))

    def strehl(self, reference: PSF) -> float:
        """Compute the Strehl ratio: the peak over that of a reference of equal energy.

        Born and Wolf 1999, section 9.1. Peaks are interpolated and divided by the energy of their
        window.

        Parameters
        ----------
        reference : PSF
            Point spread function without aberrations, in a window of equal width.
        """
        return (self.peak / self.energy) / (reference.peak / reference.energy)

    def _indices(self, centre: Pair | None) -> Values:
        """Return the fractional indices (row, column) of a position in metres."""
        position = np.asarray(self.centroid() if centre is None else centre, np.float64)
        if position.shape != (2,) or not np.isfinite(position).all():
            raise ValueError(f"centre must be finite (y, x) in metres, got {centre!r}.")
        start = np.array((self.grid.y[0], self.grid.x[0]))
        return (position - start) / np.array(self.pitch)

    def _reach(self, centre: Pair | None) -> float:
        """Return the distance in metres from a position to the nearest border."""
        sides = zip(self._indices(centre), self.values.shape, self.pitch, strict=True)
        return min(min(i + 0.5, n - 0.5 - i) * pitch for i, n, pitch in sides)

    def _within(self, lengths: Any, centre: Pair | None, label: str) -> Values:
        """Return lengths from a position; raise ValueError if any leaves the window."""
        values, reach = np.asarray(lengths, np.float64), self._reach(centre)
        if not ((values >= 0) & (values <= reach * (1 + 1e-12))).all():
            raise ValueError(
                f"{label} must be between 0 and the {reach:.4g} m from the centre to the border of "
                f"the window, got {lengths!r}: take a wider window."
            )
        return values

    def _parts(self, centre: Pair | None) -> Values:
        """Return the real amplitude of every frequency at a position, in FFT order."""
        grid, (row, column) = self.grid, self._indices(centre) * np.array(self.pitch)
        phase = np.multiply.outer(
            np.exp(2j * np.pi * grid.fy * row), np.exp(2j * np.pi * grid.fx * column)
        )
        return np.real(np.fft.fft2(self.values) * phase) / self.values.size

    def _circles(self, centre: Pair | None, far: float) -> MonotoneCurve:
        """Return the energy within circles as a function of the radius."""
        from scipy.special import j0, j1

        r = self._ladder(far)
        f, parts = self._by_length(centre)
        energies, slope = np.empty((2, r.size))
        for k in range(0, r.size, _CHUNK):
            chunk = slice(k, k + _CHUNK)
            turns = 2 * np.pi * np.outer(r[chunk], f)
            safe_turns = np.where(turns == 0, 1, turns)
            disc = np.where(turns == 0, 0.5, j1(turns) / safe_turns)
            energies[chunk] = 2 * np.pi * r[chunk] ** 2 * (disc @ parts)
            slope[chunk] = 2 * np.pi * r[chunk] * (j0(turns) @ parts)
        return MonotoneCurve(r, energies, slope)

    def _squares(self, centre: Pair | None, far: float) -> MonotoneCurve:
        """Return the energy within upright squares as a function of the width."""
        grid, parts, w = self.grid, self._parts(centre), self._ladder(far)
        y, x = (w[:, None] * np.sinc(np.outer(w, f)) for f in (grid.fy, grid.fx))
        dy, dx = (np.cos(np.pi * np.outer(w, f)) for f in (grid.fy, grid.fx))
        energies = np.sum((y @ parts) * x, axis=1)
        return MonotoneCurve(w, energies, np.sum((dy @ parts) * x + (y @ parts) * dx, axis=1))

    def _ladder(self, far: float) -> Values:
        """Return radii or widths from 0 to two steps beyond the largest."""
        step = min(self.pitch) / _STEPS
        return np.asarray(step * np.arange(math.ceil(far / step) + 3), np.float64)

    def _by_length(self, centre: Pair | None) -> tuple[Values, Values]:
        """Rebin frequencies and amplitudes by length, for sums over circles about a position.

        Each amplitude goes to six even bins by Lagrange weights, exact to 7e-8 (Abramowitz 25.2.1).
        """
        grid, parts = self.grid, self._parts(centre).ravel()
        f = np.hypot.outer(grid.fy, grid.fx).ravel()
        step = 1 / (_PER_PERIOD * max(self._reach(centre), min(self.pitch)))
        if f.max() / step + 6 >= f.size:
            return f, parts
        first = np.floor(f / step).astype(np.int64)
        t, sums = f / step - first, np.zeros(int(first.max()) + 6)
        for i in range(-2, 4):
            weight = np.prod([(t - j) / (i - j) for j in range(-2, 4) if j != i], axis=0)
            sums += np.bincount(first + i + 2, weight * parts, sums.size)
        return np.abs(np.arange(sums.size) - 2.0) * step, sums

    def _finer(self, line: Values, axis: int, factor: int) -> tuple[Values, Values]:
        if not is_integer(factor) or factor < 1:
            raise ValueError(f"oversampling must be an integer of at least 1, got {factor!r}.")
        x = self.coordinates(axis)
        if factor == 1:
            return x, line
        steps = np.arange((line.size - 1) * factor + 1)
        fine = np.asarray(x[0] + steps * (self.pitch[axis] / factor), np.float64)
        return fine, interpolated_line(line, factor)

    def _shares(self, energies: Any, total: float | None) -> Any:
        unit = self.energy if total is None else total
        if not unit > 0:
            raise ValueError(f"total must be positive, got {total!r}.")
        shares = np.asarray(energies) / unit
        return float(shares) if shares.ndim == 0 else shares


def wavefront_rms(phase: Any, *, weight: Any = None) -> float:
    """Compute the standard deviation of a wavefront over the pupil.

    Born and Wolf 1999, section 9.1.2.

    Parameters
    ----------
    phase : array_like
        Wavefront phase over the pupil, in radians, of any shape.
    weight : array_like, optional
        Amplitude over the pupil, in the shape of ``phase``, not negative, 0 outside; default 1.

    Returns
    -------
    float
        Standard deviation in radians.

    Raises
    ------
    ShapeError, ValueError
        If the shapes differ, a number is not finite, or the pupil is dark.

    Examples
    --------
    >>> x = np.linspace(-1, 1, 64)
    >>> r2 = x[:, None] ** 2 + x**2
    >>> phase = 2 * np.pi * 0.25 * r2  # a quarter of a wave of defocus
    >>> f"{clplen.analysis.wavefront_rms(phase, weight=r2 <= 1):.2f} rad"
    '0.45 rad'
    """
    phi, w = _pupil(phase, weight)
    mean = np.sum(w * phi) / w.sum()
    return float(np.sqrt(np.sum(w * (phi - mean) ** 2) / w.sum()))


def wavefront_strehl(phase: Any, *, weight: Any = None) -> float:
    """Compute the intensity at the reference point over that of the flat wavefront.

    It is abs(sum w exp(i phase))^2/(sum w)^2 (Born and Wolf 1999, section 9.1.2). Tilt or coma move
    the peak away from the reference point; `PSF.strehl` uses the peak.

    Parameters
    ----------
    phase : array_like
        Wavefront phase over the pupil, in radians, of any shape.
    weight : array_like, optional
        Amplitude over the pupil, in the shape of ``phase``, not negative, 0 outside; default 1.

    Returns
    -------
    float
        Strehl ratio, between 0 and 1.

    Raises
    ------
    ShapeError, ValueError
        If the shapes differ, a number is not finite, or the pupil is dark.

    Examples
    --------
    >>> x = np.linspace(-1, 1, 64)
    >>> r2 = x[:, None] ** 2 + x**2
    >>> phase = 2 * np.pi * 0.25 * r2  # a quarter of a wave of defocus
    >>> f"{clplen.analysis.wavefront_strehl(phase, weight=r2 <= 1):.2f}"
    '0.81'
    """
    phi, w = _pupil(phase, weight)
    return float(np.abs(np.sum(w * np.exp(1j * phi)) / w.sum()) ** 2)


def strehl_of_rms(rms: Any) -> Any:
    """Compute the Strehl ratio exp(-sigma^2) of a wavefront with a small rms (Mahajan 1983).

    Marechal's (1 - sigma^2/2)^2 (Born and Wolf 1999, section 9.3) has equal first terms.

    Parameters
    ----------
    rms : array_like
        Standard deviation sigma in radians, not negative; the ratio is accurate to a few hundredths
        up to a sigma of about 1.

    Returns
    -------
    numpy.ndarray or float
        Strehl ratio, between 0 and 1, float64, of the shape of ``rms``.

    Raises
    ------
    ValueError
        If a number is negative or not finite.

    Examples
    --------
    >>> f"{clplen.analysis.strehl_of_rms(2 * np.pi / 14):.2f}"  # Marechal's limit of lam/14
    '0.82'
    """
    sigma = real_array(rms, "The rms of a wavefront", np.float64)
    if not (np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise ValueError(f"rms must be finite and not negative, got {rms!r}.")
    ratio = np.exp(-(sigma**2))
    return float(ratio) if ratio.ndim == 0 else ratio


def _pupil(phase: Any, weight: Any) -> tuple[Any, Any]:
    values, mask = masked_array(phase, "A phase")
    phi = real_array(values, "A phase", np.float64)
    w = np.ones(phi.shape) if weight is None else real_array(weight, "weight", np.float64)
    if mask is not None and w.shape == phi.shape:
        phi, w = np.where(mask, 0, phi), np.where(mask, 0, w)
    if w.shape != phi.shape:
        raise ShapeError(f"weight must have the phase's shape {phi.shape}, got {w.shape}.")
    if not (np.isfinite(phi).all() and np.isfinite(w).all() and (w >= 0).all() and w.sum() > 0):
        raise ValueError(
            "phase and weight must be finite, and weight must not be negative nor all 0."
        )
    return phi, w
