"""The pixels around one, and the same pixel of adjacent lenslets."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from clplen.lightfield.raw.lenslet_lattice import Lattice

Vector = np.ndarray[Any, Any]
Step = tuple[int, int]

AROUND = [(i, k) for i in (-1, 0, 1) for k in (-1, 0, 1) if (i, k) != (0, 0)]
# Lenslets nearest to one, in rows and columns; every other row of a hexagonal lattice is moved.
HEXAGONAL = [(i, k) for i in (-1, 1) for k in (-0.5, 0.5)] + [(0, -1), (0, 1), (-2, 0), (2, 0)]
BRIGHTEST = 2  # that are left out of a sum, at most


def steps_around(lattice: Lattice | int | None) -> list[Step]:
    """Steps to the pixels around one, and to the same pixel of adjacent lenslets."""
    if lattice is None:
        return list(AROUND)
    if isinstance(lattice, int):
        return [*AROUND, *((i * lattice, k * lattice) for i, k in AROUND)]
    along, across = np.array(lattice.row), np.array(lattice.column)
    adjacent: list[tuple[float, float]] = list(AROUND)
    if lattice.kind == "hexagonal":
        adjacent = [(k, i) for i, k in HEXAGONAL] if lattice.turned else list(HEXAGONAL)
    far = [np.round(i * along + k * across).astype(int) for i, k in adjacent]
    return [*AROUND, *((int(y), int(x)) for y, x in far)]


def moved(light: Vector, steps: list[Step], fill: float) -> Iterable[Vector]:
    """The pictures at these steps from each pixel, with ``fill`` beyond the border."""
    reach = max(max(abs(y), abs(x)) for y, x in steps)
    wide = np.pad(light, reach, constant_values=fill)
    ny, nx = light.shape
    for y, x in steps:
        yield wide[reach + y : reach + y + ny, reach + x : reach + x + nx]


def sums_around(light: Vector, steps: list[Step], *, beyond: bool) -> tuple[Vector, Vector, Vector]:
    """Sum the pixels at these steps: all, without the brightest, without the two brightest."""
    total, first, second, third = (np.zeros_like(light) for _ in range(4))
    missing = np.zeros_like(light)
    for one in moved(light, steps, np.nan):
        outside = np.isnan(one)
        missing += outside
        here = np.where(outside, np.float32(0), one)
        total += here
        third = np.maximum(third, np.minimum(second, here))
        second = np.maximum(second, np.minimum(first, here))
        first = np.maximum(first, here)
    if beyond:
        total += missing * third
    one = np.maximum(total - first, 0)
    return total, one, np.maximum(one - second, 0)
