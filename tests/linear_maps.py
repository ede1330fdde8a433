"""Small linear maps with adjoints, of which every number is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device


class Fourier:
    """The discrete Fourier transform of the last two axes, not normalised, on the device."""

    def __init__(self, shape: tuple[int, int], device: Device) -> None:
        self.in_shape = self.out_shape = shape
        self.device, self.dtype = device, device.complex

    def __repr__(self) -> str:
        return f"<Fourier of {self.in_shape}>"

    def forward_data(self, data: cla.Array) -> cla.Array:
        out = self._copied(data)
        self.device.fft.forward(out, self.device)
        return out

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        out = self._copied(data)
        self.device.fft.inverse(out, self.device)
        with self.device.on_host(out) as values:
            values *= np.prod(self.in_shape)
        return out

    def _copied(self, data: cla.Array) -> cla.Array:
        out = self.device.empty(data.shape, data.dtype)
        self.device.copy_into(out, data, 0)
        return out


class Dense:
    """A matrix, on the host."""

    def __init__(self, matrix: np.ndarray[Any, Any], device: Device) -> None:
        self.matrix, self.device, self.dtype = matrix, device, matrix.dtype
        self.in_shape, self.out_shape = (matrix.shape[1],), (matrix.shape[0],)

    def __repr__(self) -> str:
        return f"<Dense {self.matrix.shape}>"

    def forward_data(self, data: cla.Array) -> cla.Array:
        return self.device.upload(self.device.download(data) @ self.matrix.T)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        return self.device.upload(self.device.download(data) @ self.matrix.conj())


class Copied:
    """The identity as a copy on the device; it remembers where the data lay."""

    def __init__(self, shape: tuple[int, ...], dtype: Any, device: Device) -> None:
        self.in_shape = self.out_shape = shape
        self.device, self.dtype = device, np.dtype(dtype)
        self.read: list[int] = []  # addresses of data and of results, on a CPU
        self.made: list[int] = []

    def forward_data(self, data: cla.Array) -> cla.Array:
        out = self.device.empty(data.shape, data.dtype)
        self.device.copy_into(out, data, 0)
        if self.device.is_cpu:
            for array, addresses in ((data, self.read), (out, self.made)):
                with self.device.on_host(array, write=False) as values:
                    addresses.append(values.ctypes.data)
        return out

    adjoint_data = forward_data


class Same(Copied):
    """The identity that gives its argument back."""

    def forward_data(self, data: cla.Array) -> cla.Array:
        return data

    adjoint_data = forward_data


class Broken(Copied):
    """A map whose adjoint makes infinity of the first sample."""

    def __repr__(self) -> str:
        return "<Broken>"

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        values = self.device.download(data)
        values[..., 0] = np.inf
        return self.device.upload(values)


def matrix(rows: int, columns: int, dtype: Any) -> np.ndarray[Any, Any]:
    """Random numbers, complex for a complex type."""
    rng = np.random.default_rng(rows * 100 + columns)
    values = rng.normal(size=(rows, columns))
    if np.dtype(dtype).kind == "c":
        values = values + 1j * rng.normal(size=(rows, columns))
    return values.astype(dtype)
