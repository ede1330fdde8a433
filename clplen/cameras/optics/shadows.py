"""Shadows of flat screens on the pupil of the main lens, by waves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clplen.cameras.scenes.occluders import Occluder

Values = np.ndarray[Any, np.dtype[np.float64]]
Waves = np.ndarray[Any, np.dtype[np.complex128]]


def shadows(
    occluders: Sequence[Occluder],
    positions: Values,
    *,
    object_distance: float,
    wavelength: float,
    axis: Values,
) -> Waves:
    """Field of points on the pupil over the field that they would have without screens.

    A spherical wave from (x, y) at z1 before the lens passes a screen of transmission t at z2 < z1.
    Over the wave without it, its field at u on the lens is that of t lit by a plane wave,
    propagated over z2 (z1 - z2)/z1 and seen at x + (u - x) (z1 - z2)/z1, where the ray to u
    crosses the screen (Goodman 2005, eq. 4-14 and problem 4-9). The samples of t are squares, so
    that this is a sum of products of Fresnel integrals along y and x, here in their means over the
    cells of ``axis``. Several screens multiply: light that one diffracts is not diffracted by
    another.
    """
    made = np.ones((len(positions), axis.size, axis.size), complex)
    for screen in occluders:
        stopped = 1 - np.sqrt(1 - screen.opacity)
        nearer = object_distance + screen.z
        for number in np.flatnonzero(positions[:, 2] > screen.z):
            x, y, dz = positions[number]
            farther = object_distance + dz
            share = (farther - nearer) / farther
            scale = np.sqrt(2 / (wavelength * nearer * share))
            down, right = (
                _covered(edges, at + (axis - at) * share, scale)
                for edges, at in zip(screen.edges(), (y, x), strict=True)
            )
            made[number] *= 1 - down @ stopped @ right.T
    return made


def _covered(edges: Values, places: Values, scale: float) -> Waves:
    """The light of each strip between two edges at each place, mean over its cell.

    Shape (places, strips): the integral of exp(i pi w^2/2)/(1 + i) over the strip, w the distance
    times ``scale``.
    """
    half = abs(places[1] - places[0]) * scale / 2
    w = (edges[None, :] - places[:, None]) * scale
    mean = (_integral(w + half) - _integral(w - half)) / (2 * half)
    return np.diff(mean, axis=1) / (1 + 1j)


def _integral(w: Values) -> Waves:
    """The integral of C(w) + i S(w): w (C + i S) + i exp(i pi w^2/2)/pi (DLMF 7.7)."""
    from scipy import special  # a slow import

    s, c = special.fresnel(w)
    return np.asarray(w * (c + 1j * s) + 1j / np.pi * np.exp(0.5j * np.pi * w**2))
