"""An OpenCL device at one precision: how it is found, and kept for its hardware."""

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
        if precision == "double" and "cl_khr_fp64" not in cl_device.extensions:
            name, platform = cl_device.name.strip(), cl_device.platform.name.strip()
            raise DeviceError(
                f"precision='double' was asked for, but {name} ({platform}) has no double "
                "precision (cl_khr_fp64); use precision='single' or another device."
            )
        super().__init__(cl_device, beside)
        self.place = place
        self.precision: Precision = precision
        self._fft: FFTRoute | None = None

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

    def __reduce__(self) -> tuple[Any, ...]:
        """By its selector: what another process gets is its own object of the same hardware."""
        return _reopened, (self.place, self.name, self.platform, self.precision)

    def __copy__(self) -> Device:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Device:
        return self

    @property  # not a cached one, whose frame would hide the line that a warning points to
    def fft(self) -> FFTRoute:
        """How Fourier transforms are done on this device; chosen once."""
        if self._fft is None:
            self._fft = choose_route(self.is_cpu, self.platform)
        return self._fft

    @fft.setter
    def fft(self, route: FFTRoute) -> None:
        self._fft = route

    @cached_property
    def tuning(self) -> Tuning:
        """Which forms of kernels are fastest here, and which cannot be run."""
        return Tuning(self)

    def wave_defines(self) -> dict[str, Any]:
        """Definitions that choose the precision of a kernel of the wave tower."""
        return {"DOUBLE": True} if self.precision == "double" else {}

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
