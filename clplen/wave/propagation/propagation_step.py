"""Propagation as a differentiable step, with gradients by the field and by the distance."""

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
    """Free space of any distance between two grids, for automatic differentiation."""

    grid: Grid
    wavelength: float  # in metres
    method: str
    pad: float
    out_grid: Grid | None  # as in `propagate`
    device: Device

    def plan(self, z: float) -> Any:
        """Return the `Propagator` of a distance."""
        return plan(
            self.grid, z, wavelength=self.wavelength, method=self.method, pad=self.pad,
            device=self.device, out_grid=self.out_grid,
        )  # fmt: skip

    def __call__(self, data: cla.Array, z: Any) -> tuple[cla.Array, Pullback]:
        """Propagate samples (..., ny, nx) by a distance z; return the pullback of both."""
        propagator = self.plan(float(z))

        def pullback(g: cla.Array) -> tuple[cla.Array, float]:
            front = Field(data, self.grid, self.wavelength, self.device)
            behind = Field(g, propagator.out_grid, self.wavelength, self.device)
            slope = inner_product(behind, propagator.distance_slope(front)).real
            return propagator.adjoint_data(g), slope

        return propagator.forward_data(data), pullback
