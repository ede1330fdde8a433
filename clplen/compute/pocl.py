"""Make PoCL's wheel work on a CPU that is newer than its compiler.

The wheel ``pocl-binary-distribution`` is PoCL 3.0 with LLVM 14. On a CPU that this LLVM does not
know (AMD family 26, Zen 5, for one) the device looks healthy, but every build ends in
``error: unknown target CPU 'generic'`` (pocl/pocl issues 1049 and 512), and neither a build option
nor an environment variable changes the name. PoCL keeps it as a heap string behind a pointer in
its device object, so that is where the remedy writes another one: the one that fits the CPU's
flags. Then everything builds and runs at full speed.

Why this is safe enough to do:

- It is done only after a one-line kernel was refused with exactly that message by exactly that
  PoCL. The probe's source may stay the same: PoCL 3.0 starts its compiler before it looks into
  its cache, so a kernel cached earlier does not hide the fault.
- Only a pointer into readable and writable memory, to exactly ``generic`` and a zero byte, within
  the first 4 kB of the device object is replaced.
- A name that does not fit PoCL's built-in library makes LLVM abort the process as soon as a wide
  built-in is used. So a child process tries the name first, with 16-wide sincos, fma and mad in a
  kernel cache of its own. Its verdict is kept in the user's cache folder.

``CLPLEN_POCL_CPU=off`` switches the remedy off; any other value is the name to give.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyopencl as cl

from clplen.compute.cachedir import cache_dir
from clplen.errors import DeviceError

UNKNOWN_CPU = "error: unknown target CPU 'generic'"
WHEEL = re.compile(r"PoCL 3\.0\b.*\bLLVM 14\.")
PROBE = "kernel void probe(global int *a) { a[0] = 1; }"
WIDE_PROBE = """
kernel void probe(global float16 *x)
{
    float16 c, s = sincos(x[0], &c);
    x[0] = mad(s, c, fma(s, s, c * c));
}
"""
TRIAL_SECONDS = 120
# Of the package only what the trial needs is imported: the whole takes as long as the trial.
_CHILD = (
    "import sys, types; package = types.ModuleType('clplen'); package.__path__ = [sys.argv[1]]; "
    "sys.modules['clplen'] = package; from clplen.compute.pocl import try_name; "
    "try_name(sys.argv[2])"
)
SEARCHED_BYTES = 4096
INSTEAD = (
    "install another OpenCL driver for the CPU: `apt install pocl-opencl-icd` (Debian, Ubuntu) or "
    '`pip install "clplen[intel]"` (that is `pip install intel-opencl-rt intel-cmplr-lib-rt`)'
)


@functools.cache
def ensure_usable(device: cl.Device) -> str:
    """Build a one-line kernel on a PoCL device and apply the remedy if it needs it.

    The work is done once per device and process; later calls return the same sentence.

    Parameters
    ----------
    device : pyopencl.Device
        Any device; one that is not PoCL's is left alone.

    Returns
    -------
    str
        Empty when nothing had to be done, else one sentence that says what was done.

    Raises
    ------
    DeviceError
        The device cannot build kernels and the remedy does not apply, is switched off or failed.
    """
    if device.platform.name != "Portable Computing Language":
        return ""
    refusal = _refusal(device)
    if not refusal:
        return ""
    if refusal != UNKNOWN_CPU or not WHEEL.search(device.platform.version):
        raise DeviceError(f"{device.name} cannot build kernels ({refusal}); {INSTEAD}")
    name = os.environ.get("CLPLEN_POCL_CPU") or cpu_name(_cpuinfo().get("flags", ""))
    unknown = f"The compiler of PoCL {device.driver_version} does not know this CPU"
    if name == "off":
        raise DeviceError(f"{unknown} and CLPLEN_POCL_CPU=off forbids the remedy; {INSTEAD}")
    if not _survives(name, device.driver_version) or not _rename(device, name):
        raise DeviceError(f"{unknown} and fails under the CPU name {name!r}; {INSTEAD}")
    return f"{unknown}; it was given the CPU name {name!r} (CLPLEN_POCL_CPU=off forbids this)."


def cpu_name(flags: str) -> str:
    """Choose the CPU name that matches the built-in library PoCL picks by CPU flags.

    Parameters
    ----------
    flags : str
        The line ``flags`` of ``/proc/cpuinfo``, words separated by spaces.

    Returns
    -------
    str
        A name that LLVM 14 knows.
    """
    have = set(flags.split())
    if "avx512f" in have:
        return "skylake-avx512"
    if {"avx2", "fma", "bmi1", "bmi2", "f16c", "abm"} <= have:  # abm is the kernel's lzcnt
        return "haswell"
    return "sandybridge" if "avx" in have else "x86-64"


def _cpuinfo() -> dict[str, str]:
    """Read the first processor's entry of ``/proc/cpuinfo``."""
    entry = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
    pairs = (line.partition(":") for line in entry.splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _refusal(device: cl.Device) -> str:
    """Build the one-line kernel; return the compiler's first complaint, empty if it builds."""
    program = cl.Program(cl.Context([device]), PROBE)
    try:
        program.build()
    except cl.Error as error:
        lines = str(error).splitlines()
        return next((line for line in lines if line.startswith("error:")), lines[0])
    return ""


def _rename(device: cl.Device, name: str) -> bool:
    """Point the device's CPU name to another string, if it is 'generic' now.

    The new string is the C library's, never freed here, as PoCL would have made it itself.
    """
    found = _find_name(device, b"generic\0")
    if found is None:
        return False
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    found.value = strdup(name.encode())
    return True


def _find_name(device: cl.Device, text: bytes) -> ctypes.c_uint64 | None:
    """Find the first pointer to exactly `text` in the device object's first 4 kB."""
    blocks = _writable_memory()
    start = device.int_ptr
    end = next((end for begin, end in blocks if begin <= start < end), start)
    for address in range(start, min(start + SEARCHED_BYTES, end) - 7, 8):
        pointer = ctypes.c_uint64.from_address(address)
        target = pointer.value
        inside = any(begin <= target and target + len(text) <= end for begin, end in blocks)
        if inside and ctypes.string_at(target, len(text)) == text:
            return pointer
    return None


def _writable_memory() -> list[tuple[int, int]]:
    """List the readable and writable mappings of this process as (begin, end)."""
    blocks = []
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, rights = line.split()[:2]
        if rights.startswith("rw"):
            begin, end = span.split("-")
            blocks.append((int(begin, 16), int(end, 16)))
    return blocks


def _survives(name: str, driver: str) -> bool:
    """Whether wide built-ins run under `name`: the kept verdict, else a child's."""
    cpu = _cpuinfo()
    identity = [cpu.get(key, "") for key in ("model name", "cpu family", "model", "stepping")]
    key = hashlib.sha256("\n".join([*identity, driver, name]).encode()).hexdigest()[:16]
    verdict = cache_dir() / f"pocl-cpu-{key}"
    if verdict.exists():
        return True
    if not _try_in_child(name):
        return False
    try:
        verdict.parent.mkdir(parents=True, exist_ok=True)
        verdict.touch()
    except OSError:
        pass  # nowhere to keep it: the next process tries again
    return True


def _try_in_child(name: str) -> bool:
    """Run `try_name` in a child process, which a wrong name aborts."""
    package = str(Path(__file__).parents[1])
    paths = [os.environ.get("PYTHONPATH", ""), *sys.path]
    with tempfile.TemporaryDirectory(prefix="clplen-pocl-") as folder:
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
            "POCL_CACHE_DIR": folder,
            "PYOPENCL_NO_CACHE": "1",
        }
        try:
            child = subprocess.run(
                [sys.executable, "-c", _CHILD, package, name],
                env=environment,
                capture_output=True,
                timeout=TRIAL_SECONDS,
            )
        except (OSError, subprocess.TimeoutExpired):
            return False
    return child.returncode == 0


def try_name(name: str) -> None:
    """Give PoCL's device a CPU name and run 16-wide built-ins; for a child process.

    A name that does not fit aborts the process.

    Parameters
    ----------
    name : str
        The CPU name.

    Raises
    ------
    DeviceError
        The device's name could not be written, or the results are wrong.
    """
    platforms = [p for p in cl.get_platforms() if WHEEL.search(p.version)]
    device = platforms[0].get_devices()[0]
    if not _rename(device, name):
        raise DeviceError("PoCL's device holds no CPU name 'generic'")
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    angle = np.linspace(-3.0, 3.0, 16, dtype=np.float32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffer = cl.Buffer(context, flags, hostbuf=angle)
    program = cl.Program(context, WIDE_PROBE).build()
    program.probe(queue, (1,), None, buffer)
    result = np.empty_like(angle)
    cl.enqueue_copy(queue, result, buffer)
    wanted = np.sin(angle.astype(float)) * np.cos(angle.astype(float)) + 1.0
    if np.abs(result - wanted).max() > 1e-5:
        raise DeviceError(f"16-wide built-ins are wrong under the CPU name {name!r}")
