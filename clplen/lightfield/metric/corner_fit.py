"""Corners of checkerboards to hundredths of a pixel.

About a corner the picture is m + c S(d1/w) S(d2/w): two edges with the distances d1, d2 to them, S
an error function from -1 to 1. Place, two directions, m, c and the width w of the edges are found
by least squares (Levenberg-Marquardt), of all corners of a view together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erf

Array = np.ndarray[Any, Any]

_WINDOW = (2, 8)  # pixels from the middle of a window to its rim, at least and at most
_SHARE = 0.7  # of the distance to the nearest corner that is taken, as the next edges disturb
_ROUNDS = 12
_BLUR = 0.7  # pixels; makes pixels that integrate, and any lens, much like the model
_ERF = 2 / np.sqrt(np.pi)
_FARTHEST = 1.5  # pixels that a corner may move
_NARROWEST, _WIDEST = 0.15, 3.0  # pixels of w


def fitted_corners(view: Array, corners: Array, board: tuple[int, int]) -> Array:
    """The corners, placed by the samples around them."""
    grid = corners.reshape(*board, 2)
    down, across = (np.asarray(np.gradient(grid, axis=axis)).reshape(-1, 2) for axis in (0, 1))
    nearest = np.minimum(np.linalg.norm(down, axis=1), np.linalg.norm(across, axis=1))
    radius = int(np.clip(_SHARE * nearest.min(), *_WINDOW))
    side = np.arange(-radius, radius + 1)
    y, x = np.repeat(side, len(side)), np.tile(side, len(side))
    inside = np.hypot(y, x) <= radius + 0.5
    offsets = np.stack([y, x], -1)[inside].astype(np.float64)
    base = np.rint(corners)
    places = base[:, None] + offsets
    rim = np.array(view.shape) - 1
    known = np.asarray(((places >= 0) & (places <= rim)).all(-1))
    index = np.clip(places, 0, rim).astype(int)
    samples = gaussian_filter(view.astype(np.float64), _BLUR)[index[..., 0], index[..., 1]]
    start = _start(samples, known, corners - base, down, across)
    found = _least_squares(samples, known, offsets, start)
    placed = base + found[:, :2]
    lost = ~(np.abs(placed - corners).max(1) <= _FARTHEST)
    placed[lost] = np.nan
    return placed


def _start(samples: Array, known: Array, at: Array, down: Array, across: Array) -> Array:
    """First values: y, x, angle of each edge, m, c, log w; c by the better of its signs."""
    count = len(samples)
    start = np.empty((count, 7))
    start[:, :2] = at
    start[:, 2] = np.arctan2(across[:, 0], across[:, 1])
    start[:, 3] = np.arctan2(down[:, 0], down[:, 1])
    low = np.where(known, samples, np.inf).min(1)
    high = np.where(known, samples, -np.inf).max(1)
    start[:, 4], start[:, 5] = (low + high) / 2, (high - low) / 2
    start[:, 6] = np.log(1.2)
    return start


def _model(offsets: Array, q: Array) -> tuple[Array, Array]:
    """The samples of a window and their derivatives by the seven numbers."""
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


def _least_squares(samples: Array, known: Array, offsets: Array, q: Array) -> Array:
    """The seven numbers of each corner, after `_ROUNDS` damped steps."""
    q = _signed(samples, known, offsets, q)
    damping = np.full(len(q), 1e-3)
    model, derivatives = _model(offsets, q)
    error = (np.where(known, samples - model, 0) ** 2).sum(1)
    for _ in range(_ROUNDS):
        derivatives = np.where(known[..., None], derivatives, 0)
        normal = derivatives.swapaxes(1, 2) @ derivatives
        right = (derivatives * np.where(known, samples - model, 0)[..., None]).sum(1)
        diagonal = np.einsum("nii->ni", normal)
        diagonal += damping[:, None] * diagonal + 1e-12 * (1 + diagonal.max(1, keepdims=True))
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        step[:, :2] = np.clip(step[:, :2], -0.5, 0.5)
        tried = q + step
        tried[:, 6] = np.clip(tried[:, 6], np.log(_NARROWEST), np.log(_WIDEST))
        new_model, new_derivatives = _model(offsets, tried)
        new_error = (np.where(known, samples - new_model, 0) ** 2).sum(1)
        better = new_error < error
        damping = np.where(better, damping / 5, damping * 5)
        q = np.where(better[:, None], tried, q)
        model = np.where(better[:, None], new_model, model)
        derivatives = np.where(better[:, None, None], new_derivatives, derivatives)
        error = np.where(better, new_error, error)
        if np.abs(step[:, :2]).max() < 1e-4:
            break
    return q


def _signed(samples: Array, known: Array, offsets: Array, q: Array) -> Array:
    """With the sign of c that fits: which squares are dark."""
    model = _model(offsets, q)[0] - q[:, 4:5]
    fit = (np.where(known, (samples - q[:, 4:5]) * model, 0)).sum(1)
    q = q.copy()
    q[:, 5] *= np.where(fit < 0, -1, 1)
    return q
