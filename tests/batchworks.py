"""Small light fields of many kinds for batch jobs, and what their outputs have to be."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tifffile

from clplen import Device, LightField, all_in_focus, depth_map, focal_stack, read_lightfield
from clplen.batch import Job
from clplen.batch.jobs.task import Report
from clplen.batch.running import runner
from clplen.batch.running.job import local_executor
from clplen.batch.running.runner import Summary, execute_job

PLANES = np.linspace(-1, 1, 5)
WORK = """
[stack]
disparities = "-1:1:5"
[depth]
disparities = "-1:1:5"
cue = "energy"
[all_in_focus]
"""
OUTPUTS = ("stack.ome.tif", "depth.ome.tif", "all_in_focus.ome.tif")
_TYPES = (np.uint8, np.uint16, np.float32)


def write_inputs(folder: Path, count: int, *, seed: int = 0, largest: int = 48) -> list[Path]:
    """Light fields of mixed numbers of views, sizes, channels, types and kinds of file."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for i in range(count):
        views = tuple(int(n) for n in random.integers(2, 6, 2))
        size = tuple(int(n) for n in random.integers(12, largest, 2))
        shape = (*views, *size, *((3,) if i % 3 == 0 else ()))
        kind = np.dtype(_TYPES[i % 3])
        scale = {1: 255, 2: 65535, 4: 1}[kind.itemsize]
        values = (scale * random.random(shape)).astype(kind)
        stem = folder / f"field_{i:03d}"
        if i % 2:
            np.save(stem.with_suffix(".npy"), values)
            files.append(stem.with_suffix(".npy"))
        else:
            with h5py.File(stem.with_suffix(".h5"), "w") as file:
                file["lightfield"] = values
            files.append(stem.with_suffix(".h5"))
    return files


def expected(path: Path, device: Device) -> dict[str, np.ndarray[Any, Any]]:
    """What the job of `WORK` makes of a file, in core."""
    return expected_of(read_lightfield(path, device=device))


def expected_of(lf: LightField) -> dict[str, np.ndarray[Any, Any]]:
    """The same of a light field."""
    depth = depth_map(lf, disparities=PLANES, cue="energy")
    return {
        "stack.ome.tif": focal_stack(lf, disparities=PLANES).to_numpy(),
        "depth.ome.tif": np.stack([depth.disparity, depth.confidence]),
        "all_in_focus.ome.tif": all_in_focus(lf, depth=depth).to_numpy(),
    }


def write_job(folder: Path, *, files: str = "in/*", output: str = "out", more: str = "") -> Path:
    """A job file over all inputs."""
    path = folder / "job.toml"
    path.write_text(f'output = "{output}"\n{more}\n[[inputs]]\nfiles = "{files}"\n{WORK}')
    return path


def wrong_outputs(out: Path, files: list[Path], device: Device) -> list[str]:
    """What is not as it has to be, in words."""
    wrong = []
    for file in files:
        for name, values in expected(file, device).items():
            path = out / file.stem / name
            if not path.exists():
                wrong.append(f"{path} is missing")
                continue
            found = tifffile.imread(path)
            if found.shape != values.shape or not np.array_equal(found, values):
                wrong.append(f"{path} differs")
    return wrong


def strays(out: Path) -> list[Path]:
    """Files that no run should leave: temporary ones, and what no item made."""
    known = {*OUTPUTS, "item.json"}
    return [
        path
        for path in out.rglob("*")
        if path.is_file()
        and path.parent != out
        and ".clplen" not in path.parts
        and path.name not in known
    ]


class Watcher(runner.Watcher):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.reports: list[Report] = []
        self.skipped = -1

    def begin(self, *, total: int, skipped: int) -> None:
        self.skipped = skipped

    def report(self, report: Report) -> None:
        self.reports.append(report)


def run(job: Job | Path, device: Device, **how: Any) -> tuple[Summary, Watcher]:
    """Run a job in this process."""
    watcher = Watcher()
    executor = partial(local_executor, selector=device.place, memory=how.pop("memory", None))
    chosen = job if isinstance(job, Job) else Job.read(job)
    return execute_job(chosen, executor, watcher=watcher, **how), watcher
