"""Focal stacks, depth and transfers of light fields, beside copies and readings of the samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, Times, finished, halved, in_turn, numbers
from clplen.bench.report import Benchmark, Goal, Report, rate_rows, time_rows
from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.lightfield.depth.depth_maps import CUES
from clplen.lightfield.focus_and_depth import depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

STACK_FORM = "VxUxYxX[xC]"
STACK_MAIN = "15x15x434x625x3"
STACK_SIZES = (STACK_MAIN, "9x9x512x512", "30x30x101x101", "5x7x333x1021x3", "17x17x768x768")
STACK_PLANES = 32
STACK_RANGE = 1.5  # disparities of the stack: -STACK_RANGE to STACK_RANGE
STACK_DISPARITY = 1.37  # of the single planes
STORED = ("uint8", "uint16", "float16")
COPY, READING = "copy of the views", "reading the views (search for NaN)"
_DEPTH_PLANES = 31
_MOST = 2.0  # of the stack's time, for the energy cue


def stack_needs(size: str) -> int:
    """The light field in four types on the device, twice on the host, its copy, and the stacks."""
    shape = numbers(size, (4, 5), STACK_FORM)
    return 25 * math.prod(shape) + 5 * 4 * STACK_PLANES * math.prod(shape[2:])


def measure_stack(device: Device, size: str, repeats: int) -> Report:
    """Rates of stacks and of refocus, beside moving the samples alone."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values, device=device)
    times = in_turn([*transfer_cases(lf), *stack_cases(lf, values)], repeats)
    by_name = {t.case.name: t for t in times}
    notes = (
        f"{STACK_PLANES} planes of disparity {-STACK_RANGE} to {STACK_RANGE}, "
        f"single ones of {STACK_DISPARITY}; a ray is a "
        "pixel of a view used for one plane.",
        f"Refocus takes {by_name['refocus'].over(by_name[READING]):.2f} of reading the views once.",
    )
    rows = rate_rows(times, by_name[READING])
    goals = stack_goals(size, by_name)
    return Report("stack", size, "rays/s over those of one reading", rows, goals, notes)


def transfer_cases(lf: LightField) -> list[Case]:
    """What moving the samples alone costs."""
    device, rays = lf.device, float(math.prod(lf.shape[:4]))
    twin = device.empty(lf.shape, lf.dtype)
    return [
        Case(COPY, finished(lambda: device.copy_into(twin, lf.data, 0), device), rays, "rays"),
        Case(READING, lambda: count_bad(lf.data, device), rays, "rays"),
    ]


def stack_cases(lf: LightField, values: np.ndarray[Any, Any]) -> list[Case]:
    """Refocus and stacks of every storage type, and a stack with the way in and out."""
    device, rays = lf.device, float(math.prod(lf.shape[:4]))
    planes = np.linspace(-STACK_RANGE, STACK_RANGE, STACK_PLANES)

    def stack_of(stored: LightField) -> Any:
        return finished(lambda: focal_stack(stored, disparities=planes), device)

    def with_transfers() -> Any:
        moved = LightField.from_array(values, device=device, weights=lf.weights)
        return focal_stack(moved, disparities=planes).to_numpy()

    plane = finished(lambda: refocus(lf, disparity=STACK_DISPARITY), device)
    cases = [Case("stack, float32", stack_of(lf), STACK_PLANES * rays, "rays")]
    for name in STORED:
        scale = np.iinfo(name).max if name.startswith("u") else 1
        stored = LightField.from_array((values * scale).astype(name), device=device)
        cases.append(Case(f"stack, {name}", stack_of(stored), STACK_PLANES * rays, "rays"))
    with_copies = Case("stack with transfers", with_transfers, STACK_PLANES * rays, "rays")
    # Refocus is last: threads of other libraries spin for a while.
    return [*cases, with_copies, Case("refocus", plane, rays, "rays")]


