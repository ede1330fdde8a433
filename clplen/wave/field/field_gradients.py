"""Gradients of a loss by factors of a field, from the cotangent of the product.

The gradient of a real loss L with respect to complex samples is dL/dRe + i dL/dIm.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import require
from clplen.compute.device import require_same_device
from clplen.errors import ShapeError
from clplen.types import Array
from clplen.wave.field.field import Field, require_field


def polar_gradient(field: Field, cotangent: Field) -> dict[str, Array]:
    """Return the gradient of a loss with respect to the amplitude and the phase of a field.

    With u = a exp(i p) and the gradient g with respect to u, dL/da = Re(conj(u) g)/a and
    dL/dp = Im(conj(u) g).

    Parameters
    ----------
    field : Field
        Field u, shape (..., ny, nx).
    cotangent : Field
        Gradient g = dL/dRe u + i dL/dIm u, with the shape of ``field``.

    Returns
    -------
    dict of str to numpy.ndarray
        Gradients "amplitude" and "phase", float64, with the shape of ``field``. The phase is
        defined as 0 where u is 0.

    Raises
    ------
    ShapeError
        If the shapes differ.
    DeviceError
        If the fields are on two devices.

    Examples
    --------
    >>> grid = clplen.Grid((1, 2), 10e-6)
    >>> field = clplen.Field.from_array([[1, 2j]], grid, wavelength=500e-9)
    >>> cotangent = clplen.Field.from_array([[3 + 4j, 3 + 4j]], grid, wavelength=500e-9)
    >>> gradients = clplen.wave.polar_gradient(field, cotangent)
    >>> gradients["amplitude"].tolist(), gradients["phase"].tolist()
    ([[3.0, 4.0]], [[4.0, -6.0]])
    """
    check_cotangent(field, cotangent)
    u, g = (f.to_numpy().astype(np.complex128) for f in (field, cotangent))
    amplitude = np.abs(u)
    unit = np.divide(u, amplitude, out=np.ones_like(u), where=amplitude > 0)
    rotated = np.conj(unit) * g
    return {"amplitude": rotated.real, "phase": amplitude * rotated.imag}


def check_cotangent(field: Any, cotangent: Any) -> None:
    """Raise unless a cotangent is a field with the shape and device of a field."""
    require_field(field)
    require(Field, cotangent, "cotangent", "Field.from_array")
    require_same_device(field.device, cotangent.device)
    if field.shape != cotangent.shape:
        raise ShapeError(
            f"cotangent must have the field's shape {field.shape}, got {cotangent.shape}."
        )


def transmission_gradient(field: Field, cotangent: Field) -> cla.Array:
    """Return the gradient by a factor of a field, the sum of conj(u) g over a batch."""
    check_cotangent(field, cotangent)
    device, (ny, nx) = field.device, field.grid.shape
    out = device.empty((ny, nx), device.complex)
    device.launch_rows(
        device.kernel("transmission_gradient.cl", "transmission_gradient", **device.wave_defines()),
        (ny, nx),
        out,
        field.data,
        cotangent.data,
        math.prod(field.shape[:-2]),
        ny,
        nx,
    )
    return out


def log_moments(behind: Field, cotangent: Field, y: Array, x: Array, order: int = 2) -> Array:
    """Return moments of the gradient with respect to the logarithm of a transmission."""
    check_cotangent(behind, cotangent)
    device, (ny, nx) = behind.device, behind.grid.shape
    unit = float(np.abs(x).max()) or 1.0
    sums = device.empty((order + 1, ny), device.complex)
    defines = device.wave_defines() | {"ORDER": order}
    device.launch(
        device.kernel("transmission_gradient.cl", "row_moments", **defines),
        (ny,),
        sums,
        behind.data,
        cotangent.data,
        device.upload((x / unit).astype(device.real)),
        math.prod(behind.shape[:-2]),
        ny,
        nx,
    )
    rows = device.download(sums).astype(np.complex128)
    powers = np.asarray(y, np.float64) ** np.arange(order + 1)[:, None]
    return np.asarray(powers @ rows.T * unit ** np.arange(order + 1))
