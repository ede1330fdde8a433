"""The plan of a propagation on a device, and how fields run through plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device, DeviceLike, as_device, require_same_device
from clplen.compute.drivers.forked import Guard
from clplen.compute.fft.blocks import Spectrum, add, multiplied, run, window
from clplen.deprecation import warn_caller
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.description import (
    BORDER,
    Description,
    Request,
    factor_samples,
    least_samples,
    request,
    table_samples,
)
from clplen.wave.propagation.methods import corrected, describe
from clplen.wave.propagation.one_step import SeriesFactor, series_spectra
from clplen.wave.propagation.plan_report import PlanReport, report
from clplen.wave.propagation.transfer_function import factor_on_device

PHASES = ("tables", "fp64", "twofloat")
SHARING = 8  # plans that share the field's transform at a time: more hold memory and gain nothing


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


class Propagator:
    """A plan for one grid and distance: transforms along the axes, transfer function, windows.

    Parameters
    ----------
    grid : Grid
        Of the fields that it propagates.
    z : float
        Distance in metres; negative propagates back (evanescent waves are then dropped).
    wavelength : float
        In metres.
    method : str
        - "auto": whichever of as, cblas, rs and one-step is exact at this distance and cheapest.
        - "as": angular spectrum, H = exp(i k z (sqrt(1 - s) - 1)) (Goodman 2005, eq. 3-66).
        - "blas": the same within the band that the window samples (Matsushima and Shimobaba 2009,
          eq. 13).
        - "cblas": within the band that reaches the output, widened by a smooth guard, in a window
          that keeps aliases clear of it; any output grid.
        - "rs": convolution with the sampled Rayleigh-Sommerfeld I kernel (Goodman 2005, eq. 3-43);
          any output grid.
        - "one-step": the same integral by a chirp-z transform between two chirps, the rest of the
          path (beyond Fresnel's) exact on one of the grids and a power series on the other; far
          away or onto a small output, where the error's bound is 1e-9; any output grid.
        - "fresnel-tf", "fresnel-ir": paraxial, by the sampled transfer function (near) or impulse
          response (far) (Goodman 2005, eqs. 4-20 and 4-16).
        - "fresnel-1fft": paraxial, one transform; the output pitch is lam abs(z)/(L dx), or
          any by a chirp-z transform.
        - "fresnel-multistep": paraxial, steps of one transform that keep the pitch.
    pad : float
        For as, blas and the Fresnel methods the window is exactly round(pad N) samples (1:
        periodic, no padding); of fresnel-multistep an even length without prime factors above 7.
        Lengths with large prime factors take up to three times as long. The others size their own
        windows.
    device : Device or str, optional
        Default ``Device.open()``.
    out_grid : Grid, optional
        Of the result, for auto, cblas, rs, one-step and fresnel-1fft; by default the field's, of
        fresnel-1fft that of its pitch.
    guard : float, optional
        Of auto and cblas, in Fresnel widths sqrt(cos^3 theta/(lam z)); by default 6, and 8 so far
        away that the window is narrower than 2 sqrt(lam z). 8 is for reference results.
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
        How the phase of H is formed; by default whatever is exact to 1e-5 rad on the device
        (less next to the grazing frequency 1/lam).

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    report : PlanReport
        What the plan knows of itself: method, sampling, band, cost.
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

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> plan = clplen.Propagator(grid, 5e-3, wavelength=500e-9)
    >>> plan.method, plan.out_grid == grid
    ('as', True)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> plan(clplen.aperture(wave, 0.2e-3))
    <Field (64, 64) complex64, 500 nm, pitch 10 um, ...>
    """

    def __init__(
        self,
        grid: Grid,
        z: float,
        *,
        wavelength: float,
        method: str = "auto",
        pad: float = 2,
        device: DeviceLike | None = None,
        out_grid: Grid | None = None,
        guard: float | None = None,
        border: float = BORDER,
        support: float | tuple[float, float] | None = None,
        lens: float | None = None,
        phase: str | None = None,
    ) -> None:
        checked = request(
            grid, z, wavelength, method, pad, out_grid, guard, border, support=support, lens=lens
        )
        self._prepare(checked, device, phase)

    @classmethod
    def of(cls, request: Request, device: DeviceLike | None = None) -> Propagator:
        """The plan of a checked request."""
        plan = cls.__new__(cls)
        plan._prepare(request, device, None)
        return plan

    def _prepare(self, request: Request, device: DeviceLike | None, phase: str | None) -> None:
        device = as_device(device)
        if phase is not None and phase not in PHASES:
            raise ValueError(f"There is no phase route {phase!r}; use one of {', '.join(PHASES)}.")
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"In double precision the phase is by 'tables', not {phase!r}.")
        if phase == "fp64" and not device.has_fp64:
            raise ValueError(f"{device.name} has no double precision: use phase='twofloat'.")
        self.request, self.device = request, device
        self.grid, self.z, self.wavelength = request.grid, request.z, request.wavelength
        device.require_memory(least_samples(request) * device.complex.itemsize, "This propagation")
        description = describe(request)
        self.description = _in_precision(description, device)
        self.method, self.why = description.method, description.why
        self.out_grid = description.out_grid
        self.phase = "tables"
        if description.factor is not None:
            self.phase = phase or description.factor.phase_route(device)
        if description.warning:
            warn_caller(description.warning, SamplingWarning)
        self._spectrum: Spectrum | None = None
        self._terms: list[Spectrum] | None = None
        self._lock = Guard()

    def __getstate__(self) -> dict[str, Any]:
        """Without what is on the device, which is made again at first use."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_spectrum", "_terms", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_spectrum": None, "_terms": None, "_lock": Guard()})

    def __repr__(self) -> str:
        return f"<Propagator {self.method}, {self.z:g} m, {self.grid} to {self.out_grid}>"

    @property
    def report(self) -> PlanReport:
        """What the plan knows of itself: method, sampling, band, cost."""
        return report(self.description, self.phase)

    @property
    def nbytes(self) -> int:
        """Bytes that the plan holds."""
        samples = table_samples(self.description) + factor_samples(self.description)
        return samples * self.device.complex.itemsize

    @property
    def spectrum(self) -> Spectrum | None:
        """The factor on the device, made at first use; None where the method has none."""
        with self._lock:
            if self._spectrum is None and self.description.factor is not None:
                self._spectrum = factor_on_device(self.description.factor, self.device, self.phase)
            return self._spectrum

    @property
    def spectra(self) -> list[Spectrum]:
        """The factor, or those of all terms of a sum, on the device; made at first use."""
        if not self.description.terms:
            return [self.spectrum] if self.spectrum is not None else []
        with self._lock:
            if self._terms is None:
                factor = self.description.factor
                assert isinstance(factor, SeriesFactor)
                self._terms = series_spectra(factor.series, self.device)
            return self._terms

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
        return run_plans(field, [self])[0]

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
        return _energy(field, self._by_fft(), self.phase)

    def _by_fft(self) -> Description:
        """The description whose sum is done by FFTs of a window of the field's own samples."""
        description = self.description
        if description.kind == "nothing" or self.method in ("as", "blas"):
            return description
        if self.method != "cblas" or not self.request.is_aligned:
            raise SamplingError(
                "energy() is for as, blas and cblas on the field's own pitch and centre, whose "
                f"window holds all the light; this plan is {self.method!r} onto {self.out_grid}: "
                "make one with method='cblas' and without out_grid."
            )
        return corrected(description.request, self.why, "fft")

    def _check(self, field: Field) -> None:
        if not isinstance(field, Field):
            raise TypeError(
                f"A plan takes a Field, as Field.from_array makes it, not a {type(field).__name__}."
            )
        require_same_device(field.device, self.device)
        if field.grid != self.grid or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The plan is for {self.grid} at {self.wavelength:g} m, the field has {field.grid} "
                f"at {field.wavelength:g} m."
            )