def stack_goals(size: str, times: dict[str, Times]) -> tuple[Goal, ...]:
    """Goals beside a copy of the views, and of storage types beside float32."""
    stack, goals = times["stack, float32"], []
    if size == STACK_MAIN:
        plane = stack.over(times[COPY]) / STACK_PLANES
        goals.append(Goal("a plane over a copy of the views", plane, 0.5, "at most"))
    for kind in STORED:
        ratio = times[f"stack, {kind}"].over(stack)
        goals.append(Goal(f"stack of {kind} over float32, time", ratio, 1.0, "at most"))
    return tuple(goals)


def _transfers_needs(size: str) -> int:
    """The light field eight times: three on the host, four on the device, one on its way."""
    return 8 * 4 * math.prod(numbers(size, (4, 5), STACK_FORM))


def measure_transfers(device: Device, size: str, repeats: int) -> Report:
    """Rates of a light field's way in and out."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    twin = np.empty_like(values)
    weights = np.ones(shape[:2], np.float32)
    there = LightField.from_array(values, device=device, weights=weights)
    moved = values.nbytes

    def from_array() -> None:
        LightField.from_array(values, device=device, weights=weights)
        device.finish()

    cases = [
        Case("copy within the host", lambda: np.copyto(twin, values), moved, "bytes"),
        Case("copy within the device", ceilings.copy(device, moved).run, moved, "bytes"),
        Case("upload", finished(lambda: device.upload(values), device), moved, "bytes"),
        Case("download", lambda: device.download(there.data), moved, "bytes"),
        Case("LightField.from_array", from_array, moved, "bytes"),
        Case("LightField.to_numpy", there.to_numpy, moved, "bytes"),
    ]
    times = in_turn(cases, repeats)
    return Report("transfers", size, "rate over that within the host", rate_rows(times, times[0]))


def _depth_needs(size: str) -> int:
    """The light field three times, a stack, and the maps of the combined cue."""
    shape = numbers(size, (4, 5), STACK_FORM)
    return 4 * (3 * math.prod(shape) + 4 * _DEPTH_PLANES * math.prod(shape[2:]))


def measure_depth(device: Device, size: str, repeats: int) -> Report:
    """Times of every cue over that of the focal stack."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    lf = LightField.from_array(values, device=device)
    planes = np.linspace(-STACK_RANGE, STACK_RANGE, _DEPTH_PLANES)

    def of(cue: str) -> Callable[[], Any]:
        return lambda: depth_map(lf, disparities=planes, cue=cue)

    stack = finished(lambda: focal_stack(lf, disparities=planes), device)
    pixels = float(_DEPTH_PLANES * math.prod(shape[2:4]))
    cases = [Case(f"focal stack of {_DEPTH_PLANES} planes", stack, pixels, "pixels")]
    cases += [Case(cue, of(cue), pixels, "pixels") for cue in CUES]
    times = in_turn(cases, repeats)
    goal = Goal("energy over the stack", times[1].over(times[0]), _MOST, "at most")
    return Report("depth", size, "time over that of the stack", time_rows(times, times[0]), (goal,))


BENCHMARKS = (
    Benchmark(
        "stack",
        "rays a second of focal stack and refocus, beside a copy and a reading of the views",
        sizes=STACK_SIZES,
        quick="5x5x120x160x3",
        needs=stack_needs,
        run=measure_stack,
        smaller=lambda size: halved(size, (2, 3), 64),
    ),
    Benchmark(
        "transfers",
        "host to device and back, beside a copy within the host's memory",
        sizes=("15x15x434x625x3",),
        quick="5x5x120x160x3",
        needs=_transfers_needs,
        run=measure_transfers,
        smaller=lambda size: halved(size, (2, 3), 16),
    ),
    Benchmark(
        "depth",
        "every cue of depth, beside the focal stack of its planes",
        sizes=("9x9x512x512",),
        quick="5x5x60x80",
        needs=_depth_needs,
        run=measure_depth,
        smaller=lambda size: halved(size, (2, 3), 16),
    ),
)
