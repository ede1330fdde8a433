"""What does not fit into a limit of memory is refused in a sentence, and nothing dies."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from clplen.compute import memory
from clplen.compute.device import Device
from clplen.compute.drivers import limits
from clplen.compute.drivers.limits import Room
from clplen.errors import DeviceError

WITHIN = """
import resource, sys, warnings
import numpy as np
import clplen
warnings.simplefilter("ignore")
device = clplen.Device.open(sys.argv[1])
lf = clplen.LightField.from_array(np.zeros((3, 5, 30, 40), np.uint8), device=device)
clplen.refocus(lf, disparity=0.5).to_numpy()
field = clplen.wave.plane_wave(clplen.Grid((900, 700), 5e-6), wavelength=5e-7, device=device)
large, whole = np.zeros(90_000_000, np.uint8), device.empty((90_000_000,), np.uint8)
used = int(open("/proc/self/statm").read().split()[int(sys.argv[3])]) * resource.getpagesize()
most = used + (260 << 20)
resource.setrlimit(getattr(resource, sys.argv[2]), (most, most))
kept = []
def small():
    kept.clear()
    for _ in range(200):
        kept.append(device.zeros((900, 1000), np.float32))
        device.finish()
steps = {
    "small": small,
    "small and untouched": lambda: [device.empty((900, 1000), np.float32) for _ in range(200)],
    "small uploads": lambda: [device.upload(large[:3_000_000]) for _ in range(200)],
    "upload": lambda: device.upload(large),
    "large": lambda: device.zeros((100_000_000,), np.uint8),
    "download": lambda: device.download(whole),
    "stack": lambda: clplen.focal_stack(lf, disparities=np.linspace(-1, 1, 20_000)),
    "fields": lambda: kept.extend(clplen.propagate(field, 5e-3 + n * 1e-3) for n in range(60)),
}
for name, step in steps.items():
    kept.clear()
    try:
        step()
    except clplen.DeviceError as error:
        assert "needs" in str(error) and "bytes" in str(error) and "limit" in str(error), error
        assert "\\n" not in str(error)
        print(name)
kept.clear()
assert device.download(device.upload(np.arange(7))).tolist() == list(range(7))
"""
STEPS = "small,small and untouched,small uploads,upload,large,download,stack,fields"


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space as Linux has them")
@pytest.mark.parametrize(
    ("limit", "place"),
    [("RLIMIT_AS", 0), pytest.param("RLIMIT_DATA", 5, marks=pytest.mark.thorough)],
)
def test_a_limit_of_the_process(device: Device, limit: str, place: int) -> None:
    """Every step is refused with the bytes; afterwards what is small works as before."""
    if not device.is_cpu:
        pytest.skip("a GPU's arrays are not host memory")
    done = subprocess.run(
        [sys.executable, "-c", WITHIN, device.place, limit, str(place)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout.split("\n")[:-1]) == (0, STEPS.split(",")), done.stderr


LOADING = """
import resource, clplen
clplen.Device
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (150 << 20),) * 2)
try:
    clplen.Device.open()
except clplen.DeviceError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space as Linux has them")
def test_drivers_are_not_loaded_where_they_do_not_fit() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADING], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Loading the OpenCL drivers needs ")
    assert "limit of address space (ulimit -v)" in done.stdout


