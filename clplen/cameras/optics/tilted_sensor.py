"""Sensor tilted against the array, by fields in a few planes parallel to the array.

The pixel at (y, x) lies at z3 + s, s = t_y y + t_x x. Without the carrier a plane wave of the
samples' band turns by -w s over the distance s, w from 0 to W = k (1 - sqrt(1 - lam^2 f^2)) of the
largest f. The field of every pixel is a polynomial in s through planes at Chebyshev points s_j
(Trefethen 2013, chapters 3 and 8), with exp(i W s/2) taken out, so that |w - W/2| <= W/2 counts:

    u(y, x) = sum_j c_j(s) u_j(y, x),   c_j = L_j(s) exp(i W (s_j - s)/2).

Its derivative by s is the sum with dc_j/ds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.polynomial import chebyshev

from clplen.compute.device import Device
from clplen.wave.field.field import Grid
from clplen.wave.field.transmission import phasor

Pair = tuple[float, float]
Values = np.ndarray[Any, np.dtype[np.float64]]

TOLERANCE = {"single": 1e-6, "double": 1e-10}  # error of the derivative by s, over W/2
MIN_PHASE = 0.1  # minimum of W/2 times the reach of the planes, for a slightly tilted sensor


@dataclass(frozen=True, eq=False)
class SensorPlanes:
    """Planes between which the field of a tilted sensor is interpolated."""

    distances: tuple[float, ...]  # distances from the array in metres
    # weights, slopes: c_j and dc_j/ds (a metre) of the pixels, complex, shape (ny, nx) each
    weights: tuple[cla.Array, ...]
    slopes: tuple[cla.Array, ...]

    @property
    def nbytes(self) -> int:
        """Number of bytes on the device."""
        return sum(int(table.nbytes) for table in (*self.weights, *self.slopes))


def tilt_reach(grid: Grid, tilt: Pair) -> float:
    """Return the largest distance by which a tilt moves a pixel along the axis, in metres."""
    down, right = (float(np.abs(axis).max()) for axis in (grid.y, grid.x))
    return abs(tilt[0]) * down + abs(tilt[1]) * right


def sensor_planes(
    grid: Grid, distance: float, tilt: Pair, wavelength: float, device: Device
) -> SensorPlanes:
    """Return the planes of a sensor."""
    square = sum((wavelength / (2 * pitch)) ** 2 for pitch in grid.pitch)
    half_turn = math.pi / wavelength * (1 - math.sqrt(max(0.0, 1 - square)))  # W/2
    reach = max(tilt_reach(grid, tilt), MIN_PHASE / half_turn)
    count = plane_count(half_turn * reach, TOLERANCE[device.precision])
    nodes = chebyshev.chebpts1(count)
    coefficients = 2 / count * chebyshev.chebvander(nodes, count - 1).T
    coefficients[0] /= 2
    s = tilt[0] * grid.y[:, None] + tilt[1] * grid.x
    lagrange = chebyshev.chebval(s / reach, coefficients)
    steps = chebyshev.chebval(s / reach, chebyshev.chebder(coefficients)) / reach
    turned = phasor(half_turn / (2 * np.pi) * (reach * nodes[:, None, None] - s))
    weights, slopes = lagrange * turned, (steps - 1j * half_turn * lagrange) * turned
    return SensorPlanes(
        tuple(float(z) for z in distance + reach * nodes),
        *(
            tuple(device.upload(c.astype(device.complex)) for c in tables)
            for tables in (weights, slopes)
        ),
    )


def plane_count(phase: float, tolerance: float) -> int:
    """Return the number of planes for light with up to ``phase`` from the middle to the last.

    A polynomial through K Chebyshev points departs from exp(i phase x), abs(x) <= 1, by up to
    2 (phase/2)^K/K! (Trefethen 2013, chapter 8; Sueli and Mayers 2003, theorem 8.7), and its
    derivative, over ``phase``, by about K/(K - 1)! (phase/2)^(K - 1), Markov's K^2 times as much.
    """
    count = 3
    while count * (phase / 2) ** (count - 1) / math.factorial(count - 1) > tolerance:
        count += 1
    return count
