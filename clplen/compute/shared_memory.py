"""Arrays shared by host and device: the same memory on a CPU, copies on other devices.

Automatic differentiation passes arrays in and out at every step. A CPU device computes on arrays of
the host in place (``CL_MEM_USE_HOST_PTR``) and maps its results without a copy.
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
    """Return a read-only device array of an array of the host; a CPU device copies nothing.

    Do not change ``values`` while the device reads them: call `Device.finish`, or `keep` for a
    result computed from them, before returning them to their owner.
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
    """Return an array of a device on the host; a CPU device returns its memory, not a copy.

    The call waits for all enqueued work. The memory lives as long as the result and its views, so
    do not use the device array afterwards.
    """
    if not (device.is_cpu and array.size):
        return device.download(array)
    return np.asarray(_Mapped(array, device))


class _Mapped(HoldsOpenCL):
    """Mapped array with its buffer, kept alive by the NumPy array of its memory."""

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
            self._bytes.base.release(self._queue)  # before the buffer returns to the pool


def shares_memory(a: cla.Array, b: cla.Array) -> bool:
    """Return True if two arrays use the same buffer."""
    return math.prod(a.shape) > 0 and a.base_data is not None and a.base_data == b.base_data
