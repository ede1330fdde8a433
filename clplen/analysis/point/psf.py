"""Point spread functions: where they lie, how wide they are, what they hold; Strehl ratios."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from clplen.analysis.point.samples import (
    Pair,
    Values,
    between,
    check_axis,
    checked,
    finer,
    first_fall,
    line_of,
)
from clplen.checks import is_integer, masked_array, real_array
from clplen.compute.arrays import HostArray
from clplen.errors import ShapeError
from clplen.results import Plottable
from clplen.wave.field.field import Grid

FINER = 16  # samples for one, in which a width is looked for
_STEPS = 16  # a sample, on which energies within circles are found
_ROWS = 64  # of them at once
_PER_TURN = 40  # lengths of frequencies for each turn of the largest circle's transform


class Rising:
    """A curve from 0 on that never falls.

    On the steps of a ladder it has the largest value up to there, between them it is a cubic with
    the slopes given, as far as it does not fall with them (Fritsch and Carlson 1980, eq. 4, the
    square of side 3).
    """

    def __init__(self, steps: Values, values: Values, slopes: Values) -> None:
        from scipy.interpolate import CubicHermiteSpline

        high = np.maximum.accumulate(np.maximum(values, 0))
        rise = np.diff(high) / np.diff(steps)
        most = 3 * np.minimum(np.append(rise, rise[-1]), np.insert(rise, 0, rise[0]))
        self._curve = CubicHermiteSpline(steps, high, np.clip(slopes, 0, most))
        self._steps, self._high = steps, high

    def __call__(self, x: Any) -> Any:
        k = np.clip(np.searchsorted(self._steps, x, side="right") - 1, 0, self._steps.size - 2)
        return np.clip(self._curve(x), self._high[k], self._high[k + 1])  # against rounding


@dataclass(frozen=True, eq=False, repr=False)
class PSF(Plottable, HostArray):
    """The intensity that one point gives, on the host.

    Between samples it is read by Fourier interpolation, which is exact where the samples resolve
    it and the window holds it all. The window's own background is not taken off.

    Attributes
    ----------
    values : numpy.ndarray
        Intensities [y, x], float64, at least 4 samples a side.
    pitch : tuple of float
        (dy, dx) in metres; one number is taken for both.
    origin : tuple of float
        (y, x) of sample (ny//2, nx//2) in metres.

    Raises
    ------
    ShapeError
        If the values are not two-dimensional, or too few.
    ValueError
        If values are not finite and real, their sum is not positive, or the pitch or origin is no
        pair of finite numbers.

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
        values = checked(self.values, "A point spread function", least=4)
        grid = Grid((values.shape[0], values.shape[1]), self.pitch, origin=self.origin)
        if not values.sum() > 0:
            raise ValueError(
                f"A point spread function has a positive sum, not {values.sum():.4g}: was a "
                "background taken off?"
            )
        values.flags.writeable = False
        for name, value in (("values", values), ("pitch", grid.pitch), ("origin", grid.origin)):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        ny, nx = self.values.shape
        return f"<PSF {ny} x {nx}, pitch {self.pitch[0]:g} x {self.pitch[1]:g} m>"

    @property
    def grid(self) -> Grid:
        """Where the samples lie."""
        ny, nx = self.values.shape
        return Grid((ny, nx), self.pitch, origin=self.origin)

    @property
    def energy(self) -> float:
        """Integral over the window, in units of the values times m^2."""
        return float(self.values.sum() * self.pitch[0] * self.pitch[1])

    def cut(self, centre: Pair, shape: tuple[int, int]) -> PSF:
        """The window of so many samples about a place.

        Parameters
        ----------
        centre : tuple of float
            (y, x) in metres; the sample nearest to it is sample (ny//2, nx//2) of the window.
        shape : tuple of int
            (ny, nx).

        Raises
        ------
        ValueError
            If the window does not lie within this one.
        """
        near = [round(float(i)) for i in self._indices(centre)]
        first = [i - n // 2 for i, n in zip(near, shape, strict=True)]
        size = self.values.shape
        if any(a < 0 or a + n > whole for a, n, whole in zip(first, shape, size, strict=True)):
            raise ValueError(
                f"A window of {tuple(shape)} samples about {tuple(centre)} m does not lie within "
                f"{size} samples: take a smaller one."
            )
        part = self.values[first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]
        return PSF(part, self.pitch, (float(self.grid.y[near[0]]), float(self.grid.x[near[1]])))

    def centroid(self, power: float = 2) -> Pair:
        """Centre of gravity (y, x) in metres, weighted by a power of the intensity.

        Parameters
        ----------
        power : float
            2 by default: first moments of the sinc^2 and Airy tails of an aperture with an edge
            diverge with the window. Negative samples count 0.

        Raises
        ------
        ValueError
            If the power is not positive.
        """
        if not power > 0:
            raise ValueError(f"The power of the weights is positive, not {power!r}.")
        weights = np.maximum(self.values / self.values.max(), 0) ** power
        grid, total = self.grid, weights.sum()
        y, x = weights.sum(axis=1) @ grid.y, weights.sum(axis=0) @ grid.x
        return float(y / total), float(x / total)

    @cached_property
    def peak(self) -> float:
        """Highest intensity, between samples too, by Fourier interpolation about the brightest."""
        place = np.array(np.unravel_index(np.argmax(self.values), self.values.shape), np.float64)
        best = float(self.values.max())
        for step in (1 / 8, 1 / 64, 1 / 512):
            rows, columns = (i + step * np.arange(-8, 9) for i in place)
            near = between(self.values, rows, columns)
            k, m = np.unravel_index(np.argmax(near), near.shape)
            place, best = np.array((rows[k], columns[m])), max(best, float(near[k, m]))
        return best

    def coordinates(self, axis: int) -> Values:
        """Of the samples along y (0) or x (1), in metres."""
        return np.asarray(self.grid.x if check_axis(axis) else self.grid.y, np.float64)

    def profile(
        self, axis: int, *, centre: Pair | None = None, oversampling: int = 1
    ) -> tuple[Values, Values]:
        """The line through the centre.

        Parameters
        ----------
        axis : int
            0 along y, 1 along x.
        centre : tuple of float, optional
            (y, x) in metres; default `centroid`.
        oversampling : int
            Samples in the place of one.

        Returns
        -------
        tuple of numpy.ndarray
            Coordinates along the axis in metres, as in `grid`, and intensities.
        """
        axis = check_axis(axis)
        line = line_of(self.values, axis, self._indices(centre)[1 - axis])
        return self._finer(line, axis, oversampling)

    def line_spread(self, axis: int, *, oversampling: int = 1) -> tuple[Values, Values]:
        """The image of a line: the integral over the other axis.

        Its Fourier transform is the transfer function along the axis (Bracewell 1956).

        Parameters
        ----------
        axis : int
            0 along y, 1 along x.
        oversampling : int
            Samples in the place of one.

        Returns
        -------
        tuple of numpy.ndarray
            Coordinates along the axis in metres, and intensities times metres.
        """
        other = 1 - check_axis(axis)
        return self._finer(self.values.sum(axis=other) * self.pitch[other], axis, oversampling)

    def fwhm(self, axis: int, *, centre: Pair | None = None) -> float:
        """Full width at half maximum of `profile`, in metres.

        The maximum and the two nearest places at which the line has half of it are found on 16
        Fourier-interpolated samples for one, by a straight line between them.

        Raises
        ------
        ValueError
            If the line does not fall to half of its maximum within the window.
        """
        x, line = self.profile(axis, centre=centre, oversampling=FINER)
        k, half = int(np.argmax(line)), line.max() / 2
        right = first_fall(x[k:], line[k:], half)
        left = first_fall(x[k::-1], line[k::-1], half)
        if math.isnan(right - left):
            raise ValueError(
                f"The profile along axis {axis} does not fall to half of its maximum within the "
                f"window of {x.size // FINER + 1} samples: take a wider window."
            )
        return right - left

    def encircled_energy(
        self, radii: Any, *, centre: Pair | None = None, total: float | None = None
    ) -> Any:
        """Share of the energy within circles (Born and Wolf 1999, section 8.5.2).

        The integral of the Fourier interpolation: each frequency f adds its amplitude at the centre
        times r J1(2 pi r f)/f, the transform of a disc. Samples that lie partly in a circle count
        with that part, negative ones (a background taken off) as they are. Where they, noise, or
        samples that do not resolve the image make a circle hold less than a smaller one, it counts
        as much as that: the share never falls with the radius.

        Parameters
        ----------
        radii : array_like
            In metres, not negative, of circles that lie within the window.
        centre : tuple of float, optional
            (y, x) in metres; default `centroid`.
        total : float, optional
            Energy that counts as 1, in units of `energy`; default that of the window.

        Returns
        -------
        numpy.ndarray or float
            float64, of the shape of ``radii``.

        Raises
        ------
        ValueError
            If a radius is negative, or larger.
        """
        r = self._within(radii, centre, "A radius")
        return self._shares(self._circles(centre, r.max(initial=0.0))(r), total)

    def ensquared_energy(
        self, widths: Any, *, centre: Pair | None = None, total: float | None = None
    ) -> Any:
        """Share of the energy within upright squares, as `encircled_energy` in circles.

        It never falls with the width, in the same way.

        Parameters
        ----------
        widths : array_like
            Of the sides, in metres, not negative, of squares that lie within the window.
        centre, total
            As in `encircled_energy`.

        Raises
        ------
        ValueError
            If a width is negative, or larger.
        """
        w = 2 * self._within(np.asarray(widths, np.float64) / 2, centre, "Half a width")
        return self._shares(self._squares(centre, w.max(initial=0.0))(w), total)

    def radius(
        self, fraction: float, *, centre: Pair | None = None, total: float | None = None
    ) -> float:
        """Radius in metres of the circle that holds a share of the energy.

        Parameters
        ----------
        fraction : float
            Between 0 and 1.
        centre, total
            As in `encircled_energy`.

        Raises
        ------
        ValueError
            If the fraction is outside, or the largest circle in the window holds less.
        """
        from scipy.optimize import brentq

        if not 0 < fraction < 1:
            raise ValueError(f"A share of the energy lies between 0 and 1, not {fraction!r}.")
        middle = self.centroid() if centre is None else centre
        far = self._reach(middle)
        held = self._circles(middle, far)

        def missing(r: float) -> float:
            return float(self._shares(held(r), total)) - fraction

        if missing(far) < 0:
            raise ValueError(
                f"The largest circle in the window holds {missing(far) + fraction:.4g} of the "
                f"energy, less than {fraction:.4g}: take a wider window."
            )
        return float(brentq(missing, 0, far, xtol=1e-6 * far, rtol=1e-9))

    def strehl(self, reference: PSF) -> float:
        """Strehl ratio: the peak over that of a reference of equal energy.

        Born and Wolf 1999, section 9.1; both peaks are those between samples, and each counts for
        the energy of its own window.

        Parameters
        ----------
        reference : PSF
            Without aberrations, of a window as wide.
        """
        return (self.peak / self.energy) / (reference.peak / reference.energy)

    def _indices(self, centre: Pair | None) -> Values:
        """Fractional indices (row, column) of a place in metres."""
        place = np.asarray(self.centroid() if centre is None else centre, np.float64)
        if place.shape != (2,) or not np.isfinite(place).all():
            raise ValueError(f"A centre is finite, (y, x) in metres, not {centre!r}.")
        start = np.array((self.grid.y[0], self.grid.x[0]))
        return (place - start) / np.array(self.pitch)

    def _reach(self, centre: Pair | None) -> float:
        """Metres from a place to the nearest border of the window."""
        sides = zip(self._indices(centre), self.values.shape, self.pitch, strict=True)
        return min(min(i + 0.5, n - 0.5 - i) * pitch for i, n, pitch in sides)

    def _within(self, lengths: Any, centre: Pair | None, what: str) -> Values:
        """Lengths from a place that do not leave the window."""
        values, reach = np.asarray(lengths, np.float64), self._reach(centre)
        if not ((values >= 0) & (values <= reach * (1 + 1e-12))).all():
            raise ValueError(
                f"{what} lies between 0 and the {reach:.4g} m from the centre to the border of the "
                f"window, unlike {lengths!r}: take a wider window."
            )
        return values

    def _parts(self, centre: Pair | None) -> Values:
        """Real amplitude at a place of every frequency, FFT order; they sum to the value there."""
        grid, (row, column) = self.grid, self._indices(centre) * np.array(self.pitch)
        phase = np.multiply.outer(
            np.exp(2j * np.pi * grid.fy * row), np.exp(2j * np.pi * grid.fx * column)
        )
        return np.real(np.fft.fft2(self.values) * phase) / self.values.size

    def _circles(self, centre: Pair | None, far: float) -> Rising:
        """Energy within circles up to a radius."""
        from scipy.special import j0, j1

        r = self._ladder(far)
        f, parts = self._by_length(centre)
        held, slope = np.empty((2, r.size))
        for k in range(0, r.size, _ROWS):
            some = slice(k, k + _ROWS)
            turns = 2 * np.pi * np.outer(r[some], f)
            near_0 = np.where(turns == 0, 1, turns)
            disc = np.where(turns == 0, 0.5, j1(turns) / near_0)
            held[some] = 2 * np.pi * r[some] ** 2 * (disc @ parts)
            slope[some] = 2 * np.pi * r[some] * (j0(turns) @ parts)
        return Rising(r, held, slope)

    def _squares(self, centre: Pair | None, far: float) -> Rising:
        """Energy within upright squares up to a width."""
        grid, parts, w = self.grid, self._parts(centre), self._ladder(far)
        y, x = (w[:, None] * np.sinc(np.outer(w, f)) for f in (grid.fy, grid.fx))
        dy, dx = (np.cos(np.pi * np.outer(w, f)) for f in (grid.fy, grid.fx))
        held = np.sum((y @ parts) * x, axis=1)
        return Rising(w, held, np.sum((dy @ parts) * x + (y @ parts) * dx, axis=1))

    def _ladder(self, far: float) -> Values:
        """Radii or widths on which energies are found, from 0 to the second beyond the largest."""
        step = min(self.pitch) / _STEPS
        return np.asarray(step * np.arange(math.ceil(far / step) + 3), np.float64)

    def _by_length(self, centre: Pair | None) -> tuple[Values, Values]:
        """Lengths of few frequencies and amplitudes at a place, for sums over circles about it.

        The amplitude of every frequency goes to the six nearest of evenly spaced lengths by
        Lagrange's polynomials (Abramowitz and Stegun 1964, eq. 25.2.1), which is right to 7e-8.
        """
        grid, parts = self.grid, self._parts(centre).ravel()
        f = np.hypot.outer(grid.fy, grid.fx).ravel()
        step = 1 / (_PER_TURN * max(self._reach(centre), min(self.pitch)))
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
            raise ValueError(f"oversampling is a whole number of at least 1, not {factor!r}.")
        x = self.coordinates(axis)
        if factor == 1:
            return x, line
        steps = np.arange((line.size - 1) * factor + 1)
        fine = np.asarray(x[0] + steps * (self.pitch[axis] / factor), np.float64)
        return fine, finer(line, factor)

    def _shares(self, held: Any, total: float | None) -> Any:
        whole = self.energy if total is None else total
        if not whole > 0:
            raise ValueError(f"The energy that counts as 1 is positive, not {total!r}.")
        shares = np.asarray(held) / whole
        return float(shares) if shares.ndim == 0 else shares


def wavefront_rms(phase: Any, *, weight: Any = None) -> float:
    """Return the standard deviation of a wavefront over the pupil.

    Born and Wolf 1999, section 9.1.2.

    Parameters
    ----------
    phase : array_like
        Of the wavefront over the pupil, in radians, of any shape.
    weight : array_like, optional
        Amplitude over the pupil, same shape, not negative: 0 outside; default 1.

    Returns
    -------
    float
        In radians, not negative.

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
    """Return the intensity on the reference point over that of the flat wavefront.

    It is abs(sum w exp(i phase))^2/(sum w)^2 (Born and Wolf 1999, section 9.1.2). The peak itself
    may lie beside that point: `PSF.strehl` finds it.

    Parameters
    ----------
    phase : array_like
        Of the wavefront over the pupil, in radians, of any shape.
    weight : array_like, optional
        Amplitude over the pupil, same shape, not negative: 0 outside; default 1.

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
    """Return the Strehl ratio exp(-sigma^2) of a wavefront with a small rms (Mahajan 1983).

    Marechal's (1 - sigma^2/2)^2 (Born and Wolf 1999, section 9.3) has the same first terms.

    Parameters
    ----------
    rms : array_like
        Standard deviation sigma in radians, not negative; the ratio is right within a few
        hundredths up to about 1.

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
        raise ValueError(f"The rms of a wavefront is finite and not negative, not {rms!r}.")
    found = np.exp(-(sigma**2))
    return float(found) if found.ndim == 0 else found


def _pupil(phase: Any, weight: Any) -> tuple[Any, Any]:
    given, mask = masked_array(phase, "A phase")
    phi = real_array(given, "A phase", np.float64)
    w = np.ones(phi.shape) if weight is None else real_array(weight, "weight", np.float64)
    if mask is not None and w.shape == phi.shape:
        phi, w = np.where(mask, 0, phi), np.where(mask, 0, w)
    if w.shape != phi.shape:
        raise ShapeError(f"The phase has shape {phi.shape}, its weights {w.shape}.")
    if not (np.isfinite(phi).all() and np.isfinite(w).all() and (w >= 0).all() and w.sum() > 0):
        raise ValueError(
            "Phase and weights of a wavefront are finite, and the weights not negative nor all 0."
        )
    return phi, w
