"""Checkerboard corners in the views of a light field: detected by OpenCV, refined by fits."""

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

_MIN_CORNERS = 3  # minimum rows or columns of corners


def find_corners(
    light_field: LightField | Array,
    board: tuple[int, int],
    *,
    device: DeviceLike | None = None,
) -> Array:
    """Detect the inner corners of a checkerboard in every view.

    OpenCV detects the corners. Fits of two edges to the samples around each corner then locate it
    to a hundredth of a pixel in pictures with 1 % of noise.

    Parameters
    ----------
    light_field : LightField or array_like
        Views of one board, shape (v, u, y, x[, c]), averaged over colours. Views of weight 0 are
        skipped.
    board : tuple of int
        Number (rows, columns) of inner corners, where four squares meet; at least 3 each.
    device : Device or str, optional
        Device for an array; default ``Device.open()``.

    Returns
    -------
    numpy.ndarray
        Corners (y, x) in pixels, float64, shape (V, U, rows columns, 2), row by row and in one
        order for all views; NaN in views without a detected board.

    Raises
    ------
    ModuleNotFoundError
        If OpenCV is not installed.
    ValueError
        If the board has fewer corners than 3 x 3.
    ShapeError
        If the views are not a light field.

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
    corners_of_views = np.full((V, U, rows * columns, 2), np.nan)
    views = [(v, u) for v, u in np.ndindex(V, U) if lf.weights[v, u] > 0]

    def detect(view: tuple[int, int]) -> Array | None:
        samples = np.asarray(lf.device.download(lf.data[view]), np.float32)
        return _of_view(samples if samples.ndim == 2 else samples.mean(-1), (rows, columns))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for view, corners in zip(views, pool.map(detect, views), strict=True):
            if corners is not None:
                corners_of_views[view] = corners
    return _ordered(corners_of_views, (rows, columns))


def checked_board(board: Any) -> tuple[int, int]:
    """Check the number of inner corners and return (rows, columns)."""
    try:
        rows, columns = board
    except (TypeError, ValueError):
        rows = columns = None
    if not (is_integer(rows) and is_integer(columns) and min(rows, columns) >= _MIN_CORNERS):
        raise ValueError(
            "board must be (rows, columns) of inner corners, where four squares meet, at least "
            f"{_MIN_CORNERS} each, got {board!r}."
        )
    return int(rows), int(columns)


def opencv() -> Any:
    """Return the package cv2."""
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "Detecting checkerboards needs OpenCV, which is not installed: "
            f"{install_advice('calibrate')}."
        ) from error
    return cv2


def _of_view(view: Array, board: tuple[int, int]) -> Array | None:
    """Return one view's corners, shape (rows columns, 2); None if the board is incomplete."""
    cv2 = opencv()
    smooth = median_filter(view, 3)  # the board may be small, and a single pixel hot
    black, white = smooth.min(), smooth.max()
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
    refined = fitted_corners(view, corners.reshape(-1, 2)[:, ::-1].astype(np.float64), board)
    return refined if np.isfinite(refined).all() else None


def _ordered(corners: Array, board: tuple[int, int]) -> Array:
    """Order the corners of all views like those of the view nearest to the middle.

    A board looks equal after a turn by 180 degrees, a square one also by 90 degrees.
    """
    detected = np.isfinite(corners).all((-1, -2))
    if not detected.any():
        return corners
    V, U = detected.shape
    distance = np.abs(np.add.outer(1j * (np.arange(V) - (V - 1) / 2), np.arange(U) - (U - 1) / 2))
    first = np.unravel_index(np.argmin(np.where(detected, distance, np.inf)), detected.shape)
    reference = corners[first] - corners[first].mean(0)
    turns = range(4) if board[0] == board[1] else (0, 2)
    for view in np.argwhere(detected):
        grid = corners[tuple(view)].reshape(*board, 2)
        orientations = [np.rot90(grid, turn).reshape(-1, 2) for turn in turns]
        mismatch = [
            ((candidate - candidate.mean(0) - reference) ** 2).sum() for candidate in orientations
        ]
        corners[tuple(view)] = orientations[int(np.argmin(mismatch))]
    return corners
