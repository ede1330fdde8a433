"""Pictures on the synthetic plane of another focus, where they have another size; and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.raw.decode_adjoint import sparse_rows

Table = np.ndarray[Any, Any]


def magnify(picture: cla.Array, alpha: float, *, device: Device) -> cla.Array:
    """A picture on the synthetic plane: alpha^2 R(alpha x') about the middle, linear, 0 outside."""
    ny, nx, count = _sizes(picture)
    out = device.empty(picture.shape, np.float32)
    tables = [table for n in (ny, nx) for table in _places(n, alpha)]
    device.launch_rows(
        device.kernel("magnify.cl", "magnify"),
        (ny, nx * count),
        out,
        picture,
        *(device.upload(table) for table in tables),
        np.float32(alpha**2),
        *(np.int32(n) for n in (ny, nx, count)),
    )
    return out


def magnify_adjoint(picture: cla.Array, alpha: float, *, device: Device) -> cla.Array:
    """The transpose of `magnify`, with the same arguments."""
    ny, nx, count = _sizes(picture)
    out = device.empty(picture.shape, np.float32)
    tables: list[Table] = []
    for n in (ny, nx):
        whole, part = _places(n, alpha)
        pixel, weight = np.stack((whole, whole + 1)), np.stack((1 - part, part))
        source = np.broadcast_to(np.arange(n), pixel.shape)
        kept = (pixel >= 0) & (pixel < n) & (weight != 0)
        tables += sparse_rows(pixel[kept], source[kept], weight[kept], n)
    device.launch_rows(
        device.kernel("magnify.cl", "spread"),
        (ny, nx * count),
        out,
        picture,
        *(device.upload(table) for table in tables),
        np.float32(alpha**2),
        *(np.int32(n) for n in (nx, count)),
    )
    return out


def _sizes(picture: cla.Array) -> tuple[int, int, int]:
    """(ny, nx, channels)."""
    ny, nx, count = (*(int(n) for n in picture.shape), 1)[:3]
    return ny, nx, count


def _places(n: int, alpha: float) -> tuple[Table, Table]:
    """The pixel before the place that each of n pixels shows, int32; the fraction, float32."""
    position = (n - 1) / 2 + alpha * (np.arange(n) - (n - 1) / 2)
    whole = np.floor(np.clip(position, -2, n))
    return whole.astype(np.int32), (position - whole).astype(np.float32)
