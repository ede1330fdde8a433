"""One description for every propagation: maps along the axes, a factor in between, maps back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from clplen.compute.lines import Separable
from clplen.wave.field.field import Grid
from clplen.wave.propagation.request import Request
from clplen.wave.propagation.transfer_function import Factor

Kind = Literal["nothing", "fft", "chirp-z", "separable"]


@dataclass(frozen=True, eq=False)
class Description:
    """A propagation before it is on a device.

    Attributes
    ----------
    request : Request
    method, why : str
        The method taken and the inequality that decided.
    out_grid : Grid
    into, back : Separable
        Before and after the factor; ``back`` is empty where there is none.
    factor : Factor or None
    kind : {"nothing", "fft", "chirp-z", "separable"}
        How the sums are done.
    route : str
        The same in words.
    sampled : str
        What has to be sampled: the transfer function, a kernel, a chirp.
    phase_step : float
        Its largest phase step a sample, divided by pi: sampled up to 1.
    valid : tuple of float
        Smallest and largest abs(z) in metres at which it is sampled.
    band : tuple of tuple of float
        ((fy low, fy high), (fx low, fx high)) that is used, in cycles a metre.
    warning : str
        What is wrong with the sampling and what to do; empty where nothing is.
    """

    request: Request
    method: str
    why: str
    out_grid: Grid
    into: Separable
    back: Separable
    factor: Factor | None
    kind: Kind
    route: str
    sampled: str
    phase_step: float
    valid: tuple[float, float]
    band: tuple[tuple[float, float], tuple[float, float]]
    warning: str = ""

    @property
    def window(self) -> tuple[int, int]:
        """Samples of the computation window."""
        shape = self.request.grid.shape
        there = self.into.widest(shape)
        back = self.back.widest(self.into.shape_after(shape))
        return (max(there[0], back[0]), max(there[1], back[1]))

    @property
    def work_samples(self) -> int:
        """Samples that one field needs beside input and output."""
        (ny, _), (my, mx) = self.request.grid.shape, self.into.shape_after(self.request.grid.shape)
        rows = max(ny, self.out_grid.shape[0]) if self.factor is not None else ny
        return max(rows, my if self.factor is None else 0) * max(mx, self.out_grid.shape[1])


def whole_bands(request: Request) -> tuple[tuple[float, float], tuple[float, float]]:
    """The band of everything that is sampled, for `Description.band`."""
    y, x = (
        (0.0, 0.0) if n == 1 else (-1 / (2 * d), 1 / (2 * d))
        for n, d in zip(request.grid.shape, request.grid.pitch, strict=True)
    )
    return (y, x)


def any_distance() -> tuple[float, float]:
    """The interval of a method that is sampled at every distance."""
    return (0.0, math.inf)
