"""Arrays in the memory of a device: allocated, copied to and from the host, mapped.

The first write to a new buffer of a CPU device causes a page fault every 4 kB. These faults take
longer than a pass over the data. Linux provides 2 MB pages on request. NumPy requests them for its
arrays; OpenCL runtimes do not.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property
from typing import Any, TypeVar, cast

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
from pyopencl.tools import ImmediateAllocator, MemoryPool

from clplen.compute.drivers import limits
from clplen.compute.drivers.failures import device_errors, is_out_of_memory
from clplen.compute.drivers.forked import Guard, require_own_process
from clplen.compute.fft.plans import PlanCache, Workspace
from clplen.compute.hardware import Hardware
from clplen.errors import DeviceError, ShapeError
from clplen.units import bytes_of

T = TypeVar("T")
MIN_LARGE_BYTES = 2**22  # smallest buffer for which large pages and reuse save time
_PAGE = 4096
_MADV_HUGEPAGE = 14


def ask_for_large_pages(queue: cl.CommandQueue, buffer: cl.Buffer) -> None:
    """Request large pages from Linux for a new buffer of a CPU device; elsewhere do nothing."""
    advise = _madvise()
    if advise is None or buffer.size < MIN_LARGE_BYTES:
        return
    flags = cast(cl.map_flags, cl.map_flags.READ | cl.map_flags.WRITE)
    size: Any = (buffer.size,)
    mapped, _ = cl.enqueue_map_buffer(queue, buffer, flags, 0, size, np.dtype(np.uint8))
    start = -(-mapped.ctypes.data // _PAGE) * _PAGE
    length = (mapped.ctypes.data + buffer.size - start) // _PAGE * _PAGE
    advise(start, length, _MADV_HUGEPAGE)  # only a hint, which may fail silently
    mapped.base.release(queue)


@cache
def _madvise() -> Any:
    """Return ``madvise`` of the C library, or None if the system has none."""
    if sys.platform != "linux":
        return None
    function = getattr(ctypes.CDLL(None), "madvise", None)
    if function is not None:
        function.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return function


def trim_heap() -> None:
    """Return freed heap memory to Linux, which the C library holds after many small buffers."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
        if trim is not None:
            trim(0)


_SPARE_BYTES = 2**30  # default cache limit of a CPU, both precisions together
_GPU_SPARE_BYTES = 6 * 2**30  # default cache limit of a GPU, which other programs may share
_SPARE_SHARE = 4  # the limit is at most this fraction, 1/4, of the device's memory
_PLAN_SHARE = 5 / 8  # fraction of the limit for plans, the slowest to recreate
_WORKSPACE_SHARE = 1 / 4  # fraction of the limit for the workspace of FFTs on the host
_COPIES = 64  # maximum number of pending small copies to a GPU
_POOL_STEP = 8  # the pool rounds sizes up by less than 1/8


