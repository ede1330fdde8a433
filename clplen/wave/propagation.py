"""Free-space propagation of fields: plans, one or many distances, one or many wavelengths."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.blocks import Spectrum, multiplied, run, window
from clplen.compute.device import Device, require_device, require_same_device
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.wave.band import GUARD
from clplen.wave.choice import describe
from clplen.wave.description import Description
from clplen.wave.field import Field, Grid
from clplen.wave.report import Energy, Report, report
from clplen.wave.request import BORDER, Request
from clplen.wave.spectral import corrected

PHASES = ("tables", "fp64", "twofloat")


class Propagator:
    """A plan for one grid and distance: transforms along the axes, transfer function, windows.

    Parameters
    ----------
    grid : Grid
    z : float
        Distance in metres; negative propagates back (evanescent waves are then dropped).
    wavelength : float
        In metres.
    method : str
        - "auto": whichever of as, cblas and rs is exact at this distance and cheapest.
        - "as": angular spectrum, H = exp(i k z (sqrt(1 - s) - 1)) (Goodman 2005, eq. 3-66).
        - "blas": the same within the band that the window samples (Matsushima and Shimobaba 2009,
          eq. 13).
        - "cblas": within the band that reaches the output, widened by a smooth guard, in a window
          that keeps aliases clear of it; any output grid.
        - "rs": convolution with the sampled Rayleigh-Sommerfeld I kernel (Goodman 2005, eq. 3-43).
        - "fresnel-tf", "fresnel-ir": paraxial, by the sampled transfer function (near) or impulse
          response (far) (Goodman 2005, eqs. 4-20 and 4-16).
        - "fresnel-1fft": paraxial, one transform; the output pitch is lam abs(z)/(L dx).
        - "fresnel-multistep": paraxial, steps of one transform that keep the pitch.
    pad : float
        For as, blas and the Fresnel methods the window is exactly round(pad N) samples (1:
        periodic, no padding); of fresnel-multistep an even length without prime factors above 7.
        Lengths with large prime factors take up to three times as long. The others size their own
        windows.
    device : Device
    out_grid : Grid, optional
        Of the result, for auto and cblas; by default the field's.
    guard : float
        Of auto and cblas, in Fresnel widths sqrt(cos^3 theta/(lam z)); 8 for reference results.
        0 ends the band sharply where geometry says, in the window of ``pad``.
    border : float
        Of fresnel-multistep, the fraction of half the window over which each step is absorbed; 0
        lets light wrap around.
    support : float or tuple of float, optional
        (y, x) widths about the grid's centre that carry light, in metres; by default the window.
        Less means fewer frequencies to compute.
    lens : float, optional
        Focal length in metres of a paraxial thin lens on the axis right before a fresnel-1fft,
        joined to its chirp before that is sampled: nothing aliases at z = lens.
    phase : {"tables", "fp64", "twofloat"}, optional
        How the phase of H is formed; by default whatever is exact to 1e-5 rad on the device.

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    report : Report
    out_grid : Grid
        Of the result.

    Raises
    ------
    ValueError
        For an unknown method or phase, or a number outside its range.
    SamplingError
        For an output grid that the method cannot give, or fresnel-1fft at z = 0.

    Warns
    -----
    SamplingWarning
        When what the method samples is aliased, or no light reaches the output.
    """

    def __init__(
        self,
        grid: Grid,
        z: float,
        *,
        wavelength: float,
        method: str = "auto",
        pad: float = 2,
        device: Device,
        out_grid: Grid | None = None,
        guard: float = GUARD,
        border: float = BORDER,
        support: float | tuple[float, float] | None = None,
        lens: float | None = None,
        phase: str | None = None,
    ) -> None:
        wanted = request(
            grid, z, wavelength, method, pad, out_grid, guard, border, support=support, lens=lens
        )
        self._prepare(wanted, device, phase, stacklevel=3)

    @classmethod
    def of(cls, wanted: Request, device: Device, *, stacklevel: int = 3) -> Propagator:
        """The plan of a checked request."""
        made = cls.__new__(cls)
        made._prepare(wanted, device, None, stacklevel=stacklevel + 1)
        return made

    def _prepare(
        self, wanted: Request, device: Device, phase: str | None, *, stacklevel: int
    ) -> None:
        require_device(device)
        if phase is not None and phase not in PHASES:
            raise ValueError(f"There is no phase route {phase!r}; use one of {', '.join(PHASES)}.")
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"In double precision the phase is by 'tables', not {phase!r}.")
        self.request, self.device = wanted, device
        self.grid, self.z, self.wavelength = wanted.grid, wanted.z, wanted.wavelength
        made = describe(wanted)
        self.description = _in_precision(made, device)
        self.method, self.why, self.out_grid = made.method, made.why, made.out_grid
        route = "tables" if made.factor is None else made.factor.phase_route(device)
        self.phase = phase or route
        self.report: Report = report(made, self.phase)
        if made.warning:
            warnings.warn(made.warning, SamplingWarning, stacklevel=stacklevel)
        self._spectrum: Spectrum | None = None

    @property
    def nbytes(self) -> int:
        """Bytes that the plan holds."""
        made, itemsize = self.description, self.device.complex.itemsize
        tables = 3 * sum(line.length for line in made.into.y + made.into.x)
        if made.factor is None:
            return tables * itemsize
        rows, columns = made.factor.stored
        if self.device.fft.name != "vkfft":
            columns = made.factor.shape[1]  # on the host all columns
        return (rows * columns + 2 * tables) * itemsize

    @property
    def spectrum(self) -> Spectrum | None:
        """The factor on the device, made at first use; None where the method has none."""
        if self._spectrum is None and self.description.factor is not None:
            self._spectrum = self.description.factor.on_device(self.device, self.phase)
        return self._spectrum

    def __call__(self, field: Field) -> Field:
        """Propagate a field (or a batch of fields) on the plan's grid.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx).

        Returns
        -------
        Field
            On `out_grid`, without the carrier exp(ikz).

        Raises
        ------
        DeviceError
            If field and plan live on two devices, or the window does not fit the device.
        ShapeError
            If the field's grid or wavelength is not the plan's.
        """
        self._check(field)
        return _together(field, [self])[0]

    def energy(self, field: Field) -> Energy:
        """Where the energy of a field goes, each part computed by itself.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx); a batch is added up.

        Returns
        -------
        Energy
            In the unit of `Field.power`; ``into = window + outside + cut`` but for rounding.

        Raises
        ------
        SamplingError
            For a method without a transfer function in a window of the field's samples: rs and
            the Fresnel methods, or another output pitch or centre.
        """
        self._check(field)
        made, device = self._by_fft(), self.device
        if made.factor is None:
            power = float(np.sum(field.power()))
            return Energy(into=power, window=power, outside=0.0, cut=0.0)
        spectrum = made.factor.on_device(device, self.phase)
        shape = (*field.shape[:-2], *spectrum.shape)
        nbytes = int(np.prod(shape, dtype=np.int64)) * device.complex.itemsize
        device.require_memory(4 * nbytes, "This energy budget")
        area, samples = (
            self.grid.pitch[0] * self.grid.pitch[1],
            spectrum.shape[0] * spectrum.shape[1],
        )
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

    def _by_fft(self) -> Description:
        """The description whose sum is done by FFTs of a window of the field's own samples."""
        made = self.description
        if (made.factor is None and made.route == "none") or self.method in ("as", "blas"):
            return made
        if self.method != "cblas" or not self.request.is_aligned:
            raise SamplingError(
                "energy() is for as, blas and cblas on the field's own pitch and centre, whose "
                f"window holds all the light; this plan is {self.method!r} onto {self.out_grid}."
            )
        return corrected(self.request, self.why, "fft")

    def _check(self, field: Field) -> None:
        require_same_device(field.device, self.device)
        if field.grid != self.grid or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The plan is for {self.grid} at {self.wavelength:g} m, the field has {field.grid} "
                f"at {field.wavelength:g} m."
            )


