"""Arrays in the memory of a device: allocated, copied to and from the host, mapped.

The first write to a fresh buffer of a CPU device meets a page fault every 4 kB, which takes longer
than a pass over the data. Linux hands out 2 MB pages where it is asked to; NumPy asks for its own
arrays, OpenCL runtimes do not.
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
from clplen.compute.drivers.failures import device_errors, is_want_of_memory
from clplen.compute.drivers.forked import Guard, require_own_process
from clplen.compute.fft.plans import PlanCache, Workspace
from clplen.compute.hardware import Hardware
from clplen.errors import DeviceError, ShapeError
from clplen.units import bytes_of

T = TypeVar("T")
LEAST_BYTES = 2**22  # below this the request costs as much as it saves
_PAGE = 4096
_MADV_HUGEPAGE = 14


def ask_for_large_pages(queue: cl.CommandQueue, buffer: cl.Buffer) -> None:
    """Ask Linux for large pages under a fresh buffer of a CPU device; elsewhere do nothing."""
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


def trim_heap() -> None:
    """Let the C library give freed memory back to Linux; it keeps that of many small buffers."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
        if trim is not None:
            trim(0)


_SPARE_BYTES = 2**30  # that both precisions of a CPU keep for later calls
_GPU_SPARE_BYTES = 6 * 2**30  # on a GPU: other programs use it, too
_SPARE_SHARE = 4  # of the device's memory: at most a quarter
_PLAN_SHARE = 5 / 8  # of what is kept: plans, which take longest to make again; buffers the rest
_WORKSPACE_SHARE = 1 / 4
_COPIES = 64  # small arrays on their way to a GPU
_POOL_STEP = 8  # their sizes are rounded up by less than an eighth


