"""The method that ``auto`` takes, beside the cheapest one that is as accurate.

python benchmarks/bench_automatic.py [--device pocl] [--size 1024] [--quick]
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from script import command

from clplen import Device, Field, Propagator, SamplingWarning
from clplen.bench import (
    Benchmark,
    Case,
    Goal,
    Report,
    Row,
    finished,
    halved,
    in_turn,
    numbers,
    speckle,
    time_rows,
)

Array = np.ndarray[Any, Any]
PITCH, WAVELENGTH = 6.6e-6, 550e-9  # of `speckle`

# Distances in units of N dx^2/lam, the last at which the angular spectrum is sampled unpadded.
DISTANCES = (0.1, 0.5, 1, 2, 4, 8, 16, 32, 128, 1024)
EXACT = ("as", "blas", "cblas", "rs")
ENOUGH = 120.0  # dB; beyond, single precision hides every difference
SAME = 0.5  # dB
_SLOWER = 1.2  # times as long as the cheapest at most; machines that are busy differ by a tenth


def smaller(size: str) -> str:
    """Half the samples a side."""
    return halved(size, (0,), 32)


def needs(size: str) -> int:
    """Plans of five methods in single and double precision, each some windows of 2N x 2N."""
    (n,) = numbers(size, (1,), "N")
    return 40 * 16 * 4 * n * n


def measure_automatic(device: Device, size: str, repeats: int) -> Report:
    """At each distance auto and every method that is as accurate, which double precision tells."""
    (n,) = numbers(size, (1,), "N")
    field = speckle(n, device)
    rows: list[Row] = []
    worst = 0.0
    for distance in DISTANCES:
        z = distance * n * PITCH**2 / WAVELENGTH
        auto = _plan(field, z, "auto")
        fit = _as_accurate(field, z)
        cases = [
            _step(f"{method} at {distance:g}", plan, field)
            for method, plan in {"auto": auto, **fit}.items()
        ]
        times = in_turn(cases, repeats)
        best = min(times[1:] or times, key=lambda t: t.median)
        (row,) = time_rows(times[:1], best)
        rows.append(replace(row, name=f"{distance:g}: {auto.method}, {auto.report.route}"))
        worst = max(worst, times[0].over(best))
    goals = (Goal("auto over the cheapest", worst, _SLOWER, "at most"),) if n >= 512 else ()
    words = "time over the cheapest as accurate, distances in N dx^2/lam"
    return Report("automatic", size, words, tuple(rows), goals)


def _step(name: str, plan: Propagator, field: Field) -> Case:
    return Case(name, finished(lambda: plan(field), field.device))


def _as_accurate(field: Field, z: float) -> dict[str, Propagator]:
    """Plans of the methods whose result, in double precision, is as near the truth as auto's."""
    double = Device.open(field.device.place, precision="double")
    exact = Field.from_array(field.to_numpy(), field.grid, wavelength=WAVELENGTH, device=double)
    truth = _plan(exact, z, "cblas", guard=8)(exact).to_numpy()

    def error(method: str) -> float:
        return _decibels(truth, _plan(exact, z, method)(exact).to_numpy())

    wanted = min(error("auto"), ENOUGH) - SAME
    return {method: _plan(field, z, method) for method in EXACT if error(method) >= wanted}


def _plan(field: Field, z: float, method: str, **options: Any) -> Propagator:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        return Propagator(
            field.grid, z, wavelength=WAVELENGTH, method=method, device=field.device, **options
        )


def _decibels(expected: Array, got: Array) -> float:
    """-20 log10 of the relative error, nothing fitted."""
    error = float(np.linalg.norm(got - expected) / np.linalg.norm(expected))
    return -20 * math.log10(error) if error else math.inf


BENCHMARK = Benchmark(
    "automatic",
    "auto beside the cheapest method that is as accurate, at distances near and far",
    sizes=("1024",),
    quick="64",
    needs=needs,
    run=measure_automatic,
    smaller=smaller,
)

if __name__ == "__main__":
    command(BENCHMARK, __doc__)()