def propagate(
    field: Field,
    z: float | Sequence[float],
    *,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float = GUARD,
    border: float = BORDER,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
) -> Field:
    """Propagate a field through free space, by one distance or by several.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    z : float or sequence of float
        Distance in metres; 0 returns the field, a negative distance propagates back. Several
        distances share the field's transform where their windows agree.
    method : str
        auto | as | blas | cblas | rs | fresnel-tf | fresnel-ir | fresnel-1fft | fresnel-multistep:
        see `Propagator`.
    pad : float
        Zero padding of as, blas and the Fresnel methods, at least 1; 1 makes the window periodic.
    out_grid : Grid, optional
        Of the result: any pitch, shape and origin with auto and cblas.
    guard, border, support, lens
        See `Propagator`.

    Returns
    -------
    Field
        On ``out_grid``, without the carrier exp(ikz). Shape (..., my, mx), or (n, ..., my, mx) for
        n distances.

    Raises
    ------
    ValueError
        For an unknown method, z that is not finite, or pad < 1.
    SamplingError
        For an output grid that the method cannot give, fresnel-1fft at z = 0, or several distances
        with fresnel-1fft, whose results have different pitches.
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
    """
    distances = [z] if np.ndim(z) == 0 else list(np.asarray(z).ravel())
    if not distances:
        raise ValueError("z is one distance or several, in metres, not an empty list.")
    requests = [
        request(
            field.grid, one, field.wavelength, method, pad, out_grid, guard, border,
            support=support, lens=lens,
        )
        for one in distances
    ]  # fmt: skip
    plans = []
    for wanted in requests:  # a comprehension has a frame of its own before Python 3.12: stacklevel
        plans.append(_kept(wanted, field.device))
    if len({plan.out_grid for plan in plans}) > 1:
        raise SamplingError(
            "fresnel-1fft gives another pitch at each distance: propagate to one at a time, or use "
            "method='cblas' with an out_grid."
        )
    results = _together(field, plans)
    return results[0] if np.ndim(z) == 0 else _stack(results)


