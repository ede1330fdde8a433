"""The Rayleigh-Sommerfeld integral in one step: a chirp-z transform between two chirps.

r is the path between an input point and an output point. Relative to the centres of the two grids,
t is the position on the smaller grid and d on the larger, c the vector between the centres. Then
r = R(c + d) - s0 t - D d t + D t^2/2 + remainder, with the path R from the centre of the smaller
grid to each sample of the larger grid, its slope s0 at c and its second derivative D along each
axis. All terms but the remainder are factors on each grid and a chirp-z transform with the samples
of both grids. The remainder, and the change of the amplitude with t, are a power series in t with
coefficients on the larger grid; each further term needs another chirp-z transform.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum
from clplen.compute.fft.lines import Line, Separable, chirp_z, identity
from clplen.wave.field.transmission import phasor
from clplen.wave.propagation.description import FARTHEST, Request
from clplen.wave.propagation.transfer_function import line_samples

Vector = np.ndarray[Any, Any]
Powers = tuple[int, int]

TOLERANCE = 1e-9  # relative error of the field, 180 dB, as with a guard of 6 Fresnel widths
MAX_ERROR = 1e-2  # relative error above which the series may diverge
MAX_POWERS = 6  # maximum power of t
_LATTICE = 17  # points along each axis at which the remainder is evaluated for its bound
_SAFETY = 1.1  # margin of the largest value on these points for the maximum
_ROWS = 64  # rows of the larger grid whose coefficients are computed at a time


@dataclass(frozen=True, eq=False)
class Series:
    """Power series of a request, about the input (``inward``) or about the output."""

    request: Request
    # True if t is on the input and the coefficients are on the output; False for the reverse
    inward: bool

    @property
    def side(self) -> float:
        """Sign of z, 1 or -1."""
        return math.copysign(1.0, self.request.z)

    @cached_property
    def middle(self) -> tuple[float, float]:
        """Vector c (y, x) from the centre of the input to that of the output, in metres."""
        source, target = self.request.grid, self.request.target
        y, x = (
            0.0 if n == 1 else b - a
            for n, a, b in zip(source.shape, source.origin, target.origin, strict=True)
        )
        return (y, x)

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Slope s0 along (y, x)."""
        distance = math.hypot(*self.middle, self.request.z)
        return (self.middle[0] / distance, self.middle[1] / distance)

    @cached_property
    def bends(self) -> tuple[float, float]:
        """Second derivative D along (y, x), in cycles per metre."""
        distance = math.hypot(*self.middle, self.request.z)
        y, x = ((1 - slope**2) / distance for slope in self.slopes)
        return (y, x)

    def _half(self, axis: int, *, small: bool) -> float:
        """Return the largest abs(t), or abs(d), along an axis in metres."""
        r = self.request
        if r.grid.shape[axis] == 1:
            return 0.0
        if small == self.inward:
            return min(r.grid.shape[axis] // 2 * r.grid.pitch[axis], r.span(axis).lit / 2)
        return r.target.shape[axis] // 2 * r.target.pitch[axis]

    @cached_property
    def halves(self) -> tuple[float, float]:
        """Largest abs(t) along (y, x) in metres."""
        return (self._half(0, small=True), self._half(1, small=True))

    def polynomial(self, y: Vector, x: Vector) -> dict[Powers, Vector]:
        """Return the coefficients of t up to the fourth power in the logarithm of the remainder.

        Keys are powers of t/halves along (y, x); positions d of the larger grid broadcast.
        """
        (cy, cx), (s0y, s0x), (by, bx), (hy, hx) = (
            self.middle, self.slopes, self.bends, self.halves,
        )  # fmt: skip
        wave = 2j * np.pi / self.request.wavelength * self.side
        fall = self.falls
        distance = np.sqrt((cy + y) ** 2 + (cx + x) ** 2 + self.request.z**2)
        sy, sx = (cy + y) / distance, (cx + x) / distance
        square = {(2, 0): 1.0, (0, 2): 1.0}  # t^2
        along = {(1, 0): sy, (0, 1): sx}  # s t
        both, cube = _times(square, along), _times(along, along, along)
        third = wave / (2 * distance**2)
        fourth = wave / distance**3
        coefficients = {
            (1, 0): wave * (s0y + by * y - sy) + 2 * fall * sy / distance,
            (0, 1): wave * (s0x + bx * x - sx) + 2 * fall * sx / distance,
            (2, 0): wave / 2 * ((1 - sy**2) / distance - by) + fall * (2 * sy**2 - 1) / distance**2,
            (0, 2): wave / 2 * ((1 - sx**2) / distance - bx) + fall * (2 * sx**2 - 1) / distance**2,
            (1, 1): sy * sx * (4 * fall / distance**2 - wave / distance),
        }
        for factor, part in (
            (third - 2 * fall / distance**3, both),
            (8 / 3 * fall / distance**3 - third, cube),
            (-fourth / 8, _times(square, square)),
            (fourth * 3 / 4, _times(both, along)),
            (-fourth * 5 / 8, _times(cube, along)),
        ):
            for powers, value in part.items():
                coefficients[powers] = coefficients.get(powers, 0) + factor * value
        return {
            (a, b): value * (hy**a * hx**b)
            for (a, b), value in coefficients.items()
            if (a == 0 or hy > 0) and (b == 0 or hx > 0)
        }

    @property
    def falls(self) -> float:
        """Half the power of 1/r in the amplitude: 1, or 3/4 for line sources."""
        return 1.0 if len(self.request.axes) == 2 else 0.75

    @cached_property
    def bound(self) -> tuple[int, float]:
        """Highest power of t in the series, and the relative error of the field.

        Majorants of the logarithm's coefficients give those of its exponential. The error consists
        of the omitted powers and of the fifth power of the path.
        """
        positions = [
            np.linspace(-1, 1, _LATTICE) * self._half(axis, small=False) for axis in (0, 1)
        ]
        y, x = positions[0][:, None], positions[1][None]
        orders, power, error = [0.0] * 4, 0, math.inf
        parts = self.polynomial(y, x)
        for order in (1, 2, 3, 4):
            terms = [np.abs(value) for (a, b), value in parts.items() if a + b == order]
            total = sum(terms) if terms else np.zeros(1)
            orders[order - 1] = _SAFETY * float(np.max(total))
        if max(orders) > 1:
            return MAX_POWERS, math.inf
        coefficients = [1.0]
        for n in range(1, 60):
            coefficients.append(
                sum(m * c * coefficients[n - m] for m, c in enumerate(orders, 1) if n >= m) / n
            )
        left = self._beyond(y, x) * math.exp(min(sum(orders), 50.0))
        for power in range(MAX_POWERS + 1):
            error = left + sum(coefficients[power + 1 :])
            if error <= TOLERANCE:
                break
        return power, error

    def _beyond(self, y: Vector, x: Vector) -> float:
        """Return a bound of the path's powers of t from 5 on and the amplitude's from 4 on."""
        (cy, cx), (hy, hx) = self.middle, self.halves
        distance = np.sqrt((cy + y) ** 2 + (cx + x) ** 2 + self.request.z**2)
        wave = 2 * math.pi / self.request.wavelength
        radius = math.hypot(hy, hx)
        across = (np.abs(cy + y) * hy + np.abs(cx + x) * hx) / distance
        if radius > 0.1 * abs(self.request.z):
            return math.inf
        fifth = 3 / 8 * radius**4 * across + 5 / 4 * radius**2 * across**3 + 7 / 8 * across**5
        path = fifth / distance**4 + radius**6 / 16 / distance**5
        amplitude = (radius**4 / 2 + 4 * (radius * across) ** 2 + 4 * across**4) / distance**4
        hankel = radius / (wave * distance**2)  # of 1/r - ik, and of line sources
        return float(np.max(2 * (wave * path + amplitude) + hankel))

    @cached_property
    def powers(self) -> list[Powers]:
        """Powers (y, x) of t of the terms."""
        highest = self.bound[0]
        hy, hx = self.halves
        return [
            (a, n - a)
            for n in range(highest + 1)
            for a in range(n + 1)
            if (a == 0 or hy > 0) and (n == a or hx > 0)
        ]

    def line(self, axis: int, power: int) -> Line:
        """Return the chirp-z transform along an axis with a power of t."""
        r = self.request
        n, m = r.grid.shape[axis], r.target.shape[axis]
        if n == 1:
            return identity(1)
        pitch, out_pitch = r.grid.pitch[axis], r.target.pitch[axis]
        bend, slope, wave = self.bends[axis], self.slopes[axis], self.side / r.wavelength
        small, d = (n, pitch) if self.inward else (m, out_pitch)
        t = (np.arange(small) - small // 2) * d * (1 if self.inward else -1)
        table = phasor(wave * (bend * t**2 / 2 - slope * t)) * (t / self.halves[axis]) ** power
        ones = np.ones(m if self.inward else n, np.complex128)
        pre, post = (table, ones) if self.inward else (ones, table)
        return chirp_z(n, m, -wave * bend * pitch * out_pitch, pre=pre, post=post)

    def ways(self) -> list[Separable]:
        """Return the maps of each term along both axes."""
        y, x = ({p[axis]: self.line(axis, p[axis]) for p in self.powers} for axis in (0, 1))
        return [Separable.of((y[a], x[b])) for a, b in self.powers]

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the larger grid, which has the coefficients."""
        return self.request.target.shape if self.inward else self.request.grid.shape

    def _positions(self, axis: int) -> Vector:
        """Return d along an axis: of output samples, or of input samples with opposite sign."""
        r, n = self.request, self.shape[axis]
        pitch = (r.target if self.inward else r.grid).pitch[axis]
        if r.grid.shape[axis] == 1:
            return np.zeros(n)
        return (np.arange(n) - n // 2) * pitch * (1 if self.inward else -1)

    def coefficients(self) -> Iterator[tuple[slice, list[Vector]]]:
        """Yield rows of the larger grid and the factors of all terms on them, complex128."""
        y, x = self._positions(0), self._positions(1)
        for start in range(0, len(y), _ROWS):
            rows = slice(start, min(start + _ROWS, len(y)))
            kernel = self._kernel(y[rows], x)
            parts = self.polynomial(y[rows, None], x[None])
            factors: dict[Powers, Vector] = {(0, 0): kernel}
            for a, b in self.powers[1:]:
                along = 0 if a else 1
                total: Vector = np.zeros_like(kernel)
                for key, value in parts.items():
                    left = (a - key[0], b - key[1])
                    if key[along] and left in factors:
                        total += key[along] * value * factors[left]
                factors[a, b] = total / (a, b)[along]
            yield rows, [factors[p] for p in self.powers]

    def _kernel(self, y: Vector, x: Vector) -> Vector:
        """Return h from the centre of the smaller grid, times the area of an input sample."""
        r = self.request
        z, k = abs(r.z), 2 * np.pi / r.wavelength
        dy, dx = self.middle[0] + y, self.middle[1] + x
        if len(r.axes) < 2:
            lines = [shift if axis in r.axes else None for axis, shift in enumerate((dy, dx))]
            h = line_samples(lines[0], lines[1], r.grid.pitch, z, r.wavelength)
        else:
            rho2 = dy[:, None] ** 2 + dx[None] ** 2
            distance = np.sqrt(rho2 + z * z)
            h = z / (2 * np.pi * distance**2) * (1 / distance - 1j * k)
            h = h * phasor(rho2 / (distance + z) / r.wavelength) * math.prod(r.grid.pitch)
        return h if r.z > 0 else h.conj()


def _times(*polynomials: dict[Powers, Any]) -> dict[Powers, Any]:
    """Return the product of polynomials in (y, x)."""
    product: dict[Powers, Any] = {(0, 0): 1.0}
    for polynomial in polynomials:
        total: dict[Powers, Any] = {}
        for (a, b), value in product.items():
            for (c, d), other in polynomial.items():
                total[a + c, b + d] = total.get((a + c, b + d), 0.0) + value * other
        product = total
    return product


@dataclass(frozen=True, eq=False)
class SeriesFactor:
    """Factor of a term on the larger grid of a `Series`."""

    series: Series
    which: int = 0  # index of the term in ``series.powers``
    flipped: bool = False  # True if x and y are exchanged

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the factor."""
        ny, nx = self.series.shape
        return (nx, ny) if self.flipped else (ny, nx)

    stored = shape

    @property
    def lit(self) -> None:
        """None, since all columns are used."""

    def residual_turns(self) -> float:
        """Return 0, since the factor is computed in float64."""
        return 0.0

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """Return the samples on a device; the host computes the phase for every route."""
        out = np.empty(self.series.shape, device.complex)
        for rows, values in self.series.coefficients():
            out[rows] = values[self.which]
        return Spectrum(device.upload(out.T.copy() if self.flipped else out), self.shape)

    def turned(self) -> SeriesFactor:
        """Return the factor with x and y exchanged."""
        return replace(self, flipped=not self.flipped)


def series_spectra(series: Series, device: Device) -> list[Spectrum]:
    """Return the factors of all terms on a device in the order of `run` of blocks.py."""
    outs = [np.empty(series.shape, device.complex) for _ in series.powers]
    for rows, values in series.coefficients():
        for out, value in zip(outs, values, strict=True):
            out[rows] = value
    return [Spectrum.of(out, device) for out in outs]


def best_series(request: Request) -> Series:
    """Return the series about the input or the output, whichever needs fewer terms."""
    both = [Series(request, inward) for inward in (True, False)]
    return min(both, key=lambda s: (s.bound[1] > TOLERANCE, len(s.powers), s.bound[1]))


def nearest(request: Request) -> float:
    """Return the smallest abs(z) in metres at which one step is exact to `TOLERANCE`."""
    low, high = 1e-12, FARTHEST

    def is_exact(z: float) -> bool:
        candidate = replace(request, z=math.copysign(z, request.z))
        return best_series(candidate).bound[1] <= TOLERANCE

    while high / low > 1.0002:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if is_exact(middle) else (middle, high)
    return high