class Memory(Hardware):
    """The memory of a device, and what is kept there between calls.

    ``beside`` is the same hardware in the other precision, with which it shares what may be kept.
    """

    def __init__(self, cl_device: cl.Device, beside: Memory | None = None) -> None:
        super().__init__(cl_device)
        self._unchecked_bytes = 0  # allocated since the limits were last looked at
        # mapped buffers: their bytes, and how many use them
        self._maps: dict[tuple[int, bool], list[Any]] = {}
        self._maps_lock = Guard()
        # copies to a GPU under way, which hold what they copy; the oldest is waited for
        self._copies: deque[Any] = deque(maxlen=_COPIES)
        self.spare_bytes = min(_spare_limit(self.is_cpu), self.memory_bytes // _SPARE_SHARE)
        limit = int(_PLAN_SHARE * self.spare_bytes)
        # plans (transfer functions, arrays of lenslets), bounded in bytes with those below
        self.plans: PlanCache = PlanCache(limit, beside.plans if beside else None)
        self.transforms = PlanCache(limit, self.plans)  # Fourier transforms that the device runs
        self.tables = PlanCache(limit, self.plans)  # small ones of recent launches
        # host memory that transforms on the host use again and again
        workspace = beside.workspace if beside else None
        self.workspace: Workspace = workspace or Workspace(int(_WORKSPACE_SHARE * self.spare_bytes))
        self._precisions: list[Memory] = beside._precisions if beside else []
        self._precisions.append(self)

    def require_memory(self, nbytes: int, what: str) -> None:
        """Raise a `DeviceError` about ``what`` if its bytes cannot fit; allocate nothing."""
        if nbytes > self.memory_bytes:
            raise self._too_much(nbytes, what)
        if self.is_cpu and nbytes > LEAST_BYTES:
            free = limits.array_room(nbytes)
            # What is there already may be among what is needed.
            room = free._replace(nbytes=max(free.nbytes, 0) + self.held_bytes())
            if nbytes > room.nbytes:
                raise self._too_much(nbytes, what, room)

    def _too_much(self, nbytes: int, what: str, room: limits.Room | None = None) -> DeviceError:
        """The refusal of a size, for want of the device's memory or within a limit."""
        there = f"{self.name} has {_bytes(self.memory_bytes)}"
        remedy = "a device with more memory"
        if room is not None:
            there = f"{room.limit} leaves {_bytes(max(room.nbytes, 0))} to arrays"
            remedy = "raise the limit" if "limit" in room.limit else remedy
        return DeviceError(
            f"{what} needs {_bytes(nbytes)}, but {there}: use fewer planes or samples at a time, "
            f"integer instead of float storage, or {remedy}."
        )

    def held_bytes(self) -> int:
        """Bytes of large arrays on this hardware, in use or kept for use again."""
        return sum(pool.managed_bytes for pool in self._pools())

    def _pools(self) -> list[MemoryPool]:
        """The spare buffers of both precisions, where there are any yet."""
        devices = tuple(self._precisions)
        return [one._spare for one in devices if "_spare" in one.__dict__]

    def _require_room(self, nbytes: int, what: str) -> None:
        """Refuse an array of a CPU that a limit of the process or the computer does not admit.

        What is kept for later calls is given back before. Small arrays are looked at together.
        """
        self._unchecked_bytes += nbytes
        if not self.is_cpu or self._unchecked_bytes < LEAST_BYTES:
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
        least = LEAST_BYTES if self.is_cpu else 1  # what a GPU allocates or frees, it waits for
        spare = least <= nbytes <= largest - nbytes // _POOL_STEP
        held = self._spare.managed_bytes
        allocator = self._spare if spare else self._allocator
        with device_errors(self.cl_device, what):
            array = self.roomy(lambda: cla.empty(self.queue, shape, dtype, allocator=allocator))
        if self.is_cpu and self._spare.managed_bytes > held:
            ask_for_large_pages(self.queue, _buffer(array))
        self._trim()
        return array

    @property
    def _flags(self) -> cl.mem_flags:
        """A CPU's memory is allocated at once: PoCL fails later, and there without an error."""
        late = cl.mem_flags.READ_WRITE
        return cast(cl.mem_flags, late | cl.mem_flags.ALLOC_HOST_PTR) if self.is_cpu else late

    @cached_property
    def _allocator(self) -> Callable[[int], cl.Buffer]:
        """What allocates small arrays."""
        context, flags = self.context, self._flags
        return lambda nbytes: cl.Buffer(context, flags, nbytes)

    @cached_property
    def _spare(self) -> MemoryPool:
        """Large buffers that were let go, for the next one of their size: fresh ones cost time."""
        return MemoryPool(ImmediateAllocator(self.queue, self._flags))

    def _trim(self) -> None:
        """Give back spare buffers beyond what may be kept."""
        pools = self._pools()
        spare = sum(pool.managed_bytes - pool.active_bytes for pool in pools)
        if spare > self.spare_bytes - self.plans.shared_bytes - self.workspace.nbytes:
            for pool in pools:
                pool.free_held()

    def roomy(self, act: Callable[[], T]) -> T:
        """What ``act`` gives; where memory is wanting, once more without what is kept."""
        try:
            return act()
        except Exception as error:
            self.make_room(error)
        return act()

    def make_room(self, error: Exception) -> None:
        """Give back what is kept after a want of memory; raise any other error again."""
        if not is_want_of_memory(error):
            raise error
        self.free_spare()

    def free_spare(self) -> None:
        """Give back what this hardware keeps for later calls, in both precisions.

        These are plans, tables, spare buffers and the working memory of Fourier transforms.
        """
        require_own_process()
        for one in tuple(self._precisions):
            for kept in (one.plans, one.transforms, one.tables, one.workspace):
                kept.clear()
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
        """Copy a host array to the device; a small one does not wait for earlier work."""
        values = np.asarray(values, order="C")
        what = "A copy to the device"
        small = 0 < values.nbytes < min(LEAST_BYTES, self.memory_bytes)
        if small and self._profile is None and not self.is_cpu:
            array = self.empty(values.shape, values.dtype)
            with device_errors(self.cl_device, what):
                done = cl.enqueue_copy(self.queue, _buffer(array), values.copy(), is_blocking=False)
            self._copies.append(done)
            return array
        if small and self._profile is None:
            flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
            self._require_room(values.nbytes, what)
            with device_errors(self.cl_device, what):
                buffer = self.roomy(lambda: cl.Buffer(self.context, flags, hostbuf=values))
            return cla.Array(self.queue, values.shape, values.dtype, data=buffer)
        array = self.empty(values.shape, values.dtype)
        if values.nbytes:
            with device_errors(self.cl_device, what):
                done = cl.enqueue_copy(self.queue, _buffer(array), values, is_blocking=True)
            self._note("upload", done, values.nbytes)
        return array

    def download(self, array: cla.Array) -> np.ndarray[Any, Any]:
        """Copy a C-contiguous device array to the host, same shape and dtype."""
        _require_contiguous(array)
        what = f"A copy to the host, of shape {array.shape} ({array.dtype}),"
        self._require_room(array.nbytes, what)
        with device_errors(self.cl_device, what):
            values = self.roomy(lambda: np.empty(array.shape, array.dtype))
        if values.nbytes:
            with device_errors(self.cl_device, "A copy to the host"):
                done = cl.enqueue_copy(
                    self.queue, values, _buffer(array), src_offset=array.offset, is_blocking=True
                )
            self._note("download", done, values.nbytes)
        return values

    def copy_into(self, target: cla.Array, source: cla.Array, offset: int) -> None:
        """Copy a whole device array into another one, from a byte of that on."""
        if source.nbytes:
            with device_errors(self.cl_device, "A copy on the device"):
                done = cl.enqueue_copy(
                    self.queue,
                    _buffer(target),
                    _buffer(source),
                    src_offset=source.offset,
                    dst_offset=target.offset + offset,
                    byte_count=source.nbytes,
                )
            self._note("copy", done, 2 * source.nbytes)

    def copy_lines(
        self,
        target: cla.Array,
        source: cla.Array,
        size: tuple[int, int],
        of_source: tuple[int, int],
        of_target: tuple[int, int],
    ) -> None:
        """Copy lines of bytes from one C-contiguous device array into another one.

        ``size`` is (bytes of a line, lines), ``of_source`` and ``of_target`` are (byte at which the
        first line starts, bytes from one line to the next).
        """
        (start, pitch), (to, apart) = of_source, of_target
        with device_errors(self.cl_device, "A copy on the device"):
            done = cl.enqueue_copy(
                self.queue,
                _buffer(target),
                _buffer(source),
                src_origin=(source.offset + start, 0, 0),
                dst_origin=(target.offset + to, 0, 0),
                region=(*size, 1),
                src_pitches=(pitch,),
                dst_pitches=(apart,),
            )
        self._note("copy", done, 2 * math.prod(size))

    @contextmanager
    def on_host(self, array: cla.Array, *, write: bool = True) -> Iterator[np.ndarray[Any, Any]]:
        """Yield a C-contiguous array's values as a NumPy array, on a CPU device without a copy.

        With ``write`` changes in place are kept; a GPU's array is written back.
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
            own = values[array.offset : array.offset + array.nbytes]
            yield own.view(array.dtype).reshape(array.shape)

    @contextmanager
    def _mapped(self, buffer: cl.Buffer, write: bool) -> Iterator[np.ndarray[Any, Any]]:
        """A buffer's bytes, mapped once for all who read and once for all who write."""
        key = buffer.int_ptr, write
        with self._maps_lock:
            if key not in self._maps:
                wanted = cl.map_flags.READ | cl.map_flags.WRITE if write else cl.map_flags.READ
                flags = cast(cl.map_flags, wanted)
                with device_errors(self.cl_device, "A mapped buffer"):
                    values, _ = cl.enqueue_map_buffer(
                        self.queue, buffer, flags, 0, (buffer.size,), np.dtype(np.uint8)
                    )
                self._maps[key] = [values, 0]
            else:
                with device_errors(self.cl_device, "What was enqueued"):
                    self.queue.finish()  # as a map of its own would wait
            held = self._maps[key]
            held[1] += 1
        try:
            yield held[0]
        finally:
            with self._maps_lock:
                held[1] -= 1
                if not held[1]:
                    del self._maps[key]
                    held[0].base.release(self.queue)


def _spare_limit(is_cpu: bool) -> int:
    """Bytes that may be kept for later calls: ``$CLPLEN_SPARE_MEMORY``, else the default."""
    asked = os.environ.get("CLPLEN_SPARE_MEMORY", "").strip()
    try:
        return bytes_of(asked) if asked else (_SPARE_BYTES if is_cpu else _GPU_SPARE_BYTES)
    except ValueError as error:
        raise DeviceError(f"CLPLEN_SPARE_MEMORY {error}, got {asked!r}.") from error


def _require_contiguous(array: cla.Array) -> None:
    if not array.flags.c_contiguous:
        raise ShapeError(
            f"A device array of strides {array.strides} is not C-contiguous: copy it into a new "
            "array."
        )


def _buffer(array: cla.Array) -> cl.Buffer:
    """The buffer that holds an array of at least one sample."""
    return cast(cl.Buffer, array.base_data)


def _bytes(count: int) -> str:
    return f"{count:,} bytes ({count / 2**30:.2f} GiB)"


_UNKNOWN = 4 << 30  # where a system does not say how much memory is free


def free_memory() -> int:
    """Bytes of host memory that this process may still take."""
    rooms = limits.machine_room(swap=False), limits.process_room(), limits.group_room()
    free = min(room.nbytes for room in rooms)
    return _UNKNOWN if free == sys.maxsize else max(free, 0)