class Memory(Hardware):
    """Memory of a device, with a cache of plans and buffers between calls.

    ``sibling`` is the device of the other precision on this hardware; the two share the cache.
    """

    def __init__(self, cl_device: cl.Device, sibling: Memory | None = None) -> None:
        super().__init__(cl_device)
        self._unchecked_bytes = 0  # bytes allocated since the last check of the limits
        # mapped buffers: their bytes and their number of users
        self._maps: dict[tuple[int, bool], list[Any]] = {}
        self._maps_lock = Guard()
        # pending copies to a GPU, which hold references to their sources
        self._copies: deque[Any] = deque(maxlen=_COPIES)
        self.spare_bytes = min(_spare_limit(self.is_cpu), self.memory_bytes // _SPARE_SHARE)
        limit = int(_PLAN_SHARE * self.spare_bytes)
        # plans (transfer functions, arrays of lenslets), under a common limit in bytes
        self.plans: PlanCache = PlanCache(limit, sibling.plans if sibling else None)
        self.transforms = PlanCache(limit, self.plans)  # Fourier transforms on the device
        self.tables = PlanCache(limit, self.plans)  # small tables of recent launches
        # host memory reused by transforms on the host
        workspace = sibling.workspace if sibling else None
        self.workspace: Workspace = workspace or Workspace(int(_WORKSPACE_SHARE * self.spare_bytes))
        self._precisions: list[Memory] = sibling._precisions if sibling else []
        self._precisions.append(self)

    def require_memory(self, nbytes: int, what: str) -> None:
        """Raise a `DeviceError` if ``what`` needs more bytes than can fit; allocate nothing."""
        if nbytes > self.memory_bytes:
            raise self._too_much(nbytes, what)
        if self.is_cpu and nbytes > MIN_LARGE_BYTES:
            free = limits.array_room(nbytes)
            # Arrays that exist already may count towards the bytes needed.
            room = free._replace(nbytes=max(free.nbytes, 0) + self.held_bytes())
            if nbytes > room.nbytes:
                raise self._too_much(nbytes, what, room)

    def _too_much(self, nbytes: int, what: str, room: limits.Room | None = None) -> DeviceError:
        """Return the error about a size above the device's memory or above a limit."""
        capacity = f"{self.name} has {_bytes(self.memory_bytes)}"
        remedy = "a device with more memory"
        if room is not None:
            capacity = f"{room.limit} leaves {_bytes(max(room.nbytes, 0))} to arrays"
            remedy = "raise the limit" if "limit" in room.limit else remedy
        return DeviceError(
            f"{what} needs {_bytes(nbytes)}, but {capacity}: use fewer planes or samples at a "
            f"time, integer instead of float storage, or {remedy}."
        )

    def held_bytes(self) -> int:
        """Return the bytes of large arrays on this hardware, in use or cached for reuse."""
        return sum(pool.managed_bytes for pool in self._pools())

    def _pools(self) -> list[MemoryPool]:
        """Return the pools of spare buffers of both precisions, as far as they exist."""
        devices = tuple(self._precisions)
        return [device._spare for device in devices if "_spare" in device.__dict__]

    def _require_room(self, nbytes: int, what: str) -> None:
        """Raise if an array of a CPU exceeds a limit of the process or of the computer.

        Spare memory is freed before the check fails. Small arrays are checked together.
        """
        self._unchecked_bytes += nbytes
        if not self.is_cpu or self._unchecked_bytes < MIN_LARGE_BYTES:
            return
        self._unchecked_bytes = 0
        if nbytes <= limits.array_room(nbytes).nbytes:
            return
        self.free_spare()
        room = limits.array_room(nbytes)
        if nbytes > room.nbytes:
            raise self._too_much(nbytes, what, room)

    def empty(self, shape: Sequence[int], dtype: Any) -> cla.Array:
        """Allocate an uninitialised C-contiguous array on the device."""
        shape, dtype = tuple(int(n) for n in shape), np.dtype(dtype)
        what = f"An array of shape {shape} ({dtype})"
        nbytes = math.prod(shape) * dtype.itemsize
        largest = min(self.memory_bytes, int(self.cl_device.max_mem_alloc_size))
        if nbytes > largest:
            raise self._too_much(nbytes, what, limits.Room(largest, self.name))
        self._require_room(nbytes, what)
        smallest = MIN_LARGE_BYTES if self.is_cpu else 1  # a GPU synchronises at each allocation
        spare = smallest <= nbytes <= largest - nbytes // _POOL_STEP
        pooled_bytes = self._spare.managed_bytes
        allocator = self._spare if spare else self._allocator
        with device_errors(self.cl_device, what):
            array = self.retry_with_room(
                lambda: cla.empty(self.queue, shape, dtype, allocator=allocator)
            )
        if self.is_cpu and self._spare.managed_bytes > pooled_bytes:
            ask_for_large_pages(self.queue, _buffer(array))
        self._trim()
        return array

    @property
    def _flags(self) -> cl.mem_flags:
        """Buffer flags; a CPU allocates at once, since PoCL's late allocation fails silently."""
        flags = cl.mem_flags.READ_WRITE
        return cast(cl.mem_flags, flags | cl.mem_flags.ALLOC_HOST_PTR) if self.is_cpu else flags

    @cached_property
    def _allocator(self) -> Callable[[int], cl.Buffer]:
        """Allocator of small arrays."""
        context, flags = self.context, self._flags
        return lambda nbytes: cl.Buffer(context, flags, nbytes)

    @cached_property
    def _spare(self) -> MemoryPool:
        """Pool of large buffers for reuse, since a new buffer costs page faults or a wait."""
        return MemoryPool(ImmediateAllocator(self.queue, self._flags))

    def _trim(self) -> None:
        """Free spare buffers above the cache limit."""
        pools = self._pools()
        spare = sum(pool.managed_bytes - pool.active_bytes for pool in pools)
        if spare > self.spare_bytes - self.plans.shared_bytes - self.workspace.nbytes:
            for pool in pools:
                pool.free_held()

    def retry_with_room(self, act: Callable[[], T]) -> T:
        """Return ``act()``; after an out-of-memory error free spare memory and retry once."""
        try:
            return act()
        except Exception as error:
            self.make_room(error)
        return act()

    def make_room(self, error: Exception) -> None:
        """Free spare memory after an out-of-memory error; raise any other error again."""
        if not is_out_of_memory(error):
            raise error
        self.free_spare()

    def free_spare(self) -> None:
        """Free the memory that this hardware caches for later calls, in both precisions.

        The cache holds plans, tables, spare buffers and the workspace of Fourier transforms.
        """
        require_own_process()
        for device in tuple(self._precisions):
            for store in (device.plans, device.transforms, device.tables, device.workspace):
                store.clear()
        for pool in self._pools():
            pool.free_held()
        trim_heap()

    def zeros(self, shape: Sequence[int], dtype: Any) -> cla.Array:
        """Allocate an array of zeros on the device."""
        array = self.empty(shape, dtype)
        if array.nbytes:
            zero = np.zeros(1, np.uint8)
            with device_errors(self.cl_device, "An array of zeros"):
                cl.enqueue_fill_buffer(self.queue, _buffer(array), zero, 0, array.nbytes)
        return array

    def upload(self, values: np.ndarray[Any, Any]) -> cla.Array:
        """Copy a host array to the device; small arrays do not wait for earlier work."""
        values = np.asarray(values, order="C")
        what = "A copy to the device"
        small = 0 < values.nbytes < min(MIN_LARGE_BYTES, self.memory_bytes)
        if small and self._profile is None and not self.is_cpu:
            array = self.empty(values.shape, values.dtype)
            with device_errors(self.cl_device, what):
                event = cl.enqueue_copy(
                    self.queue, _buffer(array), values.copy(), is_blocking=False
                )
            self._copies.append(event)
            return array
        if small and self._profile is None:
            flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
            self._require_room(values.nbytes, what)
            with device_errors(self.cl_device, what):
                buffer = self.retry_with_room(
                    lambda: cl.Buffer(self.context, flags, hostbuf=values)
                )
            return cla.Array(self.queue, values.shape, values.dtype, data=buffer)
        array = self.empty(values.shape, values.dtype)
        if values.nbytes:
            with device_errors(self.cl_device, what):
                event = cl.enqueue_copy(self.queue, _buffer(array), values, is_blocking=True)
            self._note("upload", event, values.nbytes)
        return array

    def download(self, array: cla.Array) -> np.ndarray[Any, Any]:
        """Copy a C-contiguous device array to the host, same shape and dtype."""
        _require_contiguous(array)
        what = f"A copy to the host, of shape {array.shape} ({array.dtype}),"
        self._require_room(array.nbytes, what)
        with device_errors(self.cl_device, what):
            values = self.retry_with_room(lambda: np.empty(array.shape, array.dtype))
        if values.nbytes:
            with device_errors(self.cl_device, "A copy to the host"):
                event = cl.enqueue_copy(
                    self.queue, values, _buffer(array), src_offset=array.offset, is_blocking=True
                )
            self._note("download", event, values.nbytes)
        return values

    def copy_into(self, target: cla.Array, source: cla.Array, offset: int) -> None:
        """Copy a device array into another device array, starting at a byte offset."""
        if source.nbytes:
            with device_errors(self.cl_device, "A copy on the device"):
                event = cl.enqueue_copy(
                    self.queue,
                    _buffer(target),
                    _buffer(source),
                    src_offset=source.offset,
                    dst_offset=target.offset + offset,
                    byte_count=source.nbytes,
                )
            self._note("copy", event, 2 * source.nbytes)

    def copy_lines(
        self,
        target: cla.Array,
        source: cla.Array,
        size: tuple[int, int],
        of_source: tuple[int, int],
        of_target: tuple[int, int],
    ) -> None:
        """Copy lines of bytes between two C-contiguous device arrays.

        ``size`` is (bytes of a line, number of lines). ``of_source`` and ``of_target`` are (byte
        offset of the first line, bytes between the starts of lines).
        """
        (source_start, source_pitch), (target_start, target_pitch) = of_source, of_target
        with device_errors(self.cl_device, "A copy on the device"):
            event = cl.enqueue_copy(
                self.queue,
                _buffer(target),
                _buffer(source),
                src_origin=(source.offset + source_start, 0, 0),
                dst_origin=(target.offset + target_start, 0, 0),
                region=(*size, 1),
                src_pitches=(source_pitch,),
                dst_pitches=(target_pitch,),
            )
        self._note("copy", event, 2 * math.prod(size))

    @contextmanager
    def on_host(self, array: cla.Array, *, write: bool = True) -> Iterator[np.ndarray[Any, Any]]:
        """Yield the values of a C-contiguous array as a NumPy array; a CPU device copies nothing.

        If ``write``, in-place changes persist; the values of a GPU are copied back.
        """
        _require_contiguous(array)
        if not self.is_cpu:
            values = self.download(array)
            yield values
            if write:
                with device_errors(self.cl_device, "A copy to the device"):
                    cl.enqueue_copy(
                        self.queue,
                        _buffer(array),
                        values,
                        dst_offset=array.offset,
                        is_blocking=True,
                    )
            return
        with self._mapped(_buffer(array), write) as values:
            segment = values[array.offset : array.offset + array.nbytes]
            yield segment.view(array.dtype).reshape(array.shape)

    @contextmanager
    def _mapped(self, buffer: cl.Buffer, write: bool) -> Iterator[np.ndarray[Any, Any]]:
        """Yield the bytes of a buffer, mapped once for all readers and once for all writers."""
        key = buffer.int_ptr, write
        with self._maps_lock:
            if key not in self._maps:
                access = cl.map_flags.READ | cl.map_flags.WRITE if write else cl.map_flags.READ
                flags = cast(cl.map_flags, access)
                with device_errors(self.cl_device, "A mapped buffer"):
                    values, _ = cl.enqueue_map_buffer(
                        self.queue, buffer, flags, 0, (buffer.size,), np.dtype(np.uint8)
                    )
                self._maps[key] = [values, 0]
            else:
                with device_errors(self.cl_device, "Enqueued work"):
                    self.queue.finish()  # mapping the buffer again would wait, too
            mapping = self._maps[key]
            mapping[1] += 1
        try:
            yield mapping[0]
        finally:
            with self._maps_lock:
                mapping[1] -= 1
                if not mapping[1]:
                    del self._maps[key]
                    mapping[0].base.release(self.queue)


def _spare_limit(is_cpu: bool) -> int:
    """Return the cache limit in bytes: ``$CLPLEN_SPARE_MEMORY``, else the default."""
    variable = os.environ.get("CLPLEN_SPARE_MEMORY", "").strip()
    try:
        return bytes_of(variable) if variable else (_SPARE_BYTES if is_cpu else _GPU_SPARE_BYTES)
    except ValueError as error:
        raise DeviceError(f"CLPLEN_SPARE_MEMORY {error}, got {variable!r}.") from error


def _require_contiguous(array: cla.Array) -> None:
    if not array.flags.c_contiguous:
        raise ShapeError(
            f"Device arrays must be C-contiguous, got strides {array.strides}; copy the array."
        )


def _buffer(array: cla.Array) -> cl.Buffer:
    """Return the buffer of an array with at least one sample."""
    return cast(cl.Buffer, array.base_data)


def _bytes(count: int) -> str:
    return f"{count:,} bytes ({count / 2**30:.2f} GiB)"


DEFAULT_FREE_BYTES = 4 << 30  # assumed if the system does not report its free memory


def free_memory() -> int:
    """Return the bytes of host memory that this process may still allocate."""
    rooms = limits.machine_room(swap=False), limits.process_room(), limits.group_room()
    free = min(room.nbytes for room in rooms)
    return DEFAULT_FREE_BYTES if free == sys.maxsize else max(free, 0)
