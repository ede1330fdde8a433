"""Shear, interpolate, sum: the pictures of a light field refocused on many planes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.errors import ShapeError
from clplen.lightfield.samples import C_TYPE

if TYPE_CHECKING:
    from clplen.compute.device import Device

Table = np.ndarray[Any, Any]
Edge = Literal["normalised", "clamp"]

_MOST_PLANES = 64  # of one launch
_LOCAL_BYTES = 512 * 1024  # of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # what an OpenCL runtime may keep for itself
_WIDEST = 16  # chunks of a block
_NORM_FLOATS = 1 << 23  # of the weights that samples use, in one launch
_ITEMS_PER_CORE = 8  # so that no core waits long for the last one
_SAMPLE_PLANES, _SAMPLE_HEIGHT, _SAMPLE_GROUP = 4, 4, 64  # what a GPU's work-item does


def shear_sum(
    lf_data: cla.Array,
    weights: Table,
    shift_y: Table,
    shift_x: Table,
    *,
    device: Device,
    edge: Edge = "normalised",
    total: bool = False,
    out: cla.Array | None = None,
) -> cla.Array:
    """Shift every view by its constant, interpolate linearly, and average over the views.

    Picture p is the sum over v, u of w[v, u] L[v, u](y + shift_y[p, v], x + shift_x[p, u]) over
    the sum of the weights (Ng 2005, shift and add); views that lie on no grid have a shift of
    their own each. The result has the same bits in every run.

    Parameters
    ----------
    lf_data : pyopencl.array.Array
        Shape (v, u, y, x) or (v, u, y, x, c), C-contiguous, uint8, uint16 or float32.
    weights : numpy.ndarray
        Shape (V, U), finite. A view of weight 0 is not read.
    shift_y, shift_x : numpy.ndarray
        Shapes (P, V) and (P, U), or (P, V, U) (either or both), finite, in pixels; split in
        float64 into a whole number, which moves the view, and a fraction, by which it is
        interpolated. A grid, (P, V), is summed faster.
    device : Device
        Where ``lf_data`` lives.
    edge : {"normalised", "clamp"}
        "normalised": a sample outside a view counts neither in the sum nor in the weights, and a
        pixel that no view reaches is 0. "clamp": it is the nearest sample of the view.
    total : bool
        The sum itself, not divided by the weights.
    out : pyopencl.array.Array, optional
        float32, where the result goes.

    Returns
    -------
    pyopencl.array.Array
        float32, shape (P, y, x) or (P, y, x, c).

    Raises
    ------
    ShapeError
        If the shapes do not fit together.
    ValueError
        If a weight or shift is not finite, or ``edge`` is neither.
    DeviceError
        If the pictures need more memory than the device has.
    """
    shape = tuple(int(n) for n in lf_data.shape)
    views = _views(shape, weights, shift_y, shift_x, edge)
    if out is None:
        nbytes = 4 * views.planes * views.ny * views.samples
        device.require_memory(nbytes, "The refocused pictures")
        out = device.empty((views.planes, *shape[2:]), np.float32)
    elif tuple(out.shape) != (views.planes, *shape[2:]) or out.dtype != np.float32:
        raise ShapeError(
            f"out holds {views.planes} float32 pictures of shape {shape[2:]}, not "
            f"{tuple(out.shape)} ({out.dtype})."
        )
    blocks = _best_blocks(views, device) if device.rows else None
    step = min(blocks.planes if blocks else _MOST_PLANES, _planes_of_norm(views))
    for first in range(0, views.planes, step):
        part = views.part(first, step)
        _launch(device, out, lf_data, part, blocks, (first, int(total)))
    return out


@dataclass(frozen=True)
class _Views:
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

    def part(self, first: int, count: int) -> _Views:
        """`count` planes (or as many as there are) from `first` on."""
        some = slice(first, first + count)
        return replace(
            self,
            down=self.down[some],
            below=self.below[some],
            right=self.right[some],
            beside=self.beside[some],
        )


@dataclass(frozen=True)
class _Blocks:
    """What a work-item of shear_blocks does, and its share of the cost of a plane."""

    planes: int
    width: int
    height: int
    pitch: int
    cost: float


def _views(
    shape: tuple[int, ...], weights: Table, shift_y: Table, shift_x: Table, edge: str
) -> _Views:
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
    return _Views(w, *_split(sy, ny), *_split(sx, nx), ny, nx, channels, edge == "clamp")


def _split(shift: Table, size: int) -> tuple[Table, Table]:
    """Whole shift and fraction; a shift that leaves the view altogether by one pixel is enough."""
    whole = np.floor(shift)
    return np.clip(whole, -size - 1, size).astype(np.int32), shift - whole


def _planes_of_norm(views: _Views) -> int:
    """Planes of a launch whose table of weights is not too large."""
    return max(1, _NORM_FLOATS // ((len(views.weights) + 1) * views.samples))


def _lanes(device: Device) -> tuple[int, int]:
    """Floats of a vector, and vectors summed at a time: two registers each of 32, or 16."""
    lanes = min(max(int(device.cl_device.native_vector_width_float), 4), 16)
    return lanes, 8 if lanes == 16 else 6


def _best_blocks(views: _Views, device: Device) -> _Blocks | None:
    """The cheapest blocks whose local memory the device has; None if there are none."""
    lanes, vectors = _lanes(device)
    chunk = lanes * vectors
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    items = _ITEMS_PER_CORE * int(device.cl_device.max_compute_units)
    first = views.channels // chunk + 1
    last = max(first, min(_WIDEST, -(-(views.samples + views.channels) // chunk)))
    passes = {-(-views.planes // most) for most in (1, 2, 4, 8, 16, 32, _MOST_PLANES)}
    found = []
    for planes in sorted({-(-views.planes // n) for n in passes}):
        spread = _spread(views, planes)
        for width in range(first * chunk, last * chunk + 1, chunk):
            found.append(_blocks(views, planes, width, spread, room, items, lanes))
    return min((b for b in found if b), key=lambda b: b.cost, default=None)


def _spread(views: _Views, planes: int) -> tuple[float, int]:
    """Furthest that planes of one launch lie apart: in rows (mean over v) and in samples."""
    rows, pixels = 0.0, 0
    for first in range(0, views.planes, planes):
        part = views.part(first, planes)
        rows = max(rows, float(np.ptp(part.down, axis=0).mean()))
        pixels = max(pixels, int(np.ptp(part.right, axis=0).max()))
    return rows, pixels * views.channels


def _blocks(
    views: _Views,
    planes: int,
    width: int,
    spread: tuple[float, int],
    room: int,
    items: int,
    lanes: int,
) -> _Blocks | None:
    """Blocks of a width as high as local memory (room, in floats) and enough items allow.

    The cost of a plane is counted in vectors that are multiplied and added; one that is fetched
    from the light field costs about 8, and the start of a row 40 (measured on two cores with
    512-bit vectors).
    """
    pitch = -(-(width + spread[1]) // lanes) * lanes
    columns = -(-views.samples // (width - views.channels))
    second = width + views.channels
    highest = (room - views.weights.shape[1] * pitch - second) // (planes * width)
    highest = min(highest, views.ny, max(1, -(-views.ny * columns // items)))
    if highest < 1:
        return None
    height = -(-views.ny // -(-views.ny // highest))
    rows = (height + 1 + spread[0]) / height
    cost = columns * (width + rows * (8 * pitch + 40 * lanes) / planes)
    return _Blocks(planes, width, height, pitch, cost)


def _launch(
    device: Device,
    out: cla.Array,
    lf_data: cla.Array,
    views: _Views,
    blocks: _Blocks | None,
    where: tuple[int, int],
) -> None:
    """Enqueue the planes of one launch; `where` is (first plane, total)."""
    V, U = views.weights.shape
    columns = -(-views.samples // (blocks.width - views.channels)) if blocks else 0
    norm_pitch = columns * blocks.width if blocks else views.samples
    tables = [device.upload(table) for table in _tables(views, norm_pitch)]
    sizes = (V, U, views.ny, views.samples, views.channels, views.planes, where[0], norm_pitch)
    args = (out, lf_data, *tables, *(np.int32(n) for n in (*sizes, where[1])))
    defines: dict[str, Any] = {"SAMPLE": C_TYPE[np.dtype(lf_data.dtype)]}
    if views.clamp:
        defines["CLAMP"] = True
    if blocks is None:
        planes = min(views.planes, _SAMPLE_PLANES)
        kernel = device.kernel(
            "shear.cl", "shear_samples", HEIGHT=_SAMPLE_HEIGHT, PLANES=planes, **defines
        )
        rows = -(-views.ny // _SAMPLE_HEIGHT)
        size = (views.samples, -(-views.planes // planes), rows)
        device.launch(kernel, size, *args, group=(_SAMPLE_GROUP, 1, 1))
        return
    lanes, vectors = _lanes(device)
    kernel = device.kernel("shear.cl", "shear_blocks", LANES=lanes, VECTORS=vectors, **defines)
    floats = (
        U * blocks.pitch,
        blocks.planes * blocks.height * blocks.width,
        blocks.width + views.channels,
    )
    device.launch(
        kernel,
        (columns, -(-views.ny // blocks.height)),
        *args,
        *(np.int32(n) for n in (blocks.height, blocks.width, blocks.pitch)),
        *(cl.LocalMemory(4 * n) for n in floats),
        group=(1, 1),
    )


def _tables(views: _Views, norm_pitch: int) -> list[Table]:
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


def _norm(views: _Views, pitch: int) -> Table:
    """Weights that each sample of a row uses, by v, then in all. Shape (P, V + 1, pitch)."""
    w = views.weights
    norm = np.zeros((views.planes, len(w) + 1, pitch), np.float32)
    here = norm[..., : views.samples].reshape(*norm.shape[:2], views.nx, -1)
    if views.clamp:
        here[:, :-1] = w.sum(axis=1)[:, None, None]
        here[:, -1] = w.sum()
        return norm
    x = np.arange(views.nx) + views.right[..., None]
    left, right = ((x + step >= 0) & (x + step < views.nx) for step in (0, 1))
    inside = left * (1 - views.beside[..., None]) + right * views.beside[..., None]
    used = np.zeros((views.planes, len(w), views.nx))
    for u in range(w.shape[1]):  # in one order for every pixel, which a product of matrices is not
        used += w[:, u, None] * inside[..., u, :].reshape(views.planes, -1, views.nx)
    here[:, :-1] = used[..., None]
    here[:, -1] = used.sum(axis=1)[..., None]
    return norm
