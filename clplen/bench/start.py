"""The first call in a fresh process with empty caches, beside the second one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from clplen.bench.measure import Case, Times
from clplen.bench.report import Benchmark, Goal, Report, time_rows
from clplen.compute.device import Device
from clplen.errors import ClplenError
from clplen.lightfield.model.light_field import LightField

SIZES = ("focal_stack", "depth_map", "depth_default", "propagate", "expose")
MOST_BEYOND = 5.0  # seconds
MOST_IMPORT = 0.5
_STEPS = ("import clplen", "open the device", "first call", "second call")
_BYTES = 2**30
_TIMEOUT = 300  # seconds
_CHILD = (
    "import sys, time; start = time.perf_counter(); import clplen; "
    "imported = time.perf_counter() - start; "
    "from clplen.bench.start import child; child(imported, *sys.argv[1:])"
)


def _needs(size: str) -> int:
    """About what a child takes."""
    _require_known(size)
    return _BYTES


def measure_start(device: Device, size: str, repeats: int) -> Report:
    """Times of a call in children that begin with empty caches."""
    _require_known(size)
    taken = [_cold(device.place, size) for _ in range(repeats)]
    cases = [Case(name, lambda: None, 1.0, "calls") for name in _STEPS]
    times = [
        Times(case, tuple(seconds))
        for case, seconds in zip(cases, zip(*taken, strict=True), strict=True)
    ]
    imported, opened, first, second = (one.median for one in times)
    beyond = opened + first - second
    goals = (
        Goal("opening and first call beyond the second, s", beyond, MOST_BEYOND, "at most"),
        Goal("import, s", imported, MOST_IMPORT, "at most"),
    )
    return Report("start", size, "time over the second call", time_rows(times, times[3]), goals)


def child(imported: float, place: str, size: str) -> None:
    """What a child does: prints the seconds of `_STEPS`."""
    from clplen.compute.device import Device

    start = perf_counter()
    device = Device.open(place)
    opened = perf_counter() - start
    call = _CALLS[size](device)
    seconds = []
    for _ in range(2):
        start = perf_counter()
        call()
        device.finish()
        seconds.append(perf_counter() - start)
    print(json.dumps([imported, opened, *seconds]))


def _cold(place: str, size: str) -> list[float]:
    """Seconds of `_STEPS` in a fresh process whose caches are empty."""
    with tempfile.TemporaryDirectory(prefix="clplen-start-") as name:
        (Path(name) / "pocl").mkdir()
        caches = {
            "XDG_CACHE_HOME": name,
            "POCL_CACHE_DIR": str(Path(name) / "pocl"),
            "CUDA_CACHE_PATH": str(Path(name) / "cuda"),
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        }
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", _CHILD, place, size],
            env=os.environ | caches,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT,
        )
    if done.returncode:
        raise ClplenError(f"A fresh process failed at {size}: {done.stderr.strip()[-500:]}")
    return [float(n) for n in json.loads(done.stdout.strip().splitlines()[-1])]


def _require_known(size: str) -> None:
    if size not in SIZES:
        raise ClplenError(f"A size of this benchmark is {', '.join(SIZES)}, not {size!r}.")


def _stack(device: Device) -> Callable[[], object]:
    import numpy as np

    from clplen.lightfield.focus_and_depth import focal_stack

    planes = np.linspace(-1, 1, 16)
    return lambda: focal_stack(_light_field(device), disparities=planes).to_numpy()


def _depth(device: Device) -> Callable[[], object]:
    import numpy as np

    from clplen.lightfield.focus_and_depth import depth_map

    planes = np.linspace(-1, 1, 16)
    return lambda: depth_map(_light_field(device), disparities=planes, cue="energy")


def _default(device: Device) -> Callable[[], object]:
    import numpy as np

    from clplen.lightfield.focus_and_depth import depth_map
    from clplen.lightfield.model import light_field

    values = np.random.default_rng(1).random((5, 5, 96, 128, 3), dtype=np.float32)

    def call() -> object:
        lf = light_field.LightField.from_array(values, device=device)
        return depth_map(lf, disparities=np.linspace(-1, 1, 9))

    return call


def _propagate(device: Device) -> Callable[[], object]:
    import numpy as np

    from clplen.wave.field.field import Field, Grid
    from clplen.wave.propagation.free_space import propagate

    grid = Grid((512, 512), 5e-6)

    def call() -> object:
        field = Field.from_array(np.ones(grid.shape), grid, wavelength=532e-9, device=device)
        return propagate(field, 0.05).to_numpy()

    return call


def _expose(device: Device) -> Callable[[], object]:
    from clplen import demo

    cam = demo.camera(device, count=53)
    return lambda: demo.expose_point(cam, (0.0, 0.0, demo.DEPTHS[0])).to_numpy()


def _light_field(device: Device) -> LightField:
    import numpy as np

    from clplen.lightfield.model import light_field

    values = np.random.default_rng(1).random((5, 5, 200, 200), dtype=np.float32)
    return light_field.LightField.from_array(values, device=device)


_CALLS = dict(zip(SIZES, (_stack, _depth, _default, _propagate, _expose), strict=True))
BENCHMARKS = (
    Benchmark(
        "start",
        "import, and the first call with empty kernel caches, beside the second",
        sizes=SIZES,
        quick="focal_stack",
        needs=_needs,
        run=measure_start,
        smaller=lambda size: "",
    ),
)
