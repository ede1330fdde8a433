"""Weights and shifts of views as shear.cl takes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.errors import ShapeError

Table = np.ndarray[Any, Any]


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
    clamp: bool

    @property
    def planes(self) -> int:
        return len(self.down)

    @property
    def samples(self) -> int:
        """Samples of a row."""
        return self.nx * self.channels

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
    shape: tuple[int, ...], weights: Table, shift_y: Table, shift_x: Table, edge: str
) -> Views:
    """What the kernels need to know of the views, checked."""
    w = np.asarray(weights, np.float64)
    sy, sx = (np.asarray(shift, np.float64) for shift in (shift_y, shift_x))
    if len(shape) not in (4, 5) or 0 in shape:
        raise ShapeError(f"A light field has shape (v, u, y, x[, c]), none empty, not {shape}.")
    V, U, ny, nx = shape[:4]
    P = len(sy) if sy.ndim else 0
    fits = sy.shape in ((P, V), (P, V, U)) and sx.shape in ((P, U), (P, V, U))
    if w.shape != (V, U) or not fits:
        raise ShapeError(
            f"{V} x {U} views take weights of shape {(V, U)} and, for P planes, shifts of shape "
            f"(P, {V}) and (P, {U}), or (P, {V}, {U}), not {w.shape}, {sy.shape} and {sx.shape}."
        )
    if P == 0:
        raise ShapeError("Give the shifts of at least one plane.")
    if not all(np.isfinite(a).all() for a in (w, sy, sx)):
        raise ValueError("Weights and shifts of views are finite numbers.")
    if edge not in ("normalised", "clamp"):
        raise ValueError(f"edge is 'normalised' or 'clamp', not {edge!r}.")
    channels = shape[4] if len(shape) == 5 else 1
    if sy.ndim == 3:  # rows of one view each
        sx = np.broadcast_to(sx.reshape(P, -1, U), (P, V, U)).reshape(P, V * U, 1)
        w, sy = w.reshape(V * U, 1), sy.reshape(P, V * U)
    return Views(w, *_split(sy, ny), *_split(sx, nx), ny, nx, channels, edge == "clamp")


def _split(shift: Table, size: int) -> tuple[Table, Table]:
    """Whole shift and fraction; a shift that leaves the view altogether by one pixel is enough."""
    whole = np.floor(shift)
    return np.clip(whole, -size - 1, size).astype(np.int32), shift - whole


def tables_of(views: Views, norm_pitch: int) -> list[Table]:
    """count, order, span, slide, taps, down, blend and norm of shear.cl."""
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
        _norm(views, norm_pitch),
    ]


def _in_order(a: Table, order: Table) -> Table:
    """(P, U) or (P, V, U) as (P, V, U), each row of views in an order of its own."""
    rows = np.broadcast_to(a if a.ndim == 3 else a[:, None], (len(a), *order.shape))
    return np.take_along_axis(rows, order[None], 2)


def _norm(views: Views, pitch: int) -> Table:
    """Weights that each sample of a row uses, by v, then in all. Shape (P, V + 1, pitch)."""
    w = views.weights
    norm = np.zeros((views.planes, len(w) + 1, pitch), np.float32)
    here = norm[..., : views.samples].reshape(*norm.shape[:2], views.nx, -1)
    if views.clamp:
        here[:, :-1] = w.sum(axis=1)[:, None, None]
        here[:, -1] = w.sum()
        return norm
    first = min(max(0, -int(views.right.min())), views.nx)
    last = max(min(views.nx - 1 - int(views.right.max()), views.nx), first + 1)
    columns = np.r_[: min(first + 1, views.nx), last : views.nx]  # `first`: where all lie inside
    x = columns + views.right[..., None]
    left, right = ((x + step >= 0) & (x + step < views.nx) for step in (0, 1))
    inside = left * (1 - views.beside[..., None]) + right * views.beside[..., None]
    used = np.zeros((views.planes, len(w), columns.size))
    for u in range(w.shape[1]):  # in one order for every pixel, which a product of matrices is not
        used += w[:, u, None] * inside[..., u, :].reshape(views.planes, -1, columns.size)
    both = np.concatenate((used, used.sum(axis=1, keepdims=True)), axis=1)[..., None]
    here[:, :, :first] = both[:, :, :first]
    here[:, :, first:last] = both[:, :, first : first + 1]
    here[:, :, last:] = both[:, :, first + 1 :]
    return norm
