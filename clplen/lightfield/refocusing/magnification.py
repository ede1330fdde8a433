"""Scaling of pictures to the synthetic plane of another focus, with adjoint."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.raw.decode_adjoint import sparse_rows

Table = np.ndarray[Any, Any]


def magnify(picture: cla.Array, alpha: float, *, device: Device) -> cla.Array:
    """Scale a picture to the synthetic plane: alpha^2 R(alpha x'), linear, 0 outside."""
    ny, nx, count = _sizes(picture)
    out = device.empty(picture.shape, np.float32)
    tables = [table for n in (ny, nx) for table in _source_positions(n, alpha)]
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
    """Apply the transpose of `magnify`, with equal arguments."""
    ny, nx, count = _sizes(picture)
    out = device.empty(picture.shape, np.float32)
    tables: list[Table] = []
    for n in (ny, nx):
        pixels, fractions = _source_positions(n, alpha)
        pixel, weight = np.stack((pixels, pixels + 1)), np.stack((1 - fractions, fractions))
        source = np.broadcast_to(np.arange(n), pixel.shape)
        valid = (pixel >= 0) & (pixel < n) & (weight != 0)
        tables += sparse_rows(pixel[valid], source[valid], weight[valid], n)
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
    """Return (ny, nx, channels)."""
    ny, nx, count = (*(int(n) for n in picture.shape), 1)[:3]
    return ny, nx, count


def _source_positions(n: int, alpha: float) -> tuple[Table, Table]:
    """Return the pixel below each of n source positions, int32, and the fraction, float32."""
    position = (n - 1) / 2 + alpha * (np.arange(n) - (n - 1) / 2)
    pixels = np.floor(np.clip(position, -2, n))
    return pixels.astype(np.int32), (position - pixels).astype(np.float32)