def run_plans(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by several plans; those that begin with the same transform share it.

    Parameters
    ----------
    field : Field
        On the grid of all plans.
    plans : sequence of Propagator

    Returns
    -------
    list of Field
        One a plan, in their order.
    """
    groups: dict[Any, list[int]] = {}
    for index, plan in enumerate(plans):
        into, shares = plan.description.into, plan.description.kind == "fft"
        key = ("fft", into.widest(field.grid.shape)) if shares else index
        groups.setdefault(key, []).append(index)
    results: dict[int, Field] = {}
    for members in groups.values():
        for start in range(0, len(members), SHARING):
            indices = members[start : start + SHARING]
            fields = _run_group(field, [plans[index] for index in indices])
            results.update(zip(indices, fields, strict=True))
    return [results[index] for index in range(len(plans))]


def _run_group(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by plans that begin alike."""
    first = plans[0].description
    if first.kind == "nothing":
        return [field for _ in plans]
    if 0 in field.shape:
        shape = (*field.shape[:-2], *first.out_grid.shape)
        empty = field.device.empty(shape, field.device.complex)
        return [replace(field, data=empty, grid=plan.out_grid) for plan in plans]
    _require_memory(field, plans)
    if first.terms:
        data = _sum_of_terms(field, plans[0])
        return [replace(field, data=data, grid=first.out_grid)]
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    outputs = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=data, grid=plan.out_grid)
        for plan, data in zip(plans, outputs, strict=True)
    ]


def _sum_of_terms(field: Field, plan: Propagator) -> cla.Array:
    """A field through each term of a plan, added up."""
    total = None
    for (into, back), factor in zip(plan.description.terms, plan.spectra, strict=True):
        (data,) = run(field.data, into, [factor], [back], field.device)
        if total is None:
            total = data
        else:
            add(total, data, field.device)
    assert total is not None
    return total


def _require_memory(field: Field, plans: Sequence[Propagator]) -> None:
    first = plans[0].description
    count = int(np.prod(field.shape[:-2], dtype=np.int64))
    out = int(np.prod(first.out_grid.shape, dtype=np.int64))
    samples = first.work_samples
    if field.device.fft.name == "vkfft":
        samples = 2 * int(np.prod(first.window, dtype=np.int64))
    nbytes = count * (samples + len(plans) * (samples + out)) * field.device.complex.itemsize
    field.device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")


def _in_precision(description: Description, device: Device) -> Description:
    if description.terms:
        terms = tuple(
            (into.astype(device.complex), back.astype(device.complex))
            for into, back in description.terms
        )
        return replace(description, into=terms[0][0], back=terms[0][1], terms=terms)
    into, back = (maps.astype(device.complex) for maps in (description.into, description.back))
    return replace(description, into=into, back=back)


def _energy(field: Field, description: Description, phase: str) -> Energy:
    """Each part computed by itself, of a propagation by FFTs of a window of the field's samples.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx); a batch is added up.
    description : Description
    phase : str
        How the phase of its factor is formed.
    """
    device, grid = field.device, field.grid
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
