"""Which OpenCL devices there are, which a selector means, and what Mesa's llvmpipe needs."""

from __future__ import annotations

import functools
import re

import numpy as np
import pyopencl as cl

from clplen.compute.drivers import environment, limits
from clplen.compute.drivers.forked import begin_use, is_in_use
from clplen.errors import DeviceError
from clplen.interrupts import signals_kept

ITERATIONS = 70_000
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
    """Whether a device is Mesa's software rasteriser, told by its name."""
    return "llvmpipe" in str(device.name)


@functools.cache
def loops_are_cut(device: cl.Device) -> bool:
    """Whether a work-item's loop of `ITERATIONS` ends early."""
    if not is_llvmpipe(device):
        return False
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    result = np.array([1, 0], np.int32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffer = cl.Buffer(context, flags, hostbuf=result)
    kernel = cl.Kernel(cl.Program(context, _PROBE).build(), "probe")
    kernel(queue, (1,), (1,), buffer, np.int32(ITERATIONS))
    cl.enqueue_copy(queue, result, buffer)
    return int(result[1]) != ITERATIONS


def warning(device: cl.Device) -> str:
    """One sentence for the user of llvmpipe whose loops are cut, else the empty string."""
    if not loops_are_cut(device):
        return ""
    return (
        "llvmpipe ends the loops of a work-item after 65535 iterations without an error, so that "
        "long sums come out too small; use it for trials only."
    )


Found = tuple[str, cl.Device]

INSTALL_HELP = (
    "Linux on x86-64: pip install pocl-binary-distribution; Linux on ARM: apt install "
    "pocl-opencl-icd (or conda install -c conda-forge pocl); macOS: conda install -c conda-forge "
    "pocl; Windows: the driver of your GPU, or pip install intel-opencl-rt for the CPU."
)


def find_devices() -> list[Found]:
    """Everything that OpenCL shows, in platform order."""
    if not is_in_use():
        limits.require_driver_room()
    begin_use()
    environment.ensure_cache()
    environment.expose_intel_runtime()
    found = []
    with signals_kept():
        try:
            platforms = cl.get_platforms()
        except cl.LogicError as error:
            raise DeviceError(f"There is no OpenCL platform. {INSTALL_HELP}") from error
        for p, platform in enumerate(platforms):
            try:
                devices = platform.get_devices()
            except cl.RuntimeError:  # a driver without hardware
                continue
            found += [(f"{p}:{d}", device) for d, device in enumerate(devices)]
    if not found:
        environment.require_room("PoCL")
        raise DeviceError(f"The OpenCL platforms here have no device. {INSTALL_HELP}")
    return found


def select(devices: list[Found], selector: str | None) -> list[Found]:
    """The devices that fit a selector, best first; llvmpipe last, unless it is named."""
    kinds = {"cpu": cl.device_type.CPU, "gpu": cl.device_type.GPU}
    if selector is None:
        return sorted(devices, key=_rank)
    wanted = selector.strip().lower()
    if wanted in kinds:
        fitting = sorted((d for d in devices if d[1].type & kinds[wanted]), key=_rank)
    elif re.fullmatch(r"\d+:\d+", wanted):
        fitting = [found for found in devices if found[0] == wanted]
    else:
        # A platform's name counts before a device's: "intel" means Intel's runtime, not PoCL on
        # an Intel processor.
        fitting = [f for f in devices if wanted in _platform_words(f[1])] or [
            f for f in devices if wanted in f"{f[1].name} {f[1].vendor}".lower()
        ]
    if not fitting:
        here = "; ".join(
            f"{place} {d.platform.name.strip()}: {d.name.strip()}" for place, d in devices
        )
        raise DeviceError(
            f"No OpenCL device fits {selector!r}. Here are: {here}. Use 'cpu', 'gpu', "
            "'platform:device' or part of a name."
        )
    return fitting


def _rank(found: Found) -> int:
    """Order of devices that no name chooses: GPUs, then CPUs, then llvmpipe."""
    device = found[1]
    return 2 if is_llvmpipe(device) else int(not device.type & cl.device_type.GPU)


def _platform_words(device: cl.Device) -> str:
    platform = device.platform
    return f"{platform.name} {platform.vendor} {platform.version}".lower()
