"""Free-space propagation of fields by several distances and at several wavelengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from clplen.checks import float64_array, real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.intensity import (
    MeanIntensity,
    PartialCoherence,
    average_of,
    check_averaging,
)
from clplen.wave.propagation.description import BORDER, Request, request
from clplen.wave.propagation.propagator import Propagator, run_plans


@dataclass(frozen=True)
class FreeSpace:
    """Arguments of `propagate` except the field, for averages."""

    z: float
    method: str
    pad: float
    out_grid: Grid | None
    guard: float | None
    border: float
    support: float | tuple[float, float] | None
    lens: float | None

    @property
    def is_plain(self) -> bool:
        """True if guard, border, support and lens have their defaults."""
        return (self.guard, self.border, self.support, self.lens) == (None, BORDER, None, None)

    def __call__(self, field: Field) -> Field:
        """Return the propagated field."""
        return propagate(
            field, self.z, method=self.method, pad=self.pad, out_grid=self.out_grid,
            guard=self.guard, border=self.border, support=self.support, lens=self.lens,
        )  # fmt: skip


@overload
def propagate(
    field: Field,
    z: float | Sequence[float],
    *,
    method: str = ...,
    pad: float = ...,
    out_grid: Grid | None = ...,
    guard: float | None = ...,
    border: float = ...,
    support: float | tuple[float, float] | None = ...,
    lens: float | None = ...,
) -> Field: ...
@overload
def propagate(
    field: Field,
    z: float,
    *,
    method: str = ...,
    pad: float = ...,
    out_grid: Grid | None = ...,
    coherence: PartialCoherence,
    **averaging: Any,
) -> MeanIntensity: ...
def propagate(
    field: Field,
    z: float | Sequence[float],
    *,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float | None = None,
    border: float = BORDER,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
    coherence: PartialCoherence | None = None,
    **averaging: Any,
) -> Field | MeanIntensity:
    """Propagate a field through free space by a distance, or by several distances.

    Parameters
    ----------
    field : Field
        Field of shape (..., ny, nx).
    z : float or sequence of float
        Distance in metres; 0 returns the field, a negative distance propagates back. Several
        distances share the field's transform if their windows agree.
    method : str
        Method: "auto", "as", "blas", "cblas", "rs", "one-step", "fresnel-tf", "fresnel-ir",
        "fresnel-1fft" or "fresnel-multistep"; see `Propagator`.
    pad : float
        Zero padding of as, blas and the Fresnel methods, at least 1; 1 makes the window periodic.
    out_grid : Grid, optional
        Grid of the result: any pitch, shape and origin with auto, cblas, rs, one-step and
        fresnel-1fft.
    guard : float, optional
        Width of the guard of the band for auto and cblas, in Fresnel widths; see `Propagator`.
    border : float
        Fraction of half the window over which each step of fresnel-multistep is absorbed.
    support : float or tuple of float, optional
        Widths (y, x) of the light about the grid's centre in metres; by default the window.
    lens : float, optional
        Focal length in metres of a paraxial thin lens in front of a fresnel-1fft.
    coherence : Coherence, optional
        Light that illuminates ``field``, then the transmission of an object.
    **averaging
        Arguments of `Coherence.average` with ``coherence``: snapshots, rtol, region, checkpoint,
        progress, method.

    Returns
    -------
    Field
        Field on ``out_grid``, without the carrier exp(ikz). Shape (..., my, mx), or (n, ..., my,
        mx) for n distances. With ``coherence`` the `MeanIntensity` at a single distance.

    Raises
    ------
    ValueError
        If the method is unknown, z is not finite, or pad < 1.
    SamplingError
        If the method does not support the output grid, for fresnel-1fft at z = 0 or at several
        distances (which have different pitches), or if a method is so far out of its range that
        its result would be useless.
    DeviceError
        If the windows do not fit in the device's memory.

    Warns
    -----
    SamplingWarning
        Once per plan, if the sampled quantity is aliased.

    Notes
    -----
    The device caches the plan for equal arguments; ``device.plans`` has its size and hits.

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> hole = clplen.aperture(wave, 0.4e-3)
    >>> behind = clplen.propagate(hole, 0.08)
    >>> f"{behind.intensity().to_numpy()[32, 32]:.1f}"  # 4 on the axis at D^2/(4 lam) = 80 mm
    '4.0'
    >>> clplen.propagate(hole, [0.02, 0.04, 0.08]).shape
    (3, 64, 64)
    """
    if not isinstance(field, Field):
        raise TypeError(
            f"field must be a Field, as Field.from_array returns, got {type(field).__name__}."
        )
    check_averaging(averaging, coherence, propagate, "propagate")
    if coherence is not None:
        if isinstance(z, Sequence | np.ndarray):
            raise ValueError("coherence= requires a single distance z; propagate in a loop.")
        space = FreeSpace(z, method, pad, out_grid, guard, border, support, lens)
        return average_of(coherence)(space, field, **averaging)
    distances = [z] if np.ndim(z) == 0 else list(real_array(z, "z", np.float64))
    if not distances or np.ndim(z) > 1:
        raise ValueError(f"z must be a distance or a list of distances in metres, got {z!r}.")
    requests = [
        request(
            field.grid, distance, field.wavelength, method, pad, out_grid, guard, border,
            support=support, lens=lens,
        )
        for distance in distances
    ]  # fmt: skip
    plans = [_cached_plan(request, field.device) for request in requests]
    if len({plan.out_grid for plan in plans}) > 1:
        raise SamplingError(
            "fresnel-1fft has a different pitch at each distance; propagate in a loop, or set "
            "out_grid=."
        )
    results = run_plans(field, plans)
    return results[0] if np.ndim(z) == 0 else _stack(results)


def propagate_wavelengths(
    field: Field, z: float | Sequence[float], wavelengths: Sequence[float], **options: Any
) -> list[Field]:
    """Propagate complex amplitudes at several wavelengths, each by `propagate`.

    Parameters
    ----------
    field : Field
        Field of shape (..., ny, nx); its wavelength is ignored.
    z : float or sequence of float
        Distances in metres.
    wavelengths : sequence of float
        Wavelengths in metres.
    **options
        Options of `propagate`.

    Returns
    -------
    list of Field
        Fields, one for each wavelength.

    Raises
    ------
    ValueError
        If ``wavelengths`` is empty.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> clear = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> square = clplen.wave.rectangular_aperture(clear, 105e-6)
    >>> fields = clplen.wave.propagate_wavelengths(square, 0.01, [450e-9, 550e-9, 650e-9])
    >>> [f"{field.wavelength * 1e9:.0f} nm" for field in fields], fields[0].shape
    (['450 nm', '550 nm', '650 nm'], (32, 32))
    """
    require_field(field)
    if not np.size(wavelengths):
        raise ValueError("wavelengths must have at least one wavelength, in metres.")
    return [
        propagate(replace(field, wavelength=float(wavelength)), z, **options)
        for wavelength in np.atleast_1d(float64_array(wavelengths))
    ]


def plan(
    grid: Grid,
    z: float,
    *,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    device: DeviceLike | None = None,
    out_grid: Grid | None = None,
) -> Propagator:
    """Return the device's cached `Propagator` for the arguments."""
    return _cached_plan(request(grid, z, wavelength, method, pad, out_grid), as_device(device))


def _cached_plan(request: Request, device: Device) -> Propagator:
    cached: Propagator | None = device.plans.get(("propagator", request))
    if cached is not None:
        return cached
    propagator = Propagator.of(request, device)
    return device.plans.keep(("propagator", request), propagator, propagator.nbytes)


def _stack(fields: Sequence[Field]) -> Field:
    """Return fields on a common grid as a batch with a new leading axis."""
    device = fields[0].device
    out = device.empty((len(fields), *fields[0].shape), device.complex)
    for index, field in enumerate(fields):
        device.copy_into(out, field.data, index * field.data.nbytes)
    return fields[0].with_data(out)
