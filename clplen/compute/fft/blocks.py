"""Maps along both axes, a product, and maps back, for batches and several products.

Host libraries process blocks that fit in the cache (columns.py); VkFFT processes whole arrays on
the device.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import zip_longest
from typing import Any, Protocol

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.drivers.failures import device_errors
from clplen.compute.drivers.forked import Guard
from clplen.compute.fft.columns import Factors, Product, run_on_host
from clplen.compute.fft.lines import Line, Separable, identity
from clplen.compute.fft.plans import Workspace
from clplen.compute.fft.routes import FFTRoute, TransformDevice
from clplen.types import Array


class FieldDevice(TransformDevice, Protocol):
    """Device on which maps of complex samples run."""

    is_cpu: bool
    rows: bool
    precision: Any

    @property
    def fft(self) -> FFTRoute: ...

    @property
    def workspace(self) -> Workspace: ...

    @property
    def complex(self) -> np.dtype[Any]: ...

    def empty(self, shape: Sequence[int], dtype: Any) -> cla.Array: ...

    def upload(self, values: Array) -> cla.Array: ...

    def download(self, array: cla.Array) -> Array: ...

    def kernel(self, file: str, name: str, **defines: Any) -> cl.Kernel: ...

    def wave_defines(self) -> dict[str, Any]: ...

    def launch_rows(
        self, kernel: cl.Kernel, shape: Sequence[int], *args: Any, operations: float = 0.0
    ) -> None: ...


class Spectrum:
    """Factors of a 2-D spectrum, stored on the device or on the host, wherever they are applied."""

    def __init__(
        self,
        values: cla.Array,
        shape: tuple[int, int],
        *,
        turned: bool = False,
        lit: Array | None = None,
    ) -> None:
        self.shape = shape
        self.is_quadrant = tuple(values.shape) != (shape[::-1] if turned else shape)
        self.values, self.turned, self.lit = values, turned, lit
        self.is_conjugated = False
        self._owner: Spectrum | None = None  # spectrum whose memory a conjugate shares
        self._copy: Array | None = None
        self._lock = Guard()

    @classmethod
    def of(cls, values: Array, device: FieldDevice) -> Spectrum:
        """Return the spectrum of a host array (my, mx) in FFT order for `run` on a device."""
        shape = (values.shape[0], values.shape[1])
        if device.fft.name == "vkfft":
            return cls(device.upload(values.astype(device.complex)), shape)
        turned = values.T.astype(device.complex, order="C")
        return cls(device.upload(turned), shape, turned=True, lit=turned.any(axis=1))

    def conjugate(self) -> Spectrum:
        """Return the conjugate factors, which share this spectrum's memory."""
        twin = Spectrum(self.values, self.shape, turned=self.turned, lit=self.lit)
        twin.is_conjugated, twin._owner = not self.is_conjugated, self._owner or self
        return twin

    @contextmanager
    def on_host(self, device: FieldDevice) -> Iterator[Factors]:
        """Yield the factors on the host, from a CPU device's memory or a copy made once."""
        if device.is_cpu:
            with device.on_host(self.values, write=False) as values:
                yield self._factors(values)
            return
        yield self._factors((self._owner or self).host_copy(device))

    def host_copy(self, device: FieldDevice) -> Array:
        """Return the values of a device other than a CPU, copied once."""
        with self._lock:
            if self._copy is None:
                self._copy = device.download(self.values)
            return self._copy

    def _factors(self, values: Array) -> Factors:
        turned = values if self.turned else values.T
        return Factors(turned, self.shape, self.lit, self.is_conjugated)


def run(
    data: cla.Array,
    into: Separable,
    spectra: Sequence[Spectrum],
    back: Sequence[Separable],
    device: FieldDevice,
) -> list[cla.Array]:
    """Map, multiply by each of several spectra, and map back."""
    if device.fft.name == "vkfft":
        return _on_device(data, into, spectra, back, device)
    batch, shape = tuple(data.shape[:-2]), (data.shape[-2], data.shape[-1])
    last = back[0].shape_after(into.shape_after(shape)) if back else into.shape_after(shape)
    results = [device.empty((*batch, *last), device.complex) for _ in range(max(1, len(spectra)))]
    count = math.prod(batch)
    with ExitStack() as stack:
        source = stack.enter_context(device.on_host(data, write=False)).reshape(count, *shape)
        targets = [
            stack.enter_context(device.on_host(result)).reshape(count, *last) for result in results
        ]
        products = [
            Product(stack.enter_context(spectrum.on_host(device)), maps)
            for spectrum, maps in zip(spectra, back, strict=True)
        ]
        with device_errors(device.cl_device, f"A Fourier transform of shape {data.shape}"):
            device.retry_with_room(
                lambda: run_on_host(source, into, products, targets, device.fft, device.workspace)
            )
    return results


