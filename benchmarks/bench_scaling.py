"""How the time of an item grows with views, pixels and planes, stage by stage.

    python benchmarks/bench_scaling.py [--device pocl] [--repeats 3]

From 9 x 9 views of 512 x 512 pixels of 8 bits and 33 planes one number is changed at a time. Times
are those of the item's own record, one item at a time, the median of several; written is what the
stack takes as OME-TIFF with its fsync, digests are those of input and output.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from importlib import import_module
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from bench_batch import Quiet, job_of

from clplen import Device

local_executor = import_module("clplen.batch.running.job").local_executor
execute_job = import_module("clplen.batch.running.runner").execute_job

BASE = (9, 512, 33)
CASES = (
    BASE,
    (5, 512, 33),
    (17, 512, 33),
    (9, 256, 33),
    (9, 1024, 33),
    (9, 512, 9),
    (9, 512, 129),
)
STAGES = ("read", "compute", "write", "digest")


def seconds(device: Device, views: int, side: int, planes: int, repeats: int) -> dict[str, float]:
    """Median of each stage."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "in").mkdir()
        random = np.random.default_rng(1)
        for i in range(repeats + 1):
            values = random.integers(0, 255, (views, views, side, side), np.uint8)
            np.save(folder / "in" / f"{i}.npy", values)
        watcher = Quiet()
        executor = partial(local_executor, selector=device.place, memory=None, depth=1)
        execute_job(job_of(folder, planes), executor, watcher=watcher)
        kept = watcher.reports[1:]  # the first one compiles
        return {stage: float(np.median([r.seconds[stage] for r in kept])) for stage in STAGES}


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--repeats", default=3)
def main(selector: str | None, repeats: int) -> None:
    """A table."""
    device = Device.open(selector)
    print(repr(device))
    print("| views | pixels | planes | rays | read | compute | write | digest | bound by |")
    print("|---|---|---|---|---|---|---|---|---|")
    for views, side, planes in CASES:
        found = seconds(device, views, side, planes, repeats)
        rays = views**2 * side**2 * planes
        times = " | ".join(f"{1e3 * found[stage]:.0f} ms" for stage in STAGES)
        bound = max(found, key=lambda stage: found[stage])
        print(
            f"| {views} x {views} | {side}^2 | {planes} | {rays / 1e9:.2f} G | {times} | {bound} |"
        )


if __name__ == "__main__":
    main()
