"""Corners of a checkerboard in the views of a light field, found by OpenCV and placed by fits."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from clplen.checks import install_advice, is_integer
from clplen.compute.device import DeviceLike
from clplen.lightfield.metric.corner_fit import fitted_corners
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

Array = np.ndarray[Any, Any]

_LEAST = 3  # rows or columns of corners


def find_corners(
    light_field: LightField | Array,
    board: tuple[int, int],
    *,
    device: DeviceLike | None = None,
) -> Array:
    """Find the inner corners of a checkerboard in every view.

    OpenCV's detector finds them, and fits of two edges to the samples about each place them, to a
    hundredth of a pixel in pictures with 1 % of noise.

    Parameters
    ----------
    light_field : LightField or array_like
        Views of one board, shape (v, u, y, x[, c]); the mean of colours is taken. Views of weight 0
        are left out.
    board : tuple of int
        (rows, columns) of inner corners, where four squares meet; at least 3 each.
    device : Device or str, optional
        Where an array goes; default ``Device.open()``.

    Returns
    -------
    numpy.ndarray
        (y, x) in pixels, float64, shape (V, U, rows columns, 2), row by row and in the same order
        in all views; NaN in views where the board was not found.

    Raises
    ------
    ModuleNotFoundError
        If OpenCV is not installed.
    ValueError
        If the board has fewer corners than 3 x 3.
    ShapeError
        If there is no light field.

    Examples
    --------
    >>> row, column = np.mgrid[:80, :110] // 12 % 2
    >>> views = np.broadcast_to(np.float32(row != column), (3, 3, 80, 110)).copy()
    >>> views[..., [0, 1, -1, -2], :] = views[..., :, [0, 1, -1, -2]] = 1
    >>> corners = clplen.lightfield.find_corners(views, (5, 8))
    >>> corners.shape, bool(np.isnan(corners).any())
    ((3, 3, 40, 2), False)
    """
    rows, columns = checked_board(board)
    opencv()
    lf = as_lightfield(light_field, device=device)
    V, U = lf.shape[:2]
    found = np.full((V, U, rows * columns, 2), np.nan)
    views = [(v, u) for v, u in np.ndindex(V, U) if lf.weights[v, u] > 0]

    def one(view: tuple[int, int]) -> Array | None:
        samples = np.asarray(lf.device.download(lf.data[view]), np.float32)
        return _of_view(samples if samples.ndim == 2 else samples.mean(-1), (rows, columns))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for view, corners in zip(views, pool.map(one, views), strict=True):
            if corners is not None:
                found[view] = corners
    return _alike(found, (rows, columns))


def checked_board(board: Any) -> tuple[int, int]:
    """(rows, columns) of inner corners."""
    try:
        rows, columns = board
    except (TypeError, ValueError):
        rows = columns = None
    if not (is_integer(rows) and is_integer(columns) and min(rows, columns) >= _LEAST):
        raise ValueError(
            "A board is (rows, columns) of its inner corners, where four squares meet, at least "
            f"{_LEAST} each, not {board!r}."
        )
    return int(rows), int(columns)


def opencv() -> Any:
    """The package cv2."""
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "Checkerboards are found by OpenCV, which is not installed: "
            f"{install_advice('calibrate')}."
        ) from error
    return cv2


def _of_view(view: Array, board: tuple[int, int]) -> Array | None:
    """Corners of one view, shape (rows columns, 2); None if the board is not seen as a whole."""
    cv2 = opencv()
    calm = median_filter(view, 3)  # a board may be small, and a single pixel hot
    black, white = calm.min(), calm.max()
    if not white > black:
        return None
    grey = np.clip((view - black) * (255 / (white - black)), 0, 255).astype(np.uint8)
    pattern = (board[1], board[0])
    exhaustive = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    is_found, corners = cv2.findChessboardCornersSB(grey, pattern, flags=exhaustive)
    if not is_found:
        is_found, corners = cv2.findChessboardCorners(grey, pattern)
    if not is_found or corners is None:
        return None
    placed = fitted_corners(view, corners.reshape(-1, 2)[:, ::-1].astype(np.float64), board)
    return placed if np.isfinite(placed).all() else None


def _alike(found: Array, board: tuple[int, int]) -> Array:
    """The corners of all views in the order of the view that is nearest to the middle.

    A board looks the same turned by 180 degrees, a square one by 90 degrees too.
    """
    seen = np.isfinite(found).all((-1, -2))
    if not seen.any():
        return found
    V, U = seen.shape
    away = np.abs(np.add.outer(1j * (np.arange(V) - (V - 1) / 2), np.arange(U) - (U - 1) / 2))
    first = np.unravel_index(np.argmin(np.where(seen, away, np.inf)), seen.shape)
    wanted = found[first] - found[first].mean(0)
    turns = range(4) if board[0] == board[1] else (0, 2)
    for view in np.argwhere(seen):
        grid = found[tuple(view)].reshape(*board, 2)
        ways = [np.rot90(grid, turn).reshape(-1, 2) for turn in turns]
        off = [((way - way.mean(0) - wanted) ** 2).sum() for way in ways]
        found[tuple(view)] = ways[int(np.argmin(off))]
    return found
