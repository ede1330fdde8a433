"""Arrays that host and device share: of a CPU device the same memory, of others one copy each way.

Engines of gradients pass arrays in and out at every step. A CPU computes on an array of the host
where it lies (``CL_MEM_USE_HOST_PTR``), and what it made is mapped and handed out as it is.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.drivers.failures import device_errors
from clplen.compute.drivers.forked import HoldsOpenCL, is_forked
from clplen.types import Array


def lend(values: Array, device: Device) -> cla.Array:
    """An array of the host as one of the device, which reads it: on a CPU device without a copy.

    Nothing may change ``values`` while the device reads them: wait (`Device.finish`, or `keep` of
    what was made of them) before they are given back to their owner.
    """
    flat = np.ascontiguousarray(values).reshape(values.shape)
    is_aligned = flat.ctypes.data % max(1, flat.itemsize) == 0
    if not (device.is_cpu and flat.nbytes and is_aligned):
        return device.upload(flat)
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
    with device_errors(device.cl_device, "Memory of the host"):
        buffer = cl.Buffer(device.context, flags, hostbuf=flat)  # keeps the array alive
    return cla.Array(device.queue, flat.shape, flat.dtype, data=buffer)


def keep(array: cla.Array, device: Device) -> Array:
    """An array of a device on the host; on a CPU device its own memory, not a copy.

    Everything that was enqueued before is done then. The memory lives as long as the result and
    its views, and is not used again before; so the array is left to the result.
    """
    if not (device.is_cpu and array.size):
        return device.download(array)
    return np.asarray(_Mapped(array, device))


class _Mapped(HoldsOpenCL):
    """A mapped array with its buffer: what a NumPy array of its memory keeps alive."""

    def __init__(self, array: cla.Array, device: Device) -> None:
        flags = cast(cl.map_flags, cl.map_flags.READ | cl.map_flags.WRITE)
        size: Any = (array.nbytes,)
        self._queue, self._array = device.queue, array
        with device_errors(device.cl_device, "A mapped buffer"):
            self._bytes, _ = cl.enqueue_map_buffer(
                self._queue, cast(cl.Buffer, array.base_data), flags, array.offset, size,
                np.dtype(np.uint8),
            )  # fmt: skip
        self.__array_interface__ = {
            "version": 3,
            "shape": tuple(int(n) for n in array.shape),
            "typestr": np.dtype(array.dtype).str,
            "data": (self._bytes.ctypes.data, False),
        }

    def __del__(self) -> None:
        if hasattr(self, "_bytes") and not is_forked():
            self._bytes.base.release(self._queue)  # before the buffer, which is used again


def shares_memory(a: cla.Array, b: cla.Array) -> bool:
    """Whether two arrays lie in one buffer."""
    return math.prod(a.shape) > 0 and a.base_data is not None and a.base_data == b.base_data
