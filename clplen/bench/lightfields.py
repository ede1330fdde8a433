"""Benchmarks of focal stacks, depth and transfers, relative to copies and reads of the samples."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np

from clplen.bench import ceilings
from clplen.bench.measure import Case, finished, in_turn, numbers
from clplen.bench.report import Benchmark, Report, rate_rows, time_rows
from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.lightfield.depth.depth_maps import CUES
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

Samples = np.ndarray[Any, np.dtype[np.float32]]

STACK_FORM = "VxUxYxX[xC]"
STACK_SIZES = ("15x15x434x625x3", "9x9x512x512", "30x30x101x101", "5x7x333x1021x3", "17x17x768x768")
STACK_PLANES = 32
STACK_RANGE = 1.5  # disparities of the stack: -STACK_RANGE to STACK_RANGE
STACK_DISPARITY = 1.37  # disparity of single planes
STORED = ("uint8", "uint16", "float16")
COPY, READING = "copy of the views", "reading the views (search for NaN)"
_DEPTH_PLANES, _SLANT_PLANES = 31, 41
_WAVES, _WAVELENGTHS = 48, (3.0, 20.0)  # number of waves of a texture; range in pixels


def stack_needs(size: str) -> int:
    """Return the memory of a light field in four types, of copies and stacks, in bytes."""
    shape = numbers(size, (4, 5), STACK_FORM)
    return 25 * math.prod(shape) + 5 * 4 * STACK_PLANES * math.prod(shape[2:])


def measure_stack(device: Device, size: str, repeats: int) -> Report:
    """Measure stacks and refocus relative to moving the samples alone."""
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
    return Report("stack", size, "rays/s over those of one reading", rows, notes)


def transfer_cases(lf: LightField) -> list[Case]:
    """Create cases that only move the samples."""
    device, rays = lf.device, float(math.prod(lf.shape[:4]))
    twin = device.empty(lf.shape, lf.dtype)
    return [
        Case(COPY, finished(lambda: device.copy_into(twin, lf.data, 0), device), rays, "rays"),
        Case(READING, lambda: count_bad(lf.data, device), rays, "rays"),
    ]


def stack_cases(lf: LightField, values: np.ndarray[Any, Any]) -> list[Case]:
    """Create stacks of every storage type, a stack with its transfers, and refocus."""
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
    # Refocus is last, since threads of other libraries spin for a while.
    return [*cases, with_copies, Case("refocus", plane, rays, "rays")]


def _transfers_needs(size: str) -> int:
    """Return the memory of eight light fields on host and device, in bytes."""
    return 8 * 4 * math.prod(numbers(size, (4, 5), STACK_FORM))


def measure_transfers(device: Device, size: str, repeats: int) -> Report:
    """Measure the transfers of a light field to and from the device."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    twin = np.empty_like(values)
    weights = np.ones(shape[:2], np.float32)
    lf = LightField.from_array(values, device=device, weights=weights)
    moved = values.nbytes

    def from_array() -> None:
        LightField.from_array(values, device=device, weights=weights)
        device.finish()

    cases = [
        Case("copy within the host", lambda: np.copyto(twin, values), moved, "bytes"),
        Case("copy within the device", ceilings.copy(device, moved).run, moved, "bytes"),
        Case("upload", finished(lambda: device.upload(values), device), moved, "bytes"),
        Case("download", lambda: device.download(lf.data), moved, "bytes"),
        Case("LightField.from_array", from_array, moved, "bytes"),
        Case("LightField.to_numpy", lf.to_numpy, moved, "bytes"),
    ]
    times = in_turn(cases, repeats)
    return Report("transfers", size, "rate over that within the host", rate_rows(times, times[0]))


def _depth_needs(size: str) -> int:
    """Return the memory of light fields, stacks and maps of the combined cue, in bytes."""
    shape = numbers(size, (4, 5), STACK_FORM)
    return 4 * (12 * math.prod(shape) + 4 * _DEPTH_PLANES * math.prod(shape[2:]))


def measure_depth(device: Device, size: str, repeats: int) -> Report:
    """Measure every cue relative to the focal stack, on random samples and on a surface."""
    shape = numbers(size, (4, 5), STACK_FORM)
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    planes = np.linspace(-STACK_RANGE, STACK_RANGE, _DEPTH_PLANES)
    slant = slanted_views(shape[:4])
    slants = {"grey": slant, "colours": np.repeat(slant[..., None], 3, axis=-1)}

    def cases_of(samples: Any, planes: Any, cues: Iterable[str], of: str = "") -> list[Case]:
        lf = LightField.from_array(samples, device=device)
        pixels = float(planes.size * math.prod(shape[2:4]))
        stack = finished(lambda: focal_stack(lf, disparities=planes), device)
        cases = [Case(f"focal stack of {planes.size} planes{of}", stack, pixels, "pixels")]
        for cue in cues:
            run = partial(depth_map, lf, disparities=planes, cue=cue)
            cases.append(Case(cue + of, run, pixels, "pixels"))
        return cases

    cases = cases_of(values, planes, CUES)
    finer = np.linspace(-2, 2, _SLANT_PLANES)
    for name, samples in slants.items():
        cases += cases_of(samples, finer, ["combined"], f", {name}")
    times = in_turn(cases, repeats)
    rows = time_rows(times, times[0])
    notes = (
        "Grey and colours: a slanted textured surface, whose planes can be excluded early, unlike "
        "those of random samples.",
    )
    return Report("depth", size, "time over that of the stack", rows, notes)


def slanted_views(shape: tuple[int, ...]) -> Samples:
    """Return grey views of a textured surface whose disparity rises from -1 to 1 along x.

    The texture is a sum of plane waves of random directions, hence exact between pixels.
    """
    V, U, ny, nx = shape
    random = np.random.default_rng(2)
    angle, phase = 2 * np.pi * random.random((2, _WAVES, 1))
    length = random.uniform(*_WAVELENGTHS, (_WAVES, 1))
    d = np.linspace(-1, 1, nx)
    out = np.empty(shape, np.float32)
    for v, u in np.ndindex(V, U):
        x = np.arange(nx) + d * (u - (U - 1) / 2)
        along = 2 * np.pi * np.cos(angle) / length * x + phase
        rows = 2 * np.pi * np.sin(angle) / length * np.arange(ny)
        lift = 2 * np.pi * np.sin(angle) / length * d * (v - (V - 1) / 2)
        # cos(rows + along + lift) as a product of two tables
        columns = along + lift
        view = np.cos(rows).T @ np.cos(columns) - np.sin(rows).T @ np.sin(columns)
        out[v, u] = 0.5 + view / (6 * _WAVES**0.5)
    return out


BENCHMARKS = (
    Benchmark(
        "stack",
        "rays a second of focal stack and refocus, beside a copy and a reading of the views",
        sizes=STACK_SIZES,
        quick="5x5x120x160x3",
        needs=stack_needs,
        run=measure_stack,
    ),
    Benchmark(
        "transfers",
        "host to device and back, beside a copy within the host's memory",
        sizes=("15x15x434x625x3",),
        quick="5x5x120x160x3",
        needs=_transfers_needs,
        run=measure_transfers,
    ),
    Benchmark(
        "depth",
        "every cue of depth, beside the focal stack of its planes",
        sizes=("9x9x512x512",),
        quick="5x5x60x80",
        needs=_depth_needs,
        run=measure_depth,
    ),
)
