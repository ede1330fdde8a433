"""The remedy for a CPU that PoCL's compiler does not know, with the fault put in on purpose.

Whatever builds a kernel here runs in a process of its own with fresh caches, because a wrong CPU
name aborts the process.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pyopencl as cl
import pytest
from forcing import caches_in, generic_environment

from clplen.compute import pocl
from clplen.errors import DeviceError

if not sys.platform.startswith("linux"):
    pytest.skip("PoCL's wheel exists for Linux only", allow_module_level=True)

FLAGS = "fpu sse2 avx"
HASWELL_FLAGS = f"{FLAGS} avx2 fma bmi1 bmi2 f16c abm"
THIS_CPU = pocl.cpu_name(pocl._cpuinfo().get("flags", ""))

OPEN = """
import sys
import pyopencl as cl
from clplen.compute import pocl
from clplen.errors import DeviceError
device = next(d for p in cl.get_platforms() if "PoCL" in p.version for d in p.get_devices())
try:
    print("said", pocl.ensure_usable(device))
except DeviceError as error:
    print("refused", error)
    sys.exit(3)
"""
# After the remedy: a kernel of one's own with 16-wide built-ins, x -> exp(x) / (1 + x * x).
RUN = """
import numpy as np
context = cl.Context([device])
queue = cl.CommandQueue(context)
x = np.linspace(-1.5, 2.0, 16, dtype=np.float32)
source = "kernel void f(global float16 *x) { x[0] = exp(x[0]) / fma(x[0], x[0], (float16)1.0f); }"
kernel = cl.Program(context, source).build(cache_dir=False).f
memory = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=x)
kernel(queue, (1,), None, memory)
y = np.empty_like(x)
cl.enqueue_copy(queue, y, memory)
twin = np.exp(x.astype(float)) / (1.0 + x.astype(float) ** 2)
assert np.abs(y / twin - 1.0).max() < 1e-6, y / twin
print("ran")
"""
NO_CHILD = "import sys; sys.executable = '/no/such/python'\n"


def wheel_is_here() -> bool:
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:
        return False
    return any(pocl.WHEEL.search(platform.version) for platform in platforms)


needs_wheel = pytest.mark.skipif(not wheel_is_here(), reason="PoCL's wheel is not installed")


def python(code: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=100
    )


def verdicts(folder: Path) -> list[Path]:
    return list(folder.glob("clplen/pocl-cpu-*"))


@needs_wheel
def test_without_the_remedy_the_error_says_what_to_install(tmp_path: Path) -> None:
    done = python(OPEN, generic_environment(tmp_path, CLPLEN_POCL_CPU="off"))
    assert done.returncode == 3, done.stderr
    assert "does not know this CPU" in done.stdout
    assert "CLPLEN_POCL_CPU=off" in done.stdout
    assert "apt install pocl-opencl-icd" in done.stdout
    assert 'pip install "clplen[intel]"' in done.stdout
    assert "pip install intel-opencl-rt intel-cmplr-lib-rt" in done.stdout


@needs_wheel
def test_with_the_remedy_kernels_build_and_run(tmp_path: Path) -> None:
    environment = generic_environment(tmp_path)
    refused = python(OPEN.replace("ensure_usable(device)", "_refusal(device)"), environment)
    assert refused.stdout == f"said {pocl.UNKNOWN_CPU}\n", refused.stderr
    done = python(OPEN + RUN, environment)
    assert done.stdout.endswith("ran\n"), done.stdout + done.stderr
    assert f"given the CPU name {THIS_CPU!r}" in done.stdout
    assert len(verdicts(tmp_path)) == 1


@needs_wheel
def test_the_trial_runs_once_and_its_verdict_is_kept(tmp_path: Path) -> None:
    environment = generic_environment(tmp_path)
    assert python(NO_CHILD + OPEN, environment).returncode == 3, "no child, yet no refusal"
    assert verdicts(tmp_path) == []
    assert python(OPEN, environment).returncode == 0
    second = python(NO_CHILD + OPEN + RUN, environment)
    assert second.stdout.endswith("ran\n"), second.stdout + second.stderr


@needs_wheel
def test_no_writable_cache_is_no_failure(tmp_path: Path) -> None:
    environment = generic_environment(tmp_path, PYOPENCL_NO_CACHE="1", XDG_CACHE_HOME="/proc/none")
    done = python(OPEN + RUN, environment)
    assert done.stdout.endswith("ran\n"), done.stdout + done.stderr


@needs_wheel
@pytest.mark.parametrize(
    "name",
    [
        "no-such-cpu",
        pytest.param(
            "haswell",
            marks=pytest.mark.skipif(THIS_CPU != "skylake-avx512", reason="needs AVX-512"),
        ),
    ],
)
def test_a_name_that_fails_is_refused_and_the_process_lives(tmp_path: Path, name: str) -> None:
    done = python(OPEN, generic_environment(tmp_path, CLPLEN_POCL_CPU=name))
    assert done.returncode == 3, done.stdout + done.stderr
    assert f"fails under the CPU name {name!r}" in done.stdout
    assert verdicts(tmp_path) == []


@needs_wheel
def test_a_verdict_holds_for_its_own_name_only(tmp_path: Path) -> None:
    assert python(OPEN, generic_environment(tmp_path)).returncode == 0
    done = python(OPEN, generic_environment(tmp_path, CLPLEN_POCL_CPU="no-such-cpu"))
    assert done.returncode == 3, done.stdout


@needs_wheel
def test_a_name_given_by_the_user_is_used(tmp_path: Path) -> None:
    done = python(OPEN + RUN, generic_environment(tmp_path, CLPLEN_POCL_CPU=THIS_CPU))
    assert f"given the CPU name {THIS_CPU!r}" in done.stdout, done.stdout + done.stderr
    assert done.stdout.endswith("ran\n"), done.stderr


@needs_wheel
def test_kernels_cached_earlier_do_not_hide_the_fault(tmp_path: Path) -> None:
    healthy = python(OPEN + RUN, caches_in(tmp_path))
    assert healthy.stdout.endswith("ran\n"), healthy.stdout + healthy.stderr
    done = python(OPEN, generic_environment(tmp_path, CLPLEN_POCL_CPU="off"))
    assert done.returncode == 3, done.stdout


@pytest.mark.parametrize(
    ("version", "refusal"),
    [
        ("OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, LLVM 14.0.6", "error: disk full"),
        ("OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, LLVM 14.0.6", pocl.UNKNOWN_CPU + " of 3"),
        ("OpenCL 3.0 PoCL 3.1+debian  Linux, LLVM 15.0.6", pocl.UNKNOWN_CPU),
        ("OpenCL 3.0 PoCL 6.0  Linux, LLVM 14.0.6", pocl.UNKNOWN_CPU),
    ],
)
def test_any_other_fault_is_reported_and_left_alone(
    monkeypatch: pytest.MonkeyPatch, version: str, refusal: str
) -> None:
    platform = SimpleNamespace(name="Portable Computing Language", version=version)
    device = SimpleNamespace(name="pthread", platform=platform, driver_version="?")
    monkeypatch.setattr(pocl, "_refusal", lambda device: refusal)
    monkeypatch.setattr(pocl, "_rename", lambda device, name: pytest.fail("memory was written"))
    with pytest.raises(DeviceError, match=f"cannot build kernels .{refusal}"):
        pocl.ensure_usable.__wrapped__(device)


def test_devices_of_others_are_not_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pocl, "_refusal", lambda device: pytest.fail("it was probed"))
    device = SimpleNamespace(platform=SimpleNamespace(name="NVIDIA CUDA"))
    assert pocl.ensure_usable.__wrapped__(device) == ""


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        (f"{HASWELL_FLAGS} avx512f", "skylake-avx512"),
        (HASWELL_FLAGS, "haswell"),
        (HASWELL_FLAGS.replace(" abm", ""), "sandybridge"),
        (HASWELL_FLAGS.replace(" fma", " fma4"), "sandybridge"),
        (FLAGS, "sandybridge"),
        ("fpu sse2", "x86-64"),
        ("", "x86-64"),
    ],
)
def test_the_name_fits_the_flags(flags: str, name: str) -> None:
    assert pocl.cpu_name(flags) == name


class Memory:
    """A page that looks like a device object: word 77 may point somewhere."""

    def __init__(self, target: int, *, start: int = 0, word: int = 77) -> None:
        self.page = mmap.mmap(-1, 4 * mmap.PAGESIZE)
        base = ctypes.addressof(ctypes.c_char.from_buffer(self.page))
        self.int_ptr = base + start
        ctypes.c_uint64.from_address(self.int_ptr + 8 * word).value = target


def heap_string(text: bytes) -> int:
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    return strdup(text)


def test_only_exactly_generic_is_renamed() -> None:
    memory = Memory(heap_string(b"generic"))
    assert pocl._rename(memory, "skylake-avx512")
    pointer = ctypes.c_uint64.from_address(memory.int_ptr + 8 * 77).value
    assert ctypes.string_at(pointer) == b"skylake-avx512"
    for text in (b"generic-arm", b"generi", b"icelake-client"):
        assert not pocl._rename(Memory(heap_string(text)), "haswell"), text


def test_the_search_stays_within_4_kilobytes() -> None:
    target = heap_string(b"generic")
    assert pocl._find_name(Memory(target, word=511), b"generic\0") is not None
    assert pocl._find_name(Memory(target, word=512), b"generic\0") is None


def test_memory_that_cannot_be_written_is_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "name"
    file.write_bytes(b"generic\0" + bytes(mmap.PAGESIZE))
    libc = ctypes.CDLL(None)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + [ctypes.c_int] * 3 + [ctypes.c_long]
    handle = os.open(file, os.O_RDONLY)
    address = libc.mmap(None, mmap.PAGESIZE, mmap.PROT_READ, mmap.MAP_PRIVATE, handle, 0)
    os.close(handle)
    assert ctypes.string_at(address) == b"generic"
    assert pocl._find_name(Memory(address), b"generic\0") is None


def test_a_device_object_at_the_end_of_its_mapping_is_read_to_the_end_only() -> None:
    code = """
import ctypes, mmap
from types import SimpleNamespace
from clplen.compute import pocl
page = mmap.PAGESIZE
libc = ctypes.CDLL(None)
libc.mmap.restype = ctypes.c_void_p
libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t] + [ctypes.c_int] * 3 + [ctypes.c_long]
libc.munmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
base = libc.mmap(None, 3 * page, mmap.PROT_READ | mmap.PROT_WRITE, kind, -1, 0)
libc.munmap(base + page, 2 * page)  # nothing is mapped behind the first page
last = ctypes.c_uint64.from_address(base + page - 8)
last.value = base + page - 4  # a string that would run over the end
print(pocl._find_name(SimpleNamespace(int_ptr=base + page - 64), b"generic\\0"))
"""
    done = python(code, dict(os.environ) | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.stdout == "None\n", done.stderr
