"""An OpenCL device with its queue and its plans; how one is found, and kept for its hardware."""

from __future__ import annotations

import gc
import os
from functools import cached_property
from threading import Lock
from typing import Any, Literal

import numpy as np
import pyopencl as cl
from pyopencl.tools import MemoryPool

from clplen.compute.drivers import pocl, selection
from clplen.compute.drivers.failures import device_errors, is_want_of_memory
from clplen.compute.drivers.forked import is_forked, require_own_process
from clplen.compute.drivers.selection import find_devices, select
from clplen.compute.fft.plans import PlanCache, Workspace
from clplen.compute.fft.routes import FFTRoute, choose_route
from clplen.compute.launcher import Launcher
from clplen.compute.memory import trim_heap
from clplen.compute.tuning import Tuning
from clplen.errors import DeviceError, warn_caller
from clplen.units import bytes_of

Precision = Literal["single", "double"]

_SPARE_BYTES = 2**30  # that both precisions of a CPU keep for later calls
_GPU_SPARE_BYTES = 6 * 2**30  # on a GPU: other programs use it, too
_SPARE_SHARE = 4  # of the device's memory: at most a quarter
_PLAN_SHARE = 5 / 8  # of what is kept: plans, which take longest to make again; buffers the rest
_WORKSPACE_SHARE = 1 / 4


