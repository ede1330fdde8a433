"""Mean lenslet of a picture: all cells of a lattice averaged."""

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

_PATCH = 384  # px: side of the patches, at most nine, from which the cell is measured
_MIN_BRIGHTNESS = 0.15  # of the brightest mean: minimum for a valid pixel
_MIN_RISE = 0.025  # of the cell's range: minimum rise of a lenslet over the gaps around it
_WIDTH = 0.35  # px: standard deviation of the smoothing of the cell
_MAX_ALIASED_PITCH = 12.0  # px: larger pitches do not alias
_BIN = 0.2  # px: size of a bin of positions in a cell
_MAX_FILLED = 0.5  # of the bins: if fewer are filled, all lenslets are sampled alike
_KNOT = 0.5  # px between the knots of a profile
_CURVATURE_WEIGHT = 0.01  # weight of the profile's curvature
_PIXEL_POINTS = 5  # points a side for the integral over a pixel
_ROUNDS = 4  # Newton iterations for the centre
_MAX_MISFIT = 0.03  # of the brightest pixel: maximum rms residual of a profile
_MAX_OFFSET = 0.5  # px: maximum shift of a centre by aliasing
# Sublattices of index 2 and 3; their steps reach every denser lattice.
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
    """Average over the cells of a lattice.

    ``values`` (n, n): picture over its local mean, less one, at fractions (k/n, l/n) of the base
    vectors from a lenslet's centre, slightly smoothed; ``error``: their standard error;
    ``explained``: share of the contrast without noise that the cell explains.
    """

    values: Values
    error: float
    explained: float


def mean_cell(picture: Values, basis: Basis, phase: Values) -> MeanCell:
    """Average all cells of a picture."""
    from scipy.ndimage import gaussian_filter

    pitch = float(np.hypot(*np.linalg.inv(basis)).max())
    n = int(np.clip(round(3 * pitch), 24, 60))
    parts = [_indexed(at, patch, basis, phase, n, pitch) for at, patch in _patches(picture, pitch)]
    cell_index = np.concatenate([index[lit] for index, _, lit in parts])
    contrast = np.concatenate([flat[lit] for _, flat, lit in parts]).astype(np.float64)
    count = np.bincount(cell_index, minlength=n * n)
    total = np.bincount(cell_index, contrast, n * n)
    mean = total / np.maximum(count, 1)
    residual_variance = float((contrast - mean[cell_index]).var())
    structure = _neighbouring(parts, mean)
    signal = float(contrast.var()) - (residual_variance - structure)
    width = max(_WIDTH * n / pitch, 0.5)
    total, weight = (
        gaussian_filter(a.reshape(n, n).astype(float), width, mode="wrap") for a in (total, count)
    )
    error = (residual_variance / max(4 * np.pi * width**2 * len(contrast) / n**2, 1)) ** 0.5
    explained = 1 - structure / signal if signal > 0 else 0.0
    return MeanCell(total / np.maximum(weight, 1e-9), error, explained)


def _indexed(
    at: tuple[int, int], patch: Values, basis: Basis, phase: Values, n: int, pitch: float
) -> tuple[Values, Values, Values]:
    """Return the cell sample, the contrast and the validity of each pixel of a patch."""
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
    """Return the covariance of neighbouring residuals: structure without noise."""
    products, count = 0.0, 0
    for index, flat, lit in parts:
        residual = np.where(lit, flat - mean[index], 0.0)
        products += float(
            (residual[:, 1:] * residual[:, :-1]).sum() + (residual[1:] * residual[:-1]).sum()
        )
        count += int((lit[:, 1:] & lit[:, :-1]).sum() + (lit[1:] & lit[:-1]).sum())
    return max(products / max(count, 1), 0.0)


def denser_basis(cell: MeanCell, basis: Basis) -> Basis | None:
    """Return the reciprocal vectors of a denser lattice if each cell holds several lenslets.

    Unequal brightness makes the period longer than the lenslet distance, as on a chessboard. Each
    point of a denser lattice must rise over the darkest position on the way to each neighbour.
    """
    for matrix in _DENSER:
        closer = np.linalg.inv(matrix).T  # direct vectors in units of the cell's
        if _all_rise(cell, closer, round(abs(np.linalg.det(matrix))), np.linalg.inv(basis).T):
            return np.asarray(matrix @ basis)
    return None


def _all_rise(cell: MeanCell, closer: Basis, index: int, vectors: Basis) -> bool:
    """Return True if all points of a denser lattice are separate blobs."""
    short = reduced_basis(closer @ vectors)
    sides = np.hypot(*short.T)
    if sides.max() > 1.6 * sides.min() or abs(short[0] @ short[1]) > 0.6 * sides.prod():
        return False
    neighbours = np.array([*short, short[0] + short[1], short[0] - short[1]]) @ np.linalg.inv(
        vectors
    )
    near = neighbours[np.hypot(*(neighbours @ vectors).T) < 1.25 * sides.max()]
    rise = max(_MIN_RISE * float(np.ptp(cell.values)), 4 * cell.error)
    steps = np.linspace(0, 0.7, 15)[:, None, None] * np.concatenate([near, -near])
    points = {
        tuple(np.round(np.round(np.array([a, b]) @ closer, 6) % 1, 6))
        for a in range(index)
        for b in range(index)
    }
    for point in points:
        along = _at(cell.values, np.asarray(point) + steps)
        if not (along[0] > along.min(axis=0) + rise).all():
            return False
    return True


