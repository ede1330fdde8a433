"""An OpenCL device at one precision, and the registry of devices in use."""

from __future__ import annotations

import os
from functools import cached_property
from threading import Lock
from typing import Any, Literal

import numpy as np
import pyopencl as cl

from clplen.compute.drivers.forked import is_forked
from clplen.compute.drivers.selection import find_devices, select
from clplen.compute.fft.routes import FFTRoute, choose_route
from clplen.compute.launcher import Launcher
from clplen.compute.tuning import Tuning
from clplen.errors import DeviceError

Precision = Literal["single", "double"]


class Device(Launcher):
    """OpenCL device at one precision; open it with `Device.open`.

    Parameters
    ----------
    cl_device : pyopencl.Device
        Device as listed by pyopencl.
    precision : {"single", "double"}
        Precision of wave fields: "double" computes in float64.
    selector : str
        Selector "platform:device" that opens the device.
    sibling : Device, optional
        Device of the other precision on this hardware; the two share cached memory.

    Attributes
    ----------
    name : str
        Name that the driver reports.
    is_cpu : bool
        True for a CPU: buffers are mapped and FFTs run in place on the host.
    has_fp64 : bool
        True if the device computes in double precision.
    memory_bytes : int
        Size of the global memory in bytes.
    precision : {"single", "double"}
        Precision of wave fields; light fields are processed in float32 on every device.
    place : str
        Selector "platform:device" that opens the device.

    Raises
    ------
    ValueError
        If the precision is neither "single" nor "double".
    DeviceError
        If "double" is requested and the device has no double precision.

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
        selector: str = "",
        sibling: Device | None = None,
    ) -> None:
        if precision not in ("single", "double"):
            raise ValueError(f"precision must be 'single' or 'double', got {precision!r}.")
        if precision == "double" and "cl_khr_fp64" not in cl_device.extensions:
            name, platform = cl_device.name.strip(), cl_device.platform.name.strip()
            raise DeviceError(
                f"{name} ({platform}) has no double precision (cl_khr_fp64); use "
                "precision='single' or another device."
            )
        super().__init__(cl_device, sibling)
        self.place = selector
        self.precision: Precision = precision
        self._fft: FFTRoute | None = None

    @staticmethod
    def open(selector: str | None = None, *, precision: Precision = "single") -> Device:
        """Open a device.

        Parameters
        ----------
        selector : str, optional
            Kind ("cpu", "gpu"), index ("0:1", platform:device) or part of a name ("pocl",
            "nvidia"). None selects ``$CLPLEN_DEVICE``, else the first GPU, else the first CPU that
            can compile kernels.
        precision : {"single", "double"}
            Precision of wave fields: "double" runs their kernels and FFTs in float64.

        Returns
        -------
        Device
            Device; the process has a single object for each hardware and precision.

        Raises
        ------
        TypeError
            If the selector is not a string.
        DeviceError
            If no OpenCL platform exists, no device matches the selector, or the device cannot
            compile kernels or lacks double precision.
        """
        if selector is None:
            selector = os.environ.get("CLPLEN_DEVICE") or None
        elif not isinstance(selector, str):
            raise TypeError(
                f"selector must be a string such as 'cpu', 'gpu' or '0:1', got {selector!r:.80}."
            )
        problems = []
        for index, cl_device in select(find_devices(), selector):
            try:
                device = _registered(cl_device, precision, index)
                device.ensure_usable()
            except DeviceError as error:
                problems.append(str(error))
            else:
                return device
        raise DeviceError(" ".join(problems))

    @staticmethod
    def all() -> list[Device]:
        """Return all OpenCL devices in single precision, in platform order.

        Nothing is compiled yet. A device that cannot compile kernels raises at its first use.
        """
        return [_registered(cl_device, "single", index) for index, cl_device in find_devices()]

    def __repr__(self) -> str:
        parts = [self.name, self.driver, self.precision, f"FFT {self.fft.name}"]
        parts += [self.tuning.note] if self.tuning.note else []
        return f"<Device {', '.join(parts)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the selector; another process opens its own device of this hardware."""
        return _reopened, (self.place, self.name, self.platform, self.precision)

    def __copy__(self) -> Device:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Device:
        return self

    @property  # a cached property would add a frame and misplace the line of a warning
    def fft(self) -> FFTRoute:
        """Fourier transform route of the device, chosen at first use."""
        if self._fft is None:
            self._fft = choose_route(self.is_cpu, self.platform)
        return self._fft

    @fft.setter
    def fft(self, route: FFTRoute) -> None:
        self._fft = route

    @cached_property
    def tuning(self) -> Tuning:
        """Fastest forms of kernels on the device, and forms that cannot run on it."""
        return Tuning(self)

    def wave_defines(self) -> dict[str, Any]:
        """Return the definitions that set the precision of a kernel for wave fields."""
        return {"DOUBLE": True} if self.precision == "double" else {}

    @property
    def real(self) -> np.dtype[Any]:
        """Real dtype of wave fields: float32 or float64."""
        return np.dtype(np.float32 if self.precision == "single" else np.float64)

    @property
    def complex(self) -> np.dtype[Any]:
        """Complex dtype of wave fields: complex64 or complex128."""
        return np.dtype(np.complex64 if self.precision == "single" else np.complex128)


def as_device(device: DeviceLike | None, *, optional: bool = True) -> Device:
    """Return the device of an argument ``device``: a `Device`, a selector or None."""
    if isinstance(device, Device):
        return device
    if isinstance(device, str) or (device is None and optional):
        return Device.open(device)
    raise TypeError(
        "device must be a Device, such as Device.open() returns, or a selector such as 'cpu', "
        f"'gpu' or '0:1', got {device!r:.80}."
    )


def require_same_device(a: Device, b: Device) -> None:
    """Raise if data are on two devices, or at two precisions of one device."""
    if a is not b:
        raise DeviceError(
            f"The operands are on two devices, {a!r} and {b!r}; move both to one of them."
        )


def _registered(cl_device: cl.Device, precision: Precision, index: str) -> Device:
    """Return this process's Device of a hardware and a precision."""
    with _registry_lock:
        key = (cl_device, precision)
        if key not in _registry:
            siblings = (device for (key, _), device in _registry.items() if key == cl_device)
            _registry[key] = Device(
                cl_device, precision=precision, selector=index, sibling=next(siblings, None)
            )
        return _registry[key]


DeviceLike = Device | str


def _reopened(index: str, name: str, platform: str, precision: Precision) -> Device:
    """Return the local device of a pickle; a forked process gets the parent's, which raises."""
    if is_forked():
        for (_, stored_precision), device in _registry.items():
            if (device.name, device.platform, stored_precision) == (name, platform, precision):
                return device
    matches = [
        (current_index, cl_device)
        for current_index, cl_device in find_devices()
        if (cl_device.name.strip(), cl_device.platform.name.strip()) == (name, platform)
    ]
    if not matches:
        raise DeviceError(
            f"The pickle was made on {name} ({platform}), which this computer does not have; "
            "pickle to_numpy() instead."
        )
    index, cl_device = next((match for match in matches if match[0] == index), matches[0])
    device = _registered(cl_device, precision, index)
    device.ensure_usable()
    return device


# One handle for each hardware and precision: data of two `Device.open` calls share a queue.
_registry: dict[tuple[cl.Device, Precision], Device] = {}
_registry_lock = Lock()
