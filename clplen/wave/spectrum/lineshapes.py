"""Shapes of spectra over frequency: Gaussian or sharp lines, a rectangle, a table.

Each has unit power and provides its density S(nu), its samples at equal steps of frequency, and its
complex degree of temporal coherence

    gamma(tau) = int S(nu) exp(-2 pi i nu tau) dnu

(Goodman, Statistical Optics, 1985, section 5.1.3), in float64 on the host.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import hermite, legendre
from numpy.typing import ArrayLike

from clplen.reprs import OneLine

C = 299_792_458.0  # m/s, speed of light in vacuum
WIDEST_PIECE = 1.5  # maximum ratio of the end wavelengths of a piece of a table
ROUNDING = 1e-17  # relative size at which a Legendre series is truncated
MIN_NODES = 8  # minimum number of nodes of a piece
MAX_NODES_SINGLE, MAX_NODES_SHARED = 4, 8  # Gauss-Hermite samples of one or several lines
BLOCK = 2**16  # numbers in memory at a time

Vector = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]
Sampling = tuple[Vector, Vector, float]  # frequencies, weights of sum 1, step in Hz


class Shape(Protocol):
    """Spectral density over frequency, as used by `Spectrum`."""

    @property
    def mean(self) -> float:
        """Mean frequency in Hz."""

    @property
    def width(self) -> float:
        """Width in Hz of the band with light; 0 for a single frequency."""

    @property
    def square(self) -> float:
        """Integral of S^2 over nu in seconds, equal to that of |gamma|^2 over tau (Parseval)."""

    def density(self, nu: Vector) -> Vector:
        """Return S(nu) per Hz."""

    def gamma(self, tau: Vector) -> Complex:
        """Return gamma at delays in seconds, shape (n,)."""

    def sample(self, n: int, span: float) -> Sampling:
        """Return samples at n frequencies."""

    def needed(self, delay: float, span: float) -> int:
        """Return the number of samples that follow gamma up to a delay; see `Spectrum.needed`."""


@dataclass(frozen=True)
class Lines:
    """Gaussian lines, or sharp lines if the widths are 0."""

    centres: tuple[float, ...]
    widths: tuple[float, ...]
    powers: tuple[float, ...]

    @property
    def is_sharp(self) -> bool:
        """True if the lines have no width."""
        return self.widths[0] == 0

    @property
    def mean(self) -> float:
        return float(np.dot(self.powers, self.centres))

    @property
    def width(self) -> float:
        reach = 2 * np.array(self.widths)
        return float((self.centres + reach).max() - (self.centres - reach).min())

    @property
    def square(self) -> float:
        if self.is_sharp:
            return math.inf
        nu, width, power = (np.array(a) for a in (self.centres, self.widths, self.powers))
        both = width[:, None] ** 2 + width**2  # a product of Gaussians integrates to a Gaussian
        overlap = np.exp(-4 * np.log(2) * (nu[:, None] - nu) ** 2 / both)
        return float(power @ (2 * np.sqrt(np.log(2) / np.pi / both) * overlap) @ power)

    def density(self, nu: Vector) -> Vector:
        total = np.zeros_like(nu)
        for centre, width, power in zip(self.centres, self.widths, self.powers, strict=True):
            peak = 2 * math.sqrt(math.log(2) / math.pi) / width
            total += power * peak * np.exp(-4 * math.log(2) * ((nu - centre) / width) ** 2)
        return total

    def gamma(self, tau: Vector) -> Complex:
        total = np.zeros(tau.shape, dtype=complex)
        for centre, width, power in zip(self.centres, self.widths, self.powers, strict=True):
            envelope = np.exp(-((np.pi * width * tau) ** 2) / (4 * math.log(2)))
            total += power * envelope * np.exp(-2j * np.pi * centre * tau)
        return total

    def sample(self, n: int, span: float) -> Sampling:
        if self.is_sharp:
            return np.array(self.centres), np.array(self.powers), 0.0
        nu, weights, steps = [], [], []
        max_nodes = MAX_NODES_SINGLE if len(self.centres) == 1 else MAX_NODES_SHARED
        for centre, width, power, count in zip(
            self.centres, self.widths, self.powers, self._shared(n), strict=True
        ):
            t, w = _nodes(count) if count <= max_nodes else _steps(count, span)
            nu.append(centre + width * t)
            weights.append(power * w)
            steps.append(width * np.diff(t).max() if count > 1 else math.inf)
        return np.concatenate(nu), np.concatenate(weights), float(max(steps))

    def _shared(self, n: int) -> list[int]:
        """Return the number of samples of each line, at least 1; the strongest get the rest."""
        lines = len(self.centres)
        if n < lines:
            return [1] * lines
        counts = np.full(lines, n // lines)
        counts[np.argsort(self.powers)[::-1][: n % lines]] += 1
        return [int(count) for count in counts]

    def needed(self, delay: float, span: float) -> int:
        if self.is_sharp:
            return len(self.centres)
        time = [math.sqrt(2 * math.log(2) / math.pi) / width for width in self.widths]
        bands = [2 * span * width for width in self.widths]
        counts = [min_samples(b * (delay + 1.5 * t)) for b, t in zip(bands, time, strict=True)]
        return len(counts) * max(counts)


@dataclass(frozen=True)
class Rectangle:
    """Constant density between two frequencies in Hz."""

    low: float
    high: float

    @property
    def mean(self) -> float:
        return (self.low + self.high) / 2

    @property
    def width(self) -> float:
        return self.high - self.low

    @property
    def square(self) -> float:
        return 1 / self.width

    def density(self, nu: Vector) -> Vector:
        return np.where((nu >= self.low) & (nu <= self.high), 1 / self.width, 0.0)

    def gamma(self, tau: Vector) -> Complex:
        return np.sinc(self.width * tau) * np.exp(-2j * np.pi * self.mean * tau)

    def sample(self, n: int, span: float) -> Sampling:
        step = self.width / n
        nu = np.linspace(self.low + step / 2, self.high - step / 2, n)
        return nu, np.full(n, 1 / n), _step(step, n)

    def needed(self, delay: float, span: float) -> int:
        return min_samples(self.width * (delay + 1.5 * self.square))


@dataclass(frozen=True)
class Table:
    """Density per wavelength, linear between its points and 0 outside."""

    wavelengths: tuple[float, ...]
    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        nu, mass = self._points
        return float(nu @ mass)

    @property
    def width(self) -> float:
        return C / self.wavelengths[0] - C / self.wavelengths[-1]

    @property
    def square(self) -> float:
        nu, mass = self._points
        return float(mass @ self.density(nu))

    @cached_property
    def _power(self) -> float:
        lam, values = np.array(self.wavelengths), np.array(self.values)
        return float((values[1:] + values[:-1]) @ np.diff(lam) / 2)

    def density(self, nu: Vector) -> Vector:
        """Return S(nu) = S(lam) |dlam/dnu| with lam = c/nu and |dlam/dnu| = c/nu^2."""
        is_positive = nu > 0
        lam = C / np.where(is_positive, nu, 1.0)
        values = np.interp(lam, self.wavelengths, self.values, left=0.0, right=0.0)
        return np.where(is_positive, values * lam**2 / (C * self._power), 0.0)

    def gamma(self, tau: Vector) -> Complex:
        """Return the sum over pieces of h exp(-2 pi i m tau) sum_k a_k 2 (-i)^k j_k(2 pi h tau).

        m and h are the centre and the half width of a piece in Hz, a_k its Legendre series. The
        transform of P_k is 2 (-i)^k j_k (DLMF, eq. 18.17.19).
        """
        from scipy import special  # a local import, a third of the package's import time

        middle, half, series = self._pieces
        total = np.zeros(tau.shape, dtype=complex)
        size = max(1, BLOCK // middle.size)
        for start in range(0, tau.size, size):
            turns = 2 * np.pi * tau[start : start + size, None]
            parts = [np.zeros((len(turns), middle.size)) for _ in range(2)]  # real, -imaginary
            for k, coefficients in enumerate(series):
                bessel = special.spherical_jn(k, half * turns)
                parts[k % 2] += (-1) ** (k // 2) * coefficients * bessel
            cos, sin = np.cos(middle * turns), np.sin(middle * turns)
            even, odd = parts
            real, imaginary = even * cos - odd * sin, even * sin + odd * cos
            total[start : start + size] = 2 * (real - 1j * imaginary) @ half
        return total

    def sample(self, n: int, span: float) -> Sampling:
        """Return the centres of n cells without dark cells; weights are the powers of the cells."""
        edges = np.linspace(C / self.wavelengths[-1], C / self.wavelengths[0], n + 1)
        nu, mass = self._masses(edges)
        cell = np.clip(np.searchsorted(edges, nu) - 1, 0, n - 1)
        weights = np.bincount(cell, mass, n)
        step, lit = self.width / n, weights > 0
        return (edges[:-1] + step / 2)[lit], weights[lit] / weights.sum(), _step(step, n)

    def needed(self, delay: float, span: float) -> int:
        return min_samples(self.width * (delay + 1.5 * self.square))

    @cached_property
    def _points(self) -> tuple[Vector, Vector]:
        return self._masses()

    def _masses(self, cuts: Vector | None = None) -> tuple[Vector, Vector]:
        """Return the frequencies of a quadrature exact to rounding, and the power at each."""
        middle, half, nodes, weights = self._quadrature(cuts)
        nu = middle[:, None] + half[:, None] * nodes
        return nu.ravel(), (self.density(nu) * half[:, None] * weights).ravel()

    @cached_property
    def _pieces(self) -> tuple[Vector, Vector, Vector]:
        """Centre and half width of each piece in Hz, shape (m,), and Legendre series (k, m)."""
        middle, half, nodes, weights = self._quadrature()
        density = self.density(middle[:, None] + half[:, None] * nodes)
        order = np.arange(nodes.size)
        basis = legendre.legvander(nodes, nodes.size - 1) * weights[:, None]
        return middle, half, (density @ basis * (order + 0.5)).T

    def _quadrature(self, cuts: Vector | None = None) -> tuple[Vector, Vector, Vector, Vector]:
        """Return pieces with a smooth density, and Gauss-Legendre nodes and weights in [-1, 1].

        The Legendre series falls geometrically (Trefethen, SIAM Review 50, 67 (2008)).
        """
        knots = np.array(self.wavelengths)
        splits = np.ceil(np.log(knots[1:] / knots[:-1]) / math.log(WIDEST_PIECE)).astype(int)
        ends = [
            np.geomspace(*pair, count + 1)[1:-1]
            for pair, count in zip(pairwise(knots), splits, strict=True)
        ]
        edges = C / np.concatenate([knots, *ends])
        edges = np.unique(edges if cuts is None else np.concatenate([edges, cuts]))
        middle, half = (edges[1:] + edges[:-1]) / 2, (edges[1:] - edges[:-1]) / 2
        pole = float((middle / half).min())
        # The series falls as rho^-k, rho = x + sqrt(x^2 - 1), for the pole (nu = 0) of the density
        # at -x on the scale of the piece (Bernstein's ellipse).
        rate = math.log(pole + math.sqrt(pole**2 - 1))
        count = max(MIN_NODES, 1 + math.ceil(-math.log(ROUNDING) / rate))
        nodes, weights = legendre.leggauss(count)
        return middle, half, nodes, weights


def _steps(count: int, span: float) -> tuple[Vector, Vector]:
    """Return equal steps over +-span FWHM of a Gaussian, and weights of sum 1."""
    t = np.linspace(-span, span, count)
    w = np.exp(-4 * math.log(2) * t**2)
    return t, w / w.sum()


def _nodes(count: int) -> tuple[Vector, Vector]:
    """Return Gauss-Hermite nodes of a Gaussian in FWHM, and weights of sum 1.

    They are exact for powers up to 2 count - 1 (Abramowitz & Stegun, 1964, eq. 25.4.46).
    """
    x, w = hermite.hermgauss(count)  # for exp(-x^2)
    return x / (2 * math.sqrt(math.log(2))), w / w.sum()


def min_samples(turns: float) -> int:
    """Return the number of samples 1 + turns, rounded up: at most a turn per step."""
    return 1 + math.ceil(turns * (1 - 1e-12))


def _step(step: float, n: int) -> float:
    """Return the step, or infinity for a single sample, which never loses its coherence."""
    return step if n > 1 else math.inf


DELAYS = 4096  # number of delays in a block


@dataclass(frozen=True, eq=False, repr=False)
class SpectralSamples(OneLine):
    """Samples of a spectrum at a few wavelengths.

    Parameters
    ----------
    wavelengths : numpy.ndarray
        Wavelengths in metres, shape (n,), float64.
    weights : numpy.ndarray
        Shares of the power, shape (n,), float64, sum 1.
    step : float
        Step in Hz, the largest of several. It is 0 if the samples are the complete spectrum (sharp
        lines), infinite for a single sample of a band or of a line with a width.

    Examples
    --------
    >>> samples = clplen.Spectrum.gaussian(550e-9, 30e-9).sample(5)
    >>> np.round(samples.wavelengths * 1e9, 1).tolist()
    [617.3, 581.7, 550.0, 521.6, 495.9]
    >>> f"{samples.weights.sum():.3f}", f"coherent again at {samples.revival * 1e6:.1f} um"
    ('1.000', 'coherent again at 10.1 um')
    """

    wavelengths: Vector
    weights: Vector
    step: float

    @property
    def revival(self) -> float:
        """Path difference c/step in metres at which light of these samples is coherent again.

        The revival is complete for equal steps, else partial.
        """
        return math.inf if self.step == 0 else C / self.step

    def gamma(self, tau: ArrayLike) -> Complex:
        """Return the complex degree of temporal coherence at delays in seconds.

        Parameters
        ----------
        tau : array_like
            Delays in seconds, of any shape.

        Returns
        -------
        numpy.ndarray
            Sum of weight exp(-2 pi i nu tau), complex128, with the shape of ``tau``.
        """
        delays = np.asarray(tau, dtype=float)
        nu = C / self.wavelengths
        blocks = [np.exp(-2j * np.pi * part * nu) @ self.weights for part in _blocks(delays)]
        return np.concatenate(blocks).reshape(delays.shape)


def _blocks(delays: Vector) -> list[Vector]:
    """Split delays into columns of limited length."""
    return np.array_split(delays.reshape(-1, 1), max(1, math.ceil(delays.size / DELAYS)))
