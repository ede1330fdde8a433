"""The plan of a propagation on a device, and how fields run through plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device, DeviceLike, as_device, require_same_device
from clplen.compute.drivers.forked import Guard
from clplen.compute.fft.blocks import Spectrum, add, run
from clplen.compute.fft.lines import Separable, adjoint_maps
from clplen.compute.linear_map import Solvable
from clplen.errors import SamplingError, SamplingWarning, ShapeError, warn_caller
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
from clplen.wave.propagation.fresnel import distance_slopes
from clplen.wave.propagation.methods import corrected, describe
from clplen.wave.propagation.one_step import SeriesFactor, series_spectra
from clplen.wave.propagation.plan_report import Energy, PlanReport, energy_budget, report
from clplen.wave.propagation.transfer_function import Sommerfeld, Transfer, factor_on_device
from clplen.wave.propagation.windowed_kernel import WindowedKernel

PHASES = ("tables", "fp64", "twofloat")
SHARING = 8  # plans that share the field's transform at a time: more hold memory and gain nothing

Way = tuple[Separable, Spectrum | None, Separable]


class Propagator(Solvable):
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
        How the factor's phase is formed, each right to 6e-7 of the light (less next to the
        grazing frequency 1/lam); "tables" by default, whatever the device and the distance.

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
        For an output grid that the method cannot give, fresnel-1fft at z = 0, or a method so far
        outside its range that its result would be no field.

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
        if description.is_refused:
            raise SamplingError(description.warning)
        self.description = _in_precision(description, device)
        self.method, self.why = description.method, description.why
        self.out_grid = description.out_grid
        self.phase = "tables" if description.factor is None or phase is None else phase
        if description.warning:
            warn_caller(description.warning, SamplingWarning)
        self._spectrum: Spectrum | None = None
        self._terms: list[Spectrum] | None = None
        self._lock = Guard()

    def __getstate__(self) -> dict[str, Any]:
        """Without what is on the device, which is made again at first use."""
        made = ("_spectrum", "_terms", "_lock", "_adjoint_ways", "_slope")
        return {k: v for k, v in self.__dict__.items() if k not in made}

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

    def adjoint(self, field: Field) -> Field:
        """The adjoint of the plan: what its sum over samples gives from the output to the input.

        ``<A u, v> = <u, A' v>`` with ``<a, b> = sum conj(a) b``, exact to rounding whatever the
        method. It is no propagation back where the plan cuts, or where the pitches differ.

        Parameters
        ----------
        field : Field
            On `out_grid`, shape (..., my, mx).

        Returns
        -------
        Field
            On `grid`, shape (..., ny, nx).

        Raises
        ------
        DeviceError
            If field and plan live on two devices, or the window does not fit the device.
        ShapeError
            If the field's grid or wavelength is not that of the plan's output.
        """
        self._check(field, self.out_grid, "output")
        return replace(field, data=self.adjoint_data(field.data), grid=self.grid)

    def distance_slope(self, field: Field) -> Field:
        """The derivative of the propagated field by z, per metre.

        That of the plan's sum in its own window and band, which another distance may change; the
        carrier exp(ikz) is dropped as in the field.

        Parameters
        ----------
        field : Field
            On `grid`, shape (..., ny, nx).

        Returns
        -------
        Field
            On `out_grid`.

        Raises
        ------
        SamplingError
            For fresnel-ir, fresnel-1fft and fresnel-multistep.
        """
        self._check(field)
        if not self._slope:  # nothing varies
            shape = (*field.shape[:-2], *self.out_grid.shape)
            return replace(field, data=self.device.zeros(shape, self.dtype), grid=self.out_grid)
        data = sum_of_ways(field.data, self._slope, self.device)
        return replace(field, data=data, grid=self.out_grid)

    @property
    def in_shape(self) -> tuple[int, int]:
        """(ny, nx) of `grid`."""
        return self.grid.shape

    @property
    def out_shape(self) -> tuple[int, int]:
        """(my, mx) of `out_grid`."""
        return self.out_grid.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """complex64, or complex128 on a device of double precision."""
        return self.device.complex

    def forward_data(self, data: cla.Array) -> cla.Array:
        """The plan on samples of the device, shape (..., ny, nx)."""
        return run_plans(Field(data, self.grid, self.wavelength, self.device), [self])[0].data

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """`adjoint` on samples of the device, shape (..., my, mx)."""
        if self.description.kind == "nothing":
            return data
        if 0 in data.shape:
            return self.device.empty((*data.shape[:-2], *self.in_shape), self.dtype)
        require_memory(tuple(data.shape[:-2]), [self])
        spectra: list[Spectrum | None] = [spectrum.conjugate() for spectrum in self.spectra]
        return sum_of_ways(
            data,
            [
                (into, spectrum, back)
                for (into, back), spectrum in zip(
                    self._adjoint_ways, spectra or [None], strict=True
                )
            ],
            self.device,
        )

    @cached_property
    def _adjoint_ways(self) -> list[tuple[Separable, Separable]]:
        """Maps before and after the conjugate factor, of every term; before, if there is none."""
        description = self.description
        if description.factor is None:
            return [adjoint_maps(Separable(), description.into)]
        ways = description.terms or ((description.into, description.back),)
        return [adjoint_maps(into, back) for into, back in ways]

    @cached_property
    def _slope(self) -> list[Way]:
        """Maps and factors of the terms of `distance_slope`."""
        made = self.description
        if made.kind == "nothing" or made.kind == "series":
            made = _in_precision(corrected(self.request, made.why), self.device)
        if self.method == "fresnel-tf":
            into = distance_slopes(made.into, self.grid.pitch, self.wavelength)
            return [(one.astype(self.dtype), None, Separable()) for one in into]
        if not isinstance(made.factor, Transfer | Sommerfeld | WindowedKernel):
            raise SamplingError(
                f"The derivative by z is for as, blas, cblas, rs, one-step and fresnel-tf, not "
                f"{self.method!r}: make the plan with method='auto'."
            )
        factor = replace(made.factor, is_slope=True)
        return [(made.into, factor_on_device(factor, self.device, self.phase), made.back)]

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
        return energy_budget(field, self.description, self.phase)

    def _check(self, field: Field, grid: Grid | None = None, where: str = "input") -> None:
        if not isinstance(field, Field):
            raise TypeError(
                f"A plan takes a Field, as Field.from_array makes it, not a {type(field).__name__}."
            )
        require_same_device(field.device, self.device)
        wanted = self.grid if grid is None else grid
        if field.grid != wanted or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The {where} of the plan is on {wanted} at {self.wavelength:g} m, the field is on "
                f"{field.grid} at {field.wavelength:g} m."
            )


def _in_precision(description: Description, device: Device) -> Description:
    if description.terms:
        terms = tuple(
            (into.astype(device.complex), back.astype(device.complex))
            for into, back in description.terms
        )
        return replace(description, into=terms[0][0], back=terms[0][1], terms=terms)
    into, back = (maps.astype(device.complex) for maps in (description.into, description.back))
    return replace(description, into=into, back=back)


def run_plans(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by several plans; those that begin with the same transform share it."""
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
    require_memory(field.shape[:-2], plans)
    if first.terms:
        ways = [
            (into, factor, back)
            for (into, back), factor in zip(first.terms, plans[0].spectra, strict=True)
        ]
        data = sum_of_ways(field.data, ways, field.device)
        return [replace(field, data=data, grid=first.out_grid)]
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    outputs = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=data, grid=plan.out_grid)
        for plan, data in zip(plans, outputs, strict=True)
    ]


def sum_of_ways(data: cla.Array, ways: Sequence[Way], device: Device) -> cla.Array:
    """Samples by several ways (maps, factor, maps; without a factor the first maps), added up."""
    total = None
    for into, factor, back in ways:
        spectra, after = ([], []) if factor is None else ([factor], [back])
        (made,) = run(data, into, spectra, after, device)
        if total is None:
            total = made
        else:
            add(total, made, device)
    assert total is not None
    return total


def require_memory(batch: tuple[int, ...], plans: Sequence[Propagator]) -> None:
    """Refuse a batch of fields that does not fit the device."""
    first, device = plans[0].description, plans[0].device
    count = math.prod(batch)
    out = max(math.prod(first.out_grid.shape), math.prod(first.request.grid.shape))
    samples = first.work_samples
    if device.fft.name == "vkfft":
        samples = 2 * math.prod(first.window)
    nbytes = count * (samples + len(plans) * (samples + out)) * device.complex.itemsize
    device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")
