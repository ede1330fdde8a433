"""Cost of a batch job beside its parts, gain by overlap, and time of items by stage.

    python -m benchmarks speed/batch [--device pocl] [--small 200] [--large 16] [--side 512]

Small light fields (numbers of views, sizes, channels and types mixed) show the overhead: the time
of an item less reading, digests, `focal_stack` and writing with its fsync, each measured alone on
the same files. Large ones (9 x 9 views, 8 bits) show the overlap: the slowest of reading, computing
and writing alone over the time of the job. "scaling" changes views, pixels or planes.
Only ratios and milliseconds of overhead mean something on another machine.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import batchworks
import click
import numpy as np
from batchworks import execute_job, local_executor

from clplen import Device, FocalStack, LightField, depth_map, focal_stack, io
from clplen.batch import Job

STAGES = ("read", "compute", "write", "digest")


class Quiet:
    """Keeps the reports."""

    def __init__(self) -> None:
        self.reports: list[Any] = []

    def begin(self, *, total: int, skipped: int) -> None:
        pass

    def report(self, report: Any) -> None:
        assert report.state == "done", report.error
        self.reports.append(report)


def job_of(folder: Path, planes: int, output: str = "out", cue: str | None = None) -> Job:
    """A stack of all files, and their depth by a cue."""
    disparities = list(np.linspace(-1, 1, planes))
    return Job(
        output=output,
        inputs=[{"files": "in/*"}],
        stack={"disparities": disparities},
        depth={"disparities": disparities, "cue": cue} if cue else None,
    ).relative_to(folder)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.perf_counter()
    found = work()
    return time.perf_counter() - begun, found


def read(path: Path, device: Device) -> LightField:
    with io.open_lightfield(path, device=device) as stored:
        return LightField.from_array(stored.read((slice(None),) * 4), device=device)


def stack_of(lf: LightField, planes: np.ndarray, device: Device) -> FocalStack:
    stack = focal_stack(lf, disparities=planes)
    device.finish()
    return stack


def alone(
    files: list[Path], folder: Path, planes: np.ndarray, device: Device, cue: str | None = None
) -> dict[str, float]:
    """Seconds of each part for all files, one after the other."""
    seconds = dict.fromkeys(("read", "digest", "compute", "write"), 0.0)
    folder.mkdir()
    for file in files:
        taken, lf = timed(partial(read, file, device))
        seconds["read"] += taken
        taken, stack = timed(partial(stack_of, lf, planes, device))
        seconds["compute"] += taken
        target = folder / f"{file.stem}.ome.tif"
        taken, _ = timed(partial(io.write_stack, target, stack, durable=True))
        seconds["write"] += taken
        if cue:
            taken, depth = timed(lambda lf=lf: depth_map(lf, disparities=planes, cue=cue))
            seconds["compute"] += taken
            other = folder / f"{file.stem}_depth.ome.tif"
            taken, _ = timed(partial(io.write_depth, other, depth, durable=True))
            seconds["write"] += taken
        for stored in (file, target):
            taken, _ = timed(lambda stored=stored: sha256(stored.read_bytes()))
            seconds["digest"] += taken
    return seconds


def overhead(device: Device, count: int) -> None:
    """Milliseconds of a small item beside its parts."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = batchworks.write_inputs(folder / "in", count)
        planes = np.linspace(-1, 1, 9)
        alone(files, folder / "warm", planes, device)
        parts = alone(files, folder / "alone", planes, device)
        watcher = Quiet()
        executor = partial(local_executor, selector=device.place, memory=None)
        one = partial(executor, depth=1)
        taken, _ = timed(lambda: execute_job(job_of(folder, 9, "one"), one, watcher=watcher))
        wall, _ = timed(lambda: execute_job(job_of(folder, 9), executor, watcher=Quiet()))
        item = sum(r.seconds["total"] for r in watcher.reports)
        said = ", ".join(f"{part} {1e3 * taken / count:.2f}" for part, taken in parts.items())
        print(f"{count} small items, milliseconds each: parts alone {said}")
        rest = 1e3 * (item - sum(parts.values())) / count
        print(f"  one at a time {1e3 * item / count:.2f}: overhead {rest:.2f} ms (goal 10)")
        rest = 1e3 * (taken - sum(parts.values())) / count
        print(f"  with the manifest and the start of the job: overhead {rest:.2f} ms")
        print(f"  wall time of the job with overlap {1e3 * wall / count:.2f} an item")


