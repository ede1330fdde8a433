"""Free-space propagation of fields: one or many distances, one or many wavelengths."""

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
    """`propagate` with all but the field, for averages."""

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
        """Whether guard, border, support and lens are the default ones."""
        return (self.guard, self.border, self.support, self.lens) == (None, BORDER, None, None)

    def __call__(self, field: Field) -> Field:
        """The field at the end."""
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
    """Propagate a field through free space, by one distance or by several.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    z : float or sequence of float
        Distance in metres; 0 returns the field, a negative distance propagates back. Several
        distances share the field's transform where their windows agree.
    method : str
        One of "auto", "as", "blas", "cblas", "rs", "one-step", "fresnel-tf", "fresnel-ir",
        "fresnel-1fft" and "fresnel-multistep": see `Propagator`.
    pad : float
        Zero padding of as, blas and the Fresnel methods, at least 1; 1 makes the window periodic.
    out_grid : Grid, optional
        Of the result: any pitch, shape and origin with auto, cblas, rs, one-step and fresnel-1fft.
    guard : float, optional
        Of auto and cblas, width of the guard of the band in Fresnel widths: see `Propagator`.
    border : float
        Of fresnel-multistep, the fraction of half the window over which each step is absorbed.
    support : float or tuple of float, optional
        (y, x) widths about the grid's centre that carry light, in metres; by default the window.
    lens : float, optional
        Focal length in metres of a paraxial thin lens right before a fresnel-1fft.
    coherence : Coherence, optional
        The light that illuminates ``field``, which then is the transmission of an object.
    **averaging
        With ``coherence``: snapshots, rtol, region, checkpoint, progress as in `Coherence.average`.

    Returns
    -------
    Field
        On ``out_grid``, without the carrier exp(ikz). Shape (..., my, mx), or (n, ..., my, mx) for
        n distances. With ``coherence`` the `MeanIntensity` at one distance.

    Raises
    ------
    ValueError
        For an unknown method, z that is not finite, or pad < 1.
    SamplingError
        For an output grid that the method cannot give, fresnel-1fft at z = 0, several distances
        with fresnel-1fft, whose results have different pitches, or a method so far outside its
        range that its result would be no field.
    DeviceError
        If the windows do not fit the device.

    Warns
    -----
    SamplingWarning
        Once a plan, when what the method samples is aliased.

    Notes
    -----
    The plan is kept on the device and used again for the same arguments; ``device.plans`` shows its
    size and hits.

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
            f"propagate takes a Field, as Field.from_array makes it, not a {type(field).__name__}."
        )
    check_averaging(averaging, coherence, propagate, "propagate")
    if coherence is not None:
        if isinstance(z, Sequence | np.ndarray):
            raise ValueError("Partially coherent light is propagated to one distance at a time.")
        space = FreeSpace(z, method, pad, out_grid, guard, border, support, lens)
        return average_of(coherence)(space, field, **averaging)
    distances = [z] if np.ndim(z) == 0 else list(real_array(z, "z", np.float64))
    if not distances or np.ndim(z) > 1:
        raise ValueError(f"z is one distance or a list of them, in metres, not {z!r}.")
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
            "fresnel-1fft gives another pitch at each distance: propagate to one at a time, or "
            "give an out_grid."
        )
    results = run_plans(field, plans)
    return results[0] if np.ndim(z) == 0 else _stack(results)


def propagate_wavelengths(
    field: Field, z: float | Sequence[float], wavelengths: Sequence[float], **options: Any
) -> list[Field]:
    """Propagate the same complex amplitudes at several wavelengths, each as by `propagate`.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx); its own wavelength does not matter.
    z : float or sequence of float
        Distances in metres.
    wavelengths : sequence of float
        In metres.
    **options
        Of `propagate`.

    Returns
    -------
    list of Field
        One a wavelength, each with its wavelength.

    Raises
    ------
    ValueError
        If there is no wavelength.

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
        raise ValueError("wavelengths is one wavelength or several, in metres, not an empty list.")
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
    """The device's `Propagator` for these values, made when it is not there yet."""
    return _cached_plan(request(grid, z, wavelength, method, pad, out_grid), as_device(device))


def _cached_plan(request: Request, device: Device) -> Propagator:
    kept: Propagator | None = device.plans.get(("propagator", request))
    if kept is not None:
        return kept
    propagator = Propagator.of(request, device)
    return device.plans.keep(("propagator", request), propagator, propagator.nbytes)


def _stack(fields: Sequence[Field]) -> Field:
    """Fields of one grid as a batch with a new leading axis."""
    device = fields[0].device
    out = device.empty((len(fields), *fields[0].shape), device.complex)
    for index, field in enumerate(fields):
        device.copy_into(out, field.data, index * field.data.nbytes)
    return fields[0].with_data(out)
