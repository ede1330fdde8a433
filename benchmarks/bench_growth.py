"""How the time grows with views, pixels, planes, samples and batches: exponents of power laws.

python benchmarks/bench_growth.py [--device pocl] [--size 1x5] [--figure docs/images/growth.png]
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from script import measure

from clplen import Device, Field, Grid, LightField, Propagator, focal_stack
from clplen.bench import Benchmark, Case, Goal, Report, Row, Times, finished, in_turn, numbers

FORM = "SCALExPOINTS"
PITCH, WAVELENGTH, DISTANCE = 6.6e-6, 550e-9, 0.05
_TOLERANCE = 0.1  # of an exponent
_RANGE = 1.5  # disparities from -1.5 to 1.5


NAMES = {
    "rows": "rows of the views (9 x 9 x n x 640, 32 planes)",
    "views": "views (n x 256 x 640, 32 planes)",
    "planes": "planes (9 x 9 x 512 x 512)",
    "samples a side": r"$N^2 \log_2 2N$, a propagation padded to 2N",
    "fields of a batch": "fields of 1024 x 1024 in a batch, padded",
}


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


def measure_growth(device: Device, size: str, repeats: int) -> Report:
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


BENCHMARK = Benchmark(
    "growth",
    "time against rays, planes, samples and batches, each doubled four times",
    sizes=("1x5",),
    quick="1x2",
    needs=needs,
    run=measure_growth,
    smaller=smaller,
)


@click.command(help=__doc__)
@click.option("--device", "selector", help="As Device.open takes it.")
@click.option("--size", default=BENCHMARK.sizes[0], show_default=True, help=FORM)
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1))
@click.option("--figure", type=click.Path(dir_okay=False, path_type=Path))
def main(selector: str | None, size: str, repeats: int, figure: Path | None) -> None:
    device = Device.open(selector)
    for report in measure(BENCHMARK, device, (size,), repeats):
        if figure is not None:
            draw(report, device, figure)


def draw(report: Report, device: Device, figure: Path) -> None:
    """Time against work of every series, with its exponent."""
    import matplotlib.pyplot as plt

    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row in report.rows:
        name = row.name.rsplit(" ", 1)[0]
        series[name].append((row.rate * row.seconds, row.seconds))
    _, axes = plt.subplots(figsize=(7, 4.6), layout="constrained")
    for name, pairs in series.items():
        work, seconds = np.array(pairs).T
        slope = np.polyfit(np.log(work), np.log(seconds), 1)[0]
        axes.loglog(work / work[0], 1e3 * seconds, "o-", label=f"{NAMES[name]}: {slope:.2f}")
    low, high = axes.get_ylim()
    for start in 10.0 ** np.arange(np.floor(np.log10(low)), np.log10(high)):
        axes.loglog([1, 256], [start, 256 * start], color="0.85", lw=0.8, zorder=0)
    axes.set_ylim(low, high)
    axes.set_xlabel("work, of the smallest")
    axes.set_ylabel("time (ms)")
    axes.legend(title="exponent of the time in the work", fontsize=8, title_fontsize=8)
    axes.set_title(f"{device.name}, {device.driver}, {device.fft.threads} cores", fontsize=9)
    plt.savefig(figure, dpi=110)


if __name__ == "__main__":
    main()
