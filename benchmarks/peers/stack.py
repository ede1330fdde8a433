"""Focal stack and refocus beside what is written by hand with NumPy, PyTorch, Numba and OpenCV.

python -m benchmarks peers/stack [--device pocl] [--size 15x15x434x625x3] [--quick]
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.peers.by_hand import ByHand, by_hand, margins, numpy_slices
from benchmarks.script import command
from clplen import Device, LightField, refocus
from clplen.bench import (
    READING,
    STACK_DISPARITY,
    STACK_FORM,
    STACK_PLANES,
    STACK_RANGE,
    Case,
    Report,
    find_benchmark,
    in_turn,
    numbers,
    rate_rows,
    stack_cases,
    transfer_cases,
)


def measure_by_hand(device: Device, size: str, repeats: int) -> Report:
    """Rates of everything, taken in turn."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    threads = tuple(sorted({1, os.cpu_count() or 1}))
    hand = by_hand(values, STACK_DISPARITY, threads)
    rays = float(math.prod(shape[:4]))
    lf = LightField.from_array(values, device=device)
    cases = [Case(one.name, one.run, rays, "rays") for one in hand]
    cases += transfer_cases(lf) + stack_cases(lf, values)
    times = in_turn(cases, repeats)
    by_name = {t.case.name: t for t in times}
    notes = (
        f"{STACK_PLANES} planes of disparity {-STACK_RANGE} to {STACK_RANGE}, "
        f"single ones of {STACK_DISPARITY}; a ray "
        "is a pixel of a view used for one plane. By hand, only what all views reach.",
        f"Largest difference of refocus from NumPy: {_difference(lf, values):.1e}.",
        f"Refocus takes {by_name['refocus'].over(by_name[READING]):.2f} of reading the views once.",
        *(f"{name} over {best.case.name}: {count / by_name[name].over(best):.2f}"
          for name, count in (("stack, float32", STACK_PLANES), ("refocus", 1))
          for best in (min((by_name[one.name] for one in group), key=lambda t: t.median)
                       for group in _groups(hand))),
    )  # fmt: skip
    return Report("stack", size, "rays/s over those of NumPy", rate_rows(times, times[0]), notes)


def _groups(hand: list[ByHand]) -> list[list[ByHand]]:
    """NumPy's form, the others with four taps, and the separable ones, as far as installed."""
    others = [[one for one in hand[1:] if one.four_taps == taps] for taps in (True, False)]
    return [hand[:1], *(group for group in others if group)]


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

main = command(BENCHMARK, __doc__)
