"""Benchmarks of propagation, fields and gradients, relative to transforms and products."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, finished, in_turn, numbers
from clplen.bench.report import Benchmark, Report, time_rows
from clplen.compute.device import Device
from clplen.compute.fft.blocks import Spectrum, multiplied
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.elements.lens import thin_lens
from clplen.wave.field.adjoints import intensity_gradient
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.free_space import propagate
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.propagation.transfer_function import Transfer
from clplen.wave.systems.components import Lens
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.space import Space

PITCH, WAVELENGTH, DISTANCE = 6.6e-6, 550e-9, 0.1
DISTANCES = tuple(0.05 + 0.01 * n for n in range(8))
SEVERAL = 2048  # largest samples a side for timing several distances
_SNAPSHOTS = 4
_CELLS = 16  # cells of a mask along a side of the window
FOCAL = 5.0


def _propagation_needs(size: str) -> int:
    """Return the memory in bytes: 12 complex arrays of N x N, 24 with several distances."""
    (n,) = numbers(size, (1,), "N")
    return (24 if n <= SEVERAL else 12) * 8 * n * n


def measure_propagation(device: Device, size: str, repeats: int) -> Report:
    """Measure a step with and without a stored transfer function, and several distances."""
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
    )


def speckle(n: int, device: Device) -> Field:
    """Create a random field over 75 % of the band in the middle half of the window."""
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
    """Create a propagation to several distances from one forward transform."""
    run = finished(lambda: propagate(field, DISTANCES, method="blas"), field.device)
    return Case(f"{len(DISTANCES)} distances at once", run, float(len(DISTANCES)), "distances")


def _fields_needs(size: str) -> int:
    """Return the memory of eight complex arrays, in bytes."""
    (n,) = numbers(size, (1,), "N")
    return 8 * 8 * n * n


def measure_fields(device: Device, size: str, repeats: int) -> Report:
    """Measure each kernel over whole arrays; a lens returns a new array."""
    (n,) = numbers(size, (1,), "N")
    rng = np.random.default_rng(3)
    u = rng.random((n, n), dtype=np.float32) + np.complex64(1j)
    field = Field.from_array(u, Grid((n, n), PITCH), wavelength=WAVELENGTH, device=device)
    work, phases = (device.upload(np.exp(1j * u.real).astype(device.complex)) for _ in range(2))
    full = Spectrum(phases, (n, n))
    part = np.exp(1j * u.real[: n // 2 + 1, : n // 2 + 1]).astype(device.complex)
    quadrant = Spectrum(device.upload(part), (n, n))
    H, diameter = _transfer(n), n * PITCH / 2

    def case(name: str, do: Callable[[], object]) -> Case:
        return Case(name, finished(do, device), float(n * n), "samples")

    cases = [
        case("complex multiplication", lambda: multiplied(work, full, device, copy=False)),
        case("transfer function, whole", lambda: H.on_device(device, "tables")),
        case("quadrant applied", lambda: multiplied(work, quadrant, device, copy=False)),
        case("thin lens", lambda: thin_lens(field, FOCAL)),
        case("thin lens with its disc", lambda: thin_lens(field, FOCAL, diameter=diameter)),
        case("stigmatic lens", lambda: thin_lens(field, FOCAL, form="stigmatic")),
        ceilings.copy(device, n * n * device.complex.itemsize),
    ]
    times = in_turn(cases, repeats)
    rows = time_rows(times, times[0])
    return Report("fields", size, "time over a complex multiplication", rows)


def _transfer(n: int) -> Transfer:
    """Create H at n x n FFT frequencies, without symmetry."""
    f = np.fft.fftfreq(n, PITCH)
    return Transfer((n, n), (f, f), (np.ones(n), np.ones(n)), DISTANCE, WAVELENGTH)


def _gradients_needs(size: str) -> int:
    """Return the memory of thirty complex arrays of N x N, in bytes."""
    (n,) = numbers(size, (1,), "N")
    return 30 * 8 * n * n


def measure_gradients(device: Device, size: str, repeats: int) -> Report:
    """Measure each step alone, and with gradients of its input and parameters."""
    (n,) = numbers(size, (1,), "N")
    field = speckle(n, device)
    steps = {
        "propagation": _propagation(field),
        "lens and propagation, intensity": _imaging(field, ()),
        "the same, focal length too": _imaging(field, (0,)),
        f"mean of {_SNAPSHOTS} snapshots": _mean(field),
    }
    cases = [
        Case(name if way == 0 else f"{name}, and back", finished(run, device), 1.0, "steps")
        for name, ways in steps.items()
        for way, run in enumerate(ways)
    ]
    times = in_turn(cases, repeats)
    pairs = zip(times[::2], times[1::2], strict=True)
    rows = tuple(row for pair in pairs for row in time_rows(pair, pair[0]))
    notes = (
        "The backward pass stores one field in front of each part with parameters, "
        f"{n * n * device.complex.itemsize / 2**20:.0f} MiB, and one per snapshot.",
    )
    return Report("gradients", size, "time over forward alone", rows, notes)


Ways = tuple[Callable[[], Any], Callable[[], Any]]


def _propagation(field: Field) -> Ways:
    plan = _plan(field, DISTANCE)

    def both() -> Any:
        return plan.adjoint(plan(field))

    return (lambda: plan(field)), both


def _imaging(field: Field, parameters: tuple[int, ...]) -> Ways:
    system = OpticalSystem([Lens(FOCAL), Space(DISTANCE, method="blas")])
    weights = field.intensity()

    def both() -> Any:
        image, pullback = system.vjp(field, parameters=parameters)
        image.intensity()
        return pullback(intensity_gradient(image, weights))

    return (lambda: system(field).intensity()), both


def _mean(field: Field) -> Ways:
    cell = field.grid.extent[0] / _CELLS
    light = Coherence(RandomPhaseMask(cell))
    system = OpticalSystem([Space(DISTANCE, method="blas")])
    weights = field.intensity().to_numpy()

    def forward() -> Any:
        return light.average(system, field, snapshots=_SNAPSHOTS, method="monte-carlo")

    def both() -> Any:
        _, pullback = light.vjp(system, field, snapshots=_SNAPSHOTS, method="monte-carlo")
        return pullback(weights)

    return forward, both


BENCHMARKS = (
    Benchmark(
        "propagation",
        "a step of N x N samples padded to 2N, beside two bare FFTs of 2N x 2N",
        sizes=("1024", "2048", "4096"),
        quick="128",
        needs=_propagation_needs,
        run=measure_propagation,
    ),
    Benchmark(
        "fields",
        "lenses and transfer functions of N x N samples, beside a complex multiplication",
        sizes=("4096",),
        quick="128",
        needs=_fields_needs,
        run=measure_fields,
    ),
    Benchmark(
        "gradients",
        "forward and backward beside forward alone, through propagation, a lens, coherence",
        sizes=("1024", "2048"),
        quick="256",
        needs=_gradients_needs,
        run=measure_gradients,
    ),
)
