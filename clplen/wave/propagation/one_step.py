"""Rayleigh and Sommerfeld's integral in one step: a chirp-z transform between two chirps.

Between an input point and an output point the path is r. About the middle of the two grids, with
the smaller of them t and the larger of them d, r = R(c + d) - s0 t - D d t + D t^2/2 + remainder: c
from middle to middle, R the path from the middle of the smaller grid to each sample of the larger
one, s0 its slope at c, D the second derivative along each axis. All but the remainder is a factor
of each grid and a chirp-z transform of as many samples as both grids have. The remainder, and how
the amplitude changes with t, is a power series in t with coefficients on the larger grid: one more
chirp-z transform a term.
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

TOLERANCE = 1e-9  # of the field's norm, 180 dB, as a guard of 6 Fresnel widths
MOST_ERROR = 1e-2  # of the field's norm; where the bound is higher the series may diverge
MOST_POWERS = 6  # of t
_LATTICE = 17  # points along each axis at which the remainder is bounded
_SAFETY = 1.1  # of the largest value there over the largest anywhere
_ROWS = 64  # of the larger grid whose coefficients are made at a time


@dataclass(frozen=True, eq=False)
class Series:
    """The power series of a request, about the input (``inward``) or about the output."""

    request: Request
    # whether t is on the input and the coefficients are on the output, or the other way round
    inward: bool

    @property
    def side(self) -> float:
        """1 for z > 0, -1 for z < 0."""
        return math.copysign(1.0, self.request.z)

    @cached_property
    def middle(self) -> tuple[float, float]:
        """c: (y, x) from the middle of the input to that of the output, in metres."""
        own, other = self.request.grid, self.request.target
        y, x = (
            0.0 if n == 1 else b - a
            for n, a, b in zip(own.shape, own.origin, other.origin, strict=True)
        )
        return (y, x)

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """s0 along (y, x)."""
        distance = math.hypot(*self.middle, self.request.z)
        return (self.middle[0] / distance, self.middle[1] / distance)

    @cached_property
    def bends(self) -> tuple[float, float]:
        """D along (y, x), in cycles a metre."""
        distance = math.hypot(*self.middle, self.request.z)
        y, x = ((1 - slope**2) / distance for slope in self.slopes)
        return (y, x)

    def _half(self, axis: int, *, small: bool) -> float:
        """Largest abs(t), or abs(d), along an axis, in metres."""
        r = self.request
        if r.grid.shape[axis] == 1:
            return 0.0
        if small == self.inward:
            return min(r.grid.shape[axis] // 2 * r.grid.pitch[axis], r.span(axis).lit / 2)
        return r.target.shape[axis] // 2 * r.target.pitch[axis]

    @cached_property
    def halves(self) -> tuple[float, float]:
        """Largest abs(t) along (y, x), in metres."""
        return (self._half(0, small=True), self._half(1, small=True))

    def polynomial(self, y: Vector, x: Vector) -> dict[Powers, Vector]:
        """Coefficients of t up to the fourth power in the logarithm of the remainder.

        By powers of t/halves along (y, x), at places d of the larger grid that broadcast.
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
        made = {
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
                made[powers] = made.get(powers, 0) + factor * value
        return {
            (a, b): value * (hy**a * hx**b)
            for (a, b), value in made.items()
            if (a == 0 or hy > 0) and (b == 0 or hx > 0)
        }

    @property
    def falls(self) -> float:
        """Half the power of 1/r with which the amplitude falls: 2, of line sources 3/2."""
        return 1.0 if len(self.request.axes) == 2 else 0.75

    @cached_property
    def bound(self) -> tuple[int, float]:
        """Highest power of t that is taken, and the error left, as a part of the field's norm.

        Majorants of the logarithm's coefficients give those of its exponential; what is beyond the
        highest power, and the fifth power of the path, is the error.
        """
        places = [np.linspace(-1, 1, _LATTICE) * self._half(axis, small=False) for axis in (0, 1)]
        y, x = places[0][:, None], places[1][None]
        orders, power, error = [0.0] * 4, 0, math.inf
        parts = self.polynomial(y, x)
        for order in (1, 2, 3, 4):
            terms = [np.abs(value) for (a, b), value in parts.items() if a + b == order]
            total = sum(terms) if terms else np.zeros(1)
            orders[order - 1] = _SAFETY * float(np.max(total))
        if max(orders) > 1:
            return MOST_POWERS, math.inf
        coefficients = [1.0]
        for n in range(1, 60):
            coefficients.append(
                sum(m * one * coefficients[n - m] for m, one in enumerate(orders, 1) if n >= m) / n
            )
        left = self._beyond(y, x) * math.exp(min(sum(orders), 50.0))
        for power in range(MOST_POWERS + 1):
            error = left + sum(coefficients[power + 1 :])
            if error <= TOLERANCE:
                break
        return power, error

    def _beyond(self, y: Vector, x: Vector) -> float:
        """The fifth and higher powers of t in the path, the fourth and higher in the amplitude."""
        (cy, cx), (hy, hx) = self.middle, self.halves
        distance = np.sqrt((cy + y) ** 2 + (cx + x) ** 2 + self.request.z**2)
        wave = 2 * math.pi / self.request.wavelength
        whole = math.hypot(hy, hx)
        across = (np.abs(cy + y) * hy + np.abs(cx + x) * hx) / distance
        if whole > 0.1 * abs(self.request.z):
            return math.inf
        fifth = 3 / 8 * whole**4 * across + 5 / 4 * whole**2 * across**3 + 7 / 8 * across**5
        path = fifth / distance**4 + whole**6 / 16 / distance**5
        amplitude = (whole**4 / 2 + 4 * (whole * across) ** 2 + 4 * across**4) / distance**4
        hankel = whole / (wave * distance**2)  # of 1/r - ik, and of line sources
        return float(np.max(2 * (wave * path + amplitude) + hankel))

    @cached_property
    def powers(self) -> list[Powers]:
        """(y, x) powers of t of the terms."""
        highest = self.bound[0]
        hy, hx = self.halves
        return [
            (a, n - a)
            for n in range(highest + 1)
            for a in range(n + 1)
            if (a == 0 or hy > 0) and (n == a or hx > 0)
        ]

    def line(self, axis: int, power: int) -> Line:
        """The chirp-z transform along an axis with a power of t."""
        r = self.request
        n, m = r.grid.shape[axis], r.target.shape[axis]
        if n == 1:
            return identity(1)
        own, other = r.grid.pitch[axis], r.target.pitch[axis]
        bend, slope, wave = self.bends[axis], self.slopes[axis], self.side / r.wavelength
        small, d = (n, own) if self.inward else (m, other)
        t = (np.arange(small) - small // 2) * d * (1 if self.inward else -1)
        table = phasor(wave * (bend * t**2 / 2 - slope * t)) * (t / self.halves[axis]) ** power
        one = np.ones(m if self.inward else n, np.complex128)
        pre, post = (table, one) if self.inward else (one, table)
        return chirp_z(n, m, -wave * bend * own * other, pre=pre, post=post)

    def ways(self) -> list[Separable]:
        """The maps of each term along both axes."""
        y, x = ({p[axis]: self.line(axis, p[axis]) for p in self.powers} for axis in (0, 1))
        return [Separable.of((y[a], x[b])) for a, b in self.powers]

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the larger grid, on which the coefficients are."""
        return self.request.target.shape if self.inward else self.request.grid.shape

    def _places(self, axis: int) -> Vector:
        """d along an axis: of output samples, or of input samples with the other sign."""
        r, n = self.request, self.shape[axis]
        pitch = (r.target if self.inward else r.grid).pitch[axis]
        if r.grid.shape[axis] == 1:
            return np.zeros(n)
        return (np.arange(n) - n // 2) * pitch * (1 if self.inward else -1)

    def coefficients(self) -> Iterator[tuple[slice, list[Vector]]]:
        """Rows of the larger grid and the factors of all terms there, complex128."""
        y, x = self._places(0), self._places(1)
        for start in range(0, len(y), _ROWS):
            rows = slice(start, min(start + _ROWS, len(y)))
            kernel = self._kernel(y[rows], x)
            parts = self.polynomial(y[rows, None], x[None])
            made: dict[Powers, Vector] = {(0, 0): kernel}
            for a, b in self.powers[1:]:
                along = 0 if a else 1
                total: Vector = np.zeros_like(kernel)
                for key, value in parts.items():
                    left = (a - key[0], b - key[1])
                    if key[along] and left in made:
                        total += key[along] * value * made[left]
                made[a, b] = total / (a, b)[along]
            yield rows, [made[p] for p in self.powers]

    def _kernel(self, y: Vector, x: Vector) -> Vector:
        """h from the middle of the smaller grid, times the area of an input sample."""
        r = self.request
        z, k = abs(r.z), 2 * np.pi / r.wavelength
        dy, dx = self.middle[0] + y, self.middle[1] + x
        if len(r.axes) < 2:
            lines = [one if axis in r.axes else None for axis, one in enumerate((dy, dx))]
            h = line_samples(lines[0], lines[1], r.grid.pitch, z, r.wavelength)
        else:
            rho2 = dy[:, None] ** 2 + dx[None] ** 2
            distance = np.sqrt(rho2 + z * z)
            h = z / (2 * np.pi * distance**2) * (1 / distance - 1j * k)
            h = h * phasor(rho2 / (distance + z) / r.wavelength) * math.prod(r.grid.pitch)
        return h if r.z > 0 else h.conj()


def _times(*polynomials: dict[Powers, Any]) -> dict[Powers, Any]:
    """The product of polynomials in (y, x)."""
    made: dict[Powers, Any] = {(0, 0): 1.0}
    for one in polynomials:
        total: dict[Powers, Any] = {}
        for (a, b), value in made.items():
            for (c, d), other in one.items():
                total[a + c, b + d] = total.get((a + c, b + d), 0.0) + value * other
        made = total
    return made


@dataclass(frozen=True, eq=False)
class SeriesFactor:
    """One term's factor on the larger grid of a `Series`."""

    series: Series
    which: int = 0  # of ``series.powers``
    flipped: bool = False  # whether x and y are exchanged

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the factor."""
        ny, nx = self.series.shape
        return (nx, ny) if self.flipped else (ny, nx)

    stored = shape

    @property
    def lit(self) -> None:
        """All columns."""

    def residual_turns(self) -> float:
        """0: the factor is made in float64."""
        return 0.0

    def on_device(self, device: Device, phase: str) -> Spectrum:
        """The samples on a device; the phase is formed on the host whatever it is."""
        out = np.empty(self.series.shape, device.complex)
        for rows, values in self.series.coefficients():
            out[rows] = values[self.which]
        return Spectrum(device.upload(out.T.copy() if self.flipped else out), self.shape)

    def turned(self) -> SeriesFactor:
        """The same with x and y exchanged."""
        return replace(self, flipped=not self.flipped)


def series_spectra(series: Series, device: Device) -> list[Spectrum]:
    """The factors of all terms on a device, as `run` of blocks.py reads them."""
    outs = [np.empty(series.shape, device.complex) for _ in series.powers]
    for rows, values in series.coefficients():
        for out, value in zip(outs, values, strict=True):
            out[rows] = value
    return [Spectrum.of(out, device) for out in outs]


def best_series(request: Request) -> Series:
    """About the input or about the output, whichever needs fewer terms."""
    both = [Series(request, inward) for inward in (True, False)]
    return min(both, key=lambda one: (one.bound[1] > TOLERANCE, len(one.powers), one.bound[1]))


def nearest(request: Request) -> float:
    """Smallest abs(z) in metres, from which one step is exact to `TOLERANCE`."""
    low, high = 1e-12, FARTHEST

    def is_exact(z: float) -> bool:
        own = replace(request, z=math.copysign(z, request.z))
        return best_series(own).bound[1] <= TOLERANCE

    while high / low > 1.0002:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if is_exact(middle) else (middle, high)
    return high
