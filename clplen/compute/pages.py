"""Large pages for the buffers of CPU devices.

The first write to a fresh buffer meets a page fault every 4 kB, which takes longer than a pass over
the data. Linux hands out 2 MB pages where it is asked to; NumPy asks for its own arrays, OpenCL
runtimes do not.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any, cast

import numpy as np
import pyopencl as cl

LEAST_BYTES = 2**22  # below this the request costs as much as it saves
_PAGE = 4096
_MADV_HUGEPAGE = 14


def ask_for_large_pages(queue: cl.CommandQueue, buffer: cl.Buffer) -> None:
    """Ask Linux for large pages under a fresh buffer of a CPU device; elsewhere do nothing.

    Parameters
    ----------
    queue : pyopencl.CommandQueue
        Of the device.
    buffer : pyopencl.Buffer
        Not written yet.
    """
    advise = _madvise()
    if advise is None or buffer.size < LEAST_BYTES:
        return
    flags = cast(cl.map_flags, cl.map_flags.READ | cl.map_flags.WRITE)
    size: Any = (buffer.size,)
    mapped, _ = cl.enqueue_map_buffer(queue, buffer, flags, 0, size, np.dtype(np.uint8))
    start = -(-mapped.ctypes.data // _PAGE) * _PAGE
    length = (mapped.ctypes.data + buffer.size - start) // _PAGE * _PAGE
    advise(start, length, _MADV_HUGEPAGE)  # a hint: a refusal changes nothing
    mapped.base.release(queue)


@cache
def _madvise() -> Any:
    """The C library's function, None where there is none."""
    if sys.platform != "linux":
        return None
    function = getattr(ctypes.CDLL(None), "madvise", None)
    if function is not None:
        function.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return function
