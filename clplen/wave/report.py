"""What a plan of a propagation knows about itself, and where the energy of a field goes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clplen.wave.description import Description
from clplen.wave.field import Grid


@dataclass(frozen=True)
class Report:
    """What a plan knows about itself.

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    z : float
        Distance in metres.
    route : str
        How the sums are done.
    padded_shape : tuple of int
        (Ly, Lx), the longest transforms along y and x.
    out_grid : Grid
        Of the result.
    sampled : str
        What has to be sampled: the transfer function, a kernel or a chirp.
    phase_step : float
        Its largest phase step from sample to sample, divided by pi; aliased above 1.
    fully_sampled_from, fully_sampled_to : float
        The interval of abs(z) in metres in which it is not.
    band : tuple of float
        Largest abs(fy), abs(fx) used, in cycles a metre.
    nyquist : tuple of float
        Nyquist frequency (fy, fx) of the grid, in cycles a metre.
    lost_band : float
        Fraction of the sampled band that is not used.
    residual_turns : float
        Phase left to float32 beside the 1-D tables.
    phase : str
        "tables", "fp64" or "twofloat".
    paraxial_error : float
        Phase error of Fresnel's approximation at the highest frequency that arrives, pi z lam^3
        f^4/4 in radians; 0 for a method that is exact.
    warning : str
        What is wrong with the sampling and what to do; empty where nothing is.
    """

    method: str
    why: str
    z: float
    route: str
    padded_shape: tuple[int, int]
    out_grid: Grid
    sampled: str
    phase_step: float
    fully_sampled_from: float
    fully_sampled_to: float
    band: tuple[float, float]
    nyquist: tuple[float, float]
    lost_band: float
    residual_turns: float
    phase: str
    paraxial_error: float
    warning: str

    def __str__(self) -> str:
        (my, mx), (dy, dx) = self.out_grid.shape, self.out_grid.pitch
        lines = [
            f"method            {self.method}: {self.why}",
            f"distance          {self.z:g} m",
            f"route             {self.route}",
            f"output            {my} x {mx} samples of {dy:.6g} x {dx:.6g} m",
            f"sampling          {self.sampled}: {self.phase_step:.3g} pi from sample to sample",
            f"sampled for z     {self.fully_sampled_from:.4g} to {self.fully_sampled_to:.4g} m",
            f"band              {self.band[0]:.5g}, {self.band[1]:.5g} cycles/m in y, x "
            f"(Nyquist {self.nyquist[0]:.5g}, {self.nyquist[1]:.5g}), "
            f"{100 * self.lost_band:.3g} % of it not used",
            f"phase             {self.phase}, residual {self.residual_turns:.3g} turns",
        ]
        if self.method.startswith("fresnel"):
            lines.append(f"paraxial error    up to {self.paraxial_error:.3g} rad")
        if self.warning:
            lines.append(f"warning           {self.warning}")
        return "\n".join(lines)


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


def report(made: Description, phase: str) -> Report:
    """The report of a description whose factor is formed by a phase route."""
    r = made.request
    nyquist = [r.way(a).nyquist if r.grid.shape[a] > 1 else 0.0 for a in (0, 1)]
    band = [max(abs(low), abs(high)) for low, high in made.band]
    kept = [
        max(0.0, high - low) / (2 * f) if f else 1.0
        for (low, high), f in zip(made.band, nyquist, strict=True)
    ]
    highest = max(r.way(axis).highest for axis in (0, 1))
    paraxial = math.pi * abs(r.z) * r.wavelength**3 * highest**4 / 4
    return Report(
        method=made.method,
        why=made.why,
        z=r.z,
        route=made.route,
        padded_shape=made.window,
        out_grid=made.out_grid,
        sampled=made.sampled,
        phase_step=made.phase_step,
        fully_sampled_from=made.valid[0],
        fully_sampled_to=made.valid[1],
        band=(band[0], band[1]),
        nyquist=(nyquist[0], nyquist[1]),
        lost_band=1 - kept[0] * kept[1],
        residual_turns=0.0 if made.factor is None else made.factor.residual_turns(),
        phase=phase,
        paraxial_error=paraxial if made.method.startswith("fresnel") else 0.0,
        warning=made.warning,
    )
