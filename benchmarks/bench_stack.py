"""Focal stack and refocus beside what is written by hand with NumPy, PyTorch, Numba and OpenCV.

python benchmarks/bench_stack.py [--device pocl] [--size 15x15x434x625x3] [--quick]
"""

from __future__ import annotations

import importlib.util
import math
import os
from dataclasses import replace
from typing import Any

import numpy as np
from byhand import PLANES_TOGETHER, ByHand, by_hand, margins, numba_planes, numpy_slices
from script import command

from clplen import Device, LightField, refocus
from clplen.bench import (
    READING,
    STACK_DISPARITY,
    STACK_FORM,
    STACK_MAIN,
    STACK_PLANES,
    STACK_RANGE,
    Case,
    Goal,
    Report,
    Times,
    find_benchmark,
    in_turn,
    numbers,
    rate_rows,
    stack_cases,
    stack_goals,
    transfer_cases,
)

_INTEL = "Intel"
_MARGIN = 0.9  # of the best time by hand, that refocus is to stay below


def measure_by_hand(device: Device, size: str, repeats: int) -> Report:
    """Rates of everything, taken in turn."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    threads = tuple(sorted({1, os.cpu_count() or 1}))
    hand = by_hand(values, STACK_DISPARITY, threads)
    rays = float(math.prod(shape[:4]))
    lf = LightField.from_array(values, device=device)
    cases = [Case(one.name, one.run, rays, "rays") for one in hand]
    cases += _planes_by_hand(values, rays, max(threads))
    cases += transfer_cases(lf) + stack_cases(lf, values)
    times = in_turn(cases, repeats)
    by_name = {t.case.name: t for t in times}
    notes = (
        f"{STACK_PLANES} planes of disparity {-STACK_RANGE} to {STACK_RANGE}, "
        f"single ones of {STACK_DISPARITY}; a ray "
        "is a pixel of a view used for one plane. By hand, only what all views reach.",
        f"Largest difference of refocus from NumPy: {_difference(lf, values):.1e}.",
        f"Refocus takes {by_name['refocus'].over(by_name[READING]):.2f} of reading the views once.",
    )
    goals = _goals(size, hand, by_name, device.platform)
    return Report(
        "stack", size, "rays/s over those of NumPy", rate_rows(times, times[0]), goals, notes
    )


def _planes_by_hand(values: np.ndarray[Any, Any], rays: float, threads: int) -> list[Case]:
    """A stack by Numba with planes in blocks, where it is installed."""
    if importlib.util.find_spec("numba") is None:
        return []
    planes = np.linspace(-STACK_RANGE, STACK_RANGE, STACK_PLANES)
    run = numba_planes(values, planes, threads=threads)
    name = f"numba, four taps, {PLANES_TOGETHER} planes at a time, {threads} threads"
    return [Case(name, run, STACK_PLANES * rays, "rays")]


def _goals(
    size: str, hand: list[ByHand], times: dict[str, Times], platform: str
) -> tuple[Goal, ...]:
    stack, single = times["stack, float32"], times["refocus"]

    def best(four_taps: bool) -> Times | None:
        some = [times[one.name] for one in hand[1:] if one.four_taps == four_taps]
        return min(some, key=lambda t: t.median, default=None)

    def faster(than: Times) -> float:
        return STACK_PLANES / stack.over(than)

    intel = _INTEL in platform
    taps, separable = best(True) or times[hand[0].name], best(False)
    limit = (7.0 if intel else 5.0) if size == STACK_MAIN else 3.0
    goals = [Goal(f"stack over {taps.case.name}", faster(taps), limit, "at least")]
    if size == STACK_MAIN:
        if separable:
            limit = 4.5 if intel else 3.0
            name = f"stack over {separable.case.name}"
            goals.append(Goal(name, faster(separable), limit, "at least"))
        numpy = times[hand[0].name]
        limit = 25.0 if intel else 18.0
        goals.append(Goal("stack over NumPy", faster(numpy), limit, "at least"))
    beside = min((times[one.name] for one in hand), key=lambda t: t.median)
    name = f"refocus over {beside.case.name}, time"
    goals.append(Goal(name, single.over(beside), _MARGIN, "at most"))
    return (*goals, *stack_goals(size, times))


def _difference(lf: LightField, values: np.ndarray[Any, Any]) -> float:
    """Largest difference of refocus from NumPy, relative to the largest value."""
    margin, rows, columns = margins(values.shape, STACK_DISPARITY)
    want = numpy_slices(values, STACK_DISPARITY)
    got = refocus(lf, disparity=STACK_DISPARITY).to_numpy()
    inner = got[margin : margin + rows, margin : margin + columns]
    return float(np.abs(inner - want).max() / np.abs(want).max())


stack = find_benchmark("stack")
BENCHMARK = replace(
    stack,
    summary="focal stack and refocus, beside NumPy, PyTorch, Numba and OpenCV",
    run=measure_by_hand,
)

if __name__ == "__main__":
    command(BENCHMARK, __doc__)()
