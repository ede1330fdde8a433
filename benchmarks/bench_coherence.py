"""Streamed snapshots beside the bare Fourier transforms that they need, in the same run.

    python benchmarks/bench_coherence.py [--device pocl] [--size 1024] [--snapshots 300] [--pad 2]

A random phase mask lights an object; propagation, lens, propagation; mean and variance on the
device. The bare transforms are done in blocks between blocks of snapshots: the ratio is the median
over the blocks. Peak memory is that of a fresh process for few and for many snapshots.
"""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import time

import click
import numpy as np

from clplen import Coherence, Device, Field, Grid, OpticalSystem
from clplen.wave import ExtendedSource, IncoherentLight, Lens, Pupil, RandomPhaseMask, Space

PITCH, WAVELENGTH = 6.6e-6, 550e-9
BLOCK = 10  # snapshots between two looks at the bare transforms


def system_of(pad: float) -> OpticalSystem:
    """Propagation, lens, propagation: 2f to 2f."""
    space = Space(0.24, method="blas", pad=pad)
    return OpticalSystem([space, Lens(0.12, diameter=3.6e-3), space])


def thing_of(size: int, device: Device) -> Field:
    """An object of grey bars."""
    t = 0.2 + 0.8 * (np.arange(size) // 16 % 2)
    grid = Grid((size, size), PITCH)
    return Field.from_array(np.multiply.outer(t, t), grid, wavelength=WAVELENGTH, device=device)


def bare(size: int, pad: float, device: Device) -> list[tuple[int, Field]]:
    """Arrays of the transforms of one snapshot: two of the mask, four of the propagations."""
    shapes = {size: 2, round(pad * size): 4} if pad > 1 else {size: 6}
    made = []
    for n, count in shapes.items():
        values = np.random.default_rng(n).random((n, n)).astype(device.complex)
        made.append((count, device.upload(values)))
    return made


def seconds_of_bare(arrays: list[tuple[int, Field]], device: Device, times: int) -> float:
    start = time.perf_counter()
    for _ in range(times):
        for count, values in arrays:
            for n in range(count):
                device.fft.transform(values, device, axes=(-2, -1), forward=n % 2 == 0)
    device.finish()
    return time.perf_counter() - start


def ratios(size: int, pad: float, snapshots: int, device: Device) -> tuple[float, float, float]:
    """Median ratio, and seconds a snapshot and a snapshot's bare transforms."""
    mask = RandomPhaseMask(size * PITCH / (size // 8))
    light, system, thing = Coherence(mask), system_of(pad), thing_of(size, device)
    arrays = bare(size, pad, device)
    light.average(system, thing, snapshots=2)
    found: list[tuple[float, float]] = []
    last = [time.perf_counter()]

    def look(done: int, _: int) -> None:
        if done % BLOCK == 0:
            device.finish()
            mine = time.perf_counter() - last[0]
            found.append((mine, seconds_of_bare(arrays, device, BLOCK)))
            last[0] = time.perf_counter()

    last[0] = time.perf_counter()
    light.average(system, thing, snapshots=snapshots, progress=look)
    ratio = statistics.median(mine / other for mine, other in found)
    mine, other = (statistics.median(pair) / BLOCK for pair in zip(*found, strict=True))
    return ratio, mine, other


def _peak(size: int, pad: float, snapshots: int, place: str) -> int:
    device = Device.open(place)
    mask = RandomPhaseMask(size * PITCH / (size // 8))
    Coherence(mask).average(system_of(pad), thing_of(size, device), snapshots=snapshots)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def peak_memory(size: int, pad: float, snapshots: int, device: Device) -> int:
    """Peak resident memory in kB of a fresh process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_peak, (size, pad, snapshots, device.place))


def sources(size: int, device: Device) -> dict[str, float]:
    """Seconds for one snapshot of each sort of light."""
    window, cell = size * PITCH, size * PITCH / (size // 8)
    grid = Grid((size, size), PITCH)
    found = {}
    for name, model in {
        "square cells": RandomPhaseMask(cell),
        "square cells, phase alone": RandomPhaseMask(cell, kind="phase"),
        "Gaussian cells": RandomPhaseMask(cell, kernel="gaussian"),
        "extended source, 400 points": ExtendedSource(0.1 * window, 0.1),
        "incoherent": IncoherentLight(),
    }.items():
        times = []
        for index in range(8):
            start = time.perf_counter()
            model.field(grid, wavelength=WAVELENGTH, device=device, seed=0, index=index)
            device.finish()
            times.append(time.perf_counter() - start)
        found[name] = statistics.median(times[1:])
    return found


def exact_sums(device: Device) -> dict[str, tuple[float, int]]:
    """Seconds and terms of sums over the source, N = 256, for several masks."""
    size = 256
    pupil = OpticalSystem([Pupil.of_cutoff(13636.0, WAVELENGTH)])
    grid = Grid((size, size), 10e-6)
    t = thing_of(size, device).to_numpy()
    thing = Field.from_array(t, grid, wavelength=WAVELENGTH, device=device)
    found = {}
    for cells in (4, 8, 32, 128):
        light = Coherence(RandomPhaseMask(size * 10e-6 / cells))
        light.average(pupil, thing, method="abbe")
        start = time.perf_counter()
        result = light.average(pupil, thing, method="abbe")
        device.finish()
        found[f"{cells} x {cells} cells"] = (time.perf_counter() - start, result.snapshots)
    return found


@click.command()
@click.option("--device", "selector", help="as for Device.open")
@click.option("--size", default=1024, show_default=True)
@click.option("--snapshots", default=300, show_default=True)
@click.option("--pad", default=2.0, show_default=True)
def main(selector: str | None, size: int, snapshots: int, pad: float) -> None:
    """Time a stream of snapshots, its memory, sources of light and exact sums."""
    device = Device.open(selector)
    print(f"{device!r}")
    for name, seconds in sources(size, device).items():
        print(f"one snapshot, N = {size}, {name}: {seconds * 1e3:.1f} ms")
    ratio, mine, other = ratios(size, pad, snapshots, device)
    print(
        f"{snapshots} snapshots, N = {size}, pad {pad:g}: {mine * 1e3:.1f} ms each, "
        f"bare transforms {other * 1e3:.1f} ms, ratio {ratio:.2f}"
    )
    few, many = (peak_memory(size, pad, n, device) for n in (3, snapshots))
    print(f"peak memory: 3 snapshots {few / 1024:.0f} MiB, {snapshots} {many / 1024:.0f} MiB")
    for name, (seconds, terms) in exact_sums(device).items():
        print(f"sum over the source, N = 256, {name}: {seconds:.2f} s, {terms} terms")


if __name__ == "__main__":
    main()
