"""Focal stack and refocus beside what is written by hand, a copy and a reading of the views."""

from __future__ import annotations

import importlib.util
import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.bench.byhand import (
    PLANES_TOGETHER,
    ByHand,
    by_hand,
    margins,
    numba_planes,
    numpy_slices,
)
from clplen.bench.measure import Case, Times, finished, in_turn
from clplen.bench.report import Goal, Report, rate_rows
from clplen.bench.sizes import halved, numbers
from clplen.compute.finite import count_bad
from clplen.lightfield.focus_and_depth import focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocus.focal_stack import refocus

if TYPE_CHECKING:
    from clplen.compute.device import Device

SUMMARY = "rays a second of focal stack and refocus, beside NumPy, PyTorch, Numba and OpenCV"
MAIN = "15x15x434x625x3"
SIZES = (MAIN, "9x9x512x512", "30x30x101x101", "5x7x333x1021x3", "17x17x768x768")
QUICK = "5x5x120x160x3"
FORM = "VxUxYxX[xC]"
PLANES = 32
_RANGE = 1.5  # disparities of the stack: -_RANGE to _RANGE
_DISPARITY = 1.37  # of the single planes
_STORED = ("uint8", "uint16", "float16")
_INTEL = "Intel"
_MARGIN = 0.9  # of the best time by hand, that refocus is to stay below


def smaller(size: str) -> str:
    """Half the rows and columns."""
    return halved(size, (2, 3), 64)


def needs(size: str) -> int:
    """The light field in four types on the device, twice on the host, its copy, and the stacks."""
    shape = numbers(size, (4, 5), FORM)
    return 25 * math.prod(shape) + 5 * 4 * PLANES * math.prod(shape[2:])


def run(device: Device, size: str, repeats: int) -> Report:
    """Rates of everything, taken in turn."""
    shape = numbers(size, (4, 5), FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    threads = tuple(sorted({1, os.cpu_count() or 1}))
    hand = by_hand(values, _DISPARITY, threads)
    rays = float(math.prod(shape[:4]))
    lf = LightField.from_array(values, device=device)
    cases = [Case(one.name, one.run, rays, "rays") for one in hand]
    cases += _planes_by_hand(values, rays, max(threads))
    cases += _bounds(lf, rays) + _own(lf, values, rays)
    times = in_turn(cases, repeats)
    by_name = {t.case.name: t for t in times}
    notes = (
        f"{PLANES} planes of disparity {-_RANGE} to {_RANGE}, single ones of {_DISPARITY}; a ray "
        "is a pixel of a view used for one plane. By hand, only what all views reach.",
        f"Largest difference of refocus from NumPy: {_difference(lf, values):.1e}.",
        f"Refocus takes {by_name['refocus'].over(by_name[_READ]):.2f} of reading the views once.",
    )
    goals = _goals(size, hand, by_name, device.platform)
    return Report(
        "stack", size, "rays/s over those of NumPy", rate_rows(times, times[0]), goals, notes
    )


def _planes_by_hand(values: np.ndarray[Any, Any], rays: float, threads: int) -> list[Case]:
    """A stack by Numba with planes in blocks, where it is installed."""
    if importlib.util.find_spec("numba") is None:
        return []
    planes = np.linspace(-_RANGE, _RANGE, PLANES)
    run = numba_planes(values, planes, threads=threads)
    name = f"numba, four taps, {PLANES_TOGETHER} planes at a time, {threads} threads"
    return [Case(name, run, PLANES * rays, "rays")]


_COPY, _READ = "copy of the views", "reading the views (search for NaN)"


def _bounds(lf: LightField, rays: float) -> list[Case]:
    """What moving the samples alone costs."""
    device = lf.device
    twin = device.empty(lf.shape, lf.dtype)
    return [
        Case(_COPY, finished(lambda: device.copy_into(twin, lf.data, 0), device), rays, "rays"),
        Case(_READ, lambda: count_bad(lf.data, device), rays, "rays"),
    ]


def _own(lf: LightField, values: np.ndarray[Any, Any], rays: float) -> list[Case]:
    """Refocus and stacks of every storage type, and a stack with the way in and out."""
    device = lf.device
    planes = np.linspace(-_RANGE, _RANGE, PLANES)

    def stack_of(one: LightField) -> Any:
        return finished(lambda: focal_stack(one, disparities=planes), device)

    def with_transfers() -> Any:
        moved = LightField.from_array(values, device=device, weights=lf.weights)
        return focal_stack(moved, disparities=planes).to_numpy()

    one = Case("refocus", finished(lambda: refocus(lf, disparity=_DISPARITY), device), rays, "rays")
    cases = [Case("stack, float32", stack_of(lf), PLANES * rays, "rays")]
    for name in _STORED:
        scale = np.iinfo(name).max if name.startswith("u") else 1
        stored = LightField.from_array((values * scale).astype(name), device=device)
        cases.append(Case(f"stack, {name}", stack_of(stored), PLANES * rays, "rays"))
    moved = Case("stack with transfers", with_transfers, PLANES * rays, "rays")
    return [*cases, moved, one]  # last: threads of what is written by hand spin for a while


def _goals(
    size: str, hand: list[ByHand], times: dict[str, Times], platform: str
) -> tuple[Goal, ...]:
    stack, single = times["stack, float32"], times["refocus"]

    def best(four_taps: bool) -> Times | None:
        some = [times[one.name] for one in hand[1:] if one.four_taps == four_taps]
        return min(some, key=lambda t: t.median, default=None)

    def faster(than: Times) -> float:
        return PLANES / stack.over(than)

    intel = _INTEL in platform
    taps, separable = best(True) or times[hand[0].name], best(False)
    limit = (7.0 if intel else 5.0) if size == MAIN else 3.0
    goals = [Goal(f"stack over {taps.case.name}", faster(taps), limit, "at least")]
    if size == MAIN:
        if separable:
            limit = 4.5 if intel else 3.0
            name = f"stack over {separable.case.name}"
            goals.append(Goal(name, faster(separable), limit, "at least"))
        numpy = times[hand[0].name]
        limit = 25.0 if intel else 18.0
        goals.append(Goal("stack over NumPy", faster(numpy), limit, "at least"))
        plane = stack.over(times[_COPY]) / PLANES
        goals.append(Goal("a plane over a copy of the views", plane, 0.5, "at most"))
    beside = min((times[one.name] for one in hand), key=lambda t: t.median)
    name = f"refocus over {beside.case.name}, time"
    goals.append(Goal(name, single.over(beside), _MARGIN, "at most"))
    for kind in _STORED:
        ratio = times[f"stack, {kind}"].over(stack)
        goals.append(Goal(f"stack of {kind} over float32, time", ratio, 1.0, "at most"))
    return tuple(goals)


def _difference(lf: LightField, values: np.ndarray[Any, Any]) -> float:
    """Largest difference of refocus from NumPy, relative to the largest value."""
    margin, rows, columns = margins(values.shape, _DISPARITY)
    want = numpy_slices(values, _DISPARITY)
    got = refocus(lf, disparity=_DISPARITY).to_numpy()
    inner = got[margin : margin + rows, margin : margin + columns]
    return float(np.abs(inner - want).max() / np.abs(want).max())
