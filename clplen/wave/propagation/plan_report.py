"""Report of a propagation plan, and the energy budget of a propagated field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.fft.blocks import multiplied, window
from clplen.errors import SamplingError
from clplen.reprs import OneLine
from clplen.units import amount, angle, both, interval, metres
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.description import Description, flops, samples_held
from clplen.wave.propagation.methods import corrected


@dataclass(frozen=True, repr=False)
class PlanReport(OneLine):
    """Report of a propagation plan: method, sampling, band and cost.

    Attributes
    ----------
    method, why : str
        Method, and the inequality that selected it.
    z, wavelength : float
        Distance and wavelength in metres.
    route : str
        Description of the sums.
    padded_shape : tuple of int
        Longest transforms (Ly, Lx) along y and x.
    out_grid : Grid
        Grid of the result.
    sampled : str
        Sampled quantity: the transfer function, a kernel or a chirp.
    phase_step : float
        Largest phase step of this quantity per sample, over pi. It is aliased above 1; auto and
        cblas keep the aliases clear of the output.
    aliases_miss : bool
        True if the window is chosen so that aliases miss the output.
    fully_sampled_from, fully_sampled_to : float
        Range of abs(z) in metres without aliasing.
    band : tuple of float
        Largest used abs(fy), abs(fx) in cycles per metre.
    nyquist : tuple of float
        Nyquist frequency (fy, fx) of the grid in cycles per metre.
    lost_band : float
        Unused fraction of the sampled band.
    residual_turns : float
        Phase in turns that the 1-D tables leave to the kernel.
    phase : {"tables", "fp64", "twofloat"}
        Route of the phase; see `Propagator`.
    paraxial_error : float
        Phase error of Fresnel's approximation at the highest frequency of the output, pi z lam^3
        f^4/4 in radians; 0 for an exact method.
    flops : float
        Operations of the Fourier transforms of a field, 5 L log2 L each.
    samples : int
        Complex samples besides a field: the plan, work space and the result.
    warning : str
        Problem of the sampling and its remedy; empty if there is none.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> report = clplen.Propagator(grid, 0.2, wavelength=500e-9).report
    >>> report.method, report.sampled, f"{report.phase_step:.2f} pi a sample", report.warning
    ('rs', 'kernel', '0.13 pi a sample', '')
    """

    method: str
    why: str
    z: float
    wavelength: float
    route: str
    padded_shape: tuple[int, int]
    out_grid: Grid
    sampled: str
    phase_step: float
    aliases_miss: bool
    fully_sampled_from: float
    fully_sampled_to: float
    band: tuple[float, float]
    nyquist: tuple[float, float]
    lost_band: float
    residual_turns: float
    phase: str
    paraxial_error: float
    flops: float
    samples: int
    warning: str

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Pairs (name, value) of everything but the warning, formatted for reading."""
        rows = [
            ("method", f"{self.method}: {self.why}"),
            ("distance", f"{metres(self.z)} at {metres(self.wavelength)}"),
            ("route", self.route),
            ("output", _grid(self.out_grid)),
            ("sampling", self._sampling()),
            ("sampled for z", interval(self.fully_sampled_from, self.fully_sampled_to)),
            *self._band(),
            ("phase", f"{self.phase}, residual {self.residual_turns:.3g} turns"),
        ]
        if self.method.startswith("fresnel"):
            rows.append(("paraxial error", f"up to {self.paraxial_error:.3g} rad"))
        memory = amount(8 * self.samples, "B")
        rows.append(("memory", f"{memory} in complex64, twice that in complex128"))
        return [*rows, ("transforms", amount(self.flops, "flop"))]

    def _sampling(self) -> str:
        """Return the phase step, with a note if aliases miss the output."""
        text = f"{self.sampled}: {self.phase_step:.3g} pi from sample to sample"
        harmless = self.aliases_miss and self.phase_step > 1
        return text + (", its aliases miss the output" if harmless else "")

    def _band(self) -> list[tuple[str, str]]:
        """Return the band of each axis that varies, merged if both agree."""
        used = {}
        for axis, band, nyquist in zip("yx", self.band, self.nyquist, strict=True):
            if nyquist > 0:
                share = f"{band / 1e3:.4g} cycles/mm of {nyquist / 1e3:.4g} (Nyquist)"
                used[f"band {axis}"] = f"{share}, {angle(band, self.wavelength)}"
        if len(used) == 2 and len(set(used.values())) == 1:
            used = {"band": used["band y"]}
        share = f"{100 * (1 - self.lost_band):.3g} % of what is sampled"
        return [*used.items(), ("band used", share)]

    def __str__(self) -> str:
        rows = [*self.rows, *([("warning", self.warning)] if self.warning else [])]
        return "\n".join(f"{name:<18}{value}" for name, value in rows)


