"""Make PoCL 3.0 work on CPUs that its compiler takes for others.

PoCL 3.0, which ``pip install`` brings with LLVM 14, chooses two things for a CPU: its library of
built-in functions by the CPU's flags (one with AVX-512 where there is ``avx512f``), and its
compiler's target by the name that LLVM has for the CPU. Where the two do not fit, vectors are
passed in registers of another width than the library expects, and the first wide built-in function
kills the process or lets the compiler run for ever. So it is with AMD's Zen 4, which has AVX-512
while LLVM 14 takes it for a Zen 3, which has not. A CPU that LLVM does not know at all gets the
name ``generic``, and every build ends in an error (pocl/pocl issues 1049 and 512). No build option
and no environment variable changes the name. PoCL keeps it as a string behind a pointer in its
device object, and there another one can be written: one that fits the library. PoCL 3.1 chooses a
name that fits.

What is done is decided by trial. Before the first use of a device a child process, which may die,
builds and runs every built-in function that clplen's kernels call (pocl_trial.py), under the name
that is there, then under those that fit the CPU's flags. The first name that survives is taken,
and the verdict is kept in the user's cache folder. A child that is killed from outside, or cannot
be started, gives no verdict: the first name is taken, and later processes try again.

``CLPLEN_POCL_CPU=off`` leaves the name as it is; any other value is the only name to try.
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
TRIAL_SECONDS = 120.0  # for machines that do much else; the child limits its own computing
# Signals by which a process ends itself, or is ended for what its code did.
_FAULTS = {
    getattr(signal, f"SIG{name}", None) for name in ("ILL", "SEGV", "ABRT", "BUS", "FPE", "TRAP")
}
INSTEAD = (
    "install another OpenCL driver for the CPU: `apt install pocl-opencl-icd` (Debian, Ubuntu) or "
    f"`{install_advice('intel')}` (that is `pip install intel-opencl-rt intel-cmplr-lib-rt`)"
)

_logger = logging.getLogger("clplen")

# Libraries of built-in functions, best first: the flags of /proc/cpuinfo that PoCL 3 asks for
# (getX86KernelLibName of lib/CL/pocl_llvm_build.cc), the width of its vector registers in bits,
# and names of CPUs whose code fits it. `pni` is SSE 3 and `abm` is LZCNT.
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

    Return a sentence on the change, empty where none was needed.
    """
    pointer = _name_of(device)
    if pointer is None:
        return ""
    present, wanted = pocl_trial.read_name(pointer), os.environ.get("CLPLEN_POCL_CPU", "")
    names = names_to_try(present, cpu_info().get("flags", ""), wanted)
    path = _verdict_path(device, names)
    name = _kept(path, names)
    if name is None:
        name = _tried(device, names, path)
    version = device.driver_version
    unfit = f"The compiler of PoCL {version} does not fit this CPU, which it takes for {present!r}"
    if not name:
        tried = " and ".join(repr(one) for one in names)
        why = f"it fails under the CPU name {tried}"
        if wanted == "off":
            why = "CLPLEN_POCL_CPU=off forbids another name"
        raise DeviceError(f"{unfit}, and {why}; {INSTEAD} (remove {path} to try again).")
    if name == present:
        return ""
    pocl_trial.write_name(pointer, name)
    note = f"{unfit}; it was given the CPU name {name!r} (CLPLEN_POCL_CPU=off forbids this)."
    _logger.debug(note)
    return note


def _name_of(device: cl.Device) -> pocl_trial.Pointer | None:
    """Find the CPU name of a device of PoCL before 3.1, on Linux and x86-64; None elsewhere."""
    if device.platform.name != PLATFORM or not sys.platform.startswith("linux"):
        return None
    version = re.match(r"(\d+)\.(\d+)", device.driver_version)
    if platform.machine() != "x86_64" or (version and (int(version[1]), int(version[2])) >= (3, 1)):
        return None
    return pocl_trial.find_name(device.int_ptr)


def written_name(device: cl.Device) -> str:
    """Read the CPU name that a device of PoCL 3.0 holds now; empty for any other device."""
    pointer = _name_of(device)
    return "" if pointer is None else pocl_trial.read_name(pointer)


def library(flags: str) -> str:
    """Name the library of built-in functions that PoCL 3 takes on a CPU."""
    have = set(flags.split())
    return next(name for name, (needs, *_) in _LIBRARIES.items() if set(needs.split()) <= have)


def names_to_try(present: str, flags: str, wanted: str = "") -> list[str]:
    """List names of CPUs in the order in which they are tried."""
    if wanted:
        return [present if wanted == "off" else wanted]
    _, width, fitting = _LIBRARIES[library(flags)]
    others = [name for name in fitting if name != present]
    return (
        [*others, present] if _register_width(present) not in (None, width) else [present, *others]
    )


def _register_width(name: str) -> int | None:
    """Return the bits of the vector registers that LLVM uses for a CPU, None if unknown."""
    return next((width for width, names in _WIDTHS.items() if name in names.split()), None)


def cpu_info() -> dict[str, str]:
    """Read the first processor's entry of ``/proc/cpuinfo``."""
    entry = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
    pairs = (line.partition(":") for line in entry.splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _verdict_path(device: cl.Device, names: Sequence[str]) -> Path:
    """Name the file of a verdict: one for each CPU, PoCL, trial and list of names."""
    cpu = cpu_info()
    keys = ("vendor_id", "model name", "cpu family", "model", "stepping", "microcode", "flags")
    digest = hashlib.sha256()
    for word in (*(cpu.get(key, "") for key in keys), device.platform.version, *names):
        digest.update(word.encode() + b"\0")
    for part in (kernel_path("builtins.cl"), pocl_trial.__file__, builtin_functions.__file__):
        digest.update(Path(part).read_bytes())
    return cache_dir() / f"pocl-{digest.hexdigest()[:16]}.json"


def _kept(path: Path, names: Sequence[str]) -> str | None:
    """Read a verdict: a name, "" where none survives; None where none is kept."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        name = json.loads(path.read_text("utf-8"))["name"]
        if name in ("", *names):
            return str(name)
    return None


def _tried(device: cl.Device, names: Sequence[str], path: Path) -> str:
    """Return the first name under which everything runs, "" where there is none; keep it."""
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
    """Return whether every built-in function runs and is right under a name, in a child process."""
    if getattr(sys, "frozen", False) or not sys.executable:
        raise OSError("this program is not run by a Python interpreter of its own")
    command = [sys.executable, "-m", pocl_trial.__name__]
    # in PoCL's own folder, which was found to take kernels; the system's for temporary files may
    # forbid to execute them
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
    last = (child.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
    raise DeviceError(
        f"PoCL cannot run a kernel here, since its trial ended with status {status} ({last}): it "
        f"needs memory, room for files and the linker `ld` (apt install binutils); else {INSTEAD}."
    )
