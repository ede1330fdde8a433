"""Benchmark of the first call in a fresh process with empty caches, relative to the second."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from clplen.bench.measure import Case, Times
from clplen.bench.report import Benchmark, Report, time_rows
from clplen.compute.device import Device
from clplen.errors import ClplenError

_STEPS = ("import clplen", "open the device", "first call", "second call")
_BYTES = 2**30  # approximate memory of a child process
_TIMEOUT = 300  # seconds
# Statements that prepare a call, and the call, by size.
_CALLS = {
    "focal_stack": ("L = views(5, 5, 200, 200)", "focal_stack(L, disparities=planes).to_numpy()"),
    "depth_map": ("L = views(5, 5, 200, 200)", "depth_map(L, disparities=planes, cue='energy')"),
    "depth_default": ("L = views(5, 5, 96, 128, 3)", "depth_map(L, disparities=planes[::2])"),
    "propagate": (
        "grid = Grid((512, 512), 5e-6); ones = np.ones(grid.shape)",
        "propagate(Field.from_array(ones, grid, wavelength=532e-9, device=device), .05).to_numpy()",
    ),
    "expose": (
        "from clplen import demo; camera = demo.camera(device, count=53)",
        "demo.expose_point(camera, (0.0, 0.0, demo.DEPTHS[0])).to_numpy()",
    ),
}
_CHILD = """
import json, sys, time
begun = [time.perf_counter()]
import clplen
begun.append(time.perf_counter())
device = clplen.Device.open(sys.argv[1])
begun.append(time.perf_counter())
import numpy as np
from clplen import Field, Grid, LightField, depth_map, focal_stack, propagate
planes = np.linspace(-1, 1, 17)
def views(*shape):
    values = np.random.default_rng(1).random(shape, dtype=np.float32)
    return LightField.from_array(values, device=device)
{prepare}
taken = []
for _ in range(2):
    start = time.perf_counter()
    {call}
    device.finish()
    taken.append(time.perf_counter() - start)
print(json.dumps([begun[1] - begun[0], begun[2] - begun[1], *taken]))
"""


def measure_start(device: Device, size: str, repeats: int) -> Report:
    """Measure a call in child processes that start with empty caches."""
    runs = [_cold(device.place, size) for _ in range(repeats)]
    times = [
        Times(Case(name, lambda: None, 1.0, "calls"), tuple(seconds))
        for name, seconds in zip(_STEPS, zip(*runs, strict=True), strict=True)
    ]
    overhead = times[1].median + times[2].median - times[3].median
    note = f"Opening the device and the first call take {overhead:.2f} s more than the second call."
    return Report("start", size, "time over the second call", time_rows(times, times[3]), (note,))


def _cold(selector: str, size: str) -> list[float]:
    """Measure the seconds of `_STEPS` in a fresh process with empty caches."""
    prepare, call = _CALLS[size]
    with tempfile.TemporaryDirectory(prefix="clplen-start-") as name:
        (Path(name) / "pocl").mkdir()
        caches = {
            "XDG_CACHE_HOME": name,
            "POCL_CACHE_DIR": str(Path(name) / "pocl"),
            "CUDA_CACHE_PATH": str(Path(name) / "cuda"),
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        }
        child = _CHILD.format(prepare=prepare, call=call)
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", child, selector],
            env=os.environ | caches,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT,
        )
    if done.returncode:
        raise ClplenError(f"A fresh process failed at {size}: {done.stderr.strip()[-500:]}")
    return [float(n) for n in json.loads(done.stdout.strip().splitlines()[-1])]


def _needs(size: str) -> int:
    if size not in _CALLS:
        raise ClplenError(f"size must be among {', '.join(_CALLS)}, got {size!r}.")
    return _BYTES


BENCHMARKS = (
    Benchmark(
        "start",
        "import, and the first call with empty kernel caches, beside the second",
        sizes=tuple(_CALLS),
        quick="focal_stack",
        needs=_needs,
        run=measure_start,
    ),
)
