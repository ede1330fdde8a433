"""Where the energy of a propagated field goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.fft.blocks import multiplied, window
from clplen.errors import SamplingError
from clplen.wave.field.field import Field
from clplen.wave.propagation.description import Description
from clplen.wave.propagation.methods import corrected


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

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> square = clplen.wave.rectangular_aperture(clear, 105e-6)
    >>> plan = clplen.Propagator(grid, 0.01, wavelength=500e-9, method="cblas")
    >>> energy = plan.energy(square)
    >>> [f"{part / energy.into:.1%}" for part in (energy.window, energy.outside, energy.cut)]
    ['98.0%', '2.0%', '0.0%']
    """

    into: float
    window: float
    outside: float
    cut: float


def energy_budget(field: Field, description: Description, phase: str) -> Energy:
    """Each part computed by itself."""
    device, grid = field.device, field.grid
    description = _by_fft(description)
    if description.factor is None:
        power = float(np.sum(field.power()))
        return Energy(into=power, window=power, outside=0.0, cut=0.0)
    shape = (*field.shape[:-2], *description.factor.shape)
    nbytes = int(np.prod(shape, dtype=np.int64)) * device.complex.itemsize
    device.require_memory(4 * nbytes, "This energy budget")
    spectrum = description.factor.on_device(device, phase)
    area = grid.pitch[0] * grid.pitch[1]
    samples = spectrum.shape[0] * spectrum.shape[1]
    work = window(field.data, shape, device)
    device.fft.forward(work, device)
    before = _power(work, device)
    multiplied(work, spectrum, device, copy=False)
    after = _power(work, device)
    device.fft.inverse(work, device)
    inside = window(work, (*field.shape[:-2], *description.out_grid.shape), device)
    return Energy(
        into=float(np.sum(field.power())),
        window=_power(inside, device) * area,
        outside=_power_outside(work, description.out_grid.shape, device) * area,
        cut=(before - after) / samples * area,
    )


def _by_fft(description: Description) -> Description:
    """The description whose sum is done by FFTs of a window of the field's own samples."""
    method, request = description.method, description.request
    if description.kind == "nothing" or method in ("as", "blas"):
        return description
    if method != "cblas" or not request.is_aligned:
        raise SamplingError(
            "energy() is for as, blas and cblas on the field's own pitch and centre, whose "
            f"window holds all the light; this plan is {method!r} onto {description.out_grid}: "
            "make one with method='cblas' and without out_grid."
        )
    return corrected(request, description.why, "fft")


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
