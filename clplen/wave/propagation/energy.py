"""Where the energy of a propagated field goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl.array as cla

from clplen.compute.blocks import multiplied, window
from clplen.compute.device import Device
from clplen.wave.field.field import Field
from clplen.wave.propagation.description import Description


@dataclass(frozen=True)
class Energy:
    """Where the energy of a propagated field goes, in the unit of `Field.power`.

    Attributes
    ----------
    into : float
        Of the field that was propagated.
    window : float
        That arrives in the window of the grid.
    outside : float
        That arrives beside it, in the padding.
    cut : float
        Outside the band of the transfer function, or evanescent.
    """

    into: float
    window: float
    outside: float
    cut: float


def energy(field: Field, made: Description, phase: str) -> Energy:
    """Each part computed by itself, of a propagation by FFTs of a window of the field's samples.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx); a batch is added up.
    made : Description
    phase : str
        How the phase of its factor is formed.
    """
    device, grid = field.device, field.grid
    if made.factor is None:
        power = float(np.sum(field.power()))
        return Energy(into=power, window=power, outside=0.0, cut=0.0)
    shape = (*field.shape[:-2], *made.factor.shape)
    nbytes = int(np.prod(shape, dtype=np.int64)) * device.complex.itemsize
    device.require_memory(4 * nbytes, "This energy budget")
    spectrum = made.factor.on_device(device, phase)
    area = grid.pitch[0] * grid.pitch[1]
    samples = spectrum.shape[0] * spectrum.shape[1]
    work = window(field.data, shape, device)
    device.fft.forward(work, device)
    before = _power(work, device)
    multiplied(work, spectrum, device, copy=False)
    after = _power(work, device)
    device.fft.inverse(work, device)
    kept = window(work, (*field.shape[:-2], *made.out_grid.shape), device)
    return Energy(
        into=float(np.sum(field.power())),
        window=_power(kept, device) * area,
        outside=_power_outside(work, made.out_grid.shape, device) * area,
        cut=(before - after) / samples * area,
    )


def _power(data: cla.Array, device: Device) -> float:
    """Sum of abs(u)^2 in float64."""
    with device.on_host(data, write=False) as values:
        return float(np.vdot(values, values.astype(np.complex128)).real)


def _power_outside(data: cla.Array, shape: tuple[int, int], device: Device) -> float:
    """Sum of abs(u)^2 outside the central window of a shape, in float64."""
    with device.on_host(data, write=False) as values:
        outside = values.astype(np.complex128)
    rows, columns = (
        slice(n // 2 - m // 2, n // 2 - m // 2 + m)
        for n, m in zip(outside.shape[-2:], shape, strict=True)
    )
    outside[..., rows, columns] = 0
    return float(np.vdot(outside, outside).real)
