"""Tables and launches of kernels that read a light field sheared by planes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField

Table = np.ndarray[Any, Any]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_VECTORS = 8  # vectors of one work-item, on CPUs


def view_tables(
    lf: LightField, planes: Vector, views: Table, *more: Table
) -> tuple[cla.Array, cla.Array]:
    """Upload the tables `place` and `part` of sheared.cl for views by number.

    Shifts are split in float64 into pixels and fraction and clipped one pixel outside the view.
    `more` fills part[..., 2:] with one value a view.
    """
    shifts = np.multiply.outer(planes, unit_steps(lf).reshape(-1, 2)[views])
    pixels = np.floor(shifts)
    positions = np.zeros((planes.size, views.size, 4), np.int32)
    fractions = np.zeros((planes.size, views.size, 4), np.float32)
    positions[..., 0] = views
    limits = np.array(lf.shape[2:4])
    positions[..., 1:3] = np.clip(pixels, -limits - 1, limits)
    fractions[..., :2] = shifts - pixels
    for i, values in enumerate(more):
        fractions[..., 2 + i] = values
    return lf.device.upload(positions), lf.device.upload(fractions)


def launch_sheared(
    lf: LightField, name: tuple[str, str], planes: int, args: tuple[Any, ...], **defines: Any
) -> None:
    """Launch a kernel that includes sheared.cl.

    It appends the table of samples beyond the edges, its reach, ny, nx and channels as arguments.
    """
    device = lf.device
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    lanes, vectors = vectors_of(device)
    kernel = device.kernel(*name, SAMPLE=C_TYPE[lf.dtype], LANES=lanes, VECTORS=vectors, **defines)
    columns = -(-nx * channels // (lanes * vectors))
    edge, reach = edge_table(nx, channels, lanes * vectors)
    device.launch(
        kernel,
        (planes, columns, ny) if device.rows else (columns, planes, ny),
        *args,
        device.upload(edge),
        *(np.int32(n) for n in (reach, ny, nx, channels)),
    )


def edge_table(nx: int, channels: int, further: int) -> tuple[Table, int]:
    """Return (nearest sample inside, pixel) of every sample that a shifted row may read.

    Views are shifted by nx + 1 pixels at most; an item reads up to `further` samples too many.
    """
    reach = (nx + 2) * channels
    s = np.arange(-reach, 2 * reach + channels + further)
    x, channel = np.divmod(s, channels)
    return np.stack((np.clip(x, 0, nx - 1) * channels + channel, x), axis=1).astype(np.int32), reach


def vectors_of(device: Device) -> tuple[int, int]:
    """Return the floats of a vector and the vectors of an item; 1, 1 on GPUs."""
    if not device.rows:
        return 1, 1
    return min(max(int(device.cl_device.native_vector_width_float), 4), 16), _VECTORS


def add_colours(maps: cla.Array, device: Device) -> cla.Array:
    """Sum maps (n, y, x[, c]) over the colours to (n, y, x)."""
    *shape, channels = (int(n) for n in (*maps.shape, 1)[:4])
    if maps.ndim == 3 or channels == 1:
        return maps.reshape(*maps.shape[:3])
    out = device.empty(maps.shape[:3], np.float32)
    kernel = device.kernel("colours.cl", "add_colours")
    device.launch_rows(kernel, shape, out, maps, *(np.int32(n) for n in (*shape[1:], channels)))
    return out
