"""Tables of weights and shifts of the views for shear.cl."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Table = np.ndarray[Any, Any]

ITEM_SAMPLES = 16  # samples of a work-item, equal to the value in shear.cl


@dataclass(frozen=True)
class Views:
    """Weights and shifts, split into pixels and fractions, of the views of some planes."""

    weights: Table  # (V, U) float64
    down: Table  # (P, V), rows, and their fractions
    fraction_y: Table
    right: Table  # (P, U) or (P, V, U), columns, and their fractions
    fraction_x: Table
    ny: int
    nx: int
    channels: int

    @property
    def planes(self) -> int:
        return len(self.down)

    @property
    def samples(self) -> int:
        """Number of samples of a row."""
        return self.nx * self.channels

    @property
    def key(self) -> tuple[Any, ...]:
        """Key of these views in a cache of tables."""
        arrays = (self.weights, self.down, self.fraction_y, self.right, self.fraction_x)
        content = tuple((a.shape, a.tobytes()) for a in arrays)
        return (*content, self.ny, self.nx, self.channels)

    @property
    def operations(self) -> float:
        """Number of additions and multiplications, two of each per sample of a view."""
        return 4.0 * np.count_nonzero(self.weights) * self.planes * self.ny * self.samples

    def part(self, first: int, count: int) -> Views:
        """Return up to ``count`` planes from ``first`` on."""
        selection = slice(first, first + count)
        return replace(
            self,
            down=self.down[selection],
            fraction_y=self.fraction_y[selection],
            right=self.right[selection],
            fraction_x=self.fraction_x[selection],
        )


def split_views(shape: tuple[int, ...], weights: Table, shift_y: Table, shift_x: Table) -> Views:
    """Split shifts (P, V) and (P, U), or (P, V, U), for the kernels, with weights (V, U)."""
    w = np.asarray(weights, np.float64)
    sy, sx = (np.asarray(shift, np.float64) for shift in (shift_y, shift_x))
    V, U, ny, nx, channels = (*shape, 1)[:5]
    P = len(sy)
    if sy.ndim == 3:  # rows of one view each
        sx = np.broadcast_to(sx.reshape(P, -1, U), (P, V, U)).reshape(P, V * U, 1)
        w, sy = w.reshape(V * U, 1), sy.reshape(P, V * U)
    return Views(w, *_split(sy, ny), *_split(sx, nx), ny, nx, channels)


def _split(shift: Table, size: int) -> tuple[Table, Table]:
    """Split a shift into pixels and fraction; clip shifts beyond the view."""
    pixels = np.floor(shift)
    return np.clip(pixels, -size - 1, size).astype(np.int32), shift - pixels


def kernel_tables(views: Views) -> list[Table]:
    """Return the tables count, order, span, slide, taps, down and blend of shear.cl."""
    w = views.weights
    order = np.argsort(w == 0, axis=1, kind="stable")
    right, fraction_x = (_in_order(a, order) for a in (views.right, views.fraction_x))
    low = right.min(axis=0)
    slide = (right - low).swapaxes(0, 1) * views.channels
    weights_in_order = np.take_along_axis(w, order, 1)
    integers = [
        np.count_nonzero(w, axis=1),
        order,
        np.stack((low, np.ptp(right, axis=0)), axis=-1) * views.channels,
        slide,
    ]
    floats = [
        np.stack(
            (weights_in_order * (1 - fraction_x), weights_in_order * fraction_x), axis=-1
        ).swapaxes(0, 1)
    ]
    return [
        *(a.astype(np.int32) for a in integers),
        *(a.astype(np.float32) for a in floats),
        views.down.T.astype(np.int32),
        views.fraction_y.T.astype(np.float32),
    ]


def _in_order(a: Table, order: Table) -> Table:
    """Sort (P, U) or (P, V, U) along u by an order for each row of views; return (P, V, U)."""
    rows = np.broadcast_to(a if a.ndim == 3 else a[:, None], (len(a), *order.shape))
    return np.take_along_axis(rows, order[None], 2)


@dataclass(frozen=True)
class Norm:
    """Sums of weights for each sample of a row, by v and in total, in the layout of shear.cl."""

    table: Table  # (P, V + 1, n) float32
    near: int
    far: int


def weight_norms(views: Views, width: int) -> Norm:
    """Return the sums of weights of rows of ``width`` samples; samples outside a view have 0."""
    first = min(max(0, -int(views.right.min())), views.nx)
    last = max(min(views.nx - 1 - int(views.right.max()), views.nx), first + 1)
    sums = _used(views, np.r_[: min(first + 1, views.nx), last : views.nx])
    near, far, alike = (
        first * views.channels,
        last * views.channels - ITEM_SAMPLES,
        2 * ITEM_SAMPLES,
    )
    if last > views.nx or far < near:  # too few samples lie inside all views: store each of them
        near, far, alike = width, width, (last - first) * views.channels
    sizes = (views.channels, alike, views.channels)
    parts = zip(np.split(sums, (first, first + 1), -1), sizes, strict=True)
    table = np.concatenate([np.repeat(part, size, -1) for part, size in parts], -1)
    beyond = ((0, 0), (0, 0), (0, width - views.samples))
    return Norm(np.pad(table, beyond).astype(np.float32), near, far)


def _used(views: Views, columns: Table) -> Table:
    """Return the weights in use at some columns, by v and in total, float64 (P, V + 1, n)."""
    w = views.weights
    x = columns + views.right[..., None]
    left, right = ((x + step >= 0) & (x + step < views.nx) for step in (0, 1))
    inside = left * (1 - views.fraction_x[..., None]) + right * views.fraction_x[..., None]
    sums = np.zeros((views.planes, len(w), columns.size))
    for u in range(w.shape[1]):  # fixed order, unlike a matrix product
        sums += w[:, u, None] * inside[..., u, :].reshape(views.planes, -1, columns.size)
    return np.concatenate((sums, sums.sum(axis=1, keepdims=True)), axis=1)


def spread_tables(views: Views) -> list[Table]:
    """Return the tables count, order, span, slide, taps, down and blend of shear_adjoint.cl."""
    w = views.weights
    order = np.argsort(w == 0, axis=1, kind="stable")
    right, fraction_x = (_in_order(a, order) for a in (views.right, views.fraction_x))
    weights_in_order = np.take_along_axis(w, order, 1)
    high = right.max(axis=2)
    span = np.stack((-1 - high, np.ptp(right, axis=2)), axis=-1).swapaxes(0, 1)
    integers = [np.count_nonzero(w, axis=1), order, span * views.channels]
    slide = (high[..., None] - right) * views.channels
    taps = np.stack((weights_in_order * fraction_x, weights_in_order * (1 - fraction_x)), axis=-1)
    return [
        *(a.astype(np.int32) for a in (*integers, np.moveaxis(slide, 0, 2))),
        np.moveaxis(taps, 0, 2).astype(np.float32),
        views.down.T.astype(np.int32),
        views.fraction_y.T.astype(np.float32),
    ]
