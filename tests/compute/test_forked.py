"""A process forked from one that used a device says so; it neither waits for ever nor crashes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clplen.compute.device import Device

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")

# What the scripts below share: a device that was used, and one that works in another thread.
USED = """
import gc, multiprocessing, os, sys, threading, warnings
from concurrent.futures import ProcessPoolExecutor
import numpy as np
import clplen

warnings.simplefilter("ignore")  # newer Pythons advise against forks of threads
device = clplen.Device.open(sys.argv[1])
grid = clplen.Grid((64, 64), 1e-6)
field = clplen.wave.plane_wave(grid, wavelength=5e-7, device=device)
plan = clplen.Propagator(grid, 1e-3, wavelength=5e-7, device=device)
plan(field)
lf = clplen.LightField.from_array(np.ones((3, 3, 16, 16), "f4"), device=device)
stack = clplen.focal_stack(lf, disparities=[0, 1])
picture = lf.view(1, 1)
picture.to_numpy()
large = device.upload(np.ones(2**21, np.float32))


def say(work):
    try:
        return f"came back {work()!r}"
    except clplen.ClplenError as error:
        return f"{type(error).__name__}: {error}"
"""

WAYS = {
    "an image": "picture.to_numpy()",
    "an image by numpy": "np.asarray(picture)",
    "pyopencl's own get": "picture.data.get()",
    "a sum by pyopencl": "picture.data + picture.data",
    "opening": "clplen.Device.open()",
    "opening it again": "clplen.Device.open(sys.argv[1], precision='double')",
    "all devices": "clplen.Device.all()",
    "upload": "device.upload(np.ones(4))",
    "large upload": "device.upload(np.ones(2**22))",
    "spare memory": "device.free_spare()",
    "mapping": "device.on_host(large).__enter__()",
    "finish": "device.finish()",
    "queue": "device.queue",
    "context": "device.context",
    "profiling": "device.profiling().__enter__()",
    "light field": "clplen.LightField.from_array(np.ones((3, 3, 8, 8)), device=device)",
    "view": "lf.view(0, 0)",
    "stack": "clplen.focal_stack(lf, disparities=[0, 1])",
    "new wave": "clplen.wave.plane_wave(grid, wavelength=5e-7, device=device)",
    "a plan": "plan(field)",
    "a new plan": "clplen.propagate(field, 2e-3)",
}

FORK = """
WAYS = {ways!r}
held = [device._lock, device._maps_lock, device.plans._lock, device.tables._lock, plan._lock,
        device.workspace._lock, device.tuning._lock]
ready, leave = threading.Event(), threading.Event()


def hold():  # another thread is in the midst of its work when the process forks
    for lock in held:
        lock.__enter__()
    ready.set()
    leave.wait()
    for lock in reversed(held):
        lock.__exit__(None, None, None)


thread = threading.Thread(target=hold)
thread.start()
ready.wait()
child = os.fork()
if not child:
    for way, work in WAYS.items():
        print(way, "|", say(lambda: eval(work)), flush=True)
    print(repr(device)[:8], repr(picture)[:7], flush=True)
    del picture, stack, lf, plan, field, large, device
    gc.collect()
    print("collected", flush=True)
    sys.exit(7)
leave.set()
thread.join()
print("child", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
print("parent", clplen.focal_stack(lf, disparities=[0]).to_numpy().sum(), picture.to_numpy().sum())
"""

POOLS = """
class Views:  # as a data loader's worker reads them
    def __getitem__(self, index):
        return lf.view(0, index).to_numpy()


views = Views()
fork = multiprocessing.get_context("fork")


def read(index):
    return say(lambda: views[index])


def take(picture):
    return say(lambda: picture.to_numpy())


def fails(index):
    return views[index]


with fork.Pool(2) as pool:
    print(*pool.map(read, range(2)), *pool.map(take, [picture]), sep="\\n")
with ProcessPoolExecutor(1, mp_context=fork) as pool:
    print(*pool.map(read, range(2)), *pool.map(take, [picture]), sep="\\n")
    print(say(lambda: pool.submit(fails, 0).result()))
process = fork.Process(target=print, args=("nothing of OpenCL",))
process.start()
process.join()
print(process.exitcode)
"""

FRESH = """
import multiprocessing, os, sys
import numpy as np
import clplen


def work(selector):
    device = clplen.Device.open(selector)
    return device.download(device.upload(np.ones(2**20))).sum()


if __name__ == "__main__":
    method = sys.argv[2]
    if method == "spawn":
        print(work(sys.argv[1]))
    with multiprocessing.get_context(method).Pool(1) as pool:
        print(pool.apply(work, (sys.argv[1],)))
    print(work(sys.argv[1]))
"""


def run(tmp_path: Path, text: str, *arguments: str) -> list[str]:
    """Lines that a script prints; it ends well, in time, and says nothing else."""
    script = tmp_path / "script.py"
    script.write_text(text)
    done = subprocess.run(
        [sys.executable, str(script), *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return done.stdout.splitlines()


def says_spawn(line: str) -> bool:
    return "DeviceError: " in line and 'multiprocessing.get_context("spawn")' in line


def test_every_way_to_a_device_is_refused_in_a_fork(device: Device, tmp_path: Path) -> None:
    lines = run(tmp_path, USED + FORK.format(ways=WAYS), device.place)
    assert [line.split(" | ")[0] for line in lines[: len(WAYS)]] == list(WAYS)
    assert [line for line in lines[: len(WAYS)] if not says_spawn(line)] == []
    assert lines[len(WAYS) :] == ["<Device  <Image ", "collected", "child 7", "parent 256.0 256.0"]


@pytest.mark.thorough
def test_pools_of_forked_processes_are_refused(device: Device, tmp_path: Path) -> None:
    lines = run(tmp_path, USED + POOLS, device.place)
    assert [line for line in lines[:7] if not says_spawn(line)] == []
    assert lines[7:] == ["nothing of OpenCL", "0"]


@pytest.mark.parametrize("method", ["spawn", pytest.param("fork", marks=pytest.mark.thorough)])
def test_processes_that_open_their_own_device_work(
    device: Device, tmp_path: Path, method: str
) -> None:
    lines = run(tmp_path, FRESH, device.place, method)
    assert set(lines) == {str(2.0**20)}
