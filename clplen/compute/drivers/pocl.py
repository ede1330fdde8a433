"""Make PoCL work on CPUs that its compiler takes for others.

PoCL 3, which ``pip install`` brings with LLVM 14, chooses two things for a CPU: its library of
built-in functions by the CPU's flags (one with AVX-512 where there is ``avx512f``), and its
compiler's target by the name that LLVM has for the CPU. Where the two do not fit, vectors are
passed in registers of another width than the library expects, and the first wide built-in function
kills the process or lets the compiler run for ever. So it is with AMD's Zen 4, which has AVX-512
while LLVM 14 takes it for a Zen 3, which has not. A CPU that LLVM does not know at all gets the
name ``generic``, and every build ends in an error (pocl/pocl issues 1049 and 512). No build option
and no environment variable changes the name. PoCL keeps it as a string behind a pointer in its
device object, and there another one can be written: one that fits the library.

What is done is decided by trial. Before the first use of a device a child process, which may die,
builds and runs every built-in function that clplen's kernels call (pocl_trial.py), under the name
that is there, then under those that fit the CPU's flags. The first name that survives is taken,
and the verdict is kept in the user's cache folder. A child that is killed from outside, or lacks
memory, a linker or room for files, gives no verdict, and later processes try again.

``CLPLEN_POCL_CPU=off`` leaves the name as it is; any other value is the only name to try.
"""

from __future__ import annotations

import functools
import hashlib
import json
import logging
import os
import platform
import secrets
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyopencl as cl

from clplen.checks import install_advice
from clplen.compute.drivers import builtin_functions, pocl_trial
from clplen.compute.drivers.environment import (
    TRIAL_PREFIX,
    cache_dir,
    kernel_cache,
    require_room,
)
from clplen.compute.drivers.program import kernel_path
from clplen.errors import DeviceError

PLATFORM = "Portable Computing Language"
PROBE = "kernel void probe(global int *a) { a[0] = 1; }"
TRIAL_SECONDS = (
    120.0  # a limit for machines that do much else; its own work is limited in the child
)
# Signals by which a process ends itself, or is ended for what its code did.
_FAULTS = {
    getattr(signal, f"SIG{name}", None) for name in ("ILL", "SEGV", "ABRT", "BUS", "FPE", "TRAP")
}
PATIENCE = 1.0  # seconds after which a trial is spoken of
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
    """Find out whether a PoCL device can run clplen's kernels, and give it a name that fits.

    The work is done once per device and process; later calls return the same sentence.
    """
    if device.platform.name != PLATFORM:
        return ""
    target = _target(device)
    if target is None:
        _require_build(device)
        return ""
    wanted = os.environ.get("CLPLEN_POCL_CPU", "")
    names = names_to_try(target.name, cpu_info().get("flags", ""), wanted)
    survivor = _verdict(target, names)
    if survivor is None:
        raise DeviceError(_refusal(target, wanted, names))
    if survivor == target.name or target.pointer is None:
        return ""
    pocl_trial.write_name(target.pointer, survivor)
    return (
        f"{_unfit(target)}; it was given the CPU name {survivor!r} "
        "(CLPLEN_POCL_CPU=off forbids this)."
    )


def written_name(device: cl.Device) -> str:
    """The name of the CPU that a PoCL device on x86-64 holds now; empty for any other device."""
    if device.platform.name != PLATFORM:
        return ""
    target = _target(device)
    return "" if target is None else target.name


def library(flags: str) -> str:
    """Name the library of built-in functions that PoCL 3 takes on a CPU."""
    have = set(flags.split())
    return next(name for name, (needs, *_) in _LIBRARIES.items() if set(needs.split()) <= have)


def names_to_try(present: str, flags: str, wanted: str = "") -> list[str]:
    """Names of CPUs in the order in which they are tried."""
    if wanted == "off" or not present:
        return [present]
    if wanted:
        return [wanted]
    _, width, fitting = _LIBRARIES[library(flags)]
    others = [name for name in fitting if name != present]
    return (
        [*others, present] if _register_width(present) not in (None, width) else [present, *others]
    )


def _register_width(name: str) -> int | None:
    """Bits of the vector registers that LLVM uses for a CPU, None for an unknown name."""
    return next((width for width, names in _WIDTHS.items() if name in names.split()), None)


@dataclass(frozen=True)
class _Target:
    """What PoCL compiles for: where the name of the CPU stands, and whose PoCL it is."""

    device_name: str
    driver: str
    library: Path  # PoCL's own
    pointer: pocl_trial.Pointer | None
    name: str


def _target(device: cl.Device) -> _Target | None:
    """PoCL's target, None where no name can be tried: elsewhere than on Linux and x86-64."""
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        return None
    library = _library_of(device)
    if library is None:
        return None
    pointer = pocl_trial.find_name(device.int_ptr)
    name = "" if pointer is None else pocl_trial.read_name(pointer)
    return _Target(device.name, device.driver_version, library, pointer, name)


def _library_of(device: cl.Device) -> Path | None:
    """The file from which PoCL's code was loaded: the one that holds its first function."""
    function = pocl_trial.table_of(device.platform.int_ptr)[0]
    for line in Path("/proc/self/maps").read_text(errors="replace").splitlines():
        span, _, _, _, _, *path = line.split(maxsplit=5)
        begin, end = (int(word, 16) for word in span.split("-"))
        if begin <= function < end and path and Path(path[0]).is_file():
            return Path(path[0])
    return None


