"""Free-space propagation by the angular spectrum of plane waves."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device, require_same_device
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.wave.field import Field, Grid
from clplen.wave.transfer import Transfer, blas_band, fully_sampled_distance

METHODS = ("auto", "as", "blas")
PHASES = ("tables", "fp64", "twofloat")


@dataclass(frozen=True)
class Report:
    """What a plan knows about itself.

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    z : float
        Distance in metres.
    padded_shape : tuple of int
        (Ly, Lx) of the computation window.
    fully_sampled_to : float
        Largest abs(z) in metres at which the transfer function is sampled over the whole band.
    band : tuple of float
        Largest abs(fy), abs(fx) kept, in cycles a metre.
    nyquist : tuple of float
        Nyquist frequency (fy, fx) of the grid, in cycles a metre.
    residual_turns : float
        Phase left to float32 beside the 1-D tables.
    phase : str
        "tables", "fp64" or "twofloat".
    """

    method: str
    why: str
    z: float
    padded_shape: tuple[int, int]
    fully_sampled_to: float
    band: tuple[float, float]
    nyquist: tuple[float, float]
    residual_turns: float
    phase: str

    def __str__(self) -> str:
        return "\n".join(
            (
                f"method            {self.method}: {self.why}",
                f"distance          {self.z:g} m",
                f"window            {self.padded_shape[0]} x {self.padded_shape[1]} samples",
                f"H sampled to      {self.fully_sampled_to:.4g} m",
                f"band              {self.band[0]:.5g}, {self.band[1]:.5g} cycles/m in y, x "
                f"(Nyquist {self.nyquist[0]:.5g}, {self.nyquist[1]:.5g})",
                f"phase             {self.phase}, residual {self.residual_turns:.3g} turns",
            )
        )


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


class Propagator:
    """A plan for one grid and distance: transfer function, Fourier transforms, window.

    Parameters
    ----------
    grid : Grid
    z : float
        Distance in metres; negative propagates back (evanescent waves are then dropped).
    wavelength : float
        In metres.
    method : {"auto", "as", "blas"}
        "as": angular spectrum, H = exp(i k z (sqrt(1 - s) - 1)) (Goodman 2005, eq. 3-66).
        "blas": the same, restricted to the band that the window samples (Matsushima and Shimobaba
        2009, eq. 13). "auto": "as" while H is sampled over the whole band or the window is periodic
        (pad 1), else "blas".
    pad : float
        The window is pad times the grid (1: periodic, no padding), rounded up to a length without
        prime factors above 7.
    device : Device
    phase : {"tables", "fp64", "twofloat"}, optional
        How the phase of H is formed; by default whatever is exact to 1e-5 rad on the device.

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    report : Report

    Raises
    ------
    ValueError
        For an unknown method or phase, z that is not finite, or pad < 1.

    Warns
    -----
    SamplingWarning
        When "as" was asked for beyond the distance at which H is sampled.
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
        phase: str | None = None,
    ) -> None:
        _check_arguments(z, wavelength, method, pad, phase)
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"In double precision the phase is by 'tables', not {phase!r}.")
        self.grid, self.z, self.wavelength, self.device = grid, float(z), wavelength, device
        shape = padded_shape(grid.shape, pad)
        reach = min(
            fully_sampled_distance(n, d, wavelength) for n, d in zip(shape, grid.pitch, strict=True)
        )
        self.method, self.why = _choose(method, abs(z), reach, periodic=pad == 1)
        unlimited = (math.inf, math.inf)
        limited = blas_band(shape, grid.pitch, z, wavelength)
        self.transfer = Transfer(
            shape, grid.pitch, self.z, wavelength, limited if self.method == "blas" else unlimited
        )
        self.phase = phase or self.transfer.phase_route(device)
        self.report = self._report(reach)
        if method == "as" and abs(z) > reach and pad > 1:
            warnings.warn(
                f"The transfer function at z = {z:g} m is aliased: it is sampled over the whole "
                f"band only up to {reach:.4g} m. Use method='blas' or a larger pad.",
                SamplingWarning,
                stacklevel=2,
            )
        self._H: cla.Array | None = None

    @property
    def nbytes(self) -> int:
        """Bytes that the plan holds on the device."""
        ny, nx = self.transfer.shape
        return (ny // 2 + 1) * (nx // 2 + 1) * self.device.complex.itemsize

    def __call__(self, field: Field) -> Field:
        """Propagate a field (or a batch of fields) on the plan's grid.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx).

        Returns
        -------
        Field
            Same shape and grid, without the carrier exp(ikz).

        Raises
        ------
        DeviceError
            If field and plan live on two devices, or the window does not fit the device.
        ShapeError
            If the field's grid or wavelength is not the plan's.
        """
        require_same_device(field.device, self.device)
        if field.grid != self.grid or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The plan is for {self.grid} at {self.wavelength:g} m, the field has {field.grid} "
                f"at {field.wavelength:g} m."
            )
        if self.z == 0 or 0 in field.shape:
            return field
        work = self._spectrum(field)
        self._filter(work)
        self.device.fft.inverse(work, self.device)
        if work.shape == field.shape:
            return field.with_data(work)
        return field.with_data(window(work, field.shape, self.device))

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
        """
        area = self.grid.pitch[0] * self.grid.pitch[1]
        work = self._spectrum(field)
        before = _power(work, self.device)
        self._filter(work)
        after = _power(work, self.device)
        self.device.fft.inverse(work, self.device)
        kept = window(work, field.shape, self.device)
        with self.device.on_host(work, write=False) as values:
            outside = values.astype(np.complex128)
        rows, columns = (
            slice(n // 2 - m // 2, n // 2 - m // 2 + m)
            for n, m in zip(self.transfer.shape, self.grid.shape, strict=True)
        )
        outside[..., rows, columns] = 0
        samples = self.transfer.shape[0] * self.transfer.shape[1]
        return Energy(
            into=float(np.sum(field.power())),
            window=_power(kept, self.device) * area,
            outside=float(np.vdot(outside, outside).real) * area,
            cut=(before - after) / samples * area,
        )

    def _spectrum(self, field: Field) -> cla.Array:
        """The Fourier transform of the padded field, a new array."""
        batch = field.shape[:-2]
        samples = int(np.prod((*batch, *self.transfer.shape), dtype=np.int64))
        self.device.require_memory(
            2 * samples * self.device.complex.itemsize + self.nbytes, "This propagation"
        )
        work = window(field.data, (*batch, *self.transfer.shape), self.device)
        self.device.fft.forward(work, self.device)
        return work

    def _filter(self, spectrum: cla.Array) -> None:
        if self._H is None:
            self._H = self.transfer.on_device(self.device, self.phase)
        ny, nx = self.transfer.shape
        defines = self.device.wave_defines()
        kernel = self.device.kernel("spectral_filter.cl", "filter_spectrum", **defines)
        self.device.launch_rows(
            kernel, spectrum.shape, spectrum, self._H, np.int32(ny), np.int32(nx)
        )

    def _report(self, reach: float) -> Report:
        t = self.transfer
        nyquist = tuple(
            0.0 if n == 1 else 1 / (2 * d)
            for n, d in zip(self.grid.shape, self.grid.pitch, strict=True)
        )
        return Report(
            method=self.method,
            why=self.why,
            z=self.z,
            padded_shape=t.shape,
            fully_sampled_to=reach,
            band=(min(t.band[0], nyquist[0]), min(t.band[1], nyquist[1])),
            nyquist=(nyquist[0], nyquist[1]),
            residual_turns=t.residual_turns(),
            phase=self.phase,
        )


def propagate(
    field: Field,
    z: float,
    *,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
) -> Field:
    """Propagate a field by z through free space.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    z : float
        Distance in metres; 0 returns the field, a negative distance propagates back.
    method : {"auto", "as", "blas"}
        See `Propagator`.
    pad : float
        Zero padding, at least 1; 1 makes the window periodic.
    out_grid : Grid, optional
        These methods keep the grid: only the field's own is accepted.

    Returns
    -------
    Field
        Same shape and grid, without the carrier exp(ikz).

    Raises
    ------
    ValueError
        For an unknown method, z that is not finite, or pad < 1.
    SamplingError
        If ``out_grid`` is another grid.
    DeviceError
        If the padded window does not fit the device.

    Notes
    -----
    The plan is kept on the device and used again for the same grid, distance, wavelength, method
    and padding.
    """
    if out_grid is not None and out_grid != field.grid:
        raise SamplingError(
            f"The methods {', '.join(METHODS)} keep the grid of the field: {field.grid} was given, "
            f"{out_grid} asked for."
        )
    return plan(
        field.grid, z, wavelength=field.wavelength, method=method, pad=pad, device=field.device
    )(field)


def plan(
    grid: Grid, z: float, *, wavelength: float, method: str = "auto", pad: float = 2, device: Device
) -> Propagator:
    """The device's `Propagator` for these values, made when it is not there yet."""
    _check_arguments(z, wavelength, method, pad, None)
    return device.plans.get(
        ("propagator", grid, float(z), wavelength, method, pad),
        lambda: Propagator(grid, z, wavelength=wavelength, method=method, pad=pad, device=device),
        lambda made: made.nbytes,
    )


