"""Stored samples of a light field: types, black views, extremes, slices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device

C_TYPE = {
    np.dtype(np.uint8): "uchar",
    np.dtype(np.uint16): "ushort",
    np.dtype(np.float16): "half",
    np.dtype(np.float32): "float",
}


def lit_views(data: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return a mask of the views with a sample other than 0."""
    shape = tuple(int(n) for n in data.shape[:2])
    views = shape[0] * shape[1]
    lit = device.empty(shape, np.int32)
    kernel = device.kernel("views.cl", "lit", SAMPLE=C_TYPE[np.dtype(data.dtype)])
    read = views * data.dtype.itemsize + lit.nbytes  # minimum: reading stops early
    samples = np.int64(data.size // views)
    device.launch(kernel, (views,), lit, data, np.int32(views), samples, nbytes=read)
    return device.download(lit) != 0


def extremes(
    data: cla.Array, device: Device
) -> tuple[np.ndarray[Any, np.dtype[np.float32]], np.ndarray[Any, np.dtype[np.float32]]]:
    """Return the smallest and the largest sample of every view."""
    V, U, ny = (int(n) for n in data.shape[:3])
    rows = V * U * ny
    ranges = device.empty((rows, 2), np.float32)
    kernel = device.kernel("views.cl", "extremes", SAMPLE=C_TYPE[np.dtype(data.dtype)])
    device.launch(kernel, (rows,), ranges, data, np.int64(rows), np.int32(data.size // rows))
    values = device.download(ranges).reshape(V, U, ny, 2)
    return values[..., 0].min(axis=2), values[..., 1].max(axis=2)


def plane(
    data: cla.Array, fixed: dict[int, int], axes: tuple[int, int], device: Device
) -> cla.Array:
    """Return the samples over two axes of a light field at fixed indices of the other axes."""
    shape = tuple(int(n) for n in data.shape)
    steps = [int(np.prod(shape[axis + 1 :], dtype=np.int64)) for axis in range(4)]
    rows, columns = (shape[axis] for axis in axes)
    channels = int(np.prod(shape[4:], dtype=np.int64))
    out = device.empty((rows, columns, *shape[4:]), np.float32)
    start = sum(index * steps[axis] for axis, index in fixed.items())
    device.launch_rows(
        device.kernel("views.cl", "slice", SAMPLE=C_TYPE[np.dtype(data.dtype)]),
        (rows, columns * channels),
        out,
        data,
        *(np.int64(n) for n in (start, steps[axes[0]], steps[axes[1]])),
        np.int32(columns),
        np.int32(channels),
    )
    return out