class Device(Launcher):
    """One OpenCL device at one precision. Made by `Device.open`, not by its constructor.

    Parameters
    ----------
    cl_device : pyopencl.Device
        The device as pyopencl lists it.
    precision : {"single", "double"}
        Precision of the wave tower: "double" computes it in float64.
    place : str
        The "platform:device" selector that opens it.
    beside : Device, optional
        The same hardware in the other precision, with which it shares what may be kept.

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

    Raises
    ------
    ValueError
        If the precision is neither.
    DeviceError
        If "double" is asked for and the device has no double precision.

    Examples
    --------
    >>> device = clplen.Device.open()  # or "cpu", "gpu", "0:1", part of a name
    >>> device.precision, device.complex.name
    ('single', 'complex64')
    >>> device is clplen.Device.open(device.place)
    True
    """

    def __init__(
        self,
        cl_device: cl.Device,
        *,
        precision: Precision = "single",
        place: str = "",
        beside: Device | None = None,
    ) -> None:
        if precision not in ("single", "double"):
            raise ValueError(f"precision is 'single' or 'double', not {precision!r}.")
        super().__init__()
        self.cl_device = cl_device
        self.place = place
        self.precision: Precision = precision
        self.name: str = cl_device.name.strip()
        self.platform: str = cl_device.platform.name.strip()
        self.driver: str = f"{self.platform} {cl_device.driver_version.strip()}"
        self.is_cpu = bool(cl_device.type & cl.device_type.CPU)
        self.has_fp64 = "cl_khr_fp64" in cl_device.extensions
        self.memory_bytes = int(cl_device.global_mem_size)
        # one work-item a row (CPU) or one a sample (GPU, and the CPU that works like one)
        self.rows = self.is_cpu and not selection.is_llvmpipe(cl_device)
        self.note = ""
        self._usable = False
        self._fft: FFTRoute | None = None
        self._context: cl.Context | None = None
        self.spare_bytes = min(_spare_limit(self.is_cpu), self.memory_bytes // _SPARE_SHARE)
        limit = int(_PLAN_SHARE * self.spare_bytes)
        # plans (transfer functions, arrays of lenslets), bounded in bytes with those below
        self.plans: PlanCache = PlanCache(limit, beside.plans if beside else None)
        self.transforms = PlanCache(limit, self.plans)  # Fourier transforms that the device runs
        self.tables = PlanCache(limit, self.plans)  # small ones of recent launches
        # host memory that transforms on the host use again and again
        workspace = beside.workspace if beside else None
        self.workspace: Workspace = workspace or Workspace(int(_WORKSPACE_SHARE * self.spare_bytes))
        self._precisions: list[Device] = beside._precisions if beside else []
        self._precisions.append(self)
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
        TypeError
            If the selector is no string.
        DeviceError
            If there is no OpenCL platform, nothing fits the selector, or the device cannot
            compile kernels or lacks double precision.
        """
        if selector is None:
            selector = os.environ.get("CLPLEN_DEVICE") or None
        elif not isinstance(selector, str):
            raise TypeError(
                "A selector of devices is a string such as 'cpu', 'gpu' or '0:1', not "
                f"{selector!r:.80}."
            )
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
        parts += [self.tuning.note] if self.tuning.note else []
        return f"<Device {', '.join(parts)}>"

    def ensure_usable(self) -> None:
        """Make PoCL fit this CPU, once; warn where loops are cut. Both are kept in ``note``."""
        with self._lock:
            if not self._usable:
                self.note = pocl.ensure_usable(self.cl_device)
                self._usable = True
                if loops := selection.warning(self.cl_device):
                    self.note = loops
                    warn_caller(loops, RuntimeWarning)

    def __reduce__(self) -> tuple[Any, ...]:
        """By its selector: what another process gets is its own object of the same hardware."""
        return _reopened, (self.place, self.name, self.platform, self.precision)

    def __copy__(self) -> Device:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Device:
        return self

    @property
    def context(self) -> cl.Context:
        """The OpenCL context, made at first use."""
        with self._lock:
            if self._context is None:
                self.ensure_usable()
                with device_errors(self.cl_device, "An OpenCL context"):
                    self._context = self._make_context()
            return self._context

    def _make_context(self) -> cl.Context:
        """Create a context; where memory is wanting, once more without devices nobody holds.

        Plans refer to their device, so that Python lets go of both, and of the driver's memory,
        when it collects garbage: 0.4 GiB a context on an NVIDIA GPU.
        """
        try:
            return cl.Context([self.cl_device])
        except cl.Error as error:
            if not is_want_of_memory(error):
                raise
        gc.collect()
        return cl.Context([self.cl_device])

    @property
    def queue(self) -> cl.CommandQueue:
        """The in-order command queue, made at first use."""
        with self._lock:
            if self._queue is None:
                with device_errors(self.cl_device, "A command queue"):
                    self._queue = cl.CommandQueue(self.context)
            return self._queue

    @property  # not a cached one, whose frame would hide the line that a warning points to
    def fft(self) -> FFTRoute:
        """How Fourier transforms are done on this device; chosen once."""
        if self._fft is None:
            self._fft = choose_route(self.is_cpu, self.platform)
        return self._fft

    @fft.setter
    def fft(self, route: FFTRoute) -> None:
        self._fft = route

    def held_bytes(self) -> int:
        """Bytes of large arrays on this hardware, in use or kept for use again."""
        return sum(pool.managed_bytes for pool in self._pools())

    def _pools(self) -> list[MemoryPool]:
        """The spare buffers of both precisions, where there are any yet."""
        devices = tuple(self._precisions)
        return [one._spare for one in devices if "_spare" in one.__dict__]

    def _trim(self) -> None:
        pools = self._pools()
        spare = sum(pool.managed_bytes - pool.active_bytes for pool in pools)
        if spare > self.spare_bytes - self.plans.shared_bytes - self.workspace.nbytes:
            for pool in pools:
                pool.free_held()

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

    @cached_property
    def tuning(self) -> Tuning:
        """Which forms of kernels are fastest here, and which cannot be run."""
        return Tuning(self)

    @property
    def real(self) -> np.dtype[Any]:
        """Real dtype of the wave tower: float32 or float64."""
        return np.dtype(np.float32 if self.precision == "single" else np.float64)

    @property
    def complex(self) -> np.dtype[Any]:
        """Complex dtype of the wave tower: complex64 or complex128."""
        return np.dtype(np.complex64 if self.precision == "single" else np.complex128)


def as_device(device: DeviceLike | None, *, optional: bool = True) -> Device:
    """The device that an argument ``device`` names."""
    if isinstance(device, Device):
        return device
    if isinstance(device, str) or (device is None and optional):
        return Device.open(device)
    raise TypeError(
        "device is a Device, as Device.open() gives it, or a selector such as 'cpu', 'gpu' or "
        f"'0:1', not {device!r:.80}."
    )


def require_same_device(a: Device, b: Device) -> None:
    """Refuse data of two devices (or two precisions of one)."""
    if a is not b:
        raise DeviceError(
            f"The operands live on two devices, {a!r} and {b!r}: bring both to one of them."
        )


def _registered(cl_device: cl.Device, precision: Precision, place: str) -> Device:
    """The one Device of this hardware and precision in this process."""
    with _registry_lock:
        key = (cl_device, precision)
        if key not in _registry:
            others = (one for (known, _), one in _registry.items() if known == cl_device)
            _registry[key] = Device(
                cl_device, precision=precision, place=place, beside=next(others, None)
            )
        return _registry[key]


def _spare_limit(is_cpu: bool) -> int:
    """Bytes that may be kept for later calls: ``$CLPLEN_SPARE_MEMORY``, else the default."""
    asked = os.environ.get("CLPLEN_SPARE_MEMORY", "").strip()
    try:
        return bytes_of(asked) if asked else (_SPARE_BYTES if is_cpu else _GPU_SPARE_BYTES)
    except ValueError as error:
        raise DeviceError(f"CLPLEN_SPARE_MEMORY {error}, got {asked!r}.") from error


DeviceLike = Device | str


def _reopened(place: str, name: str, platform: str, precision: Precision) -> Device:
    """Return the local device of a pickle; in a forked process the parent's, which refuses."""
    if is_forked():
        for (_, kept_as), device in _registry.items():
            if (device.name, device.platform, kept_as) == (name, platform, precision):
                return device
    fitting = [
        (at, cl_device)
        for at, cl_device in find_devices()
        if (cl_device.name.strip(), cl_device.platform.name.strip()) == (name, platform)
    ]
    if not fitting:
        raise DeviceError(
            f"This was pickled on {name} ({platform}), which is not here: pickle its to_numpy() "
            "instead."
        )
    at, cl_device = next((found for found in fitting if found[0] == place), fitting[0])
    device = _registered(cl_device, precision, at)
    device.ensure_usable()
    return device


# Handles of hardware, not settings: data of two calls of `Device.open` must meet on one queue.
_registry: dict[tuple[cl.Device, Precision], Device] = {}
_registry_lock = Lock()
