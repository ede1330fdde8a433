"""Conjugates, inner products and intensity gradients of fields on a device."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from clplen.checks import host_array
from clplen.compute.arrays import Image
from clplen.compute.device import require_same_device
from clplen.errors import ShapeError
from clplen.types import Array
from clplen.wave.field.field import Field, map_samples, require_field


def conjugate(field: Field) -> Field:
    """Return the complex conjugate of a field."""
    defines = field.device.wave_defines()
    return map_samples(field, field.device.kernel("adjoint.cl", "conjugate", **defines))


def pointwise_adjoint(element: Callable[[Field], Field], field: Field) -> Field:
    """Apply the adjoint of an element that multiplies a field: conj(t) v = conj(t conj(v))."""
    return conjugate(element(conjugate(field)))


def inner_product(a: Field, b: Field) -> complex:
    """Return <a, b> = sum conj(a) b over all samples, without their area, summed in float64."""
    require_same_device(a.device, b.device)
    if a.shape != b.shape:
        raise ShapeError(
            f"An inner product requires two fields of equal shape, got {a.shape} and {b.shape}."
        )
    device, (ny, nx) = a.device, a.grid.shape
    rows = device.empty(a.shape[:-1], device.complex)
    kernel = device.kernel("adjoint.cl", "row_inner", **device.wave_defines())
    size = (ny, math.prod(a.shape[:-2]))
    device.launch(kernel, size, rows, a.data, b.data, ny, nx)
    return complex(device.download(rows).sum(dtype=np.complex128))


def intensity_gradient(field: Field, cotangent: Image | Array) -> Field:
    """Return the gradient of a loss by a field, from the gradient by its intensity.

    With I = abs(u)^2, dL/dRe u + i dL/dIm u = 2 (dL/dI) u.

    Parameters
    ----------
    field : Field
        Field of shape (..., ny, nx).
    cotangent : Image or array_like
        Gradient dL/dI, real, with the shape of the field.

    Returns
    -------
    Field
        Gradient with the shape of the field.

    Raises
    ------
    ShapeError
        If the shapes differ.
    DeviceError
        If an image is on another device.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> slope = wave.intensity().to_numpy() - 2  # of sum (I - 2)^2/2
    >>> gradient = clplen.wave.intensity_gradient(wave, slope)
    >>> f"{gradient.to_numpy()[0, 0]:.1f}"
    '-2.0-0.0j'
    """
    require_field(field)
    device = field.device
    if isinstance(cotangent, Image):
        require_same_device(cotangent.device, device)
    source = cotangent if isinstance(cotangent, Image) else host_array(cotangent, "A cotangent")
    shape = source.shape
    if tuple(shape) != field.shape:
        raise ShapeError(
            f"The gradient by the intensity must have the shape of the field, {field.shape}, got "
            f"{tuple(shape)}."
        )
    if isinstance(cotangent, Image):
        weights = cotangent.data
    else:
        weights = device.upload(np.ascontiguousarray(source, device.real))
    out = device.empty(field.shape, device.complex)
    kernel = device.kernel("adjoint.cl", "intensity_slope", **device.wave_defines())
    device.launch_rows(kernel, field.shape, out, weights, field.data, *field.grid.shape)
    return field.with_data(out)
