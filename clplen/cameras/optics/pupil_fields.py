"""Fields of point sources in a lens' pupil."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.errors import DeviceError
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.transmission import phasor, split

Positions = np.ndarray[Any, np.dtype[np.float64]]

LARGEST_RESIDUAL = 2.0  # turns; float32 is then right to 5e-6 rad
STEP = 1e-2  # of the table of 2 J1(v)/v; cubic Hermite interpolation is then right to 3e-12


def pupil_fields(
    positions: Positions,
    diameter: float = 0.0,
    *,
    grid: Grid,
    object_distance: float,
    focal_length: float,
    aperture_diameter: float,
    wavelength: float,
    device: Device,
) -> Field:
    """Fields right behind a thin lens with a circular aperture, one for each source.

    An exact spherical wave from the source, times 2 J1(v)/v, v = pi d rho/(lam z), for a uniform
    coherent disc of diameter d (Goodman 2005, eq. 4-31), times aperture and lens.

    Parameters
    ----------
    positions : numpy.ndarray
        (x, y, dz) of the sources in metres from the axis point of the focused object plane, shape
        (n, 3).
    diameter : float
        Of each source, in metres; 0 is a point.
    grid : Grid
        In the plane of the lens.
    object_distance : float
        Lens to focused object plane in metres.
    focal_length, aperture_diameter, wavelength : float
        In metres.
    device : Device

    Returns
    -------
    Field
        Shape (n, ny, nx), each of unit amplitude at the pupil's brightest; not normalised.

    Raises
    ------
    DeviceError
        If a source is so near that its phase needs double precision and the device has none.
    """
    y, x = grid.y, grid.x
    z = object_distance + positions[:, 2]
    ty, tx = (
        _quadratic_phasors(axis, positions[:, column], z, focal_length, wavelength, device)
        for axis, column in ((y, 1), (x, 0))
    )
    scale = np.pi * diameter / (wavelength * z)
    reach = np.hypot(*(aperture_diameter / 2 + np.abs(positions[:, :2]).max(axis=0)))
    table, per_step = _disc_table(float(scale.max() * reach), device)
    defines = device.wave_defines() | _residual_route(reach, z.min(), wavelength, device)
    feet = np.stack([*split(z, device.real).T, scale, np.zeros_like(z)], axis=-1)
    out = device.empty((len(z), *grid.shape), device.complex)
    real = device.real.type
    device.launch_rows(
        device.kernel("source.cl", "point_sources", **defines),
        out.shape,
        out,
        device.upload(ty),
        device.upload(tx),
        device.upload(feet.astype(device.real)),
        device.upload(table),
        np.int32(len(table) - 1),
        real(per_step),
        split(wavelength, device.real),
        device.upload(split(y[None, :] - positions[:, 1:2], device.real)),
        device.upload(split(x[None, :] - positions[:, 0:1], device.real)),
        device.upload(y.astype(device.real)),
        device.upload(x.astype(device.real)),
        real(aperture_diameter / 2),
        real(grid.pitch[0] / 2),
        real(grid.pitch[1] / 2),
        np.int32(grid.shape[0]),
        np.int32(grid.shape[1]),
    )
    return Field(out, grid, wavelength, device)


def _residual_route(reach: float, z: float, wavelength: float, device: Device) -> dict[str, bool]:
    """Whether the phase beside the tables, (r - z)^2/(2 z lam) turns, needs double precision."""
    beyond = reach**2 / (np.hypot(reach, z) + z)
    turns = beyond**2 / (2 * z * wavelength)
    if device.precision == "double" or turns <= LARGEST_RESIDUAL:
        return {}
    if not device.has_fp64:
        raise DeviceError(
            f"A source at {z:g} m from the lens leaves {turns:.3g} turns of phase to single "
            f"precision, more than {LARGEST_RESIDUAL:g}, and {device.name} has no double: use "
            "another device, or a smaller aperture."
        )
    return {"RESIDUAL_FP64": True}


def _quadratic_phasors(
    axis: np.ndarray[Any, Any],
    foot: np.ndarray[Any, Any],
    z: np.ndarray[Any, Any],
    f: float,
    wavelength: float,
    device: Device,
) -> np.ndarray[Any, Any]:
    """Source and lens together along one axis, shape (sources, samples)."""
    spherical = (axis[None, :] - foot[:, None]) ** 2 / (2 * wavelength * z[:, None])
    return phasor(spherical - axis[None, :] ** 2 / (2 * wavelength * f), device.complex)


def _disc_table(largest: float, device: Device) -> tuple[np.ndarray[Any, Any], float]:
    """2 J1(v)/v and its slope times the step, from 0 to ``largest``; and steps a unit of v."""
    from scipy import special  # here, because it takes a third of the package's import time

    count = max(2, int(np.ceil(largest / STEP)) + 2)
    v = np.arange(count) * STEP
    safe = np.where(v > 0, v, 1.0)
    value = np.where(v > 0, 2 * special.j1(safe) / safe, 1.0)
    slope = np.where(v > 0, -2 * special.jv(2, safe) / safe, 0.0)
    return np.stack([value, slope * STEP], axis=-1).astype(device.real), 1 / STEP
