"""From the light behind each colour filter to what pixels read, as a linear map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.pixel_array import PixelArray
from clplen.compute.device import Device

Values = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class PixelSignals:
    """What pixels read of the light on them."""

    pixels: PixelArray  # with its filters and its crosstalk
    filters: int  # kinds of pixels that the light is added up for
    shape: tuple[int, int]  # (ny, nx) of the sensor

    @property
    def is_identity(self) -> bool:
        """Whether pixels read the light as it is."""
        return self.filters == 1 and self.pixels.crosstalk is None

    def read(self, light: cla.Array, device: Device) -> cla.Array:
        """Images that pixels read, shape (batch, ny, nx), of light (filters batch, ny, nx)."""
        if self.is_identity:
            return light
        values = device.download(light).reshape(self.filters, -1, *self.shape)
        read = self.read_values(values.astype(np.float64))
        return device.upload(np.ascontiguousarray(read, device.real))

    def read_values(self, light: Values) -> Values:
        """`read` of the host: shape (batch, ny, nx), of light (filters, batch, ny, nx)."""
        if self.is_identity:
            return light[0]
        signal = np.einsum("fyx,fbyx->byx", self._masks(), light)
        return np.stack([self.pixels.read(one) for one in signal])

    def adjoint(self, images: Values) -> Values:
        """The transpose of `read`, of the host: shape (filters, batch, ny, nx)."""
        light = np.stack([self.pixels.read_adjoint(one) for one in images])
        return np.asarray(self._masks()[:, None] * light)

    def read_adjoint(self, images: cla.Array, device: Device) -> cla.Array:
        """The transpose of `read`, shape (filters batch, ny, nx)."""
        if self.is_identity:
            return images
        light = self.adjoint(device.download(images).astype(np.float64))
        return device.upload(np.ascontiguousarray(light.reshape(-1, *self.shape), device.real))

    def _masks(self) -> Values:
        """1 on the pixels behind each filter, shape (filters, ny, nx)."""
        filters, (ny, nx) = self.pixels.filters, self.shape
        if filters is None or self.filters == 1:
            return np.ones((1, ny, nx))
        down, across = filters.index.shape
        index = np.tile(filters.index, (-(-ny // down), -(-nx // across)))[:ny, :nx]
        return np.asarray(index == np.arange(self.filters)[:, None, None], np.float64)
