"""Propagation beside bare Fourier transforms; multiplied fields beside a multiplication."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, Times, finished, halved, in_turn, numbers
from clplen.bench.report import Benchmark, Goal, Report, time_rows
from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, multiplied
from clplen.wave.elements.lens import thin_lens
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.free_space import propagate
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.propagation.transfer_function import Transfer

PITCH, WAVELENGTH, DISTANCE = 6.6e-6, 550e-9, 0.1
DISTANCES = tuple(0.05 + 0.01 * n for n in range(8))
SEVERAL = 2048  # samples a side up to which several distances are timed
_CACHED = {"ducc0": 0.8, "scipy": 0.9}  # over two bare FFTs, by library
_MADE = {"ducc0": 1.0, "scipy": 1.1}
_MEMORY = 1.2  # over input, result, the rows' spectra and the quadrant of H
_LEAST = 1024  # samples a side from which the goals hold: below, starting a kernel counts
_TABLES = {"Intel": 1.6, "": 3.5}  # over a multiplication, by the beginning of the platform's name
_LENS, _APPLIED = 2.0, 1.5
FOCAL = 5.0


def _propagation_needs(size: str) -> int:
    """Twelve arrays of N x N complex samples, twenty where several distances are timed."""
    (n,) = numbers(size, (1,), "N")
    return (24 if n <= SEVERAL else 12) * 8 * n * n


def measure_propagation(device: Device, size: str, repeats: int) -> Report:
    """A step with its transfer function there, one that makes it, and several distances."""
    (n,) = numbers(size, (1,), "N")
    field = speckle(n, device)
    plan = _plan(field, DISTANCE)
    factor = plan.description.factor
    assert factor is not None
    plan(field)
    cases = [
        ceilings.bare_fft((2 * n, 2 * n), device, count=2),
        Case("step", finished(lambda: plan(field), device)),
        Case(
            "step that makes its transfer function",
            finished(lambda: _plan(field, DISTANCE)(field), device),
        ),
        Case(
            "transfer function",
            finished(lambda: factor.on_device(device, plan.phase), device),
        ),
        ceilings.copy(device, 4 * n * n * device.complex.itemsize, "copy of 2N x 2N samples"),
    ]
    if n <= SEVERAL:
        cases += [_several(field)]
    times = in_turn(cases, repeats)
    return Report(
        "propagation",
        size,
        "time over two bare FFTs",
        time_rows(times, times[0]),
        tuple(_propagation_goals(device, n, times)),
    )


def speckle(n: int, device: Device) -> Field:
    """A random field of 75 % of the band in the middle half of the window."""
    rng = np.random.default_rng(2)
    spectrum = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    low = np.abs(np.fft.fftfreq(n)) < 0.375
    u = np.fft.ifft2(spectrum * np.outer(low, low))
    bell = np.exp(-(((np.arange(n) - n // 2) / (n / 8)) ** 6))
    grid = Grid((n, n), PITCH)
    return Field.from_array(u * np.outer(bell, bell), grid, wavelength=WAVELENGTH, device=device)


def _plan(field: Field, z: float) -> Propagator:
    return Propagator(
        field.grid, z, wavelength=field.wavelength, method="blas", device=field.device
    )


def _several(field: Field) -> Case:
    """Distances from one forward transform, their plans there."""
    run = finished(lambda: propagate(field, DISTANCES, method="blas"), field.device)
    return Case(f"{len(DISTANCES)} distances at once", run, float(len(DISTANCES)), "distances")


def _propagation_goals(device: Device, n: int, times: list[Times]) -> list[Goal]:
    bare, step, made, *_ = times
    fft = device.fft.name
    goals = []
    if fft in _CACHED and n >= 1024:  # below, a step is mostly the work of starting it
        goals = [
            Goal("step over two bare FFTs", step.over(bare), _CACHED[fft], "at most"),
            Goal("step that makes H over them", made.over(bare), _MADE[fft], "at most"),
        ]
    if times[-1].case.unit == "distances":
        each = times[-1].over(step) / len(DISTANCES)
        goals.append(Goal("one of 8 distances over a step", each, 1.0, "at most"))
    used = peak_memory(n, device)
    if used is not None:
        goals.append(Goal("memory over input, result, rows, H", used, _MEMORY, "at most"))
    return goals


def peak_memory(n: int, device: Device) -> float | None:
    """Resident memory that a step adds at most, over five times N x N samples.

    Those are the input, the result, the spectra of the rows (two) and the quadrant of H.

    In a fresh process; None where Linux does not tell, or the arrays are not in its memory. Below
    1024 samples a side what runtimes take for themselves would count.
    """
    if not device.is_cpu or device.fft.name == "vkfft" or n < 1024:
        return None
    if not Path("/proc/self/clear_refs").exists():
        return None
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        added = pool.apply(_added, (n, device.place))
    return added / (5 * n * n * device.complex.itemsize)


def _added(n: int, place: str) -> int:
    """Bytes between a process that has done a small step and the peak of one of N x N samples."""
    from clplen.compute.device import Device

    device = Device.open(place)
    small = speckle(64, device)
    _plan(small, DISTANCE)(small)
    device.finish()
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    before = _resident("VmRSS")
    data = device.zeros((n, n), device.complex)
    field = Field(data, Grid((n, n), PITCH), WAVELENGTH, device)
    _plan(field, DISTANCE)(field)
    device.finish()
    return _resident("VmHWM") - before


def _resident(name: str) -> int:
    """A figure of /proc/self/status in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return 1024 * int(line.split()[1])
    raise LookupError(f"/proc/self/status has no line {name}.")


