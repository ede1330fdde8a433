"""Fourier transforms over the last two axes, in place, by VkFFT, ducc0 or SciPy.

A CPU device maps its buffer, and a host library transforms it in place. A GPU uses VkFFT if pyvkfft
is installed, else the host library with transfers both ways. The route is chosen once per device;
``$CLPLEN_FFT`` forces a route.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, Protocol, TypeVar

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.checks import install_advice
from clplen.compute.drivers.failures import device_error
from clplen.compute.drivers.forked import Guard
from clplen.compute.fft.plans import PlanCache
from clplen.errors import DeviceError, warn_caller
from clplen.types import Array

T = TypeVar("T")
VKFFT_BYTES = 2**20  # assumed bytes of the kernels and tables of a VkFFT plan
HostFFT = Callable[[Array, Array, "tuple[int, ...]", bool, int], None]
_MODULES = {"vkfft": "pyvkfft", "ducc0": "ducc0", "scipy": "scipy"}
_EXTRAS = {
    "vkfft": f"VKFFT_BACKEND=opencl {install_advice('gpu')}",
    "ducc0": install_advice("fast"),
    "scipy": "pip install scipy",
}


class TransformDevice(Protocol):
    """Device that holds the array to be transformed."""

    @property
    def queue(self) -> cl.CommandQueue: ...

    @property
    def transforms(self) -> PlanCache: ...

    @property
    def cl_device(self) -> cl.Device: ...

    def retry_with_room(self, act: Callable[[], T]) -> T: ...

    def timed(
        self, what: str, *, nbytes: int, operations: float = 0.0
    ) -> AbstractContextManager[None]: ...

    def on_host(self, array: cla.Array, *, write: bool = True) -> AbstractContextManager[Array]: ...


@dataclass(frozen=True)
class FFTRoute:
    """Library for transforms: "vkfft", or "ducc0" or "scipy" on the host with several threads."""

    name: str
    threads: int

    def forward(self, array: cla.Array, device: TransformDevice) -> None:
        """Replace an array by its discrete Fourier transform over the last two axes."""
        self.transform(array, device, axes=(-2, -1), forward=True)

    def inverse(self, array: cla.Array, device: TransformDevice) -> None:
        """Replace an array by its inverse transform, with the factor 1/(ny nx)."""
        self.transform(array, device, axes=(-2, -1), forward=False)

    def transform(
        self, array: cla.Array, device: TransformDevice, *, axes: tuple[int, ...], forward: bool
    ) -> None:
        """Apply `forward` or `inverse` over some of the last two axes."""
        operations = array.size * sum(5 * math.log2(array.shape[axis]) for axis in axes)
        with device.timed(f"FFT, {self.name}", nbytes=2 * array.nbytes, operations=operations):
            if self.name == "vkfft":
                _vkfft(array, device, axes, forward)
                return
            with device.on_host(array) as values:
                _HOST[self.name](values, values, axes, forward, self.threads)

    def lines(
        self, values: Array, out: Array, axis: int, forward: bool, *, careful: bool = False
    ) -> None:
        """Transform along an axis of a host array, in the calling thread."""
        transform = _HOST[self.name]
        if careful and values.dtype == np.complex64 and has_large_prime(values.shape[axis]):
            exact = values.astype(np.complex128)
            transform(exact, exact, (axis,), forward, 1)
            out[...] = exact
            return
        transform(values, out, (axis,), forward, 1)


@cache
def has_large_prime(n: int) -> bool:
    """Return True if a length has a prime factor above 13; libraries are then less accurate."""
    for prime in (2, 3, 5, 7, 11, 13):
        while n % prime == 0:
            n //= prime
    return n > 1


def choose_route(is_cpu: bool, platform: str = "") -> FFTRoute:
    """Return the route of a device."""
    threads = _threads()
    forced = os.environ.get("CLPLEN_FFT", "").strip().lower()
    if forced:
        if forced not in _MODULES:
            raise DeviceError(f"CLPLEN_FFT must be one of {', '.join(_MODULES)}, got {forced!r}.")
        if find_spec(_MODULES[forced]) is None:
            raise DeviceError(
                f"CLPLEN_FFT={forced!r} requires {_MODULES[forced]}, which is not installed: "
                f"{_EXTRAS[forced]}."
            )
        if forced == "vkfft" and is_cpu and platform.startswith("Intel"):
            raise DeviceError(
                "CLPLEN_FFT='vkfft' is not supported on Intel's CPU runtime, where VkFFT is wrong "
                "for some lengths: use ducc0 or scipy."
            )
        return FFTRoute(forced, threads)
    if not is_cpu and find_spec("pyvkfft") is not None:
        return FFTRoute("vkfft", threads)
    host = "ducc0" if find_spec("ducc0") is not None else "scipy"
    if not is_cpu:
        warn_caller(
            f"pyvkfft is not installed: Fourier transforms of this GPU run on the host ({host}) "
            f"with transfers both ways. {_EXTRAS['vkfft']} keeps them on the GPU.",
            RuntimeWarning,
        )
    return FFTRoute(host, threads)


def _threads() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _ducc0(values: Array, out: Array, axes: tuple[int, ...], forward: bool, threads: int) -> None:
    import ducc0

    norm = 0 if forward else 2
    ducc0.fft.c2c(values, axes=axes, forward=forward, inorm=norm, out=out, nthreads=threads)


def _scipy(values: Array, out: Array, axes: tuple[int, ...], forward: bool, threads: int) -> None:
    import scipy.fft

    transform = scipy.fft.fftn if forward else scipy.fft.ifftn
    result = transform(values, axes=axes, overwrite_x=out is values, workers=threads)
    if not np.may_share_memory(result, out):
        out[...] = result


_HOST: dict[str, HostFFT] = {"ducc0": _ducc0, "scipy": _scipy}


@dataclass(frozen=True)
class _Transform:
    """VkFFT application with a lock, since it holds its arguments while it runs."""

    app: Any
    lock: Guard

    def run(self, array: cla.Array, queue: cl.CommandQueue, forward: bool) -> None:
        with self.lock:
            self.app.queue = queue  # a profile has a queue of its own, of which VkFFT would warn
            (self.app.fft if forward else self.app.ifft)(array, array, queue=queue)

    @property
    def nbytes(self) -> int:
        return int(getattr(self.app, "tmp_buffer_nbytes", 0)) + VKFFT_BYTES


def _vkfft(array: cla.Array, device: TransformDevice, axes: tuple[int, ...], forward: bool) -> None:
    """Transform by VkFFT on the queue of the device, since the array's may be an old profile's."""
    if all(array.shape[axis] == 1 for axis in axes):
        return
    key = (array.shape, array.dtype.str, axes)
    try:
        plan = device.transforms.get(key)
        if plan is None:
            plan = _Transform(
                device.retry_with_room(lambda: _vkfft_app(array, device, axes)), Guard()
            )
            plan = device.transforms.keep(key, plan, plan.nbytes)
        plan.run(array, device.queue, forward)
    except (RuntimeError, cl.Error) as error:
        what = f"A Fourier transform of shape {array.shape} by VkFFT"
        raise device_error(device.cl_device, what, error) from error


def _vkfft_app(array: cla.Array, device: TransformDevice, axes: tuple[int, ...]) -> Any:
    """Return a plan whose twiddle factors are read from tables.

    Factors that a GPU computes in single precision triple the error of transforms.
    """
    from pyvkfft.opencl import VkFFTApp

    which = {"ndim": 2} if axes == (-2, -1) else {"axes": [array.ndim + axis for axis in axes]}
    return VkFFTApp(array.shape, array.dtype, device.queue, inplace=True, norm=1, useLUT=1, **which)
