"""Plans of propagations on a device, and their application to fields."""

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
SHARING = 8  # plans that share a transform at a time; more take memory and save no time

TermMaps = tuple[Separable, Spectrum | None, Separable]


class Propagator(Solvable):
    """Plan for a grid and a distance: transforms along the axes, transfer function, windows.

    Parameters
    ----------
    grid : Grid
        Grid of the fields.
    z : float
        Distance in metres; negative propagates back, without evanescent waves.
    wavelength : float
        Wavelength in metres.
    method : str
        - "auto": the cheapest of as, cblas, rs and one-step that is exact at this distance.
        - "as": angular spectrum, H = exp(i k z (sqrt(1 - s) - 1)) (Goodman 2005, eq. 3-66).
        - "blas": angular spectrum within the band that the window samples (Matsushima and
          Shimobaba 2009, eq. 13).
        - "cblas": angular spectrum within the band that reaches the output, plus a smooth guard,
          in a window that keeps aliases clear of the output; any output grid.
        - "rs": convolution with the sampled Rayleigh-Sommerfeld I kernel (Goodman 2005, eq. 3-43);
          any output grid.
        - "one-step": Rayleigh-Sommerfeld integral by a chirp-z transform between two chirps. The
          path beyond Fresnel's terms is exact on one grid and a power series on the other. It
          suits large distances and small outputs, with an error below 1e-9; any output grid.
        - "fresnel-tf", "fresnel-ir": paraxial, by the sampled transfer function (near) or impulse
          response (far) (Goodman 2005, eqs. 4-20 and 4-16).
        - "fresnel-1fft": paraxial, one transform; the output pitch is lam abs(z)/(L dx), or any
          pitch by a chirp-z transform.
        - "fresnel-multistep": paraxial, steps of one transform each with constant pitch.
    pad : float
        Padding of as, blas and the Fresnel methods: the window has exactly round(pad N) samples (1:
        periodic, no padding), for fresnel-multistep an even length without prime factors above 7.
        Lengths with large prime factors take up to three times as long. The other methods choose
        their windows.
    device : Device or str, optional
        Default ``Device.open()``.
    out_grid : Grid, optional
        Grid of the result, for auto, cblas, rs, one-step and fresnel-1fft; by default the field's
        grid, or for fresnel-1fft the grid of its pitch.
    guard : float, optional
        Guard of auto and cblas in Fresnel widths sqrt(cos^3 theta/(lam z)). The default is 6, or 8
        if the window is narrower than 2 sqrt(lam z); use 8 for reference results. 0 ends the band
        sharply at the geometric limit, in the window of ``pad``.
    border : float
        Fraction of half the window over which each step of fresnel-multistep is absorbed; 0 lets
        light wrap around.
    support : float or tuple of float, optional
        Widths (y, x) of the light about the grid's centre in metres; by default the window. Smaller
        widths need fewer frequencies.
    lens : float, optional
        Focal length in metres of a paraxial thin lens on the axis in front of a fresnel-1fft,
        combined with its chirp before sampling: nothing aliases at z = lens.
    phase : {"tables", "fp64", "twofloat"}, optional
        Route of the factor's phase, each accurate to 6e-7 of the light (less near the grazing
        frequency 1/lam); by default "tables" on every device and at every distance.

    Attributes
    ----------
    method, why : str
        Method, and the inequality that selected it.
    report : PlanReport
        Report of method, sampling, band and cost.
    out_grid : Grid
        Grid of the result.

    Raises
    ------
    ValueError
        If the method or phase is unknown, or a number out of range.
    SamplingError
        If the method does not support the output grid, for fresnel-1fft at z = 0, or if a method
        is so far out of its range that its result would be useless.

    Warns
    -----
    SamplingWarning
        If the sampled quantity is aliased, or no light reaches the output.

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
        """Return the plan of a validated request."""
        plan = cls.__new__(cls)
        plan._prepare(request, device, None)
        return plan

    def _prepare(self, request: Request, device: DeviceLike | None, phase: str | None) -> None:
        device = as_device(device)
        if phase is not None and phase not in PHASES:
            raise ValueError(f"phase must be one of {', '.join(PHASES)}, got {phase!r}.")
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"phase must be 'tables' in double precision, got {phase!r}.")
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
        """Return the state without objects of the device, which are created again at first use."""
        cached = ("_spectrum", "_terms", "_lock", "_adjoint_terms", "_slope")
        return {k: v for k, v in self.__dict__.items() if k not in cached}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_spectrum": None, "_terms": None, "_lock": Guard()})

    def __repr__(self) -> str:
        return f"<Propagator {self.method}, {self.z:g} m, {self.grid} to {self.out_grid}>"

    @property
    def report(self) -> PlanReport:
        """Report of method, sampling, band and cost."""
        return report(self.description, self.phase)

    @property
    def nbytes(self) -> int:
        """Bytes of the plan."""
        samples = table_samples(self.description) + factor_samples(self.description)
        return samples * self.device.complex.itemsize

    @property
    def spectrum(self) -> Spectrum | None:
        """Factor on the device, created at first use; None if the method has none."""
        with self._lock:
            if self._spectrum is None and self.description.factor is not None:
                self._spectrum = factor_on_device(self.description.factor, self.device, self.phase)
            return self._spectrum

    @property
    def spectra(self) -> list[Spectrum]:
        """Factors of all terms on the device, created at first use."""
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
            Field of shape (..., ny, nx).

        Returns
        -------
        Field
            Field on `out_grid`, without the carrier exp(ikz).

        Raises
        ------
        DeviceError
            If field and plan are on two devices, or the window does not fit in memory.
        ShapeError
            If the field's grid or wavelength is not the plan's.
        """
        self._check(field)
        return run_plans(field, [self])[0]

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint of the plan's sum over samples, from the output to the input.

        ``<A u, v> = <u, A' v>`` with ``<a, b> = sum conj(a) b``, exact to rounding for every
        method. It is not a back-propagation if the plan truncates the band or changes the pitch.

        Parameters
        ----------
        field : Field
            Field on `out_grid`, shape (..., my, mx).

        Returns
        -------
        Field
            Field on `grid`, shape (..., ny, nx).

        Raises
        ------
        DeviceError
            If field and plan are on two devices, or the window does not fit in memory.
        ShapeError
            If the field's grid or wavelength is not that of the plan's output.
        """
        self._check(field, self.out_grid, "output")
        return replace(field, data=self.adjoint_data(field.data), grid=self.grid)

    def distance_slope(self, field: Field) -> Field:
        """Return the derivative of the propagated field by z, per metre.

        The plan's window and band are held constant, although they depend on the distance. The
        carrier exp(ikz) is omitted, as in the field.

        Parameters
        ----------
        field : Field
            Field on `grid`, shape (..., ny, nx).

        Returns
        -------
        Field
            Derivative on `out_grid`.

        Raises
        ------
        SamplingError
            If the method is fresnel-ir, fresnel-1fft or fresnel-multistep.
        """
        self._check(field)
        if not self._slope:  # the field has a single sample
            shape = (*field.shape[:-2], *self.out_grid.shape)
            return replace(field, data=self.device.zeros(shape, self.dtype), grid=self.out_grid)
        data = sum_of_terms(field.data, self._slope, self.device)
        return replace(field, data=data, grid=self.out_grid)

    @property
    def in_shape(self) -> tuple[int, int]:
        """Shape (ny, nx) of `grid`."""
        return self.grid.shape

    @property
    def out_shape(self) -> tuple[int, int]:
        """Shape (my, mx) of `out_grid`."""
        return self.out_grid.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Dtype complex64, or complex128 on a device of double precision."""
        return self.device.complex

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Apply the plan to samples of the device, shape (..., ny, nx)."""
        return run_plans(Field(data, self.grid, self.wavelength, self.device), [self])[0].data

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Apply `adjoint` to samples of the device, shape (..., my, mx)."""
        if self.description.kind == "nothing":
            return data
        if 0 in data.shape:
            return self.device.empty((*data.shape[:-2], *self.in_shape), self.dtype)
        require_memory(tuple(data.shape[:-2]), [self])
        spectra: list[Spectrum | None] = [spectrum.conjugate() for spectrum in self.spectra]
        return sum_of_terms(
            data,
            [
                (into, spectrum, back)
                for (into, back), spectrum in zip(
                    self._adjoint_terms, spectra or [None], strict=True
                )
            ],
            self.device,
        )

    @cached_property
    def _adjoint_terms(self) -> list[tuple[Separable, Separable]]:
        """Maps before and after the conjugate factor of each term; before only without a factor."""
        description = self.description
        if description.factor is None:
            return [adjoint_maps(Separable(), description.into)]
        ways = description.terms or ((description.into, description.back),)
        return [adjoint_maps(into, back) for into, back in ways]

    @cached_property
    def _slope(self) -> list[TermMaps]:
        """Maps and factors of the terms of `distance_slope`."""
        description = self.description
        if description.kind == "nothing" or description.kind == "series":
            description = _in_precision(corrected(self.request, description.why), self.device)
        if self.method == "fresnel-tf":
            slopes = distance_slopes(description.into, self.grid.pitch, self.wavelength)
            return [(into.astype(self.dtype), None, Separable()) for into in slopes]
        if not isinstance(description.factor, Transfer | Sommerfeld | WindowedKernel):
            raise SamplingError(
                "The derivative by z requires as, blas, cblas, rs, one-step or fresnel-tf, got "
                f"{self.method!r}; use method='auto'."
            )
        factor = replace(description.factor, is_slope=True)
        spectrum = factor_on_device(factor, self.device, self.phase)
        return [(description.into, spectrum, description.back)]

    def energy(self, field: Field) -> Energy:
        """Return the energy budget of a field; each part is computed independently.

        Parameters
        ----------
        field : Field
            Field of shape (..., ny, nx); a batch is added up.

        Returns
        -------
        Energy
            Energies in the unit of `Field.power`; ``into = window + outside + cut`` up to rounding.

        Raises
        ------
        SamplingError
            If the method has no transfer function in a window of the field's samples: rs and the
            Fresnel methods, or another output pitch or centre.
        """
        self._check(field)
        return energy_budget(field, self.description, self.phase)

    def _check(self, field: Field, grid: Grid | None = None, where: str = "input") -> None:
        if not isinstance(field, Field):
            raise TypeError(
                f"field must be a Field, as Field.from_array returns, got {type(field).__name__}."
            )
        require_same_device(field.device, self.device)
        expected = self.grid if grid is None else grid
        if field.grid != expected or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The {where} of the plan must be on {expected} at {self.wavelength:g} m, got "
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
    """Propagate a field by several plans, which share equal first transforms."""
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
    """Propagate a field by plans with equal first transforms."""
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
        data = sum_of_terms(field.data, ways, field.device)
        return [replace(field, data=data, grid=first.out_grid)]
    spectra = [plan.spectrum for plan in plans if plan.spectrum is not None]
    back = [plan.description.back for plan in plans] if spectra else []
    outputs = run(field.data, first.into, spectra, back, field.device)
    return [
        replace(field, data=data, grid=plan.out_grid)
        for plan, data in zip(plans, outputs, strict=True)
    ]


def sum_of_terms(data: cla.Array, ways: Sequence[TermMaps], device: Device) -> cla.Array:
    """Return the sum of terms (maps, factor, maps); without a factor the first maps only."""
    total = None
    for into, factor, back in ways:
        spectra, after = ([], []) if factor is None else ([factor], [back])
        (term,) = run(data, into, spectra, after, device)
        if total is None:
            total = term
        else:
            add(total, term, device)
    assert total is not None
    return total


def require_memory(batch: tuple[int, ...], plans: Sequence[Propagator]) -> None:
    """Raise if a batch of fields does not fit in the device's memory."""
    first, device = plans[0].description, plans[0].device
    count = math.prod(batch)
    out = max(math.prod(first.out_grid.shape), math.prod(first.request.grid.shape))
    samples = first.work_samples
    if device.fft.name == "vkfft":
        samples = 2 * math.prod(first.window)
    nbytes = count * (samples + len(plans) * (samples + out)) * device.complex.itemsize
    device.require_memory(nbytes + sum(plan.nbytes for plan in plans), "This propagation")
