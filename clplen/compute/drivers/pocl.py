"""Adapt PoCL 3.0 to CPUs that its compiler mistakes for others.

PoCL 3.0, which ``pip install`` brings with LLVM 14, makes two choices for a CPU. It selects its
library of built-in functions by the CPU's flags (with AVX-512 if ``avx512f`` is set). It selects
its compiler's target by the CPU name that LLVM reports. If the two disagree, vectors are passed in
registers of a width that the library does not expect. The first wide built-in function then
crashes the process or never compiles. AMD's Zen 4 is affected: it has AVX-512, but LLVM 14
reports a Zen 3, which has not. A CPU unknown to LLVM gets the name ``generic``, and every build
fails (pocl/pocl issues 1049 and 512). No build option or environment variable changes the name.
PoCL stores it as a string behind a pointer in its device object, where this module can write a
name that fits the library. PoCL 3.1 selects a fitting name itself.

A trial decides. Before the first use of a device a child process builds and runs every built-in
function that clplen's kernels call (pocl_trial.py), under the present name, then under names that
fit the CPU's flags. The first name that passes is used, and the verdict is stored in the user's
cache folder. A child that is killed from outside, or cannot start, gives no verdict: the first
name is used, and later processes try again.

``CLPLEN_POCL_CPU=off`` keeps the present name; any other value is the only name to try.
"""

from __future__ import annotations

import functools
import hashlib
import json
import logging
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pyopencl as cl

from clplen.checks import install_advice
from clplen.compute.drivers import builtin_functions, pocl_trial
from clplen.compute.drivers.environment import (
    TRIAL_PREFIX,
    cache_dir,
    keep_json,
    kernel_cache,
    require_room,
)
from clplen.compute.drivers.program import kernel_path
from clplen.errors import DeviceError

PLATFORM = "Portable Computing Language"
TRIAL_SECONDS = 120.0  # limit for busy machines; the child limits its own CPU time
# Signals of a process that crashed.
_FAULTS = {
    getattr(signal, f"SIG{name}", None) for name in ("ILL", "SEGV", "ABRT", "BUS", "FPE", "TRAP")
}
INSTEAD = (
    "install another OpenCL driver for the CPU: `apt install pocl-opencl-icd` (Debian, Ubuntu) or "
    f"`{install_advice('intel')}` (that is `pip install intel-opencl-rt intel-cmplr-lib-rt`)"
)

_logger = logging.getLogger("clplen")

# Libraries of built-in functions, best first: the flags of /proc/cpuinfo that PoCL 3 requires
# (getX86KernelLibName of lib/CL/pocl_llvm_build.cc), the width of vector registers in bits, and
# names of CPUs whose code fits. `pni` is SSE 3 and `abm` is LZCNT.
_AVX = "avx cx16 popcnt"
_LIBRARIES = {
    "avx512": ("avx512f", 512, ("skylake-avx512",)),
    "avx2": (f"{_AVX} avx2 abm f16c fma bmi1 bmi2", 256, ("haswell", "sandybridge")),
    "avx_fma4": (f"{_AVX} xop fma4", 256, ("sandybridge",)),
    "avx_f16c": (f"{_AVX} f16c", 256, ("sandybridge",)),
    "avx": (_AVX, 256, ("sandybridge",)),
    "sse41": ("sse4_1 cx16", 128, ("x86-64",)),
    "ssse3": ("ssse3 cx16", 128, ("x86-64",)),
    "sse2": ("", 128, ("x86-64",)),
}
# Vector registers of the CPUs that LLVM 14 knows, in bits.
_WIDTHS = {
    512: "skylake-avx512 skx cascadelake cooperlake cannonlake icelake-client icelake-server "
    "tigerlake rocketlake sapphirerapids knl knm x86-64-v4",
    256: "sandybridge corei7-avx ivybridge core-avx-i haswell core-avx2 broadwell skylake "
    "alderlake bdver1 bdver2 bdver3 bdver4 btver2 znver1 znver2 znver3 x86-64-v3",
    128: "x86-64 x86-64-v2 nocona core2 penryn nehalem corei7 westmere bonnell atom silvermont slm "
    "goldmont goldmont-plus tremont k8 k8-sse3 opteron opteron-sse3 athlon64 athlon64-sse3 "
    "athlon-fx amdfam10 barcelona btver1",
    0: "generic",
}


@functools.cache
def ensure_usable(device: cl.Device) -> str:
    """Give a device of PoCL 3.0 a CPU name under which it runs clplen's kernels.

    Return a note on the change, or an empty string if the name is unchanged.
    """
    pointer = _name_of(device)
    if pointer is None:
        return ""
    current, override = pocl_trial.read_name(pointer), os.environ.get("CLPLEN_POCL_CPU", "")
    names = names_to_try(current, cpu_info().get("flags", ""), override)
    path = _verdict_path(device, names)
    name = _read_verdict(path, names)
    if name is None:
        name = _test_names(device, names, path)
    version = device.driver_version
    unfit = (
        f"The compiler of PoCL {version} does not fit this CPU, which it mistakes for {current!r}"
    )
    if not name:
        reason = f"it fails under the CPU name {' and '.join(map(repr, names))}"
        if override == "off":
            reason = "CLPLEN_POCL_CPU=off forbids another name"
        raise DeviceError(f"{unfit}, and {reason}; {INSTEAD} (remove {path} to try again).")
    if name == current:
        return ""
    pocl_trial.write_name(pointer, name)
    note = f"{unfit}; clplen set the CPU name {name!r} (CLPLEN_POCL_CPU=off prevents this)."
    _logger.debug(note)
    return note