def _fields_needs(size: str) -> int:
    """Eight arrays of complex samples."""
    (n,) = numbers(size, (1,), "N")
    return 8 * 8 * n * n


def measure_fields(device: Device, size: str, repeats: int) -> Report:
    """Each kernel over whole arrays that are there; results of a lens are new arrays."""
    (n,) = numbers(size, (1,), "N")
    rng = np.random.default_rng(3)
    u = rng.random((n, n), dtype=np.float32) + np.complex64(1j)
    field = Field.from_array(u, Grid((n, n), PITCH), wavelength=WAVELENGTH, device=device)
    work, phases = (device.upload(np.exp(1j * u.real).astype(device.complex)) for _ in range(2))
    whole = Spectrum(phases, (n, n))
    part = np.exp(1j * u.real[: n // 2 + 1, : n // 2 + 1]).astype(device.complex)
    quadrant = Spectrum(device.upload(part), (n, n))
    H, diameter = _transfer(n), n * PITCH / 2

    def case(name: str, do: Callable[[], object]) -> Case:
        return Case(name, finished(do, device), float(n * n), "samples")

    cases = [
        case("complex multiplication", lambda: multiplied(work, whole, device, copy=False)),
        case("transfer function, whole", lambda: H.on_device(device, "tables")),
        case("quadrant applied", lambda: multiplied(work, quadrant, device, copy=False)),
        case("thin lens", lambda: thin_lens(field, FOCAL)),
        case("thin lens with its disc", lambda: thin_lens(field, FOCAL, diameter=diameter)),
        case("stigmatic lens", lambda: thin_lens(field, FOCAL, form="stigmatic")),
        ceilings.copy(device, n * n * device.complex.itemsize),
    ]
    times = in_turn(cases, repeats)
    goals = tuple(_fields_goals(device, times)) if n >= _LEAST else ()
    rows = time_rows(times, times[0])
    return Report("fields", size, "time over a complex multiplication", rows, goals)


def _transfer(n: int) -> Transfer:
    """H at n x n frequencies of an FFT of as many samples, none of them mirrored."""
    f = np.fft.fftfreq(n, PITCH)
    return Transfer((n, n), (f, f), (np.ones(n), np.ones(n)), DISTANCE, WAVELENGTH)


def _fields_goals(device: Device, times: list[Times]) -> list[Goal]:
    _, made, quadrant, lens, *_ = (t.over(times[0]) for t in times)
    limit = next(m for name, m in _TABLES.items() if device.platform.startswith(name))
    return [
        Goal("transfer function, whole", made, limit, "at most"),
        Goal("quadrant applied", quadrant, _APPLIED, "at most"),
        Goal("thin lens", lens, _LENS, "at most"),
    ]


BENCHMARKS = (
    Benchmark(
        "propagation",
        "a step of N x N samples padded to 2N, beside two bare FFTs of 2N x 2N",
        sizes=("1024", "2048", "4096"),
        quick="128",
        needs=_propagation_needs,
        run=measure_propagation,
        smaller=lambda size: halved(size, (0,), 16),
    ),
    Benchmark(
        "fields",
        "lenses and transfer functions of N x N samples, beside a complex multiplication",
        sizes=("4096",),
        quick="128",
        needs=_fields_needs,
        run=measure_fields,
        smaller=lambda size: halved(size, (0,), 16),
    ),
)
