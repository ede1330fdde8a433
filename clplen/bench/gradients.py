"""Forward and backward beside forward alone: propagation, a lens, partially coherent light."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clplen.bench.measure import Case, Times, finished, halved, in_turn, numbers
from clplen.bench.report import Benchmark, Goal, Report, Row
from clplen.bench.waves import DISTANCE, FOCAL, speckle
from clplen.compute.device import Device
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.field.adjoints import intensity_gradient
from clplen.wave.field.field import Field
from clplen.wave.propagation.propagator import Propagator
from clplen.wave.systems.components import Lens
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.space import Space

MOST = 2.2  # forward and backward over forward alone
_SNAPSHOTS = 4
_CELLS = 16  # of a mask, along a side of the window


def _needs(size: str) -> int:
    """Thirty arrays of N x N complex samples."""
    (n,) = numbers(size, (1,), "N")
    return 30 * 8 * n * n


def measure_gradients(device: Device, size: str, repeats: int) -> Report:
    """Each step alone, and with its gradient by what it is given and by its parameters."""
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
    rows, goals = [], []
    for forward, both in zip(times[::2], times[1::2], strict=True):
        rows += [_row(forward, forward), _row(both, forward)]
        goals.append(Goal(f"{both.case.name}, over forward", both.over(forward), MOST, "at most"))
    notes = (
        "Backward holds no field between, but one in front of each part whose parameters are asked "
        f"for, {n * n * device.complex.itemsize / 2**20:.0f} MiB, and one a snapshot.",
    )
    return Report("gradients", size, "time over forward alone", tuple(rows), tuple(goals), notes)


def _row(times: Times, by: Times) -> Row:
    case = times.case
    return Row(case.name, times.median, times.spread, times.rate, case.unit, times.over(by))


Ways = tuple[Callable[[], Any], Callable[[], Any]]


def _propagation(field: Field) -> Ways:
    plan = Propagator(
        field.grid, DISTANCE, wavelength=field.wavelength, method="blas", device=field.device
    )

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
        "gradients",
        "forward and backward beside forward alone, through propagation, a lens, coherence",
        sizes=("1024", "2048"),
        quick="256",
        needs=_needs,
        run=measure_gradients,
        smaller=lambda size: halved(size, (0,), 256),
    ),
)