def window(data: cla.Array, shape: tuple[int, ...], device: Device) -> cla.Array:
    """A copy of complex samples in a larger or smaller window; sample N//2 stays on N//2."""
    out = device.empty(shape, device.complex)
    (ny, nx), (in_ny, in_nx) = shape[-2:], data.shape[-2:]
    kernel = device.kernel("window.cl", "window", **device.wave_defines())
    numbers = (ny, nx, in_ny, in_nx, in_ny // 2 - ny // 2, in_nx // 2 - nx // 2)
    device.launch_rows(kernel, shape, out, data, *(np.int32(n) for n in numbers))
    return out


def _power(data: cla.Array, device: Device) -> float:
    """Sum of abs(u)^2 in float64."""
    with device.on_host(data, write=False) as values:
        return float(np.vdot(values, values.astype(np.complex128)).real)


def padded_shape(shape: tuple[int, int], pad: float) -> tuple[int, int]:
    """Window lengths: N for pad 1, else the next 7-smooth length from round(pad N); 1 stays 1."""
    ny, nx = (n if pad == 1 or n == 1 else _next_smooth(round(pad * n)) for n in shape)
    return (ny, nx)


def _next_smooth(n: int) -> int:
    while True:
        rest = n
        for prime in (2, 3, 5, 7):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


def _choose(method: str, z: float, reach: float, *, periodic: bool) -> tuple[str, str]:
    if method != "auto":
        return method, "asked for"
    if periodic:
        return "as", "pad = 1: a periodic field has no frequencies between the samples of H"
    if z <= reach:
        return "as", f"z = {z:.4g} m <= {reach:.4g} m: H is sampled over the whole band"
    return "blas", f"z = {z:.4g} m > {reach:.4g} m: H is sampled over part of the band"


def _check_arguments(
    z: float, wavelength: float, method: str, pad: float, phase: str | None
) -> None:
    if method not in METHODS:
        raise ValueError(f"There is no method {method!r}; use one of {', '.join(METHODS)}.")
    if phase is not None and phase not in PHASES:
        raise ValueError(f"There is no phase route {phase!r}; use one of {', '.join(PHASES)}.")
    if np.ndim(z) or not math.isfinite(z):
        raise ValueError(f"The distance z is one finite number of metres, not {z!r}.")
    if not (math.isfinite(wavelength) and wavelength > 0):
        raise ValueError(f"The wavelength is positive, in metres, not {wavelength!r}.")
    if not (math.isfinite(pad) and pad >= 1):
        raise ValueError(f"pad is at least 1 and finite, not {pad!r}.")
