"""Checks of the foundations: memory, Fourier transforms, precision, arithmetic."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.drivers import builtin_functions
from clplen.compute.fft.routes import FFTRoute
from clplen.compute.memory import free_memory
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs
from clplen.wave.elements.lens import thin_lens
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.propagator import Propagator

LAM = 532e-9
SHARE = 4  # memory of the device over the size of the large array
MODULES = {"vkfft": "pyvkfft", "ducc0": "ducc0", "scipy": "scipy"}


def _large_array(device: Device) -> Pairs:
    """Check bytes at the beginning, in the middle and at the end of a large array."""
    free = min(device.memory_bytes, free_memory()) if device.is_cpu else device.memory_bytes
    size = min(int(device.cl_device.max_mem_alloc_size), free // SHARE) // 4096 * 4096
    large: Any = device.empty((size,), np.uint8)
    try:
        marks = np.random.default_rng(1).integers(1, 256, (3, 4096)).astype(np.uint8)
        offsets = (0, size // 2 // 4096 * 4096, size - 4096)
        for mark, offset in zip(marks, offsets, strict=True):
            device.copy_into(large, device.upload(mark), offset)
        blocks = [device.download(large[offset : offset + 4096]) for offset in offsets]
        yield marks.astype(float), np.array(blocks, float)
    finally:
        device.finish()
        large.base_data.release()
        device.free_spare()


def _transfers(device: Device) -> Pairs:
    """Check copies to the device, within it and back, of odd sizes, and zeros."""
    for count in (1, 4099, 5_000_011):
        values = np.random.default_rng(count).integers(1, 256, count).astype(np.uint8)
        array = device.upload(values)
        copied = device.zeros((count + 7,), np.uint8)
        device.copy_into(copied, array, 5)
        yield values, device.download(array)
        yield np.pad(values, (5, 2)), device.download(copied)


def _mapped(device: Device) -> Pairs:
    """Check that host and kernels see each other's writes to a mapped buffer."""
    values = twins.waves(1, 37, 41)
    array = device.upload(values)
    with device.on_host(array) as mapped:
        yield values, mapped.copy()
        mapped *= 2
    field = Field(array, Grid(values.shape, 1e-6), LAM, device)
    power = field.intensity().data
    with device.on_host(power, write=False) as mapped_power:
        yield np.abs(2 * values.astype(complex)) ** 2, mapped_power.copy()


def _dft(n: int, forward: bool) -> Any:
    """Return the matrix of the discrete Fourier transform, or of its inverse with 1/n."""
    k = np.arange(n)
    turns = np.outer(k, k) % n / n
    return np.exp((-2j if forward else 2j) * np.pi * turns) / (1 if forward else n)


def _transforms(name: str, device: Device) -> Pairs:
    """Check both directions over one and two axes, of lengths with small and large factors."""
    route = FFTRoute(name, device.fft.threads)
    for ny, nx in ((12, 35), (34, 23)):
        u = twins.waves(ny, 2, ny, nx).astype(device.complex)
        for axes, forward in (((-2, -1), True), ((-2, -1), False), ((-1,), True), ((-2,), False)):
            array: cla.Array = device.upload(u)
            route.transform(array, device, axes=axes, forward=forward)
            expected = u.astype(complex)
            expected = _dft(ny, forward) @ expected if -2 in axes else expected
            expected = expected @ _dft(nx, forward) if -1 in axes else expected
            yield expected, device.download(array)


def _no_route(name: str, device: Device) -> str:
    """Return the reason why a device lacks an FFT route, or an empty string."""
    if find_spec(MODULES[name]) is None:
        return f"{MODULES[name]} is not installed"
    if name == "vkfft" and device.is_cpu and device.platform.startswith("Intel"):
        return "VkFFT transforms some lengths wrongly on Intel's CPU runtime and is not used there"
    return ""


def built_in_values(device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Compute values of every built-in function that kernels call."""
    count = len(builtin_functions.expected(double=device.has_fp64))
    y = device.empty((count, builtin_functions.COUNT), np.float32)
    arguments = [device.upload(values) for values in builtin_functions.inputs()]
    defines = {"DOUBLE": True} if device.has_fp64 else {}
    kernel = device.kernel("builtins.cl", "builtins", **defines)
    device.launch(kernel, (1,), y, *arguments, np.int32(builtin_functions.COUNT), group=(1,))
    return device.download(y)


def _built_in(device: Device) -> Pairs:
    """Check every built-in OpenCL function that kernels call, at every width."""
    expected = builtin_functions.expected(double=device.has_fp64)
    yield from zip(expected.values(), built_in_values(device), strict=True)


def _double(device: Device) -> Pairs:
    """Check a lens and a propagation in complex128."""
    precise = Device.open(device.place, precision="double")
    grid, f, z = Grid((24, 35), (5e-6, 4e-6), origin=(2e-6, -3e-6)), 5e-3, 1.5e-3
    rng = np.random.default_rng(2)
    u = rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)
    field = Field.from_array(u, grid, wavelength=LAM, device=precise)
    yield u, field.to_numpy()
    lens = np.exp(-1j * np.pi * (grid.y[:, None] ** 2 + grid.x**2) / (LAM * f))
    yield u * lens, thin_lens(field, f).to_numpy()
    fy, fx = np.fft.fftfreq(24, 5e-6)[:, None], np.fft.fftfreq(35, 4e-6)
    H = np.exp(2j * np.pi * z / LAM * (np.sqrt(1 - LAM**2 * (fy**2 + fx**2)) - 1))
    plan = Propagator(grid, z, wavelength=LAM, method="as", pad=1, device=precise)
    yield np.fft.ifft2(np.fft.fft2(u) * H), plan(field).to_numpy()


def _no_double(device: Device) -> str:
    return "" if device.has_fp64 else "the device has no cl_khr_fp64; clplen does without it"


CHECKS = (
    Check("memory, large", "a quarter of the memory in one array", _large_array, 0.0),
    Check("memory, transfers", "to the device, within it, back", _transfers, 0.0),
    Check("memory, mapped", "buffers that host and device share", _mapped, 4 * EPS),
    Check("built-in functions", "sqrt, exp, ... of 1, 4, 8 and 16 samples", _built_in,
          32 * EPS, ("builtins.cl",)),
    *(
        Check(f"FFT, {name}", "over two axes and one, forwards and back",
              partial(_transforms, name), 5e-6, absent=partial(_no_route, name))
        for name in MODULES
    ),
    Check("double precision", "a lens and a propagation in complex128", _double, 1e-11,
          absent=_no_double),
)  # fmt: skip
