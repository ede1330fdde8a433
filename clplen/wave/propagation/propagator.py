"""A plan of a propagation on a device."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.blocks import Spectrum, multiplied, run, window
from clplen.compute.device import Device, DeviceLike, as_device, require_same_device
from clplen.compute.forked import Guard
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.description import (
    BORDER,
    Description,
    Request,
    least_samples,
    table_samples,
)
from clplen.wave.propagation.exact_methods import corrected, describe
from clplen.wave.propagation.plan_report import Report, report
from clplen.wave.propagation.transfer_function import made_for


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


if TYPE_CHECKING:
    pass


TOGETHER = 8  # plans that share a beginning at a time: more hold memory and gain nothing


def together(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    """A field by several plans; those that begin alike share their beginning."""
    results: dict[int, Field] = {}
    groups: dict[Any, list[int]] = {}
    for place, one in enumerate(plans):
        made = one.description
        alone = made.kind != "fft"
        key = place if alone else ("fft", made.into.widest(field.grid.shape))
        groups.setdefault(key, []).append(place)
    parts = (
        places[start : start + TOGETHER]
        for places in groups.values()
        for start in range(0, len(places), TOGETHER)
    )
    for places in parts:
        chosen = [plans[place] for place in places]
        for place, result in zip(places, _run(field, chosen), strict=True):
            results[place] = result
    return [results[place] for place in range(len(plans))]


def _run(field: Field, plans: Sequence[Propagator]) -> list[Field]:
    first = plans[0].description
    if first.kind == "nothing":
        return [field for _ in plans]
    if 0 in field.shape:
        shape = (*field.shape[:-2], *first.out_grid.shape)
        empty = field.device.empty(shape, field.device.complex)
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
        device: DeviceLike,
        out_grid: Grid | None = None,
        guard: float | None = None,
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
    def of(cls, wanted: Request, device: DeviceLike, *, stacklevel: int = 3) -> Propagator:
        """The plan of a checked request."""
        made = cls.__new__(cls)
        made._prepare(wanted, device, None, stacklevel=stacklevel + 1)
        return made

    def _prepare(
        self, wanted: Request, device: DeviceLike, phase: str | None, *, stacklevel: int
    ) -> None:
        device = as_device(device)
        if phase is not None and phase not in PHASES:
            raise ValueError(f"There is no phase route {phase!r}; use one of {', '.join(PHASES)}.")
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"In double precision the phase is by 'tables', not {phase!r}.")
        if phase == "fp64" and not device.has_fp64:
            raise ValueError(f"{device.name} has no double precision: use phase='twofloat'.")
        self.request, self.device = wanted, device
        self.grid, self.z, self.wavelength = wanted.grid, wanted.z, wanted.wavelength
        device.require_memory(least_samples(wanted) * device.complex.itemsize, "This propagation")
        made = describe(wanted)
        self.description = _in_precision(made, device)
        self.method, self.why, self.out_grid = made.method, made.why, made.out_grid
        self.phase = "tables"
        if made.factor is not None:
            self.phase = phase or made.factor.phase_route(device)
        self.report: Report = report(made, self.phase)
        if made.warning:
            warnings.warn(made.warning, SamplingWarning, stacklevel=stacklevel)
        self._spectrum: Spectrum | None = None
        self._lock = Guard()

    def __getstate__(self) -> dict[str, Any]:
        """Without what is on the device, which is made again at first use."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_spectrum", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_spectrum": None, "_lock": Guard()})

    def __repr__(self) -> str:
        return f"<Propagator {self.method}, {self.z:g} m, {self.grid} to {self.out_grid}>"

    @property
    def nbytes(self) -> int:
        """Bytes that the plan holds."""
        made, samples = self.description, table_samples(self.description)
        if made.factor is not None:
            rows, columns = made.factor.stored
            samples += rows * columns
        return samples * self.device.complex.itemsize

    @property
    def spectrum(self) -> Spectrum | None:
        """The factor on the device, made at first use; None where the method has none."""
        with self._lock:
            if self._spectrum is None and self.description.factor is not None:
                self._spectrum = made_for(self.description.factor, self.device, self.phase)
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
        return together(field, [self])[0]

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
        return energy(field, self._by_fft(), self.phase)

    def _by_fft(self) -> Description:
        """The description whose sum is done by FFTs of a window of the field's own samples."""
        made = self.description
        if made.kind == "nothing" or self.method in ("as", "blas"):
            return made
        if self.method != "cblas" or not self.request.is_aligned:
            raise SamplingError(
                "energy() is for as, blas and cblas on the field's own pitch and centre, whose "
                f"window holds all the light; this plan is {self.method!r} onto {self.out_grid}: "
                "make one with method='cblas' and without out_grid."
            )
        return corrected(made.request, self.why, "fft")

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


def request(
    grid: Grid,
    z: Any,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float | None = None,
    border: float = BORDER,
    *,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
) -> Request:
    """A checked request, a ``support`` of one number being that of both axes."""
    if support is not None:
        if np.shape(support) not in ((), (2,)):
            raise ValueError(f"support is one width or (y, x), in metres, not {support!r}.")
        both = np.broadcast_to(np.asarray(support, np.float64), (2,))
        support = (float(both[0]), float(both[1]))
    distance = z.item() if isinstance(z, np.ndarray) and z.ndim == 0 else z
    distance = float(distance) if isinstance(distance, Real) else distance
    return Request(grid, distance, wavelength, method, pad, out_grid, guard, border, support, lens)


def _in_precision(made: Description, device: Device) -> Description:
    return replace(
        made, into=made.into.astype(device.complex), back=made.back.astype(device.complex)
    )
