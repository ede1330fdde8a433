"""Times of several things taken in turn, so that a machine that slows down slows all of them.

Sizes of benchmarks are text: 15x15x434x625x3.
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
    """A call to time, which returns when it is done, and the work that one run does."""

    name: str
    run: Callable[[], object]
    work: float = 1.0
    unit: str = "runs"


@dataclass(frozen=True)
class Times:
    """Seconds of the repeats of one case, in the order in which they were taken."""

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
        """Work a second."""
        return self.case.work / self.median

    def over(self, other: Times) -> float:
        """Return the median of the ratios of this time over another of the same round."""
        pairs = zip(self.seconds, other.seconds, strict=True)
        return statistics.median(mine / theirs for mine, theirs in pairs)


def in_turn(cases: Sequence[Case], repeats: int) -> list[Times]:
    """Run every case once uncounted, then so many rounds of all of them."""
    seconds: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats + 1):
        for case, taken in zip(cases, seconds, strict=True):
            start = perf_counter()
            case.run()
            taken.append(perf_counter() - start)
    return [Times(case, tuple(taken[1:])) for case, taken in zip(cases, seconds, strict=True)]


def finished(run: Callable[[], object], device: Device) -> Callable[[], Any]:
    """Return a call of ``run`` that waits until the device is done."""

    def both() -> None:
        run()
        device.finish()

    return both


def numbers(size: str, counts: tuple[int, ...], form: str) -> tuple[int, ...]:
    """Return the whole numbers of a size; raise ShapeError with its form if it has others."""
    if not re.fullmatch(r"[1-9]\d*(x[1-9]\d*)*", size) or size.count("x") + 1 not in counts:
        raise ShapeError(f"A size of this benchmark is {form}, not {size!r}.")
    return tuple(int(n) for n in size.split("x"))
