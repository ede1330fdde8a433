"""An OpenCL device with its queue, its built kernels, its plans and its memory."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property
from threading import Lock, RLock
from typing import Any, Literal, cast

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
from pyopencl.tools import ImmediateAllocator, MemoryPool

from clplen.compute import pocl
from clplen.compute.cache import PlanCache
from clplen.compute.fft import FFTRoute, choose_route
from clplen.compute.pages import LEAST_BYTES, ask_for_large_pages
from clplen.compute.profile import Profile, bytes_of, label
from clplen.compute.program import build_program
from clplen.compute.selection import find_devices, select
from clplen.compute.tuning import Tuning
from clplen.compute.workspace import Workspace
from clplen.errors import DeviceError, ShapeError

Precision = Literal["single", "double"]

_GPU_GROUP = 64  # work-items of one row that a GPU runs as a group
_PLAN_SHARE = 4  # plans may hold a quarter of the device's memory
_SPARE_SHARE = 16  # buffers kept for use again, a sixteenth
_POOL_STEP = 8  # their sizes are rounded up by less than an eighth


class Device:
    """One OpenCL device at one precision. Made by `Device.open`, not by its constructor.

    Attributes
    ----------
    name : str
        The device's own name.
    is_cpu : bool
        Whether it is a CPU: buffers are mapped and FFTs run on the host in place.
    has_fp64 : bool
        Whether it computes in double precision.
    memory_bytes : int
        Its global memory.
    precision : {"single", "double"}
        Precision of the wave tower; light fields are processed in float32 on every device.
    place : str
        The "platform:device" selector that opens it.
    """

    def __init__(
        self, cl_device: cl.Device, *, precision: Precision = "single", place: str = ""
    ) -> None:
        if precision not in ("single", "double"):
            raise ValueError(f"precision is 'single' or 'double', not {precision!r}.")
        self.cl_device = cl_device
        self.place = place
        self.precision: Precision = precision
        self.name: str = cl_device.name.strip()
        self.platform: str = cl_device.platform.name.strip()
        self.driver: str = f"{self.platform} {cl_device.driver_version.strip()}"
        self.is_cpu = bool(cl_device.type & cl.device_type.CPU)
        self.has_fp64 = "cl_khr_fp64" in cl_device.extensions
        self.memory_bytes = int(cl_device.global_mem_size)
        self.rows = self.is_cpu  # one work-item a row (CPU) or one a sample (GPU)
        self.note = ""
        self._programs: dict[tuple[Any, ...], cl.Program] = {}
        self._kernels: dict[tuple[Any, ...], cl.Kernel] = {}
        self._labels: dict[cl.Kernel, str] = {}
        self._profile: Profile | None = None
        self._lock = RLock()
        self._usable = False
        self._context: cl.Context | None = None
        self._queue: cl.CommandQueue | None = None
        if precision == "double" and not self.has_fp64:
            raise DeviceError(
                f"precision='double' was asked for, but {self.name} ({self.platform}) has no "
                "double precision (cl_khr_fp64); use precision='single' or another device."
            )

    @staticmethod
    def open(selector: str | None = None, *, precision: Precision = "single") -> Device:
        """Open a device.

        Parameters
        ----------
        selector : str, optional
            ``"cpu"``, ``"gpu"``, ``"0:1"`` (platform:device), or part of a name ("pocl",
            "nvidia"). None takes ``$CLPLEN_DEVICE``, else the first GPU, else the first CPU that
            can compile kernels.
        precision : {"single", "double"}
            ``"double"`` runs every kernel and FFT of the wave tower in float64.

        Returns
        -------
        Device
            The same object for the same hardware and precision.

        Raises
        ------
        DeviceError
            If there is no OpenCL platform, nothing fits the selector, or the device cannot
            compile kernels or lacks double precision.
        """
        if selector is None:
            selector = os.environ.get("CLPLEN_DEVICE") or None
        problems = []
        for place, cl_device in select(find_devices(), selector):
            try:
                device = _registered(cl_device, precision, place)
                device.ensure_usable()
            except DeviceError as error:
                problems.append(str(error))
            else:
                return device
        raise DeviceError(" ".join(problems))

    @staticmethod
    def all() -> list[Device]:
        """Every OpenCL device that is there, in platform order, in single precision.

        Nothing is compiled yet; a device that cannot compile says so when it is first used.
        """
        return [_registered(cl_device, "single", place) for place, cl_device in find_devices()]

    def __repr__(self) -> str:
        parts = [self.name, self.driver, self.precision, f"FFT {self.fft.name}"]
        parts += [note for note in (self.note, self.tuning.note) if note]
        return f"<Device {', '.join(parts)}>"

    def ensure_usable(self) -> None:
        """Find out, once, whether the device compiles kernels; mend it where that is known how.

        What was done is said once and kept in ``note``.

        Raises
        ------
        DeviceError
            If it does not.
        """
        with self._lock:
            if not self._usable:
                self.note = pocl.ensure_usable(self.cl_device)
                self._usable = True
                if self.note:
                    warnings.warn(self.note, RuntimeWarning, stacklevel=3)

    @property
    def context(self) -> cl.Context:
        """The OpenCL context, made at first use."""
        with self._lock:
            if self._context is None:
                self.ensure_usable()
                self._context = cl.Context([self.cl_device])
            return self._context

    @property
    def queue(self) -> cl.CommandQueue:
        """The in-order command queue, made at first use."""
        with self._lock:
            if self._queue is None:
                self._queue = cl.CommandQueue(self.context)
            return self._queue

    @contextmanager
    def profiling(self) -> Iterator[Profile]:
        """Time everything that is enqueued in this block, by the device's own clock.

        Yields
        ------
        Profile
            Its ``runs`` are complete when the block is left.
        """
        properties = cl.command_queue_properties.PROFILING_ENABLE
        with self._lock:
            self.queue.finish()
            plain, before = self.queue, self._profile
            profile = self._profile = Profile()
            self._queue = cl.CommandQueue(self.context, properties=properties)
        try:
            yield profile
        finally:
            with self._lock:
                self.queue.finish()
                self._queue, self._profile = plain, before

    def timed(
        self, what: str, *, nbytes: int, operations: float = 0.0
    ) -> AbstractContextManager[None]:
        """Work of the host that belongs into a profile; nothing happens where none is kept.

        Parameters
        ----------
        what : str
        nbytes : int
            That have to be moved at least.
        operations : float
            Additions and multiplications.
        """
        if self._profile is None:
            return nullcontext()
        return self._profile.on_host(what, self.queue, nbytes, operations)

    @cached_property
    def fft(self) -> FFTRoute:
        """How Fourier transforms are done on this device; chosen once."""
        return choose_route(self.is_cpu, self.platform)

    @cached_property
    def plans(self) -> PlanCache:
        """Plans of this device (transfer functions, arrays of lenslets), bounded in bytes."""
        return PlanCache(self.memory_bytes // _PLAN_SHARE)

    @cached_property
    def tuning(self) -> Tuning:
        """Which forms of kernels are fastest here, and which cannot be run."""
        return Tuning(self)

    @cached_property
    def workspace(self) -> Workspace:
        """Host memory that transforms on the host use again and again."""
        return Workspace(self.memory_bytes // _PLAN_SHARE)

    @property
    def real(self) -> np.dtype[Any]:
        """Real dtype of the wave tower: float32 or float64."""
        return np.dtype(np.float32 if self.precision == "single" else np.float64)

    @property
    def complex(self) -> np.dtype[Any]:
        """Complex dtype of the wave tower: complex64 or complex128."""
        return np.dtype(np.complex64 if self.precision == "single" else np.complex128)

    def require_memory(self, nbytes: int, what: str) -> None:
        """Refuse what cannot fit, before anything is allocated.

        Parameters
        ----------
        nbytes : int
            Bytes that will be allocated.
        what : str
            What they are for, as the subject of the message.

        Raises
        ------
        DeviceError
            With the bytes needed and the bytes there are.
        """
        if nbytes > self.memory_bytes:
            raise DeviceError(
                f"{what} needs {_bytes(nbytes)}, but {self.name} has {_bytes(self.memory_bytes)}: "
                "use fewer planes or samples at a time, integer instead of float storage, or a "
                "device with more memory."
            )

    def empty(self, shape: Sequence[int], dtype: Any) -> cla.Array:
        """An uninitialised C-contiguous array on the device.

        Parameters
        ----------
        shape : sequence of int
        dtype : dtype-like

        Returns
        -------
        pyopencl.array.Array

        Raises
        ------
        DeviceError
            If it is larger than the device allows.
        """
        shape = tuple(int(n) for n in shape)
        nbytes = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        largest = min(self.memory_bytes, int(self.cl_device.max_mem_alloc_size))
        if nbytes > largest:
            raise DeviceError(
                f"An array of shape {shape} ({np.dtype(dtype)}) needs {_bytes(nbytes)}, but the "
                f"largest that {self.name} gives is {_bytes(largest)}: use fewer planes or samples "
                "at a time, integer instead of float storage, or a device with more memory."
            )
        if nbytes < LEAST_BYTES or nbytes + nbytes // _POOL_STEP > largest:
            return cla.empty(self.queue, shape, np.dtype(dtype))
        held = self._spare.managed_bytes
        array = cla.empty(self.queue, shape, np.dtype(dtype), allocator=self._spare)
        if self.is_cpu and self._spare.managed_bytes > held:
            ask_for_large_pages(self.queue, _buffer(array))
        if self._spare.managed_bytes - self._spare.active_bytes > self.memory_bytes // _SPARE_SHARE:
            self._spare.free_held()
        return array

    @cached_property
    def _spare(self) -> MemoryPool:
        """Large buffers that were let go, for the next one of their size: fresh ones cost time."""
        return MemoryPool(ImmediateAllocator(self.queue))

    def free_spare(self) -> None:
        """Give back the large buffers that are kept for use again."""
        self._spare.free_held()

    def zeros(self, shape: Sequence[int], dtype: Any) -> cla.Array:
        """An array of zeros on the device."""
        array = self.empty(shape, dtype)
        if array.nbytes:
            zero = np.zeros(1, np.uint8)
            cl.enqueue_fill_buffer(self.queue, _buffer(array), zero, 0, array.nbytes)
        return array

    def upload(self, values: np.ndarray[Any, Any]) -> cla.Array:
        """A copy of a host array on the device, same shape and dtype."""
        values = np.asarray(values, order="C")
        array = self.empty(values.shape, values.dtype)
        if values.nbytes:
            done = cl.enqueue_copy(self.queue, _buffer(array), values, is_blocking=True)
            self._note("upload", done, values.nbytes)
        return array

    def download(self, array: cla.Array) -> np.ndarray[Any, Any]:
        """A copy of a C-contiguous device array on the host, same shape and dtype."""
        _require_contiguous(array)
        values = np.empty(array.shape, array.dtype)
        if values.nbytes:
            done = cl.enqueue_copy(
                self.queue, values, _buffer(array), src_offset=array.offset, is_blocking=True
            )
            self._note("download", done, values.nbytes)
        return values

    def _note(self, what: str, event: Any, nbytes: int, operations: float = 0.0) -> None:
        if self._profile is not None:
            self._profile.add_event(what, event, nbytes, operations)

    def copy_into(self, target: cla.Array, source: cla.Array, offset: int) -> None:
        """Copy a whole device array into another one, from a byte of that on."""
        if source.nbytes:
            done = cl.enqueue_copy(
                self.queue,
                _buffer(target),
                _buffer(source),
                src_offset=source.offset,
                dst_offset=target.offset + offset,
                byte_count=source.nbytes,
            )
            self._note("copy", done, 2 * source.nbytes)

    @contextmanager
    def on_host(self, array: cla.Array, *, write: bool = True) -> Iterator[np.ndarray[Any, Any]]:
        """A C-contiguous array's values as a NumPy array, on a CPU device without a copy.

        Parameters
        ----------
        array : pyopencl.array.Array
        write : bool
            Whether changes in place are kept: elsewhere than on a CPU, where the buffer itself is
            mapped, they are written back.

        Raises
        ------
        ShapeError
            If the array is not C-contiguous.
        """
        _require_contiguous(array)
        if not self.is_cpu:
            values = self.download(array)
            yield values
            if write:
                cl.enqueue_copy(
                    self.queue, _buffer(array), values, dst_offset=array.offset, is_blocking=True
                )
            return
        wanted = cl.map_flags.READ | cl.map_flags.WRITE if write else cl.map_flags.READ
        flags = cast(cl.map_flags, wanted)
        mapped, _ = cl.enqueue_map_buffer(
            self.queue, _buffer(array), flags, array.offset, array.shape, array.dtype
        )
        try:
            yield mapped
        finally:
            mapped.base.release(self.queue)

    def kernel(self, file: str, name: str, **defines: Any) -> cl.Kernel:
        """A kernel, built once for every file and set of definitions, and kept."""
        if self.rows:
            defines["ROWS"] = True
        key = (file, name, tuple(sorted(defines.items())))
        with self._lock:
            if key not in self._kernels:
                program = self._program(file, tuple(sorted(defines.items())))
                self._kernels[key] = cl.Kernel(program, name)
                self._labels[self._kernels[key]] = label(name, key[2])
            return self._kernels[key]

    def _program(self, file: str, defines: tuple[tuple[str, Any], ...]) -> cl.Program:
        key = (file, defines)
        if key not in self._programs:
            self._programs[key] = build_program(self.context, file, dict(defines))
        return self._programs[key]

    def wave_defines(self) -> dict[str, Any]:
        """Definitions that choose the precision of a kernel of the wave tower."""
        return {"DOUBLE": True} if self.precision == "double" else {}

    def launch(
        self,
        kernel: cl.Kernel,
        size: Sequence[int],
        *args: Any,
        group: Sequence[int] | None = None,
        nbytes: int | None = None,
        operations: float = 0.0,
    ) -> None:
        """Enqueue a kernel.

        Parameters
        ----------
        kernel : pyopencl.Kernel
            From `kernel`.
        size : sequence of int
            Number of work-items along each axis, rounded up to the group.
        *args
            NumPy scalars, `pyopencl.array.Array` (without offset) or buffers, in order.
        group : sequence of int, optional
            Work-group; by default one item, or 64 along the first axis where ``rows`` is off.
        nbytes : int, optional
            For a profile: bytes that have to be moved at least; by default every array once.
        operations : float
            For a profile: additions and multiplications.
        """
        if group is None:
            group = (1 if self.rows else _GPU_GROUP, *(1 for _ in size[1:]))
        total = tuple(-(-int(n) // g) * g for n, g in zip(size, group, strict=True))
        if 0 in total:
            return
        plain: list[Any] = [arg.data if isinstance(arg, cla.Array) else arg for arg in args]
        with self._lock:
            done = kernel(self.queue, total, tuple(group), *plain)
            if self._profile is not None:
                moved = bytes_of(args) if nbytes is None else nbytes
                self._note(self._labels.get(kernel, kernel.function_name), done, moved, operations)

    def launch_rows(
        self, kernel: cl.Kernel, shape: Sequence[int], *args: Any, operations: float = 0.0
    ) -> None:
        """Enqueue a kernel written with ``FOR_X`` over (..., ny, nx): see common.cl."""
        *batch, ny, nx = (int(n) for n in shape)
        count = int(np.prod(batch, dtype=np.int64))
        self.launch(kernel, (1 if self.rows else nx, ny, count), *args, operations=operations)

    def finish(self) -> None:
        """Wait until everything enqueued is done."""
        self.queue.finish()


def require_device(device: object) -> None:
    """Refuse what is no `Device`.

    Raises
    ------
    TypeError
    """
    if not isinstance(device, Device):
        raise TypeError(f"device is a Device, as Device.open() gives it, not {device!r}.")


def require_same_device(a: Device, b: Device) -> None:
    """Refuse data of two devices (or two precisions of one).

    Raises
    ------
    DeviceError
        Naming both.
    """
    if a is not b:
        raise DeviceError(
            f"The operands live on two devices, {a!r} and {b!r}: bring both to one of them."
        )


def _require_contiguous(array: cla.Array) -> None:
    if not array.flags.c_contiguous:
        raise ShapeError(
            f"A device array of strides {array.strides} is not C-contiguous: copy it into a new "
            "array."
        )


def _registered(cl_device: cl.Device, precision: Precision, place: str) -> Device:
    """The one Device of this hardware and precision in this process."""
    with _registry_lock:
        key = (cl_device, precision)
        if key not in _registry:
            _registry[key] = Device(cl_device, precision=precision, place=place)
        return _registry[key]


# Handles of hardware, not settings: data of two calls of `Device.open` must meet on one queue.
_registry: dict[tuple[cl.Device, Precision], Device] = {}
_registry_lock = Lock()


def _buffer(array: cla.Array) -> cl.Buffer:
    """The buffer that holds an array of at least one sample."""
    return cast(cl.Buffer, array.base_data)


def _bytes(count: int) -> str:
    return f"{count:,} bytes ({count / 2**30:.2f} GiB)"
