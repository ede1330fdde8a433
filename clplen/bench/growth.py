"""How the time grows with views, pixels, planes, samples and batches: exponents of power laws."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.bench.measure import Case, Times, finished, in_turn
from clplen.bench.report import Goal, Report, Row
from clplen.bench.sizes import numbers
from clplen.lightfield.focus_and_depth import focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.wave.field import Field, Grid
from clplen.wave.propagator import Propagator

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "time against rays, planes, samples and batches, each doubled four times"
SIZES = ("1x5",)
QUICK = "1x2"
FORM = "SCALExPOINTS"
PITCH, WAVELENGTH, DISTANCE = 6.6e-6, 550e-9, 0.05
_TOLERANCE = 0.1  # of an exponent
_RANGE = 1.5  # disparities from -1.5 to 1.5


@dataclass(frozen=True)
class Series:
    """One thing that grows: how much work each run does, and the run."""

    name: str
    work: Callable[[int], float]
    make: Callable[[int], Callable[[], Any]]
    amounts: tuple[int, ...]


def smaller(size: str) -> str:
    """One doubling less."""
    scale, points = numbers(size, (2,), FORM)
    return f"{scale}x{points - 1}" if points > 2 else ""


def needs(size: str) -> int:
    """The largest light field and the largest padded field with their copies."""
    scale, points = numbers(size, (2,), FORM)
    return (scale * 2**points * 512) ** 2 * 32


def run(device: Device, size: str, repeats: int) -> Report:
    """Exponents of each series; those of Fourier transforms after a division by log2 N."""
    scale, points = numbers(size, (2,), FORM)
    rows: list[Row] = []
    goals = []
    for series in _series(device, scale, points):
        cases = [
            Case(f"{series.name} = {n}", finished(series.make(n), device), series.work(n), "units")
            for n in series.amounts
        ]
        times = in_turn(cases, repeats)
        for n, t in zip(series.amounts, times, strict=True):
            name = f"{series.name} {n}"
            rows.append(Row(name, t.median, t.spread, t.rate, "units", t.rate / times[0].rate))
        goals += _goals(series.name, times)
    return Report("growth", size, "work a second over that of the smallest", tuple(rows), (*goals,))


def exponent(times: Sequence[Times]) -> float:
    """Slope of log time against log work, by least squares."""
    work = np.log([t.case.work for t in times])
    seconds = np.log([t.median for t in times])
    return float(np.polyfit(work, seconds, 1)[0])


def _goals(name: str, times: Sequence[Times]) -> list[Goal]:
    found = exponent(times)
    away = f"{name}: exponent {found:.3f}, away from 1"
    return [Goal(away, abs(found - 1), _TOLERANCE, "at most")]


def _series(device: Device, scale: int, points: int) -> list[Series]:
    def doubled(first: int) -> tuple[int, ...]:
        return tuple(first * scale * 2**k for k in range(points))

    return [
        Series("rows", float, lambda n: _stack(device, (9, 9, n, 640), 32), doubled(128)),
        Series("views", float, lambda n: _stack(device, (n // 8, 8, 256, 640), 32), doubled(32)),
        Series("planes", float, lambda n: _stack(device, (9, 9, 256, 256), n), doubled(32)),
        Series("samples a side", _transforms, lambda n: _step(device, n, 1), doubled(512)),
        Series("fields of a batch", float, lambda n: _step(device, 1024, n), doubled(1)),
    ]


def _transforms(n: int) -> float:
    """Work of a propagation of n x n samples, padded to twice as many."""
    return n * n * math.log2(2 * n)


def _stack(device: Device, shape: tuple[int, ...], planes: int) -> Callable[[], Any]:
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values, device=device)
    disparities = np.linspace(-_RANGE, _RANGE, planes)
    return lambda: focal_stack(lf, disparities=disparities)


def _step(device: Device, n: int, batch: int) -> Callable[[], Any]:
    values = np.random.default_rng(1).random((batch, n, n), dtype=np.float32)
    grid = Grid((n, n), PITCH)
    field = Field.from_array(values, grid, wavelength=WAVELENGTH, device=device)
    made = Propagator(grid, DISTANCE, wavelength=WAVELENGTH, method="blas", device=device)
    return lambda: made(field)
