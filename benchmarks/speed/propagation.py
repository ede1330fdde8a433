"""Propagation by `auto`, and a zoomed focus, beside the alternatives.

    python -m benchmarks speed/propagation [--device pocl] [--size 1024] [--quick]

The method that `auto` takes is timed beside the cheapest one that is as accurate, at distances near
and far; the field in the focus of a lens beside a plain matrix Fourier transform, which is two
matrix products in NumPy.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.script import command
from clplen import Device, Field, Grid, Propagator, SamplingWarning
from clplen.bench import (
    Benchmark,
    Case,
    Report,
    Row,
    finished,
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
ZOOM_PITCH, FOCAL_LENGTH, ZOOM_WAVELENGTH = 5e-6, 0.2, 633e-9
_SPOT = 0.4  # pitch of the zoomed output over lam f/D


def needs(size: str) -> int:
    """Plans of five methods in single and double precision, each some windows of 2N x 2N."""
    (n,) = numbers(size, (1,), "N")
    return 40 * 16 * 4 * n * n


def measure_automatic(device: Device, size: str, repeats: int) -> Report:
    """At each distance auto and every method that is as accurate, which double precision tells."""
    (n,) = numbers(size, (1,), "N")
    field = speckle(n, device)
    rows: list[Row] = []
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
    words = "time over the cheapest as accurate, distances in N dx^2/lam; over the products"
    for start, end in ((n, n // 2), (2 * n, n // 4)):
        rows += zoom_rows(device, start, end, repeats)
    return Report("automatic", size, words, tuple(rows))


def zoom_rows(device: Device, n: int, m: int, repeats: int) -> tuple[Row, ...]:
    """The field of a lens in its focus: exact by auto, paraxial by fresnel-1fft, by products."""
    grid = Grid((n, n), ZOOM_PITCH)
    out = Grid((m, m), _SPOT * ZOOM_WAVELENGTH * FOCAL_LENGTH / (n * ZOOM_PITCH))
    r2 = grid.y[:, None] ** 2 + grid.x**2
    u = np.exp(-r2 / (n * ZOOM_PITCH / 4) ** 2).astype(np.complex64)
    lens = np.exp(-1j * np.pi * r2 / (ZOOM_WAVELENGTH * FOCAL_LENGTH)).astype(np.complex64)
    turns = np.multiply.outer(out.x, grid.x) / (ZOOM_WAVELENGTH * FOCAL_LENGTH)
    there = np.exp(-2j * np.pi * turns).astype(np.complex64)
    back = np.ascontiguousarray(there.T)

    def case(name: str, values: np.ndarray, **options: object) -> Case:
        field = Field.from_array(values, grid, wavelength=ZOOM_WAVELENGTH, device=device)
        made = Propagator(
            grid, FOCAL_LENGTH, wavelength=ZOOM_WAVELENGTH, device=device, out_grid=out, **options
        )
        return Case(f"{name}: {made.description.route}", finished(lambda: made(field), device))

    cases = [
        Case("two matrix products (NumPy)", lambda: there @ u @ back),
        case("auto, exact", u * lens),
        case("fresnel-1fft, paraxial", u, method="fresnel-1fft", lens=FOCAL_LENGTH),
    ]
    times = in_turn(cases, repeats)
    rows = time_rows(times, times[0])
    return tuple(replace(row, name=f"zoom {n} to {m}: {row.name}") for row in rows)


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
)

main = command(BENCHMARK, __doc__)
