"""Tables and launches of the kernels that see a light field sheared by planes."""

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

_VECTORS = 8  # of one item, on CPUs


def view_tables(
    lf: LightField, planes: Vector, views: Table, *more: Table
) -> tuple[cla.Array, cla.Array]:
    """The tables `place` and `part` of sheared.cl on the device, for views by their number.

    Shifts are split in float64 into a whole number and a fraction; one that leaves the view
    altogether by one pixel is enough. `more` fills part[..., 2:], one value a view.
    """
    moved = np.multiply.outer(planes, unit_steps(lf).reshape(-1, 2)[views])
    whole = np.floor(moved)
    place = np.zeros((planes.size, views.size, 4), np.int32)
    part = np.zeros((planes.size, views.size, 4), np.float32)
    place[..., 0] = views
    limits = np.array(lf.shape[2:4])
    place[..., 1:3] = np.clip(whole, -limits - 1, limits)
    part[..., :2] = moved - whole
    for i, values in enumerate(more):
        part[..., 2 + i] = values
    return lf.device.upload(place), lf.device.upload(part)


def launch_sheared(
    lf: LightField, name: tuple[str, str], planes: int, args: tuple[Any, ...], **defines: Any
) -> None:
    """Launch a kernel written with sheared.cl.

    Its last arguments are the table of samples beyond the edges, how far that reaches, ny, nx and
    channels.
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
    """(nearest sample inside, pixel) of every sample that a shifted row may ask for.

    Views are shifted by nx + 1 pixels at most; an item takes up to `further` samples too many.
    """
    reach = (nx + 2) * channels
    s = np.arange(-reach, 2 * reach + channels + further)
    x, channel = np.divmod(s, channels)
    return np.stack((np.clip(x, 0, nx - 1) * channels + channel, x), axis=1).astype(np.int32), reach


def vectors_of(device: Device) -> tuple[int, int]:
    """Floats of a vector of the device, and vectors of an item; one sample on GPUs."""
    if not device.rows:
        return 1, 1
    return min(max(int(device.cl_device.native_vector_width_float), 4), 16), _VECTORS


def add_colours(maps: cla.Array, device: Device) -> cla.Array:
    """Maps (n, y, x[, c]) added over the colours, (n, y, x)."""
    *shape, channels = (int(n) for n in (*maps.shape, 1)[:4])
    if maps.ndim == 3 or channels == 1:
        return maps.reshape(*maps.shape[:3])
    out = device.empty(maps.shape[:3], np.float32)
    kernel = device.kernel("colours.cl", "add_colours")
    device.launch_rows(kernel, shape, out, maps, *(np.int32(n) for n in (*shape[1:], channels)))
    return out
