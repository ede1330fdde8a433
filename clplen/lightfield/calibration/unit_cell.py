"""The mean lenslet of a picture: all cells of a lattice laid over one another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.calibration.reciprocal import (
    Basis,
    Values,
    divide_by_local_mean,
    reduced_basis,
)

_PATCH = 384  # px: the cell is taken from at most nine patches of the picture
_LIT = 0.15  # of the brightest mean
_RISE = 0.025  # of the cell's range, by which a lenslet rises over the gaps around it
_WIDTH = 0.35  # px: standard deviation of the smoothing of the cell
_SMALL = 12.0  # px: a pitch beyond which nothing is too fine for the pixels
_GROUP = 0.2  # px: places in a cell that are told apart
_EVEN = 0.5  # of the places that can be: if pixels have fewer, they lie alike in the lenslets
_KNOT = 0.5  # px between the knots of a profile
_STIFF = 0.01  # weight of its bends
_FINE = 5  # points a side, over which a pixel is integrated
_ROUNDS = 4
_MISFIT = 0.03  # of the brightest pixel, that a profile may leave
_FAR = 0.5  # px: no aliasing moves a centre further
# Sublattices of index 2 and 3: every denser lattice of lenslets is reached by steps of them.
_DENSER = tuple(
    np.array(rows)
    for rows in (
        ((2, 0), (0, 1)),
        ((1, 0), (0, 2)),
        ((1, 1), (1, -1)),
        ((3, 0), (0, 1)),
        ((1, 0), (0, 3)),
        ((1, 1), (2, -1)),
        ((1, -1), (2, 1)),
    )
)


@dataclass(frozen=True)
class MeanCell:
    """What the cells of a lattice have in common.

    ``values`` (n, n) is the mean of the picture over its local mean, less one, at the fractions
    (k/n, l/n) of the two base vectors from a lenslet's centre, slightly smoothed; ``error`` its
    standard error; ``explained`` the share of the contrast, noise taken off, that it explains.
    """

    values: Values
    error: float
    explained: float


def mean_cell(picture: Values, basis: Basis, phase: Values) -> MeanCell:
    """Lay all cells of a picture over one another."""
    from scipy.ndimage import gaussian_filter

    pitch = float(np.hypot(*np.linalg.inv(basis)).max())
    n = int(np.clip(round(3 * pitch), 24, 60))
    parts = [_indexed(at, patch, basis, phase, n, pitch) for at, patch in _patches(picture, pitch)]
    where = np.concatenate([index[lit] for index, _, lit in parts])
    what = np.concatenate([flat[lit] for _, flat, lit in parts]).astype(np.float64)
    count = np.bincount(where, minlength=n * n)
    total = np.bincount(where, what, n * n)
    mean = total / np.maximum(count, 1)
    left = float((what - mean[where]).var())
    structure = _neighbouring(parts, mean)
    seen = float(what.var()) - (left - structure)
    width = max(_WIDTH * n / pitch, 0.5)
    total, weight = (
        gaussian_filter(a.reshape(n, n).astype(float), width, mode="wrap") for a in (total, count)
    )
    error = (left / max(4 * np.pi * width**2 * len(what) / n**2, 1)) ** 0.5
    explained = 1 - structure / seen if seen > 0 else 0.0
    return MeanCell(total / np.maximum(weight, 1e-9), error, explained)


def _indexed(
    at: tuple[int, int], patch: Values, basis: Basis, phase: Values, n: int, pitch: float
) -> tuple[Values, Values, Values]:
    """Which sample of the cell each pixel of a patch belongs to, its contrast, and if it is lit."""
    y, x = (np.arange(size) + start for size, start in zip(patch.shape, at, strict=True))
    index = [
        np.rint(n * ((g[0] * y[:, None] + g[1] * x + p) % 1)).astype(np.int32) % n
        for g, p in zip(basis, phase, strict=True)
    ]
    return (
        index[0] * n + index[1],
        divide_by_local_mean(patch, round(3 * pitch)),
        _lit(patch, round(pitch)),
    )


def _neighbouring(parts: list[tuple[Values, Values, Values]], mean: Values) -> float:
    """Covariance of what neighbouring pixels deviate from the cell: structure, but not noise."""
    products, count = 0.0, 0
    for index, flat, lit in parts:
        left = np.where(lit, flat - mean[index], 0.0)
        products += float((left[:, 1:] * left[:, :-1]).sum() + (left[1:] * left[:-1]).sum())
        count += int((lit[:, 1:] & lit[:, :-1]).sum() + (lit[1:] & lit[:-1]).sum())
    return max(products / max(count, 1), 0.0)


def denser_basis(cell: MeanCell, basis: Basis) -> Basis | None:
    """Reciprocal vectors of a denser lattice, if every cell holds several lenslets.

    Lenslets of unequal brightness make a coarser lattice than their centres: a chessboard of bright
    and dim ones repeats only after two. Each of the denser lattice's points must rise, dim or
    bright, over the darkest place on the way to each of its neighbours.
    """
    for matrix in _DENSER:
        closer = np.linalg.inv(matrix).T  # direct vectors in units of the cell's
        if _all_rise(cell, closer, round(abs(np.linalg.det(matrix))), np.linalg.inv(basis).T):
            return np.asarray(matrix @ basis)
    return None


def _all_rise(cell: MeanCell, closer: Basis, index: int, vectors: Basis) -> bool:
    """Whether all points of a denser lattice are blobs of their own."""
    short = reduced_basis(closer @ vectors)
    sides = np.hypot(*short.T)
    if sides.max() > 1.6 * sides.min() or abs(short[0] @ short[1]) > 0.6 * sides.prod():
        return False
    ways = np.array([*short, short[0] + short[1], short[0] - short[1]]) @ np.linalg.inv(vectors)
    near = ways[np.hypot(*(ways @ vectors).T) < 1.25 * sides.max()]
    rise = max(_RISE * float(np.ptp(cell.values)), 4 * cell.error)
    between = np.linspace(0, 0.7, 15)[:, None, None] * np.concatenate([near, -near])
    points = {
        tuple(np.round(np.round(np.array([a, b]) @ closer, 6) % 1, 6))
        for a in range(index)
        for b in range(index)
    }
    for point in points:
        along = _at(cell.values, np.asarray(point) + between)
        if not (along[0] > along.min(axis=0) + rise).all():
            return False
    return True


def _at(cell: Values, places: Any) -> Values:
    """The cell at places (..., 2), fractions of its base vectors."""
    from scipy.ndimage import map_coordinates

    where = np.moveaxis(np.asarray(places) * len(cell), -1, 0)
    return np.asarray(map_coordinates(cell, where, order=1, mode="grid-wrap"))


def _patches(picture: Values, pitch: float) -> list[tuple[tuple[int, int], Values]]:
    """Up to three by three patches that spread over a picture, with their corners."""
    axes = []
    for n in picture.shape:
        size = min(n, max(_PATCH, round(12 * pitch)))
        count = min(3, -(-n // size))
        axes.append([(round(s), size) for s in np.linspace(0, n - size, count)])
    return [
        ((y, x), picture[y : y + height, x : x + width])
        for y, height in axes[0]
        for x, width in axes[1]
    ]


def _lit(patch: Values, pitch: int) -> Values:
    from scipy.ndimage import uniform_filter

    mean = uniform_filter(patch, 2 * pitch + 1)
    return np.asarray(mean > _LIT * mean.max())


def centre_offset(picture: Values, basis: Basis, phase: Values) -> Values:
    """How far the lenslets' centres lie from where the phases say, if these are aliased.

    Where the pitch is a small whole number of pixels and the lattice is not turned, all lenslets
    are sampled alike, and what is too fine for the pixels moves the phases. There a profile, a
    piecewise linear function of the distance from the centre, integrated over the pixels, is fitted
    to the mean lenslet with its centre, by least squares.
    """
    cell = reduced_basis(np.linalg.inv(basis).T)
    if np.hypot(*cell.T).max() > _SMALL:
        return np.zeros(2)
    at, value, count, of = _distinct(picture, cell, -phase @ np.linalg.inv(basis).T)
    if len(at) > _EVEN * of:
        return np.zeros(2)
    weight = np.sqrt(count / count.mean())
    value = value / max(float(value.max()), 1e-30)
    centre, misfit = _profiled(at, value, weight, cell)
    return centre if misfit < _MISFIT and np.hypot(*centre) < _FAR else np.zeros(2)


def _distinct(picture: Values, cell: Basis, origin: Values) -> tuple[Values, Values, Values, int]:
    """Places (n, 2) that pixels have in a cell, their means and numbers, and how many can be."""
    start = [max(0, n - _PATCH) // 2 for n in picture.shape]
    patch = picture[start[0] : start[0] + _PATCH, start[1] : start[1] + _PATCH]
    lit = _lit(patch, round(float(np.hypot(*cell.T).max())))
    away = np.stack(np.nonzero(lit), axis=1) + start - origin
    places = away @ np.linalg.inv(cell) % 1
    n = [max(1, round(side / _GROUP)) for side in np.hypot(*cell.T)]
    index = np.minimum((places * n).astype(int), np.array(n) - 1) @ [n[1], 1]
    count = np.bincount(index, minlength=n[0] * n[1])
    seen = count > 0
    sums = [np.bincount(index, what, len(count))[seen] for what in (*places.T, patch[lit])]
    means = np.array(sums) / count[seen]
    return means[:2].T @ cell, means[2], count[seen], len(count)


def _profiled(at: Values, value: Values, weight: Values, cell: Basis) -> tuple[Values, float]:
    """The centre (y, x) of the profile that fits best, and the rms of what is left."""
    knots = int(np.ceil(0.75 * np.hypot(*cell.T).max() / _KNOT)) + 2
    bends = _STIFF * len(at) ** 0.5 * np.diff(np.eye(knots), 2, axis=0)
    values = np.concatenate([value * weight, np.zeros(len(bends))])

    def left(centre: Values) -> Values:
        hats = _hats(at - centre, cell, knots) * weight[:, None]
        model = np.concatenate([hats, bends])
        return np.asarray(values - model @ np.linalg.lstsq(model, values, rcond=None)[0])

    centre = np.zeros(2)
    for _ in range(_ROUNDS):
        slopes = [(left(centre + step) - left(centre - step)) / 0.02 for step in 0.01 * np.eye(2)]
        centre = centre - np.linalg.lstsq(np.transpose(slopes), left(centre), rcond=None)[0]
    return centre, float(np.sqrt((left(centre)[: len(at)] ** 2).mean()))


def _hats(away: Values, cell: Basis, knots: int) -> Values:
    """What every knot of a profile gives to pixels ``away`` from a centre, (n, knots)."""
    inside = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    fine = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    places = (away + fine) @ np.linalg.inv(cell)
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])[:, None, None]
    ways = (places - np.floor(places) - corners) @ cell
    r = np.hypot(ways[..., 0], ways[..., 1]).min(axis=0)
    steps = np.abs(r[..., None] / _KNOT - np.arange(knots))
    return np.asarray(np.maximum(1 - steps, 0).mean(axis=0))