def test_a_kernel_is_not_built_where_its_compiler_does_not_fit(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = Device(device.cl_device)
    if not fresh.is_cpu:
        pytest.skip("the compiler of a GPU's driver is not known")
    left = [limits.FIRST_BUILD_BYTES - 1]
    monkeypatch.setattr(limits, "process_room", lambda: Room(left[0], "the limit"))
    with pytest.raises(DeviceError, match=r"Building .*'multiply.cl' needs .*the limit leaves"):
        fresh.kernel("multiply.cl", "multiply")
    left[0] += 1
    kernel, one = fresh.kernel("multiply.cl", "multiply"), fresh.zeros((1, 1), np.complex64)
    left[0] = limits.BUILD_BYTES - 1
    with pytest.raises(DeviceError, match="Running a kernel needs"):
        fresh.launch(kernel, (1,), one, one, one, np.int32(1), np.int32(1))


def files(folder: Path, numbers: dict[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in numbers.items():
        (folder / name).write_text(text)


GROUPS = {
    "version 2": (
        "0::/slice/job\n",
        {
            "slice/job": ("max", "3000000", "anon 1\ninactive_file 7\n"),
            "slice": ("900000000", "800000000", "anon 1\ninactive_file 1000\nactive_file 9\n"),
        },
        ("memory.max", "memory.current"),
        100_001_000,
    ),
    "version 1": (
        "9:name=systemd:/\n4:cpu,memory:/job\n0::/\n",
        {
            "memory/job": ("500000000", "460000000", "inactive_file 5\ntotal_inactive_file 2000\n"),
            "memory": ("9223372036854771712", "900000000", "total_inactive_file 0\n"),
        },
        ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        40_002_000,
    ),
    "inside a container": (
        "4:memory:/docker/of/the/host\n",
        {"memory": ("700000000", "200000000", "total_inactive_file 0\n")},
        ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        500_000_000,
    ),
    "none": (
        "0::/\n",
        {".": ("max", "7", "inactive_file 1\n")},
        ("memory.max", "memory.current"),
        None,
    ),
}


@pytest.mark.parametrize("name", GROUPS)
def test_limits_of_control_groups(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    """The narrowest group counts, less what it can drop; arrays beyond it are refused."""
    lines, groups, (limit, usage), left = GROUPS[name]
    for folder, (most, used, stat) in groups.items():
        files(tmp_path / "groups" / folder, {limit: most, usage: used, "memory.stat": stat})
    (tmp_path / "cgroup").write_text(lines)
    read = limits._read
    monkeypatch.setattr(limits, "_GROUPS", tmp_path / "groups")
    monkeypatch.setattr(
        limits,
        "_read",
        lambda path: read(tmp_path / "cgroup" if path == Path("/proc/self/cgroup") else path),
    )
    limits._groups.cache_clear()
    try:
        if left is None:
            assert limits.group_room().nbytes == sys.maxsize
            return
        assert limits.group_room().nbytes == left
        assert memory.free_memory() <= left
        room = left - limits.GROUP_RESERVE_BYTES
        if device.is_cpu:
            with pytest.raises(DeviceError, match=r"needs .*control group.* raise the limit"):
                device.empty((left + 1,), np.uint8)
            with pytest.raises(DeviceError, match=r"This stack needs .*control group"):
                device.require_memory(left + device.held_bytes() + 1, "This stack")
            assert room < memory.MIN_LARGE_BYTES or device.empty((room - 2**21,), np.uint8).nbytes
    finally:
        limits._groups.cache_clear()


def test_what_is_kept_is_given_back_before_an_array_is_refused(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = Device(device.cl_device)
    fresh.is_cpu = True
    fresh.plans.keep("kept", "plan", 7)
    monkeypatch.setattr(
        limits, "array_room", lambda _: Room(0 if len(fresh.plans) else 2**40, "it")
    )
    assert fresh.empty((memory.MIN_LARGE_BYTES,), np.uint8).nbytes == memory.MIN_LARGE_BYTES
    assert len(fresh.plans) == 0


def test_a_system_that_says_nothing_has_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(path: Path) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(limits, "_read", missing)
    monkeypatch.setattr(limits, "resource", None)
    monkeypatch.setattr(limits, "os", SimpleNamespace(cpu_count=os.cpu_count))
    limits._groups.cache_clear()
    try:
        limits.require_driver_room()
        limits.require_build_room("It", first=True)
        assert limits.array_room(2**30).nbytes > 2**50
        assert memory.free_memory() == 4 << 30
    finally:
        limits._groups.cache_clear()
