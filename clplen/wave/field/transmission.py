"""A field times a transmission, sampled or separable, and the coordinates tables are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.blocks import lanes_defines
from clplen.wave.field.field import Field, Grid

Vector = np.ndarray[Any, np.dtype[np.floating[Any]]]


def offsets(grid: Grid, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Vector, Vector]:
    """Coordinates (y, x) of a grid's samples from a centre in metres, shapes (ny,) and (nx,).

    Along an axis of length 1, where nothing varies, the offset is 0.
    """
    y, x = (
        np.zeros(1) if n == 1 else coordinate - middle
        for n, coordinate, middle in zip(grid.shape, (grid.y, grid.x), centre, strict=True)
    )
    return y, x


def multiply_separable(field: Field, ty: np.ndarray, tx: np.ndarray) -> Field:
    """``field`` times the product of two 1-D complex tables over y and x."""
    device, (ny, nx) = field.device, field.grid.shape
    out = device.empty(field.shape, device.complex)
    kernel = device.kernel("separable.cl", "multiply_separable", **lanes_defines(device))
    device.launch_rows(
        kernel,
        field.shape,
        out,
        field.data,
        device.upload(ty),
        device.upload(tx),
        np.int32(ny),
        np.int32(nx),
    )
    return field.with_data(out)


def multiply(field: Field, transmission: cla.Array) -> Field:
    """``field`` (or each of a batch) times a complex transmission of shape (ny, nx)."""
    device, (ny, nx) = field.device, field.grid.shape
    out = device.empty(field.shape, device.complex)
    kernel = device.kernel("multiply.cl", "multiply", **device.wave_defines())
    device.launch_rows(
        kernel, field.shape, out, field.data, transmission, np.int32(ny), np.int32(nx)
    )
    return field.with_data(out)
