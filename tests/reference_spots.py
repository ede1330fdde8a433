"""Spots that lenslets make of a point: measured in a raw image, and by Fresnel integrals, float64.

The light of a point in focus is a spherical wave on the array, times what diffraction at the main
lens' rim makes of it: rings about the edge of the blur, which run through it and turn the wave a
little under each lenslet. `Rings` finds them by Lommel's integral (Born and Wolf 1999, section
8.8.1) and sends them through nine lenslets to the sensor by the direct sum of Fresnel's integral.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import j0

from clplen.cameras.focused_camera import Plenoptic2

Array = Any


def spot(image: Array, camera: Plenoptic2, place: Array, m: float) -> tuple[float, Array]:
    """Energy and I^2 centroid (y, x) in the window of one spot: half-way to the next."""
    y, x, rows, columns = _window(camera, place, m)
    part = image[np.ix_(rows, columns)]
    return float(part.sum()), _centroid(part, y, x)


def _window(camera: Plenoptic2, place: Array, m: float) -> tuple[Array, ...]:
    half = min(1.0, 1 + m) * camera.mla.pitch / 2
    y, x = camera.grid.y, camera.grid.x
    rows, columns = np.abs(y - place[0]) <= half, np.abs(x - place[1]) <= half
    return y[rows], x[columns], rows, columns


def _centroid(part: Array, y: Array, x: Array) -> Array:
    squares = part**2
    return np.array([squares.sum(1) @ y, squares.sum(0) @ x]) / squares.sum()


def slope(weight: Array, x: Array, y: Array) -> float:
    """Of a straight line y(x) through weighted points."""
    away = x - np.average(x, weights=weight)
    return float((weight * away * y).sum() / (weight * away**2).sum())


def width(profile: Array) -> float:
    """Full width at half maximum in samples, between linear crossings."""
    half = profile.max() / 2
    above = np.flatnonzero(profile > half)
    first, last = above[0], above[-1]
    left = (profile[first] - half) / (profile[first] - profile[first - 1])
    right = (profile[last] - half) / (profile[last] - profile[last + 1])
    return float(last - first + left + right)


class Rings:
    """The spots of a point in focus of a camera of square lenslets.

    ``image`` is the point's image (Y, X) on the main lens' image plane, in metres.
    """

    FINE = 60  # samples a lenslet

    def __init__(self, camera: Plenoptic2, image: Array) -> None:
        self.camera, self.image = camera, np.asarray(image, np.float64)
        self.centre = self.image * camera.array_distance / camera.image_distance
        self.k = 2 * np.pi / camera.wavelength

    @property
    def lit(self) -> float:
        """Radius of the blur on the array."""
        camera = self.camera
        return camera.aperture_diameter / 2 * abs(camera.a) / camera.image_distance

    def inside(self) -> Array:
        """Centres (n, 2) of the lenslets that lie in the blur with all of their aperture."""
        pitch = self.camera.mla.pitch
        centres = self.camera.mla.centres().reshape(-1, 2)
        return centres[np.hypot(*(np.abs(centres - self.centre) + pitch / 2).T) < self.lit]

    def chief(self, lens: Array) -> Array:
        """Where the ray matrix puts the spot under a lenslet."""
        away = lens - self.image
        return lens + self.camera.ray_matrix()[0] @ np.array([-away, away / self.camera.a])

    def spot(self, lens: Array) -> Array:
        """I^2 centroid (y, x) of the spot under a lenslet, those beside it shining in."""
        camera, h = self.camera, self.camera.mla.pitch / self.FINE
        a, b, f, z2 = camera.a, camera.b, camera.mla.f, camera.array_distance
        at = (np.arange(-1.5 * self.FINE, 1.5 * self.FINE) + 0.5) * h
        in_lens = (at + camera.mla.pitch / 2) % camera.mla.pitch - camera.mla.pitch / 2
        y, x, *_ = _window(camera, self.chief(lens), camera.m)
        r2 = np.add.outer(*((c + at - m) ** 2 for c, m in zip(lens, self.centre, strict=True)))
        rings = self._rings
        field = np.interp(np.sqrt(r2), rings[0], rings[1].real)
        field = field + 1j * np.interp(np.sqrt(r2), rings[0], rings[1].imag)
        field *= np.exp(0.5j * self.k * r2 * camera.image_distance / (z2 * a))
        ways = [
            np.exp(0.5j * self.k * ((c + at) ** 2 / z2 + (s[:, None] - c - at) ** 2 / b))
            * np.exp(-0.5j * self.k * in_lens**2 / f)
            for c, s in zip(lens, (y, x), strict=True)
        ]
        return _centroid(np.abs(ways[0] @ field @ ways[1].T) ** 2, y, x)

    @cached_property
    def _rings(self) -> tuple[Array, Array]:
        """Radius, and the field on the array over that of rays."""
        camera, n = self.camera, 2500
        z2, F = camera.array_distance, camera.image_distance
        rho = (np.arange(n) + 0.5) * camera.aperture_diameter / 2 / n
        weight = np.exp(0.5j * self.k * rho**2 * (1 / z2 - 1 / F)) * rho
        r = np.linspace(0, 1.5 * self.lit + 3 * camera.mla.pitch, 1500)
        field = j0(self.k * r[:, None] * rho / z2) @ weight
        return r, field * np.exp(-0.5j * self.k * r**2 * F / (z2 * camera.a))