def _grid(grid: Grid) -> str:
    """Return samples, pitch, window and centre of a grid as text."""
    ny, nx = grid.shape
    text = f"{ny} x {nx} samples of {both(grid.pitch, metres)}"
    text += f", window {both(grid.extent, lambda value: metres(value, 4))}"
    if any(grid.origin):
        text += f", centre {' x '.join(metres(value, 4) for value in grid.origin)} (y x)"
    return text


def _aliases_miss(description: Description) -> bool:
    """Return True if the window keeps aliases clear; grazing waves need the windowed kernel."""
    r = description.request
    if description.method == "rs":
        return r.method == "auto" or description.kind == "chirp-z"
    grazing = any(r.bands[axis].grazing for axis in r.axes)
    return (description.method == "cblas" or r.method == "auto") and not grazing


def report(description: Description, phase: str) -> PlanReport:
    """Return the report of a description for a phase route."""
    r = description.request
    nyquist = [r.span(a).nyquist if r.grid.shape[a] > 1 else 0.0 for a in (0, 1)]
    band = [max(abs(low), abs(high)) for low, high in description.band]
    shares = [
        max(0.0, high - low) / (2 * f) if f else 1.0
        for (low, high), f in zip(description.band, nyquist, strict=True)
    ]
    corner = sum(r.span(axis).highest ** 2 for axis in (0, 1))
    paraxial = math.pi * abs(r.z) * r.wavelength**3 * corner**2 / 4
    return PlanReport(
        method=description.method,
        why=description.why,
        z=r.z,
        wavelength=r.wavelength,
        route=description.route,
        padded_shape=description.window,
        out_grid=description.out_grid,
        sampled=description.sampled,
        phase_step=description.phase_step,
        aliases_miss=_aliases_miss(description),
        fully_sampled_from=description.valid[0],
        fully_sampled_to=description.valid[1],
        band=(band[0], band[1]),
        nyquist=(nyquist[0], nyquist[1]),
        lost_band=1 - shares[0] * shares[1],
        residual_turns=0.0 if description.factor is None else description.factor.residual_turns(),
        phase=phase,
        paraxial_error=paraxial if description.method.startswith("fresnel") else 0.0,
        flops=flops(description),
        samples=samples_held(description),
        warning=description.warning,
    )


@dataclass(frozen=True)
class Energy:
    """Energy budget of a propagated field, in the unit of `Field.power`.

    Attributes
    ----------
    into : float
        Energy of the input field.
    window : float
        Energy inside the window of the output grid.
    outside : float
        Energy outside of it, in the padding.
    cut : float
        Energy outside of the band of the transfer function, or evanescent.

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
    """Return the energy budget; each part is computed independently."""
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
    """Return a description that sums by FFTs of a window of the field's samples."""
    method, request = description.method, description.request
    if description.kind == "nothing" or method in ("as", "blas"):
        return description
    if method != "cblas" or not request.is_aligned:
        raise SamplingError(
            "energy() requires as, blas or cblas with the field's pitch and centre, whose window "
            f"holds all the light, got {method!r} to {description.out_grid}; use method='cblas' "
            "without out_grid."
        )
    return corrected(request, description.why, "fft")


def _power(data: cla.Array, device: Device) -> float:
    """Return the sum of abs(u)^2 in float64."""
    with device.on_host(data, write=False) as values:
        return float(np.vdot(values, values.astype(np.complex128)).real)


def _power_outside(data: cla.Array, shape: tuple[int, int], device: Device) -> float:
    """Return the sum of abs(u)^2 outside of the central window of a shape, in float64."""
    with device.on_host(data, write=False) as values:
        outside = values.astype(np.complex128)
    rows, columns = (
        slice(n // 2 - m // 2, n // 2 - m // 2 + m)
        for n, m in zip(outside.shape[-2:], shape, strict=True)
    )
    outside[..., rows, columns] = 0
    return float(np.vdot(outside, outside).real)
