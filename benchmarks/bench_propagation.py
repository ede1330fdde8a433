"""Propagation beside the bare Fourier transforms of its padded size, in the same run.

    python benchmarks/bench_propagation.py [--device pocl] [--sizes 1024,2048,4096] [--repeats 9]

Every ratio is the median of the ratios of neighbouring runs: one of what is measured, one of what
it is measured by. Only the ratios mean something on another machine.
"""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from clplen import Device, Field, Grid, Propagator, SamplingWarning

PITCH, WAVELENGTH = 6.6e-6, 550e-9
# Distances in units of N dx^2/lam, the last at which the angular spectrum is sampled unpadded.
DISTANCES = (0.1, 0.5, 1, 2, 4, 8, 16, 32, 128, 1024)
EXACT = ("as", "blas", "cblas", "rs")
ENOUGH = 120.0  # dB; beyond, single precision hides every difference
SAME = 0.5  # dB


def ratio(run: Callable[[], Any], by: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Median of the ratios of neighbouring runs, and of the seconds of ``run``."""
    ratios, seconds = [], []
    for turn in range(repeats + 1):
        a, b = (_seconds(one) for one in ((run, by) if turn % 2 else (by, run)))
        mine, other = (a, b) if turn % 2 else (b, a)
        if turn:
            ratios.append(mine / other)
            seconds.append(mine)
    return statistics.median(ratios), statistics.median(seconds)


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def bare(
    shape: tuple[int, int], device: Device, directions: tuple[bool, ...]
) -> Callable[[], None]:
    """In-place transforms of one array of a shape, by the device's own route."""
    values = device.upload(np.random.default_rng(1).random(shape).astype(device.complex))

    def run() -> None:
        for forward in directions:
            device.fft.transform(values, device, axes=(-2, -1), forward=forward)
        device.finish()

    return run


def speckle(n: int, device: Device) -> Field:
    """A random field of 75 % of the band in the middle half of the window."""
    rng = np.random.default_rng(2)
    grid = Grid((n, n), PITCH)
    spectrum = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    low = np.abs(np.fft.fftfreq(n)) < 0.375
    u = np.fft.ifft2(spectrum * np.outer(low, low))
    bell = np.exp(-(((np.arange(n) - n // 2) / (n / 8)) ** 6))
    return Field.from_array(u * np.outer(bell, bell), grid, wavelength=WAVELENGTH, device=device)


def plan(field: Field, z: float, method: str, **options: Any) -> Propagator:
    """A plan that has made its transfer function."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        made = Propagator(
            field.grid,
            z,
            wavelength=field.wavelength,
            device=field.device,
            method=method,
            **options,
        )
    made(field)
    return made


def finished(made: Propagator, field: Field) -> Callable[[], None]:
    """One propagation, all of it done."""
    return lambda: (made(field), field.device.finish())[1]


def decibels(expected: np.ndarray[Any, Any], got: np.ndarray[Any, Any]) -> float:
    """-20 log10 of the relative error, nothing fitted."""
    return float(-20 * np.log10(np.linalg.norm(got - expected) / np.linalg.norm(expected)))


def cached_step(n: int, device: Device, repeats: int) -> None:
    """A step with its transfer function there, and the making of that."""
    field = speckle(n, device)
    made = plan(field, 0.1, "blas")
    there, forward = (
        bare((2 * n, 2 * n), device, (True, False)),
        bare((2 * n,) * 2, device, (True,)),
    )
    step, seconds = ratio(finished(made, field), there, repeats)
    factor = made.description.factor
    assert factor is not None
    build, making = ratio(
        lambda: (factor.on_device(device, made.phase), device.finish()), forward, repeats
    )
    click.echo(f"| {n} | {step:.2f} | {1e3 * seconds:.0f} | {build:.2f} | {1e3 * making:.0f} |")


def automatic(n: int, device: Device, repeats: int) -> None:
    """auto beside the cheapest method that is as accurate, at distances near and far."""
    field = speckle(n, device)
    double = Device.open(device.place, precision="double")
    exact = Field.from_array(
        field.to_numpy(), field.grid, wavelength=field.wavelength, device=double
    )
    for distance in DISTANCES:
        z = distance * n * PITCH**2 / WAVELENGTH
        truth = plan(exact, z, "cblas", guard=8)(exact).to_numpy()
        best = plan(field, z, "auto")
        wanted = min(decibels(truth, plan(exact, z, "auto")(exact).to_numpy()), ENOUGH) - SAME
        found = []
        for method in EXACT:
            if decibels(truth, plan(exact, z, method)(exact).to_numpy()) >= wanted:
                other = plan(field, z, method)
                against, _ = ratio(finished(best, field), finished(other, field), repeats)
                found.append((against, method))
        against, method = max(found)
        click.echo(
            f"| {distance:g} | {best.method}, {best.report.route} | {method} | {against:.2f} |"
        )


@click.command(help=__doc__)
@click.option("--device", "selector", default=None, help="As for Device.open.")
@click.option("--sizes", default="1024,2048,4096", show_default=True, help="Samples a side.")
@click.option("--repeats", default=9, show_default=True)
@click.option("--auto-size", default=1024, show_default=True, help="Samples a side for auto.")
def main(selector: str | None, sizes: str, repeats: int, auto_size: int) -> None:
    device = Device.open(selector)
    click.echo(f"{device!r}, {device.fft.threads} threads\n")
    click.echo("| N, padded to 2N | blas, cached / two bare FFTs | ms | H / one FFT | ms |")
    click.echo("|---|---|---|---|---|")
    for size in sizes.split(","):
        cached_step(int(size), device, repeats)
    click.echo(
        f"\n| z / (N dx^2/lam), N = {auto_size} | auto takes | cheapest as accurate | ratio |"
    )
    click.echo("|---|---|---|---|")
    automatic(auto_size, device, repeats)


if __name__ == "__main__":
    main()
