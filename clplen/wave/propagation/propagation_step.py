"""Propagation as a step of a graph, with gradients by the field and by the distance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.wave.field.adjoints import inner_product
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.free_space import plan

Pullback = Callable[[cla.Array], tuple[cla.Array, float]]


@dataclass(frozen=True)
class PropagationStep:
    """Free space of any distance between two grids, for engines of gradients."""

    grid: Grid
    wavelength: float  # in metres
    method: str
    pad: float
    out_grid: Grid | None  # as in `propagate`
    device: Device

    def plan(self, z: float) -> Any:
        """The `Propagator` of a distance."""
        return plan(
            self.grid, z, wavelength=self.wavelength, method=self.method, pad=self.pad,
            device=self.device, out_grid=self.out_grid,
        )  # fmt: skip

    def __call__(self, data: cla.Array, z: Any) -> tuple[cla.Array, Pullback]:
        """Samples (..., ny, nx) over a distance z, and the gradients by both."""
        made = self.plan(float(z))

        def pullback(g: cla.Array) -> tuple[cla.Array, float]:
            front = Field(data, self.grid, self.wavelength, self.device)
            behind = Field(g, made.out_grid, self.wavelength, self.device)
            slope = inner_product(behind, made.distance_slope(front)).real
            return made.adjoint_data(g), slope

        return made.forward_data(data), pullback
