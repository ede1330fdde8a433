"""Shared parts of float64 references: interpolation matrices, covered areas, random samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.types import Array


def reals(seed: int, *shape: int, low: float = 0.0, high: float = 1.0) -> Array:
    """Return random float32 samples between two values."""
    return np.random.default_rng(seed).uniform(low, high, shape).astype(np.float32)


def waves(seed: int, *shape: int) -> Array:
    """Return random complex64 samples with a nonzero mean."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=shape) + 1j * rng.normal(size=shape) + (0.3 - 0.1j)
    return values.astype(np.complex64)


def triangle(t: Any) -> Array:
    """Return linear interpolation weights max(1 - |t|, 0)."""
    return np.maximum(1 - np.abs(t), 0)


def keys(t: Any) -> Array:
    """Return cubic convolution weights, a = -1/2 (Keys 1981, eq. 15)."""
    t = np.abs(t)
    near = (1.5 * t - 2.5) * t**2 + 1
    far = ((-0.5 * t + 2.5) * t - 4) * t + 2
    return np.where(t <= 1, near, np.where(t < 2, far, 0.0))


def interpolation(positions: Any, n: int, *, kernel: Any = triangle, clamp: bool = False) -> Array:
    """Return the matrix (positions, n) that interpolates n samples at real positions.

    Taps outside the samples count as 0, or as the edge with ``clamp``.
    """
    at = np.asarray(positions, float)
    matrix = np.zeros((at.size, n))
    for step in (-1, 0, 1, 2):
        index = np.floor(at).astype(int) + step
        weight = kernel(at - index)
        inside = (index >= 0) & (index < n)
        np.add.at(
            matrix,
            (np.arange(at.size), np.clip(index, 0, n - 1)),
            weight if clamp else weight * inside,
        )
    return matrix


def view_steps(views: tuple[int, int]) -> Array:
    """Return the shift (y, x) in pixels of a point of disparity 1 in each view."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    return -np.stack(np.meshgrid(v, u, indexing="ij"), axis=-1)


def moved(view: Array, shift: Any, *, clamp: bool = False) -> tuple[Array, Array]:
    """Return (values, share of taps inside) of a view (y, x[, c]) at (y, x) + shift, linear."""
    ny, nx = view.shape[:2]
    down, right = np.arange(ny) + shift[0], np.arange(nx) + shift[1]
    my, mx = (interpolation(p, n, clamp=clamp) for p, n in ((down, ny), (right, nx)))
    values = np.einsum("ij,jk...,lk->il...", my, view.astype(float), mx)
    share = [interpolation(p, n).sum(axis=1) for p, n in ((down, ny), (right, nx))]
    return values, np.outer(*share)


def reflected(picture: Array, taps: Array, axis: int) -> Array:
    """Filter a picture by symmetric taps (at distance 0, 1, ...), reflected at its edges."""
    n, radius = picture.shape[axis], taps.size - 1
    index = np.arange(-radius, n + radius) % (2 * n)
    wide = np.take(picture, np.where(index < n, index, 2 * n - 1 - index), axis)
    all_taps = np.concatenate((taps[:0:-1], taps))
    return np.asarray(
        sum(w * np.take(wide, np.arange(n) + k, axis) for k, w in enumerate(all_taps))
    )


def disc_share(y: Array, x: Array, radius: float, pitch: tuple[float, float]) -> Array:
    """Return the share of each cell covered by a disc about 0: exact chords in 400 strips."""
    strips = (np.arange(400) + 0.5) / 400 - 0.5
    at = np.asarray(y)[..., None] + strips * pitch[0]
    chord = np.sqrt(np.maximum(radius**2 - at**2, 0))
    left, right = (np.asarray(x)[..., None] + side * pitch[1] / 2 for side in (-1, 1))
    width = np.maximum(np.minimum(right, chord) - np.maximum(left, -chord), 0)
    return np.asarray(width.mean(axis=-1) / pitch[1])


def bell_taps(part: float) -> Array:
    """Return taps at -1, 0, 1, 2 for a fraction: (1 - t^2/4)^4, with corrected mean."""
    t = np.arange(-1.0, 3.0)
    w = np.maximum(1 - (t - part) ** 2 / 4, 0) ** 4
    w /= w.sum()
    mean = w @ t
    return np.asarray(w * (1 + (part - mean) * (t - mean) / (w @ (t - mean) ** 2)))
