"""Text of check results, and the environment for bug reports."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyopencl as cl

from clplen import __version__
from clplen.bench.environment import PACKAGES, processor
from clplen.compute.device import Device
from clplen.errors import ClplenError
from clplen.selftest.check import CheckResult, sentence_of

PREFIXES = ("CLPLEN_", "POCL_", "OCL_", "PYOPENCL_", "RUSTICL_")
# CPU flags that choose PoCL's built-in library and compiler target.
FLAGS = (
    *("sse2", "ssse3", "sse4_1", "sse4_2", "avx", "f16c", "fma", "fma4", "avx2", "bmi1", "bmi2"),
    *("abm", "avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "asimd", "sve"),
)
HEAD = f"{'check':<19s} {'what is compared with NumPy':<47s} {'error':>8s}  {'allowed':>8s}"


@dataclass
class DeviceReport:
    """Properties of one device and the results of its checks."""

    facts: dict[str, str]  # properties of the device as text
    results: list[CheckResult] = field(default_factory=list)  # "opening" alone if it cannot open
    seconds: float = 0.0


def row(result: CheckResult) -> str:
    """Format a result as a row under `HEAD`, with a second line for a reason."""
    error = f"{result.error:8.1e}" if result.error == result.error else f"{'-':>8s}"
    allowed = f"{result.tolerance:8.1e}"
    if result.status == "left out":
        error = allowed = f"{'-':>8s}"
    line = f"{result.name:<19s} {result.compared:<47s} {error}  {allowed}  "
    line += f"{result.status:<8s} {result.seconds:5.2f} s"
    if not result.reason:
        return line
    files = f"; kernels: {', '.join(result.files)}" if result.failed and result.files else ""
    return f"{line}\n    {result.reason}{files}"


def summary(results: Sequence[CheckResult], seconds: float) -> str:
    """Format the number of passed checks, the duration and the names of failed checks."""
    failed = [result.name for result in results if result.failed]
    counts = [sum(result.status == status for result in results) for status in ("ok", "left out")]
    text = f"{counts[0]} checks ok, {len(failed)} FAILED"
    text += f", {counts[1]} left out" if counts[1] else ""
    text += f", {seconds:.1f} s"
    return text + (f": {'; '.join(failed)}" if failed else "")


def device_facts(device: Device, *, is_open: bool = False) -> dict[str, str]:
    """Return properties of a device as text by name."""
    info = device.cl_device
    facts = {
        "device": f"{device.place}  {device.name}",
        "platform": f"{device.platform}, {info.platform.version.strip()}",
        "driver": info.driver_version.strip(),
        "version": f"{info.version.strip()}; {info.opencl_c_version.strip()}",
        "memory": f"{device.memory_bytes / 2**30:.1f} GiB, at most "
        f"{info.max_mem_alloc_size / 2**30:.1f} GiB at once, local "
        f"{info.local_mem_size // 2**10} KiB",
        "units": f"{info.max_compute_units}, vectors of {info.native_vector_width_float} floats",
        "float32": _float_abilities(info.single_fp_config),
        "float64": _float_abilities(info.double_fp_config) if device.has_fp64 else "no",
    }
    if is_open:
        try:
            facts["FFT"] = f"{device.fft.name}, {device.fft.threads} threads"
        except ClplenError as error:
            facts["FFT"] = sentence_of(error)
        facts["note"] = device.note or "none"
    return facts


def _float_abilities(config: int) -> str:
    """List support of denormals and fused multiply-add, which explain rounding."""
    names = {"denormals": cl.device_fp_config.DENORM, "fma": cl.device_fp_config.FMA}
    return ", ".join(name if config & bit else f"no {name}" for name, bit in names.items())


def environment() -> dict[str, str]:
    """Return versions, processor and environment variables as text by name."""
    installed = []
    for name in PACKAGES:
        try:
            installed.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    variables = [f"{k}={v}" for k, v in sorted(os.environ.items()) if k.startswith(PREFIXES)]
    return {
        "clplen": f"{__version__}, Python {platform.python_version()}",
        "system": platform.platform(),
        "processor": processor(),
        "flags": cpu_flags() or "not known",
        "packages": ", ".join(installed),
        "variables": ", ".join(variables) or "none",
    }


def cpu_flags() -> str:
    """Return the processor flags that choose its built-in library, or an empty string."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    lines = (line.partition(":") for line in text.splitlines())
    flags = next((v.split() for k, _, v in lines if k.strip().lower() in ("flags", "features")), [])
    return " ".join(flag for flag in FLAGS if flag in flags)


def paste_block(reports: Iterable[DeviceReport]) -> str:
    """Format the text to paste into a report: environment, devices and failed checks."""
    lines = ["---- paste from here into a report ----", *_aligned(environment())]
    for report in reports:
        counted = {"checks": summary(report.results, report.seconds)}
        lines += ["", *_aligned(report.facts | counted)]
        lines += [row(result) for result in report.results if result.failed]
    return "\n".join([*lines, "---- to here ----"])


def _aligned(facts: dict[str, str]) -> list[str]:
    return [f"{name:<10s} {value}" for name, value in facts.items()]
