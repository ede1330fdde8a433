"""What is particular about llvmpipe, the CPU that Mesa's OpenCL (rusticl) offers.

- Its vectors run across work-items, as on a GPU: a work-item that owns a whole row uses one lane of
  eight. Kernels therefore run there with a work-item a sample.
- It ends the loops of a work-item after 65535 iterations, all loops together, without an error
  (``LP_MAX_TGSI_LOOP_ITERATIONS`` in Mesa's ``lp_bld_limits.h``, meant for endless loops of
  shaders). What the work-item would have added after that is missing from the result. The drivers
  of Mesa for real GPUs have no such limit.

`loops_are_cut` runs a loop of 70000 iterations, so that a version of Mesa without the limit is
recognised. llvmpipe is taken only where it is named or where there is no other device.
"""

from __future__ import annotations

import functools

import numpy as np
import pyopencl as cl

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
    """Whether a work-item's loop of `ITERATIONS` ends early.

    Parameters
    ----------
    device : pyopencl.Device
        Any device; one that is not llvmpipe is not tried.
    """
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
