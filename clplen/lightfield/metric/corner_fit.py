"""Location of checkerboard corners to hundredths of a pixel.

Around a corner the picture is m + c S(d1/w) S(d2/w): two edges at the distances d1, d2, with S an
error function from -1 to 1. Least squares (Levenberg-Marquardt) gives the position, two directions,
m, c and the width w of the edges, for all corners of a view together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erf

Array = np.ndarray[Any, Any]

_WINDOW = (2, 8)  # pixels: minimum and maximum half width of a window
_SHARE = 0.7  # of the distance to the nearest corner: half width of a window without other edges
_ROUNDS = 12  # iterations
_BLUR = 0.7  # pixels: blur that makes pixel integration and lenses similar to the model
_ERF = 2 / np.sqrt(np.pi)
_MAX_SHIFT = 1.5  # pixels: maximum shift of a corner
_MIN_WIDTH, _MAX_WIDTH = 0.15, 3.0  # pixels: range of w


def fitted_corners(view: Array, corners: Array, board: tuple[int, int]) -> Array:
    """Refine the corners with the samples around them."""
    grid = corners.reshape(*board, 2)
    down, across = (np.asarray(np.gradient(grid, axis=axis)).reshape(-1, 2) for axis in (0, 1))
    nearest = np.minimum(np.linalg.norm(down, axis=1), np.linalg.norm(across, axis=1))
    radius = int(np.clip(_SHARE * nearest.min(), *_WINDOW))
    side = np.arange(-radius, radius + 1)
    y, x = np.repeat(side, len(side)), np.tile(side, len(side))
    inside = np.hypot(y, x) <= radius + 0.5
    offsets = np.stack([y, x], -1)[inside].astype(np.float64)
    base = np.rint(corners)
    positions = base[:, None] + offsets
    rim = np.array(view.shape) - 1
    valid = np.asarray(((positions >= 0) & (positions <= rim)).all(-1))
    index = np.clip(positions, 0, rim).astype(int)
    samples = gaussian_filter(view.astype(np.float64), _BLUR)[index[..., 0], index[..., 1]]
    start = _start(samples, valid, corners - base, down, across)
    solution = _least_squares(samples, valid, offsets, start)
    refined = base + solution[:, :2]
    failed = ~(np.abs(refined - corners).max(1) <= _MAX_SHIFT)
    refined[failed] = np.nan
    return refined


def _start(samples: Array, valid: Array, positions: Array, down: Array, across: Array) -> Array:
    """Return initial values: y, x, edge angles, m, c, log w; c up to its sign."""
    count = len(samples)
    start = np.empty((count, 7))
    start[:, :2] = positions
    start[:, 2] = np.arctan2(across[:, 0], across[:, 1])
    start[:, 3] = np.arctan2(down[:, 0], down[:, 1])
    low = np.where(valid, samples, np.inf).min(1)
    high = np.where(valid, samples, -np.inf).max(1)
    start[:, 4], start[:, 5] = (low + high) / 2, (high - low) / 2
    start[:, 6] = np.log(1.2)
    return start


def _model(offsets: Array, q: Array) -> tuple[Array, Array]:
    """Return the samples of a window and their derivatives by the seven parameters."""
    dy = offsets[:, 0] - q[:, :1]
    dx = offsets[:, 1] - q[:, 1:2]
    width = np.exp(q[:, 6:])
    s, slope, along, turned = [], [], [], []
    for edge in (2, 3):
        cos, sin = np.cos(q[:, edge : edge + 1]), np.sin(q[:, edge : edge + 1])
        distance = (dy * cos - dx * sin) / width
        s.append(erf(distance))
        slope.append(_ERF * np.exp(-(distance**2)))
        along.append(distance)
        turned.append((-dy * sin - dx * cos, cos, sin))
    derivatives = np.empty((*dy.shape, 7))
    c = q[:, 5:6]
    product = s[0] * s[1]
    first, second = c * slope[0] * s[1], c * slope[1] * s[0]
    derivatives[..., 0] = -(first * turned[0][1] + second * turned[1][1]) / width
    derivatives[..., 1] = (first * turned[0][2] + second * turned[1][2]) / width
    derivatives[..., 2] = first * turned[0][0] / width
    derivatives[..., 3] = second * turned[1][0] / width
    derivatives[..., 4] = 1
    derivatives[..., 5] = product
    derivatives[..., 6] = -(first * along[0] + second * along[1])
    return q[:, 4:5] + c * product, derivatives


def _least_squares(samples: Array, valid: Array, offsets: Array, q: Array) -> Array:
    """Return the seven parameters of each corner after `_ROUNDS` damped steps."""
    q = _signed(samples, valid, offsets, q)
    damping = np.full(len(q), 1e-3)
    model, derivatives = _model(offsets, q)
    error = (np.where(valid, samples - model, 0) ** 2).sum(1)
    for _ in range(_ROUNDS):
        derivatives = np.where(valid[..., None], derivatives, 0)
        normal = derivatives.swapaxes(1, 2) @ derivatives
        right = (derivatives * np.where(valid, samples - model, 0)[..., None]).sum(1)
        diagonal = np.einsum("nii->ni", normal)
        diagonal += damping[:, None] * diagonal + 1e-12 * (1 + diagonal.max(1, keepdims=True))
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        step[:, :2] = np.clip(step[:, :2], -0.5, 0.5)
        trial = q + step
        trial[:, 6] = np.clip(trial[:, 6], np.log(_MIN_WIDTH), np.log(_MAX_WIDTH))
        new_model, new_derivatives = _model(offsets, trial)
        new_error = (np.where(valid, samples - new_model, 0) ** 2).sum(1)
        better = new_error < error
        damping = np.where(better, damping / 5, damping * 5)
        q = np.where(better[:, None], trial, q)
        model = np.where(better[:, None], new_model, model)
        derivatives = np.where(better[:, None, None], new_derivatives, derivatives)
        error = np.where(better, new_error, error)
        if np.abs(step[:, :2]).max() < 1e-4:
            break
    return q


def _signed(samples: Array, valid: Array, offsets: Array, q: Array) -> Array:
    """Choose the sign of c that fits, i.e. the dark squares."""
    model = _model(offsets, q)[0] - q[:, 4:5]
    fit = (np.where(valid, (samples - q[:, 4:5]) * model, 0)).sum(1)
    q = q.copy()
    q[:, 5] *= np.where(fit < 0, -1, 1)
    return q
