"""Kernels with a fault planted on purpose, to see that Oclgrind reports it.

Run as ``oclgrind --data-races python tests/oclgrind/planted.py race|bounds|clean``; the device
matrix in ``.ci/devices.sh`` does so before it trusts a silent Oclgrind.
"""

from __future__ import annotations

import sys

import numpy as np
import pyopencl as cl

COUNT = 13
SOURCES = {
    # every work-item adds to the same number
    "race": "kernel void race(global int *a, global int *b) { b[0] += a[get_global_id(0)]; }",
    # the last work-item reads one element behind the end
    "bounds": "kernel void bounds(global int *a, global int *b)"
    " { size_t i = get_global_id(0); b[i] = a[i + 1]; }",
    "clean": "kernel void clean(global int *a, global int *b)"
    " { size_t i = get_global_id(0); b[i] = a[i]; }",
}


def main(fault: str) -> None:
    """Run one of `SOURCES` on Oclgrind's device."""
    platforms = [p for p in cl.get_platforms() if p.name == "Oclgrind"]
    if not platforms:
        sys.exit("planted.py: this process does not see Oclgrind; run it under `oclgrind`.")
    context = cl.Context(platforms[0].get_devices())
    queue = cl.CommandQueue(context)
    values = np.arange(1, COUNT + 1, dtype=np.int32)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    a, b = (cl.Buffer(context, flags, hostbuf=values) for _ in range(2))
    program = cl.Program(context, SOURCES[fault]).build(cache_dir=False)
    cl.Kernel(program, fault)(queue, (COUNT,), None, a, b)
    queue.finish()


if __name__ == "__main__":
    main(sys.argv[1])