def cpu_info() -> dict[str, str]:
    """Read the first processor's entry of ``/proc/cpuinfo``."""
    entry = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
    pairs = (line.partition(":") for line in entry.splitlines())
    return {key.strip(): value.strip() for key, _, value in pairs}


def _verdict(target: _Target, names: Sequence[str]) -> str | None:
    """The first name under which everything runs: the kept verdict, else a trial's."""
    path = _verdict_path(target, names)
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        kept = json.loads(path.read_text("utf-8"))["name"]
        if kept is None or kept in names:
            return str(kept) if kept is not None else None
    survivor, doubt = None, None
    for name in names:
        try:
            if _survives(target.library, name):
                survivor = name
                break
        except OSError as error:
            doubt = error
    if doubt is None:
        _keep(path, survivor)
    elif survivor is None:  # what is likely to fit is trusted
        if _register_width(names[0]) == 0 or names[0] != target.name:
            raise DeviceError(
                f"{_unfit(target)}, and another CPU name cannot be tried ({doubt}); {INSTEAD}"
            ) from doubt
        return names[0]
    return survivor


def _verdict_path(target: _Target, names: Sequence[str]) -> Path:
    """Where the verdict on names is kept: one file for each CPU, PoCL, trial and list of names."""
    cpu = cpu_info()
    keys = ("vendor_id", "model name", "cpu family", "model", "stepping", "microcode", "flags")
    file = target.library.stat()
    trial = [kernel_path("builtins.cl"), Path(pocl_trial.__file__), Path(builtin_functions.__file__)]
    digest = hashlib.sha256()
    for word in (
        *(cpu.get(key, "") for key in keys),
        *(target.driver, str(target.library), str(file.st_size), str(file.st_mtime_ns)),
        *names,
    ):
        digest.update(word.encode() + b"\0")
    for part in trial:
        digest.update(part.read_bytes())
    return cache_dir() / f"pocl-{digest.hexdigest()[:16]}.json"


def _keep(path: Path, survivor: str | None) -> None:
    """Write a verdict, for other processes; where nothing can be written, they try again."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps({"name": survivor}), "utf-8")
        os.replace(temporary, path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _survives(library: Path, name: str) -> bool:
    """Whether every built-in function runs and is right under a name, in a child process."""
    if getattr(sys, "frozen", False) or not sys.executable:
        raise OSError("this program is not run by a Python interpreter of its own")
    command = [sys.executable, "-I", "-S", pocl_trial.__file__, str(library), name, str(kernel_path("builtins.cl"))]
    # in PoCL's own folder, which was found to take kernels, as the system's for temporary files
    # need not
    with tempfile.TemporaryDirectory(prefix=TRIAL_PREFIX, dir=kernel_cache()) as folder:
        environment = os.environ | {"POCL_CACHE_DIR": folder, "POCL_MAX_PTHREAD_COUNT": "1"}
        child = subprocess.Popen(
            command,
            env=environment,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        try:
            printed, complaint = _wait(child)
        finally:
            child.kill()
            child.communicate()
    status = child.returncode
    if status == 0:
        return True
    require_room("PoCL")
    if status in (pocl_trial.UNFIT, -signal.SIGXCPU) or (
        pocl_trial.READY in printed and -status in _FAULTS
    ):
        return False
    last = (complaint.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
    if status in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP):
        raise OSError(f"the trial was killed by signal {-status}")
    raise DeviceError(
        f"PoCL cannot run a kernel here, since its trial ended with status {status} ({last}): it "
        f"needs memory, room for files and the linker `ld` (apt install binutils); else {INSTEAD}."
    )


def _wait(child: subprocess.Popen[bytes]) -> tuple[bytes, bytes]:
    """What a trial prints to both streams; a long one is spoken of."""
    for seconds in (PATIENCE, TRIAL_SECONDS):
        try:
            return child.communicate(timeout=seconds)  # which returns at once when the child ends
        except subprocess.TimeoutExpired:
            if seconds == PATIENCE:
                _logger.warning("Trying the compiler of PoCL on this CPU, which is done once.")
    raise OSError(f"the trial did not end within {TRIAL_SECONDS:.0f} s")


def _unfit(target: _Target) -> str:
    return (
        f"The compiler of PoCL {target.driver} does not fit this CPU, which it takes for "
        f"{target.name!r}"
    )


def _refusal(target: _Target, wanted: str, names: Sequence[str]) -> str:
    """Why the device cannot be used, and what to do."""
    again = f"(remove {_verdict_path(target, names)} to try again)"
    if wanted == "off":
        return f"{_unfit(target)}, and CLPLEN_POCL_CPU=off forbids another name; {INSTEAD} {again}."
    tried = " and ".join(repr(name) for name in names)
    return f"{_unfit(target)}, and it fails under the CPU name {tried}; {INSTEAD} {again}."


def _require_build(device: cl.Device) -> None:
    """Build a one-line kernel."""
    try:
        cl.Program(cl.Context([device]), PROBE).build()
    except cl.Error as error:
        lines = str(error).splitlines()
        complaint = next((line for line in lines if line.startswith("error:")), lines[0])
        raise DeviceError(f"{device.name} cannot build kernels ({complaint}); {INSTEAD}") from error
