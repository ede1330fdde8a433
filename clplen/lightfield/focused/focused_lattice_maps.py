"""Values of the lenslets of a lattice: their neighbours, gaps, and values between them."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from clplen.lightfield.focused.focused_geometry import FocusedGeometry, Values

if TYPE_CHECKING:
    from clplen.lightfield.focused.focused_picture import PictureGrid

_WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # pitches, of the Gaussians that fill gaps
_ENOUGH = 0.15  # weight from which on a Gaussian's mean is taken
_NEIGHBOURS = 1.8  # pitches
_COUNTING = 0.3  # weight from which on a neighbour counts for the median


def median_of_neighbours(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Median over the neighbours within 1.8 pitches, the lenslet itself left out.

    Parameters
    ----------
    values, weights : numpy.ndarray
        Shape (lines, lenslets); neighbours of weight below 0.3 do not count.
    geometry : FocusedGeometry

    Returns
    -------
    numpy.ndarray
        NaN where no neighbour counts.
    """
    known = np.where((weights >= _COUNTING) & (geometry.kinds >= 0), values, np.nan)
    lines, lenses = known.shape
    margin = 3
    padded = np.pad(known, margin, constant_values=np.nan)
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    near = []
    for i, j in product(range(-margin, margin + 1), repeat=2):
        far = np.linalg.norm(np.array([i, j]) @ base)
        if 0 < far < _NEIGHBOURS:
            near.append(padded[margin + i :, margin + j :][:lines, :lenses])
    stack = np.array(near)
    some = np.isfinite(stack).any(0)
    stack[:, ~some] = 0
    return np.where(some, np.nanmedian(stack, axis=0), np.nan)


def fill_lenslets(values: Values, weights: Values, geometry: FocusedGeometry) -> Values:
    """Values smoothed where they are known, and carried on where they are not.

    Normalised convolution (Knutsson & Westin 1993) with the narrowest of some Gaussians that finds
    enough weight.

    Parameters
    ----------
    values, weights : numpy.ndarray
        Shape (lines, lenslets), weights 0 to 1, not 0 throughout.
    geometry : FocusedGeometry

    Returns
    -------
    numpy.ndarray
        Shape (lines, lenslets), finite.
    """
    from scipy.ndimage import convolve  # here: slow to import

    out = np.full(values.shape, float(np.average(values, weights=weights)))
    missing = np.ones(values.shape, bool)
    for width in _WIDTHS:
        kernel = _gaussian(width, geometry)
        level = convolve(weights, kernel, mode="constant")
        mean = convolve(weights * values, kernel, mode="constant")
        now = missing & (level > _ENOUGH)
        out[now] = mean[now] / level[now]
        missing &= ~now
    return out


def interpolate_lenslets(values: Values, geometry: FocusedGeometry, grid: PictureGrid) -> Values:
    """Values at the samples of a picture, bilinear along the lattice's vectors.

    Parameters
    ----------
    values : numpy.ndarray
        Shape (lines, lenslets), finite; those at the edge go on beyond it.
    geometry : FocusedGeometry
    grid : PictureGrid

    Returns
    -------
    numpy.ndarray
        float64, shape (height, width).
    """
    from scipy.ndimage import map_coordinates  # here: slow to import

    y, x = (axis - start for axis, start in zip(grid.axes(), geometry.origin, strict=True))
    inverse = np.linalg.inv(np.array([geometry.first, geometry.second]))
    at = [y[:, None] * inverse[0, n] + x[None, :] * inverse[1, n] for n in (0, 1)]
    return np.asarray(map_coordinates(values, at, order=1, mode="nearest"))


def _gaussian(width: float, geometry: FocusedGeometry) -> Values:
    """A Gaussian over the lattice, sum 1; ``width`` in pitches."""
    reach = int(np.ceil(3 * width)) + 1
    base = np.array([geometry.first, geometry.second]) / geometry.pitch
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    square = ((np.stack([i, j], -1) @ base) ** 2).sum(-1)
    kernel = np.exp(-square / (2 * width**2))
    return np.asarray(kernel / kernel.sum())
