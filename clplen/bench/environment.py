"""Description of the machine of a benchmark."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path
from typing import Any

from clplen import __version__
from clplen.compute.device import Device

PACKAGES = (
    "numpy",
    "scipy",
    "pyopencl",
    "pocl-binary-distribution",
    "intel-opencl-rt",
    "ducc0",
    "pyvkfft",
    "torch",
    "numba",
    "opencv-python-headless",
    "opencv-python",
)


def describe_environment(device: Device) -> dict[str, Any]:
    """Return device, driver, processor and versions."""
    return {
        "clplen": __version__,
        "device": device.name,
        "driver": device.driver,
        "precision": device.precision,
        "fft": device.fft.name,
        "note": device.note,
        "processor": processor(),
        "cores": device.fft.threads,
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": _versions(),
    }


def processor() -> str:
    """Return the name of the processor, with family and model on Linux."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    fields: dict[str, str] = {}
    for line in text.split("\n\n")[0].splitlines():
        key, _, value = line.partition(":")
        fields[key.strip()] = value.strip()
    name = fields.get("model name", platform.machine())
    return f"{name}, family {fields.get('cpu family', '?')}, model {fields.get('model', '?')}"


def _versions() -> dict[str, str]:
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def quiet_enough() -> str:
    """Return a warning if other programs use the processor, else an empty string."""
    if not hasattr(os, "getloadavg"):
        return ""
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    if load < cores / 2:
        return ""
    return f"Other programs are running (load {load:.1f} on {cores} cores): compare ratios only."