def _at(cell: Values, positions: Any) -> Values:
    """Sample the cell at positions (..., 2), fractions of its base vectors."""
    from scipy.ndimage import map_coordinates

    index = np.moveaxis(np.asarray(positions) * len(cell), -1, 0)
    return np.asarray(map_coordinates(cell, index, order=1, mode="grid-wrap"))


def _patches(picture: Values, pitch: float) -> list[tuple[tuple[int, int], Values]]:
    """Return up to 3 x 3 patches spread over a picture, with their corners."""
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
    return np.asarray(mean > _MIN_BRIGHTNESS * mean.max())


def centre_offset(picture: Values, basis: Basis, phase: Values) -> Values:
    """Return the offset of the lenslets' centres from the phases, 0 unless the phases alias.

    At a small whole-number pitch without rotation all lenslets are sampled alike, and detail finer
    than the pixels shifts the phases. A piecewise linear radial profile, integrated over the
    pixels, is then fitted to the mean lenslet together with its centre by least squares.
    """
    cell = reduced_basis(np.linalg.inv(basis).T)
    if np.hypot(*cell.T).max() > _MAX_ALIASED_PITCH:
        return np.zeros(2)
    positions, value, count, bins = _distinct(picture, cell, -phase @ np.linalg.inv(basis).T)
    if len(positions) > _MAX_FILLED * bins:
        return np.zeros(2)
    weight = np.sqrt(count / count.mean())
    value = value / max(float(value.max()), 1e-30)
    centre, misfit = _profiled(positions, value, weight, cell)
    return centre if misfit < _MAX_MISFIT and np.hypot(*centre) < _MAX_OFFSET else np.zeros(2)


def _distinct(picture: Values, cell: Basis, origin: Values) -> tuple[Values, Values, Values, int]:
    """Return distinct pixel positions (n, 2) in a cell, means, counts, and the number of bins."""
    start = [max(0, n - _PATCH) // 2 for n in picture.shape]
    patch = picture[start[0] : start[0] + _PATCH, start[1] : start[1] + _PATCH]
    lit = _lit(patch, round(float(np.hypot(*cell.T).max())))
    offsets = np.stack(np.nonzero(lit), axis=1) + start - origin
    positions = offsets @ np.linalg.inv(cell) % 1
    n = [max(1, round(side / _BIN)) for side in np.hypot(*cell.T)]
    index = np.minimum((positions * n).astype(int), np.array(n) - 1) @ [n[1], 1]
    count = np.bincount(index, minlength=n[0] * n[1])
    filled = count > 0
    sums = [np.bincount(index, values, len(count))[filled] for values in (*positions.T, patch[lit])]
    means = np.array(sums) / count[filled]
    return means[:2].T @ cell, means[2], count[filled], len(count)


def _profiled(
    positions: Values, value: Values, weight: Values, cell: Basis
) -> tuple[Values, float]:
    """Fit a profile; return its centre (y, x) and the rms residual."""
    knots = int(np.ceil(0.75 * np.hypot(*cell.T).max() / _KNOT)) + 2
    bends = _CURVATURE_WEIGHT * len(positions) ** 0.5 * np.diff(np.eye(knots), 2, axis=0)
    values = np.concatenate([value * weight, np.zeros(len(bends))])

    def residual(centre: Values) -> Values:
        hats = _hats(positions - centre, cell, knots) * weight[:, None]
        model = np.concatenate([hats, bends])
        return np.asarray(values - model @ np.linalg.lstsq(model, values, rcond=None)[0])

    centre = np.zeros(2)
    for _ in range(_ROUNDS):
        slopes = [
            (residual(centre + step) - residual(centre - step)) / 0.02 for step in 0.01 * np.eye(2)
        ]
        centre = centre - np.linalg.lstsq(np.transpose(slopes), residual(centre), rcond=None)[0]
    return centre, float(np.sqrt((residual(centre)[: len(positions)] ** 2).mean()))


def _hats(away: Values, cell: Basis, knots: int) -> Values:
    """Return the weight of every knot of a profile for pixels off a centre, (n, knots)."""
    inside = (np.arange(_PIXEL_POINTS) + 0.5) / _PIXEL_POINTS - 0.5
    fine = np.stack(np.meshgrid(inside, inside, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    positions = (away + fine) @ np.linalg.inv(cell)
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])[:, None, None]
    offsets = (positions - np.floor(positions) - corners) @ cell
    r = np.hypot(offsets[..., 0], offsets[..., 1]).min(axis=0)
    steps = np.abs(r[..., None] / _KNOT - np.arange(knots))
    return np.asarray(np.maximum(1 - steps, 0).mean(axis=0))
