"""Available OpenCL devices, their selection, and a warning about Mesa's llvmpipe."""

from __future__ import annotations

import functools
import re

import numpy as np
import pyopencl as cl

from clplen.compute.drivers import environment, limits
from clplen.compute.drivers.forked import begin_use, is_in_use
from clplen.errors import DeviceError
from clplen.interrupts import signals_kept

PROBE_ITERATIONS = 70_000  # above the 65535 iterations after which llvmpipe ends a loop
_PROBE = """
kernel void probe(global int *sum, const int n)
{
    int k = 0;
    for (int i = 0; i < n; ++i)
        k += sum[0];  /* unknown to the compiler, which would otherwise remove the loop */
    sum[1] = k;
}
"""


def is_llvmpipe(device: cl.Device) -> bool:
    """Return True if a device is Mesa's software rasteriser."""
    return "llvmpipe" in str(device.name)


@functools.cache
def loops_are_cut(device: cl.Device) -> bool:
    """Return True if a work-item's loop of `PROBE_ITERATIONS` ends early."""
    if not is_llvmpipe(device):
        return False
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    result = np.array([1, 0], np.int32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffer = cl.Buffer(context, flags, hostbuf=result)
    kernel = cl.Kernel(cl.Program(context, _PROBE).build(), "probe")
    kernel(queue, (1,), (1,), buffer, np.int32(PROBE_ITERATIONS))
    cl.enqueue_copy(queue, result, buffer)
    return int(result[1]) != PROBE_ITERATIONS


def warning(device: cl.Device) -> str:
    """Return a warning for users of an llvmpipe that truncates loops, else an empty string."""
    if not loops_are_cut(device):
        return ""
    return (
        "llvmpipe ends the loops of a work-item after 65535 iterations without an error, so that "
        "long sums are too small; use it for trials only."
    )


ListedDevice = tuple[str, cl.Device]  # index "platform:device", device

INSTALL_HELP = (
    "Linux on x86-64: pip install pocl-binary-distribution; Linux on ARM: apt install "
    "pocl-opencl-icd (or conda install -c conda-forge pocl); macOS: conda install -c conda-forge "
    "pocl; Windows: the driver of your GPU, or pip install intel-opencl-rt for the CPU."
)


def find_devices() -> list[ListedDevice]:
    """List all devices of all OpenCL platforms, in platform order."""
    if not is_in_use():
        limits.require_driver_room()
    begin_use()
    environment.ensure_cache()
    environment.expose_intel_runtime()
    listed = []
    with signals_kept():
        try:
            platforms = cl.get_platforms()
        except cl.LogicError as error:
            raise DeviceError(f"No OpenCL platform was found. {INSTALL_HELP}") from error
        for p, platform in enumerate(platforms):
            try:
                devices = platform.get_devices()
            except cl.RuntimeError:  # a driver without hardware
                continue
            listed += [(f"{p}:{d}", device) for d, device in enumerate(devices)]
    if not listed:
        environment.require_room("PoCL")
        raise DeviceError(f"The OpenCL platforms of this computer have no device. {INSTALL_HELP}")
    return listed


def select(devices: list[ListedDevice], selector: str | None) -> list[ListedDevice]:
    """Return the devices that match a selector, best first; llvmpipe comes last unless named."""
    kinds = {"cpu": cl.device_type.CPU, "gpu": cl.device_type.GPU}
    if selector is None:
        return sorted(devices, key=_rank)
    pattern = selector.strip().lower()
    if pattern in kinds:
        matches = sorted((d for d in devices if d[1].type & kinds[pattern]), key=_rank)
    elif re.fullmatch(r"\d+:\d+", pattern):
        matches = [entry for entry in devices if entry[0] == pattern]
    else:
        # Platform names take precedence: "intel" selects Intel's runtime, not PoCL on
        # an Intel processor.
        matches = [f for f in devices if pattern in _platform_text(f[1])] or [
            f for f in devices if pattern in f"{f[1].name} {f[1].vendor}".lower()
        ]
    if not matches:
        listing = "; ".join(
            f"{index} {d.platform.name.strip()}: {d.name.strip()}" for index, d in devices
        )
        raise DeviceError(
            f"No OpenCL device matches {selector!r}. Available devices: {listing}. Use 'cpu', "
            "'gpu', 'platform:device' or part of a name."
        )
    return matches


def _rank(entry: ListedDevice) -> int:
    """Return the sort key of devices without a name: GPUs, then CPUs, then llvmpipe."""
    device = entry[1]
    return 2 if is_llvmpipe(device) else int(not device.type & cl.device_type.GPU)


def _platform_text(device: cl.Device) -> str:
    platform = device.platform
    return f"{platform.name} {platform.vendor} {platform.version}".lower()
