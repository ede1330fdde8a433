"""Focal stack and refocus beside what is written by hand, in the same run.

    python benchmarks/bench_stack.py [--device pocl] [--planes 32] [--shape 15x15x434x625x3]

A ray is one pixel of one view used for one plane; every row is the median of repeats taken in
turn. Only the ratios mean something on another machine.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import click
import numpy as np
import pyopencl as cl

from clplen.compute.device import Device
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.refocus import focal_stack, refocus

PACKAGES = ("numpy", "pyopencl", "pocl-binary-distribution", "intel-opencl-rt", "torch", "numba")
RANGE = 1.5  # disparities of the stack: -RANGE to RANGE


@dataclass(frozen=True)
class Case:
    """Something to time: what it is, how many planes it computes, how to run it once."""

    name: str
    planes: int
    run: Callable[[], Any]


def taps(shape: tuple[int, ...], disparity: float) -> list[tuple[int, int, list[Any]]]:
    """(v, u, [(weight, y, x), ...]): the four slices of every view, by their first row, column."""
    V, U = shape[:2]
    found = []
    for v in range(V):
        for u in range(U):
            dy, dx = ((n - 1) / 2 * disparity - i * disparity for n, i in ((V, v), (U, u)))
            y, x = int(np.floor(dy)), int(np.floor(dx))
            b, a = dy - y, dx - x
            corners = [
                ((1 - b) * (1 - a), y, x),
                ((1 - b) * a, y, x + 1),
                (b * (1 - a), y + 1, x),
                (b * a, y + 1, x + 1),
            ]
            found.append((v, u, corners))
    return found


def margins(shape: tuple[int, ...], disparity: float) -> tuple[int, int, int]:
    """(margin, rows, columns) of the part of the picture that every view reaches."""
    margin = int(np.ceil(abs(disparity) * (max(shape[:2]) - 1) / 2)) + 1
    return margin, shape[2] - 2 * margin, shape[3] - 2 * margin


def numpy_slices(field: np.ndarray[Any, Any], disparity: float) -> np.ndarray[Any, Any]:
    """The mean over the views, four weighted slices a view, away from the edges."""
    margin, rows, columns = margins(field.shape, disparity)
    total = np.zeros((rows, columns, *field.shape[4:]), np.float32)
    part = np.empty_like(total)
    for v, u, corners in taps(field.shape, disparity):
        for weight, y, x in corners:
            y, x = y + margin, x + margin
            np.multiply(field[v, u, y : y + rows, x : x + columns], np.float32(weight), out=part)
            total += part
    total /= field.shape[0] * field.shape[1]
    return total


def torch_slices(field: np.ndarray[Any, Any], disparity: float) -> Callable[[], Any]:
    """The same with torch, on all its threads."""
    import torch

    views = torch.from_numpy(field)
    margin, rows, columns = margins(field.shape, disparity)

    def run() -> Any:
        total = torch.zeros((rows, columns, *field.shape[4:]))
        for v, u, corners in taps(field.shape, disparity):
            for weight, y, x in corners:
                y, x = y + margin, x + margin
                total.add_(views[v, u, y : y + rows, x : x + columns], alpha=weight)
        return total.div_(field.shape[0] * field.shape[1])

    return run


def numba_taps(field: np.ndarray[Any, Any], disparity: float) -> Callable[[], Any]:
    """The same with numba: rows in parallel, four taps a sample."""
    import numba

    margin, rows, columns = margins(field.shape, disparity)
    flat = field.reshape(*field.shape[:3], -1)
    channels = flat.shape[3] // field.shape[3]
    corners = [
        (v, u, *four[0][1:], *(c[0] for c in four)) for v, u, four in taps(field.shape, disparity)
    ]
    table = np.array(corners)

    @numba.njit(parallel=True, fastmath=True)
    def loops(views: Any, table: Any, total: Any) -> None:
        for row in numba.prange(total.shape[0]):
            for n in range(len(table)):
                v, u, y, x = (int(table[n, i]) for i in (0, 1, 2, 3))
                a, b, c, d = table[n, 4:].astype(np.float32)
                upper, lower = views[v, u, row + margin + y], views[v, u, row + margin + y + 1]
                first = (x + margin) * channels
                for s in range(total.shape[1]):
                    i = first + s
                    total[row, s] += (
                        a * upper[i]
                        + b * upper[i + channels]
                        + c * lower[i]
                        + d * lower[i + channels]
                    )

    def run() -> Any:
        total = np.zeros((rows, columns * channels), np.float32)
        loops(flat, table, total)
        return total

    return run


def baselines(field: np.ndarray[Any, Any], disparity: float) -> list[Case]:
    """What is written by hand, for one plane (its time is linear in the planes)."""
    plain = field.astype(np.float32, copy=False)
    cases = [Case("numpy, four slices a view", 1, lambda: numpy_slices(plain, disparity))]
    if importlib.util.find_spec("torch"):
        cases.append(Case("torch, four slices a view", 1, torch_slices(plain, disparity)))
    if importlib.util.find_spec("numba"):
        cases.append(Case("numba, four taps", 1, numba_taps(plain, disparity)))
    return cases


def clplen_cases(
    field: np.ndarray[Any, Any], device: Device, disparity: float, planes: int
) -> list[Case]:
    """clplen with the light field on the device, with its copies, and a plain copy beside it."""
    lf = LightField.from_array(field, device=device)
    stack = np.linspace(-RANGE, RANGE, planes)
    twin = device.empty(lf.data.shape, lf.dtype)

    def finished(run: Callable[[], Any]) -> Callable[[], Any]:
        return lambda: (run(), device.finish())

    def with_copies() -> Any:
        moved = LightField.from_array(field, device=device, weights=lf.weights)
        return focal_stack(moved, disparities=stack).to_numpy()

    return [
        Case(
            "copy of the light field",
            1,
            finished(lambda: cl.enqueue_copy(device.queue, twin.base_data, lf.data.base_data)),
        ),
        Case("clplen, refocus", 1, finished(lambda: refocus(lf, disparity=disparity))),
        Case("clplen, stack", planes, finished(lambda: focal_stack(lf, disparities=stack))),
        Case("clplen, stack, with transfers", planes, with_copies),
    ]


def medians(cases: list[Case], repeats: int) -> list[float]:
    """Seconds of every case; the repeats are taken in turn, after one that does not count."""
    seconds: list[list[float]] = [[] for _ in cases]
    for _ in range(repeats + 1):
        for case, times in zip(cases, seconds, strict=True):
            start = time.perf_counter()
            case.run()
            times.append(time.perf_counter() - start)
    return [statistics.median(times[1:]) for times in seconds]


def difference(field: np.ndarray[Any, Any], device: Device, disparity: float) -> float:
    """Largest difference between clplen and numpy, relative to the largest value."""
    margin, rows, columns = margins(field.shape, disparity)
    want = numpy_slices(field.astype(np.float32, copy=False), disparity)
    got = refocus(LightField.from_array(field, device=device), disparity=disparity).to_numpy()
    inner = got[margin : margin + rows, margin : margin + columns]
    return float(np.abs(inner - want).max() / np.abs(want).max())


def versions() -> str:
    """Python and the packages that are installed."""
    found = [f"Python {platform.python_version()}"]
    for name in PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return ", ".join(found)


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--planes", default=32, show_default=True, help="Planes of the stack.")
@click.option("--shape", default="15x15x434x625x3", show_default=True, help="VxUxYxX[xC]")
@click.option("--dtype", type=click.Choice(["float32", "uint16", "uint8"]), default="float32")
@click.option("--disparity", default=1.37, show_default=True, help="Of the single planes.")
@click.option("--repeats", default=5, show_default=True)
@click.option("--quick", is_flag=True, help="A small light field, 8 planes, two repeats.")
def main(
    selector: str | None,
    planes: int,
    shape: str,
    dtype: str,
    disparity: float,
    repeats: int,
    quick: bool,
) -> None:
    """Rays a second of a focal stack, of one picture, and of what is written by hand."""
    if quick:
        shape, planes, repeats = "5x5x120x160x3", min(planes, 8), 2
    sizes = tuple(int(n) for n in shape.split("x"))
    device = Device.open(selector)
    values = np.random.default_rng(1).random(sizes, dtype=np.float32)
    field = values if dtype == "float32" else (values * np.iinfo(dtype).max).astype(dtype)
    cases = baselines(field, disparity) + clplen_cases(field, device, disparity, planes)
    seconds = medians(cases, repeats)

    rays = int(np.prod(sizes[:4]))
    click.echo(repr(device))
    click.echo(f"{versions()}; {os.cpu_count()} CPU cores")
    click.echo(
        f"{shape} {dtype}: {field.nbytes / rays:g} bytes a ray, {planes} planes of "
        f"disparity {-RANGE} to {RANGE}, one of {disparity}"
    )
    click.echo(f"largest difference from numpy: {difference(field, device, disparity):.1e}\n")
    click.echo(f"{'':32s}{'ms':>9s}{'Mray/s':>10s}{'of numpy':>10s}")
    for case, t in zip(cases, seconds, strict=True):
        rate = case.planes * rays / t
        ratio = rate * seconds[0] / rays
        click.echo(f"{case.name:32s}{1e3 * t:9.1f}{rate / 1e6:10.0f}{ratio:10.2f}")


if __name__ == "__main__":
    main()
