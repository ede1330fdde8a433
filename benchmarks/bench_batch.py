"""What a batch job costs beside its parts, and what overlap and workers gain.

    python benchmarks/bench_batch.py [--device pocl] [--small 200] [--large 16] [--side 512]

Small light fields (numbers of views, sizes, channels and types mixed) show the overhead: the time
of an item less reading, digests, `focal_stack` and writing with its fsync, each measured alone on
the same files. Large ones (9 x 9 views, 8 bits) show the overlap: the slowest of reading, computing
and writing alone over the time of the job; and two workers on two single-core devices beside one.
Only ratios and milliseconds of overhead mean something on another machine.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import batchworks

from clplen import Device, LightField, depth_map, focal_stack, io
from clplen.batch import Job, Report
from clplen.io import digest

local_executor = import_module("clplen.batch.running.job").local_executor
execute_job = import_module("clplen.batch.running.runner").execute_job
worker_environment = import_module("clplen.batch.running.worker").worker_environment
HostStack = import_module("clplen.batch.work.products").HostStack


class Quiet:
    """Keeps the reports."""

    def __init__(self) -> None:
        self.reports: list[Report] = []

    def begin(self, *, total: int, skipped: int) -> None:
        pass

    def report(self, report: Report) -> None:
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


def alone(
    files: list[Path], folder: Path, planes: np.ndarray, device: Device, cue: str | None = None
) -> dict[str, float]:
    """Seconds of each part for all files, one after the other."""
    seconds = dict.fromkeys(("read", "digest", "compute", "write"), 0.0)
    folder.mkdir()
    for file in files:
        taken, lf = timed(partial(read, file, device))
        seconds["read"] += taken
        taken, stack = timed(partial(focal_stack, lf, disparities=planes))
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
        taken, _ = timed(lambda file=file, target=target: (digest(file), digest(target)))
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


def write_large(folder: Path, count: int, side: int) -> list[Path]:
    """Light fields of 9 x 9 views of 8 bits."""
    folder.mkdir()
    random = np.random.default_rng(1)
    values = random.integers(0, 255, (9, 9, side, side), np.uint8)
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


WORKERS = """
import sys, time
from functools import partial
from pathlib import Path
from clplen.batch.running import cluster
from clplen.batch.running.runner import execute_job
sys.path.insert(0, {here!r})
from bench_batch import Quiet, job_of

if __name__ == "__main__":
    folder, workers, planes = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    how = dict(devices=[sys.argv[4]], memory=None, retries=1)
    for output in ("warm", "out"):
        job = job_of(folder, planes, f"{{output}}{{workers}}")
        watcher = Quiet()
        execute_job(job, partial(cluster.local_cluster, workers=workers, **how), watcher=watcher)
    first = min(r.started for r in watcher.reports)
    last = max(r.started + r.seconds["total"] for r in watcher.reports)
    print(last - first)
"""


def workers(device: Device, count: int, side: int, planes: int) -> None:
    """Two workers of one core each, beside one of one core."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_large(folder / "in", count, side)
        script = folder / "run.py"
        script.write_text(WORKERS.format(here=str(Path(__file__).parent)))
        seconds = []
        for n in (1, 2):
            cores = list(range(n))
            command = ["taskset", "-c", ",".join(map(str, cores)), sys.executable, str(script)]
            done = subprocess.run(
                [*command, str(folder), str(n), str(planes), device.place],
                env={**os.environ, **worker_environment([0])} if n == 1 else None,
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, done.stderr
            seconds.append(float(done.stdout.split()[-1]))
        print(f"one worker on one core {seconds[0]:.2f} s, two on two {seconds[1]:.2f} s:")
        print(f"  {seconds[0] / seconds[1]:.2f} times (goal 1.6)")


@click.command()
@click.option("--device", "selector", default=None)
@click.option("--small", default=200)
@click.option("--large", default=16)
@click.option("--side", default=512)
@click.option("--planes", default=33)
@click.option("--only", type=click.Choice(["overhead", "overlap", "workers"]))
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
    if only in (None, "workers"):
        workers(device, large, side, planes)


if __name__ == "__main__":
    main()
