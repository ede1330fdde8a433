"""Multiplication of a field by a sampled, separable or spherical transmission.

``exp(i k z sqrt(1 - s))`` in float32 is useless at camera distances. Every large phase of the
package is therefore a product of 1-D tables, reduced to a period in double precision on the host,
times a residual that the kernel computes in pairs of float32.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.fft.blocks import lanes_defines
from clplen.wave.field.field import Field, Grid, map_samples

Vector = np.ndarray[Any, np.dtype[np.floating[Any]]]


def offsets(grid: Grid, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Vector, Vector]:
    """Return the coordinates (y, x) of samples relative to a centre in metres, (ny,) and (nx,).

    The offset is 0 along an axis of length 1.
    """
    y, x = (
        np.zeros(1) if n == 1 else coordinate - middle
        for n, coordinate, middle in zip(grid.shape, (grid.y, grid.x), centre, strict=True)
    )
    return y, x


def multiply_separable(field: Field, ty: np.ndarray, tx: np.ndarray) -> Field:
    """Multiply ``field`` by the product of two 1-D complex tables over y and x."""
    device = field.device
    kernel = device.kernel("separable.cl", "multiply_separable", **lanes_defines(device))
    return map_samples(field, kernel, device.upload(ty), device.upload(tx))


def multiply(field: Field, transmission: cla.Array, *, conjugate: bool = False) -> Field:
    """Multiply ``field`` (or each of a batch) by a complex transmission of shape (ny, nx).

    With ``conjugate`` multiply by its conjugate, which is the adjoint.
    """
    defines = field.device.wave_defines() | ({"CONJUGATE": True} if conjugate else {})
    return map_samples(
        field, field.device.kernel("multiply.cl", "multiply", **defines), transmission
    )


Table = np.ndarray[Any, Any]


def phasor(turns: Any, dtype: Any = np.complex128) -> Table:
    """Return exp(2 pi i turns), reduced to half a turn in float64 and then rounded to ``dtype``."""
    reduced = np.asarray(turns, np.float64)
    reduced = reduced - np.rint(reduced)
    return np.exp(2j * np.pi * reduced).astype(dtype)


def split(values: Any, dtype: np.dtype[Any]) -> Table:
    """Split float64 values into (high, low) pairs of ``dtype``, shape (..., 2)."""
    exact = np.asarray(values, np.float64)
    high = exact.astype(dtype)
    low = (exact - high.astype(np.float64)).astype(dtype)
    return np.stack([high, low], axis=-1)


def whole_and_part(values: Table, dtype: np.dtype[Any]) -> Table:
    """Split float64 values into (nearest integer, remainder) pairs of ``dtype``, shape (..., 2)."""
    exact = np.asarray(values, np.float64)
    integer = np.rint(exact)
    return np.stack([integer, exact - integer], axis=-1).astype(dtype)


Pair = tuple[float, float]


def multiply_sphere(
    field: Field,
    z: float,
    centre: Pair = (0.0, 0.0),
    *,
    fades: bool = False,
    out: cla.Array | None = None,
    phase: str = "tables",
) -> Field:
    """Multiply ``field`` by exp(ik(r - abs(z)) sign z) for a point source at the distance abs(z).

    r - abs(z) = rho^2/(2 abs(z)) - (r - abs(z))^2/(2 abs(z)): a product of 1-D tables, computed in
    double precision, times a residual in turns.
    """
    device = field.device
    coordinates = offsets(field.grid, centre)
    tables = [phasor(t**2 / (2 * field.wavelength * z), device.complex) for t in coordinates]
    squares = [split((t / z) ** 2, device.real) for t in coordinates]
    defines = lanes_defines(device) if phase == "tables" else device.wave_defines()
    defines[f"PHASE_{phase.upper()}"] = True
    if fades:
        defines["SOURCE"] = True
    return map_samples(
        field,
        device.kernel("sphere.cl", "sphere", **defines),
        *(device.upload(t) for t in tables),
        *(device.upload(s) for s in squares),
        split(z / field.wavelength, device.real),
        device.real.type(1 / abs(z)),
        out=out,
    )