def _on_device(
    data: cla.Array,
    into: Separable,
    spectra: Sequence[Spectrum],
    back: Sequence[Separable],
    device: FieldDevice,
) -> list[cla.Array]:
    work = data
    for y, x in zip_longest(into.y, into.x):
        work = _stage(work, y, x, device, in_place=work is not data)
    if not spectra:
        return [window(data, data.shape, device) if work is data else work]
    results = []
    for number, (spectrum, maps) in enumerate(zip(spectra, back, strict=True), 1):
        product = multiplied(work, spectrum, device, copy=work is data or number < len(spectra))
        for y, x in zip_longest(maps.y, maps.x):
            product = _stage(product, y, x, device, in_place=True)
        results.append(product)
    return results


def _stage(
    data: cla.Array, y: Line | None, x: Line | None, device: FieldDevice, *, in_place: bool
) -> cla.Array:
    """Apply a line along each axis, or none; data may be changed if ``in_place``."""
    y, x = y or identity(data.shape[-2]), x or identity(data.shape[-1])
    if y.kind == x.kind == "none":
        return data
    batch = data.shape[:-2]
    work, shape = data, (*batch, y.length, x.length)
    if not in_place or shape != data.shape or (y.offset, x.offset) != (0, 0):
        work = window(data, shape, device, offset=(y.offset, x.offset))
    multiply_tables(work, _window_factors(y), _window_factors(x), device)
    for kinds, forward in ((("forward", "convolve"), True), (("inverse",), False)):
        _transform(work, y.kind in kinds, x.kind in kinds, forward, device)
    multiply_tables(work, y.kernel, x.kernel, device)
    _transform(work, y.kind == "convolve", x.kind == "convolve", False, device)
    if (y.m, x.m) != (y.length, x.length):
        work = window(work, (*batch, y.m, x.m), device, offset=(-y.start, -x.start))
    multiply_tables(work, y.post, x.post, device)
    return work


def _window_factors(line: Line) -> Array | None:
    """Return the factors before the transform, with zeros outside of the input samples."""
    if line.pre is None:
        return None
    table = np.zeros(line.length, line.pre.dtype)
    table[line.offset : line.offset + line.n] = line.pre
    return table


def _transform(work: cla.Array, y: bool, x: bool, forward: bool, device: FieldDevice) -> None:
    axes = tuple(axis for axis, is_chosen in ((-2, y), (-1, x)) if is_chosen)
    if axes:
        device.fft.transform(work, device, axes=axes, forward=forward)


def multiply_tables(work: cla.Array, y: Array | None, x: Array | None, device: FieldDevice) -> None:
    """Multiply samples in place by two 1-D tables; None stands for 1."""
    if y is None and x is None:
        return
    ny, nx = work.shape[-2:]
    ty = np.ones(ny, device.complex) if y is None else y.astype(device.complex)
    tx = np.ones(nx, device.complex) if x is None else x.astype(device.complex)
    kernel = device.kernel("separable.cl", "multiply_separable", **lanes_defines(device))
    tables = (device.upload(ty), device.upload(tx))
    device.launch_rows(kernel, work.shape, work, work, *tables, ny, nx)


def multiplied(
    work: cla.Array, spectrum: Spectrum, device: FieldDevice, *, copy: bool
) -> cla.Array:
    """Multiply spectra (..., my, mx) by factors, in place unless ``copy``."""
    out = window(work, work.shape, device) if copy else work
    ny, nx = spectrum.shape
    form = {"CONJUGATE": True} if spectrum.is_conjugated else {}
    if spectrum.is_quadrant:
        defines = lanes_defines(device) | form
        kernel = device.kernel("spectral_filter.cl", "filter_spectrum", **defines)
        device.launch_rows(kernel, out.shape, out, spectrum.values, ny, nx)
    else:
        kernel = device.kernel("multiply.cl", "multiply", **device.wave_defines(), **form)
        device.launch_rows(kernel, out.shape, out, out, spectrum.values, ny, nx)
    return out


def add(out: cla.Array, values: cla.Array, device: FieldDevice) -> None:
    """Add complex samples (..., ny, nx) to an array of equal shape, in place."""
    ny, nx = out.shape[-2:]
    kernel = device.kernel("multiply.cl", "add", **device.wave_defines())
    device.launch_rows(kernel, out.shape, out, values, ny, nx)


def window(
    data: cla.Array,
    shape: Sequence[int],
    device: FieldDevice,
    *,
    offset: tuple[int, int] | None = None,
) -> cla.Array:
    """Copy complex samples to a larger or smaller window, padded with zeros."""
    out = device.empty(shape, device.complex)
    (ny, nx), (in_ny, in_nx) = shape[-2:], data.shape[-2:]
    if offset is None:
        offset = (ny // 2 - in_ny // 2, nx // 2 - in_nx // 2)
    kernel = device.kernel("window.cl", "window", **device.wave_defines())
    numbers = (ny, nx, in_ny, in_nx, -offset[0], -offset[1])
    device.launch_rows(kernel, shape, out, data, *numbers)
    return out


def lanes_defines(device: FieldDevice) -> dict[str, Any]:
    """Return `wave_defines`, with vectors of 16 samples if a work-item processes a row."""
    lanes = device.rows and device.precision == "single"
    return {"LANES": True} if lanes else device.wave_defines()
