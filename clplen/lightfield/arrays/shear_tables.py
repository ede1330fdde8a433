"""Weights and shifts of views as shear.cl takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Table = np.ndarray[Any, Any]

HELD = 16  # samples: see shear.cl


@dataclass(frozen=True)
class Views:
    """Weights and split shifts of the views of some planes."""

    weights: Table  # (V, U) float64
    down: Table  # (P, V), whole shifts, and their fractions
    below: Table
    right: Table  # (P, U), or (P, V, U)
    beside: Table
    ny: int
    nx: int
    channels: int

    @property
    def planes(self) -> int:
        return len(self.down)

    @property
    def samples(self) -> int:
        """Samples of a row."""
        return self.nx * self.channels

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells these views from all others."""
        arrays = (self.weights, self.down, self.below, self.right, self.beside)
        known = tuple((a.shape, a.tobytes()) for a in arrays)
        return (*known, self.ny, self.nx, self.channels)

    @property
    def operations(self) -> float:
        """Additions and multiplications: two of each for every sample of a view."""
        return 4.0 * np.count_nonzero(self.weights) * self.planes * self.ny * self.samples

    def part(self, first: int, count: int) -> Views:
        """`count` planes (or as many as there are) from `first` on."""
        some = slice(first, first + count)
        return replace(
            self,
            down=self.down[some],
            below=self.below[some],
            right=self.right[some],
            beside=self.beside[some],
        )


def split_views(
    shape: tuple[int, ...], weights: Table, shift_y: Table, shift_x: Table
) -> Views:
    """Weights (V, U) and shifts (P, V) and (P, U), or (P, V, U), as the kernels take them."""
    w = np.asarray(weights, np.float64)
    sy, sx = (np.asarray(shift, np.float64) for shift in (shift_y, shift_x))
    V, U, ny, nx, channels = (*shape, 1)[:5]
    P = len(sy)
    if sy.ndim == 3:  # rows of one view each
        sx = np.broadcast_to(sx.reshape(P, -1, U), (P, V, U)).reshape(P, V * U, 1)
        w, sy = w.reshape(V * U, 1), sy.reshape(P, V * U)
    return Views(w, *_split(sy, ny), *_split(sx, nx), ny, nx, channels)


def _split(shift: Table, size: int) -> tuple[Table, Table]:
    """Whole shift and fraction; a shift that leaves the view altogether by one pixel is enough."""
    whole = np.floor(shift)
    return np.clip(whole, -size - 1, size).astype(np.int32), shift - whole


def kernel_tables(views: Views) -> list[Table]:
    """count, order, span, slide, taps, down and blend of shear.cl."""
    w = views.weights
    order = np.argsort(w == 0, axis=1, kind="stable")
    right, beside = (_in_order(a, order) for a in (views.right, views.beside))
    low = right.min(axis=0)
    slide = (right - low).swapaxes(0, 1) * views.channels
    used = np.take_along_axis(w, order, 1)
    whole = [
        np.count_nonzero(w, axis=1),
        order,
        np.stack((low, np.ptp(right, axis=0)), axis=-1) * views.channels,
        slide,
    ]
    parts = [np.stack((used * (1 - beside), used * beside), axis=-1).swapaxes(0, 1)]
    return [
        *(a.astype(np.int32) for a in whole),
        *(a.astype(np.float32) for a in parts),
        views.down.T.astype(np.int32),
        views.below.T.astype(np.float32),
    ]


def _in_order(a: Table, order: Table) -> Table:
    """(P, U) or (P, V, U) as (P, V, U), each row of views in an order of its own."""
    rows = np.broadcast_to(a if a.ndim == 3 else a[:, None], (len(a), *order.shape))
    return np.take_along_axis(rows, order[None], 2)


@dataclass(frozen=True)
class Norm:
    """Weights that each sample of a row uses, by v, then in all, as shear.cl reads them."""

    table: Table  # (P, V + 1, n) float32
    near: int
    far: int


def weight_norms(views: Views, width: int) -> Norm:
    """Of rows of `width` samples, those beyond a view with weight 0."""
    first = min(max(0, -int(views.right.min())), views.nx)
    last = max(min(views.nx - 1 - int(views.right.max()), views.nx), first + 1)
    used = _used(views, np.r_[: min(first + 1, views.nx), last : views.nx])
    near, far, alike = first * views.channels, last * views.channels - HELD, 2 * HELD
    if last > views.nx or far < near:  # too few samples lie inside all views: keep every one
        near, far, alike = width, width, (last - first) * views.channels
    sizes = (views.channels, alike, views.channels)
    parts = zip(np.split(used, (first, first + 1), -1), sizes, strict=True)
    kept = np.concatenate([np.repeat(part, size, -1) for part, size in parts], -1)
    beyond = ((0, 0), (0, 0), (0, width - views.samples))
    return Norm(np.pad(kept, beyond).astype(np.float32), near, far)


def _used(views: Views, columns: Table) -> Table:
    """Weights that pixels of some columns use, by v, then in all: (P, V + 1, n) float64."""
    w = views.weights
    x = columns + views.right[..., None]
    left, right = ((x + step >= 0) & (x + step < views.nx) for step in (0, 1))
    inside = left * (1 - views.beside[..., None]) + right * views.beside[..., None]
    used = np.zeros((views.planes, len(w), columns.size))
    for u in range(w.shape[1]):  # in one order for every pixel, which a product of matrices is not
        used += w[:, u, None] * inside[..., u, :].reshape(views.planes, -1, columns.size)
    return np.concatenate((used, used.sum(axis=1, keepdims=True)), axis=1)


def spread_tables(views: Views) -> list[Table]:
    """count, order, span, slide, taps, down and blend of shear_adjoint.cl."""
    w = views.weights
    order = np.argsort(w == 0, axis=1, kind="stable")
    right, beside = (_in_order(a, order) for a in (views.right, views.beside))
    used = np.take_along_axis(w, order, 1)
    high = right.max(axis=2)
    span = np.stack((-1 - high, np.ptp(right, axis=2)), axis=-1).swapaxes(0, 1)
    whole = [np.count_nonzero(w, axis=1), order, span * views.channels]
    slide = (high[..., None] - right) * views.channels
    taps = np.stack((used * beside, used * (1 - beside)), axis=-1)
    return [
        *(a.astype(np.int32) for a in (*whole, np.moveaxis(slide, 0, 2))),
        np.moveaxis(taps, 0, 2).astype(np.float32),
        views.down.T.astype(np.int32),
        views.below.T.astype(np.float32),
    ]