def _name_of(device: cl.Device) -> pocl_trial.Pointer | None:
    """Return a pointer to the CPU name of a device of PoCL before 3.1 on Linux and x86-64."""
    if device.platform.name != PLATFORM or not sys.platform.startswith("linux"):
        return None
    version = re.match(r"(\d+)\.(\d+)", device.driver_version)
    if platform.machine() != "x86_64" or (version and (int(version[1]), int(version[2])) >= (3, 1)):
        return None
    return pocl_trial.find_name(device.int_ptr)


def written_name(device: cl.Device) -> str:
    """Return the present CPU name of a device of PoCL 3.0; empty for any other device."""
    pointer = _name_of(device)
    return "" if pointer is None else pocl_trial.read_name(pointer)


def library(flags: str) -> str:
    """Return the name of the library of built-in functions that PoCL 3 uses on a CPU."""
    have = set(flags.split())
    return next(name for name, (needs, *_) in _LIBRARIES.items() if set(needs.split()) <= have)


def names_to_try(present: str, flags: str, override: str = "") -> list[str]:
    """Return the names of CPUs in the order of the trials."""
    if override:
        return [present if override == "off" else override]
    _, width, fitting = _LIBRARIES[library(flags)]
    others = [name for name in fitting if name != present]
    return (
        [*others, present] if _register_width(present) not in (None, width) else [present, *others]
    )


def _register_width(name: str) -> int | None:
    """Return the width in bits of LLVM's vector registers for a CPU, or None if unknown."""
    return next((width for width, names in _WIDTHS.items() if name in names.split()), None)


def cpu_info() -> dict[str, str]:
    """Return the first processor's entry of ``/proc/cpuinfo``."""
    entry = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
    pairs = (line.partition(":") for line in entry.splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _verdict_path(device: cl.Device, names: Sequence[str]) -> Path:
    """Return the file of a verdict, unique to CPU, PoCL, trial and list of names."""
    cpu = cpu_info()
    keys = ("vendor_id", "model name", "cpu family", "model", "stepping", "microcode", "flags")
    digest = hashlib.sha256()
    for word in (*(cpu.get(key, "") for key in keys), device.platform.version, *names):
        digest.update(word.encode() + b"\0")
    for part in (kernel_path("builtins.cl"), pocl_trial.__file__, builtin_functions.__file__):
        digest.update(Path(part).read_bytes())
    return cache_dir() / f"pocl-{digest.hexdigest()[:16]}.json"


def _read_verdict(path: Path, names: Sequence[str]) -> str | None:
    """Read a verdict: a name, "" if all names fail, None if none is stored."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        name = json.loads(path.read_text("utf-8"))["name"]
        if name in ("", *names):
            return str(name)
    return None


def _test_names(device: cl.Device, names: Sequence[str], path: Path) -> str:
    """Return and store the first name under which all functions run, "" if there is none."""
    _logger.debug("Testing PoCL's compiler on this CPU (first run only).")
    survivor, doubt = "", None
    for name in names:
        try:
            if _survives(device.platform.version, name):
                survivor = name
                break
        except OSError as error:
            doubt = error
    if doubt is not None:
        _logger.debug("No verdict on PoCL's compiler: %s.", doubt)
        return survivor or names[0]
    keep_json(path, {"name": survivor})
    return survivor


def _survives(version: str, name: str) -> bool:
    """Return True if all built-in functions run correctly under a name in a child process."""
    if getattr(sys, "frozen", False) or not sys.executable:
        raise OSError("this program runs without a separate Python interpreter")
    command = [sys.executable, "-m", pocl_trial.__name__]
    # in PoCL's folder, which passed the tests; the system's temporary folder may be noexec
    with tempfile.TemporaryDirectory(prefix=TRIAL_PREFIX, dir=kernel_cache()) as folder:
        variables = {
            "POCL_CACHE_DIR": folder,
            "POCL_MAX_PTHREAD_COUNT": "1",
            "PYOPENCL_NO_CACHE": "1",
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),
        }
        try:
            child = subprocess.run(
                [*command, version, name, str(kernel_path("builtins.cl"))],
                env=os.environ | variables,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=TRIAL_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise OSError(f"the trial did not end within {TRIAL_SECONDS:.0f} s") from error
    status = child.returncode
    if status == 0:
        return True
    require_room("PoCL")
    if status in (pocl_trial.UNFIT, -signal.SIGXCPU) or (
        pocl_trial.READY in child.stdout and -status in _FAULTS
    ):
        return False
    if status in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP):
        raise OSError(f"the trial was killed by signal {-status}")
    output = (child.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
    raise DeviceError(
        f"PoCL cannot run kernels on this computer; its test ended with {status} ({output}): "
        f"provide memory, disk space and the linker `ld` (apt install binutils), or {INSTEAD}."
    )
