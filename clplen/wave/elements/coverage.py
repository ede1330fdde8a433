"""The exact fraction of every sample's cell that a figure covers, in float64 on the host."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.wave.field.field import Grid
from clplen.wave.field.transmission import Vector, offsets

NOTHING = 1e-9  # of a cell: rounding of coordinates up to a million cells away


def interval_coverage(offset: Vector, pitch: float, half: float) -> Vector:
    """Fraction of each cell of width ``pitch`` about ``offset`` that lies within +-half."""
    low = np.maximum(offset - pitch / 2, -half)
    high = np.minimum(offset + pitch / 2, half)
    return np.maximum(high - low, 0) / pitch


def disc_coverage(grid: Grid, radius: float, centre: tuple[float, float]) -> Vector:
    """Fraction of each cell inside a disc, shape (ny, nx); only rim cells are integrated.

    Parameters
    ----------
    grid : Grid
        Without an axis of length 1.
    radius : float
        In metres; 0 covers nothing.
    centre : tuple of float
        (y, x) in metres.
    """
    if radius == 0:
        return np.zeros(grid.shape)
    y, x = (offset / radius for offset in offsets(grid, centre))
    hy, hx = (pitch / (2 * radius) for pitch in grid.pitch)
    far = np.add.outer((np.abs(y) + hy) ** 2, (np.abs(x) + hx) ** 2)
    near = np.add.outer(np.maximum(np.abs(y) - hy, 0) ** 2, np.maximum(np.abs(x) - hx, 0) ** 2)
    covered = (far <= 1).astype(np.float64)
    row, column = np.nonzero((near < 1) & (far > 1))
    top, bottom = y[row] - hy, y[row] + hy
    left, right = x[column] - hx, x[column] + hx
    area = _corner_area(bottom, right) - _corner_area(bottom, left)
    area += _corner_area(top, left) - _corner_area(top, right)
    covered[row, column] = np.clip(area / (4 * hy * hx), 0, 1)
    return covered


def _corner_area(y: Vector, x: Vector) -> Vector:
    """Area of the unit disc between the axes and the lines at y and x; odd in both."""
    sign = np.sign(y) * np.sign(x)
    y, x = np.minimum(np.abs(y), 1), np.minimum(np.abs(x), 1)
    beyond = x * np.sqrt(1 - x**2) + y * np.sqrt(1 - y**2) + np.arcsin(x) + np.arcsin(y) - np.pi / 2
    return sign * np.where(x**2 + y**2 <= 1, x * y, beyond / 2)


def polygon_coverage(grid: Grid, vertices: Any) -> Vector:
    """Fraction of each cell inside a polygon, shape (ny, nx), by signed areas.

    Every edge is cut at the borders of the cells. A piece of height h along y adds h to all cells
    to its right and, to its own cell, h times the part of the cell that is to its right: running
    sums along x then are the fractions (Green's theorem).

    Parameters
    ----------
    grid : Grid
    vertices : array_like
        Shape (n, 2), (y, x) in metres, in order, either way round; the last joins the first.

    Raises
    ------
    ValueError
        If the polygon has no area or crosses itself.
    """
    corner = np.array([grid.y[0], grid.x[0]]) - np.array(grid.pitch) / 2
    places = (np.asarray(vertices, np.float64) - corner) / grid.pitch
    middle = places - places.mean(axis=0)
    turned = np.roll(middle, -1, axis=0)
    area = np.sum(middle[:, 1] * turned[:, 0] - middle[:, 0] * turned[:, 1]) / 2
    if abs(area) <= 1e-12 * np.ptp(places, axis=0).prod():
        raise ValueError("A polygon encloses an area; these vertices lie on a line or cross.")
    covered = _signed_coverage(places, grid.shape) * np.sign(area)
    if covered.min() < -1e-6 or covered.max() > 1 + 1e-6:
        raise ValueError("The polygon crosses itself: give its outline once round, as vertices.")
    covered[covered < NOTHING] = 0
    covered[covered > 1 - NOTHING] = 1
    return covered


def _signed_coverage(places: Vector, shape: tuple[int, int]) -> Vector:
    """Coverage by a polygon given in cells; negative where it runs from +y to +x."""
    ny, nx = shape
    pieces = [_cut(a, b, shape) for a, b in zip(places, np.roll(places, -1, axis=0), strict=True)]
    start, end = (np.concatenate(ends) for ends in zip(*pieces, strict=True))
    y, x = ((start + end) / 2).T
    row, column = np.floor(y).astype(np.int64), np.clip(np.floor(x), 0, nx).astype(np.int64)
    kept = (row >= 0) & (row < ny) & (column < nx)
    place = (row * (nx + 1) + column)[kept]
    height = (start - end)[kept, 0]
    left = np.clip(x - column, 0, 1)[kept]
    sums = np.bincount(place, height * (1 - left), ny * (nx + 1))
    sums += np.bincount(place + 1, height * left, ny * (nx + 1))
    return np.cumsum(sums.reshape(ny, nx + 1), axis=1, dtype=np.float64)[:, :nx]


def _cut(a: Vector, b: Vector, shape: tuple[int, int]) -> tuple[Vector, Vector]:
    """Starts and ends (m, 2) of the pieces of an edge between borders of cells, in cells."""
    cuts = [np.array([0.0, 1.0])]
    for p, q, n in zip(a, b, shape, strict=True):
        if p != q:
            low, high = max(min(p, q), 0), min(max(p, q), n)
            cuts.append((np.arange(np.ceil(low), np.floor(high) + 1) - p) / (q - p))
    t = np.sort(np.clip(np.concatenate(cuts), 0, 1))[:, None]
    points = a + t * (b - a)
    return points[:-1], points[1:]
