"""Focus on a tilted or curved surface: a disparity of every pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.errors import ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

DisparityMap = np.ndarray[Any, np.dtype[np.float64]]

_ROUNDS = 8  # of the fixed point in `carried`
_FLAT = 1e-9  # points on one line, relative to their spread


def plane_through(points: ArrayLike, shape: tuple[int, ...]) -> DisparityMap:
    """Disparity of every pixel on the plane through three points, or nearest to more of them.

    A plane in space is a plane d = a + b y + c x in the disparities of a light field (d is linear
    in 1/z by the lens law, and perspective keeps planes).

    Parameters
    ----------
    points : array_like
        Shape (n, 3), n >= 3: y, x in pixels of the centre view and d there. Three are met exactly,
        more by least squares.
    shape : tuple of int
        (y, x[, c]) of a view, as in ``lf.shape[2:]``.

    Returns
    -------
    numpy.ndarray
        float64, shape (y, x); for ``refocus(lf, disparity=...)``.

    Raises
    ------
    ShapeError
        If the points are not (n, 3) with at least three.
    ValueError
        If one is not finite, or they lie on one line.
    """
    values = np.asarray(points, np.float64)
    if values.ndim != 2 or values.shape[1:] != (3,) or len(values) < 3:
        raise ShapeError(
            f"A plane goes through at least three points (y, x, d), shape (n, 3), not "
            f"{values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError(f"The points of a plane are finite numbers (y, x, d), not {points!r}.")
    middle = values[:, :2].mean(axis=0)
    around = values[:, :2] - middle
    spread = np.linalg.svd(around, compute_uv=False)
    if spread[1] <= _FLAT * spread[0]:
        raise ValueError(
            "The points of a plane lie on one line (or one place): pick one beside it."
        )
    known = np.column_stack((np.ones(len(values)), around))
    offset, down, right = np.linalg.lstsq(known, values[:, 2], rcond=None)[0]
    y, x = (np.arange(n) - at for n, at in zip(shape, middle, strict=False))
    return offset + down * y[:, None] + right * x[None, :]


def carried(disparity: DisparityMap, step: DisparityMap) -> DisparityMap:
    """A disparity map of the centre view as another viewpoint sees it.

    What lies at p in the centre view is at p + step d(p) in the other, so the map there solves
    e(q) = d(q - step e(q)): a fixed point, found in a few rounds. Where a surface hides another
    it takes one of the two, beyond the edges the nearest pixel.

    Parameters
    ----------
    disparity : numpy.ndarray
        Shape (y, x).
    step : numpy.ndarray
        (y, x) in pixels for disparity 1, as of `unit_steps`.

    Returns
    -------
    numpy.ndarray
        float64, shape (y, x).
    """
    from scipy.ndimage import map_coordinates  # here: slow to import

    if not step.any():
        return disparity
    y, x = np.indices(disparity.shape)
    found = disparity
    for _ in range(_ROUNDS):
        at = (y - step[0] * found, x - step[1] * found)
        found = map_coordinates(disparity, at, order=1, mode="nearest")
    return np.asarray(found)
