"""Depth cues beside the focal stack of the same planes, in the same run.

    python benchmarks/bench_depth.py [--device pocl] [--planes 31] [--shape 9x9x512x512]

Every row is the median of repeats taken in turn; the ratio to the focal stack is what means
something on another machine.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.depth import CUES, depth_map
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.refocus import focal_stack

RANGE = 1.5  # disparities: -RANGE to RANGE


def medians(cases: dict[str, Callable[[], Any]], device: Device, repeats: int) -> dict[str, float]:
    """Seconds of every case; the repeats are taken in turn, after one that does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(repeats + 1):
        for name, run in cases.items():
            start = time.perf_counter()
            run()
            device.finish()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(times[1:]) for name, times in seconds.items()}


@click.command()
@click.option("--device", "selector", help="As for Device.open.")
@click.option("--planes", default=31, show_default=True)
@click.option("--shape", default="9x9x512x512", show_default=True, help="VxUxYxX[xC]")
@click.option("--dtype", type=click.Choice(["float32", "uint16", "uint8"]), default="float32")
@click.option("--cue", "cues", multiple=True, type=click.Choice(CUES), default=CUES)
@click.option("--repeats", default=5, show_default=True)
@click.option("--quick", is_flag=True, help="A small light field, 8 planes, two repeats.")
def main(
    selector: str | None,
    planes: int,
    shape: str,
    dtype: str,
    cues: tuple[str, ...],
    repeats: int,
    quick: bool,
) -> None:
    """Time of every cue over the time of its focal stack."""
    if quick:
        shape, planes, repeats = "5x5x120x160", min(planes, 8), 2
    sizes = tuple(int(n) for n in shape.split("x"))
    device = Device.open(selector)
    values = np.random.default_rng(1).random(sizes, dtype=np.float32)
    field = values if dtype == "float32" else (values * np.iinfo(dtype).max).astype(dtype)
    lf = LightField.from_array(field, device=device)
    tried = np.linspace(-RANGE, RANGE, planes)

    def of(cue: str) -> Callable[[], Any]:
        return lambda: depth_map(lf, disparities=tried, cue=cue)

    cases = {"focal stack": lambda: focal_stack(lf, disparities=tried), **{c: of(c) for c in cues}}
    found = medians(cases, device, repeats)
    click.echo(f"{device!r}\n{shape} {dtype}, {planes} planes from {-RANGE} to {RANGE}\n")
    click.echo(f"{'':20s}{'ms':>10s}{'of the stack':>14s}")
    for name, seconds in found.items():
        click.echo(f"{name:20s}{1e3 * seconds:10.1f}{seconds / found['focal stack']:14.2f}")


if __name__ == "__main__":
    main()