def write_large(folder: Path, count: int, side: int, views: int = 9) -> list[Path]:
    """Light fields of 8 bits."""
    folder.mkdir()
    random = np.random.default_rng(1)
    values = random.integers(0, 255, (views, views, side, side), np.uint8)
    for i in range(count):
        values[0, 0, 0, 0] = i
        np.save(folder / f"large_{i:03d}.npy", values)
    return sorted(folder.iterdir())


def overlap(
    device: Device, count: int, side: int, planes: int, cue: str | None, rounds: int = 3
) -> None:
    """Throughput over that of the slowest part alone; medians of rounds in turns, as disks vary."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = write_large(folder / "in", count, side)
        some = np.linspace(-1, 1, planes)
        alone(files[:2], folder / "warm", some, device, cue)
        executor = partial(local_executor, selector=device.place, memory=None)
        found, walls = [], []
        for i in range(rounds):
            found.append(alone(files, folder / f"alone{i}", some, device, cue))
            shutil.rmtree(folder / f"alone{i}")
            job = job_of(folder, planes, f"out{i}", cue)
            walls.append(timed(lambda job=job: execute_job(job, executor, watcher=Quiet()))[0])
            shutil.rmtree(folder / f"out{i}")
        parts = {part: float(np.median([one[part] for one in found])) for part in found[0]}
        wall = float(np.median(walls))
        said = ", ".join(f"{part} {taken:.2f}" for part, taken in parts.items())
        print(f"{count} x 9 x 9 x {side}^2, {planes} planes, {cue}, seconds: alone {said}")
        ratio = max(parts.values()) / wall
        print(
            f"  the job {wall:.2f}: {ratio:.2f} of the slowest part (goal .8), one after the other "
            f"{sum(parts.values()):.2f}"
        )


def scaling(device: Device, repeats: int) -> None:
    """Median seconds of each stage as one number of 9 x 9 views of 512^2, 33 planes changes."""
    base = (9, 512, 33)
    cases = (base, (5, 512, 33), (17, 512, 33), (9, 256, 33), (9, 1024, 33), (9, 512, 9),
             (9, 512, 129))  # fmt: skip
    print("| views | pixels | planes | rays | " + " | ".join(STAGES) + " |\n" + "|---" * 8 + "|")
    for views, side, planes in cases:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_large(folder / "in", repeats + 1, side, views)
            watcher = Quiet()
            executor = partial(local_executor, selector=device.place, memory=None, depth=1)
            execute_job(job_of(folder, planes), executor, watcher=watcher)
        reports = watcher.reports[1:]  # the first one compiles
        medians = (np.median([r.seconds[stage] for r in reports]) for stage in STAGES)
        times = " | ".join(f"{1e3 * median:.0f} ms" for median in medians)
        rays = views**2 * side**2 * planes / 1e9
        print(f"| {views} x {views} | {side}^2 | {planes} | {rays:.2f} G | {times} |")


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--small", default=200)
@click.option("--large", default=16)
@click.option("--side", default=512)
@click.option("--planes", default=33)
@click.option("--only", type=click.Choice(["overhead", "overlap", "scaling"]))
def main(
    selector: str | None, small: int, large: int, side: int, planes: int, only: str | None
) -> None:
    """All three."""
    device = Device.open(selector)
    print(repr(device))
    if only in (None, "overhead"):
        overhead(device, small)
    if only in (None, "overlap"):
        overlap(device, large, side, planes, None)
        overlap(device, large, side, planes, "energy")
        overlap(device, max(large // 4, 4), side, planes, "combined")
    if only in (None, "scaling"):
        scaling(device, 3)
