"""Timing of several cases in turn, so that a slower machine affects all of them alike.

Sizes of benchmarks are text, such as 15x15x434x625x3.
"""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from clplen.compute.device import Device
from clplen.errors import ShapeError


@dataclass(frozen=True)
class Case:
    """Synchronous call to time, and the work of one run."""

    name: str
    run: Callable[[], object]
    work: float = 1.0
    unit: str = "runs"


@dataclass(frozen=True)
class Times:
    """Seconds of the repeats of one case, in order of measurement."""

    case: Case
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median of the seconds."""
        return statistics.median(self.seconds)

    @property
    def spread(self) -> float:
        """Distance of the quartiles over the median."""
        if len(self.seconds) < 2:
            return 0.0
        low, _, high = statistics.quantiles(self.seconds, n=4, method="inclusive")
        return (high - low) / self.median

    @property
    def rate(self) -> float:
        """Work per second."""
        return self.case.work / self.median

    def over(self, other: Times) -> float:
        """Return the median ratio of this time over another time of the same round."""
        pairs = zip(self.seconds, other.seconds, strict=True)
        return statistics.median(mine / theirs for mine, theirs in pairs)


def in_turn(cases: Sequence[Case], repeats: int) -> list[Times]:
    """Run every case once as a warm-up, then in rounds over all cases."""
    seconds: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats + 1):
        for case, case_seconds in zip(cases, seconds, strict=True):
            start = perf_counter()
            case.run()
            case_seconds.append(perf_counter() - start)
    return [
        Times(case, tuple(case_seconds[1:]))
        for case, case_seconds in zip(cases, seconds, strict=True)
    ]


def finished(run: Callable[[], object], device: Device) -> Callable[[], Any]:
    """Wrap a call so that it waits until the device has finished."""

    def run_and_wait() -> None:
        run()
        device.finish()

    return run_and_wait


def numbers(size: str, counts: tuple[int, ...], form: str) -> tuple[int, ...]:
    """Return the integers of a size; raise ShapeError if it does not match the form."""
    if not re.fullmatch(r"[1-9]\d*(x[1-9]\d*)*", size) or size.count("x") + 1 not in counts:
        raise ShapeError(f"size must be {form}, got {size!r}.")
    return tuple(int(n) for n in size.split("x"))