def propagate_wavelengths(
    field: Field, z: float | Sequence[float], wavelengths: Sequence[float], **options: Any
) -> list[Field]:
    """The same complex amplitudes at several wavelengths, each propagated as by `propagate`.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx); its own wavelength does not matter.
    z : float or sequence of float
        In metres.
    wavelengths : sequence of float
        In metres.
    **options
        Of `propagate`.

    Returns
    -------
    list of Field
        One a wavelength, each with its wavelength.
    """
    return [
        propagate(replace(field, wavelength=float(wavelength)), z, **options)
        for wavelength in wavelengths
    ]


def plan(
    grid: Grid,
    z: float,
    *,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    device: Device,
    out_grid: Grid | None = None,
) -> Propagator:
    """The device's `Propagator` for these values, made when it is not there yet."""
    return _kept(request(grid, z, wavelength, method, pad, out_grid), device)


def request(
    grid: Grid,
    z: Any,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float = GUARD,
    border: float = BORDER,
    *,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
) -> Request:
    """A checked request, a ``support`` of one number being that of both axes."""
    if support is not None:
        both = np.broadcast_to(np.asarray(support, np.float64), (2,))
        support = (float(both[0]), float(both[1]))
    distance = float(z) if np.ndim(z) == 0 else z
    return Request(grid, distance, wavelength, method, pad, out_grid, guard, border, support, lens)


def _kept(wanted: Request, device: Device) -> Propagator:
    require_device(device)
    return device.plans.get(
        ("propagator", wanted),
        lambda: Propagator.of(wanted, device, stacklevel=6),
        lambda made: made.nbytes,
    )


def _together(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by several plans; those that begin alike share their beginning."""
    results: dict[int, Field] = {}
    groups: dict[Any, list[int]] = {}
    for place, one in enumerate(plans):
        made = one.description
        alone = made.factor is None or made.route.startswith("chirp")
        key = place if alone else ("fft", made.into.widest(field.grid.shape))
        groups.setdefault(key, []).append(place)
    for places in groups.values():
        chosen = [plans[place] for place in places]
        for place, result in zip(places, _run(field, chosen), strict=True):
            results[place] = result
    return [results[place] for place in range(len(plans))]


def _run(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    first = plans[0].description
    if first.route == "none" or 0 in field.shape:
        same = field.shape[:-2]
        if first.route == "none":
            return [field for _ in plans]
        empty = field.device.empty((*same, *first.out_grid.shape), field.device.complex)
        return [replace(field, data=empty, grid=plan.out_grid) for plan in plans]
    _require_memory(field, plans)
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    data = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=one, grid=plan.out_grid) for plan, one in zip(plans, data, strict=True)
    ]


def _require_memory(field: Field, plans: Sequence[Propagator]) -> None:
    made = plans[0].description
    count = int(np.prod(field.shape[:-2], dtype=np.int64))
    out = int(np.prod(made.out_grid.shape, dtype=np.int64))
    samples = made.work_samples
    if field.device.fft.name == "vkfft":
        samples = 2 * int(np.prod(made.window, dtype=np.int64))
    nbytes = count * (samples + len(plans) * (samples + out)) * field.device.complex.itemsize
    field.device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")


def _stack(fields: Sequence[Field]) -> Field:
    """Fields of one grid as a batch with a new leading axis."""
    device = fields[0].device
    out = device.empty((len(fields), *fields[0].shape), device.complex)
    for place, field in enumerate(fields):
        device.copy_into(out, field.data, place * field.data.nbytes)
    return fields[0].with_data(out)


def _in_precision(made: Description, device: Device) -> Description:
    return replace(
        made, into=made.into.astype(device.complex), back=made.back.astype(device.complex)
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
