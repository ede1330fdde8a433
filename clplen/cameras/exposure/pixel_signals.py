"""Linear map from the light behind each colour filter to the signals of pixels."""

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
    """Signals that pixels record of the light on them."""

    pixels: PixelArray  # pixels with their filters and their crosstalk
    filters: int  # number of kinds of pixels whose light is summed separately
    shape: tuple[int, int]  # (ny, nx) of the sensor

    @property
    def is_identity(self) -> bool:
        """True if signals equal the light."""
        return self.filters == 1 and self.pixels.crosstalk is None

    def read(self, light: cla.Array, device: Device) -> cla.Array:
        """Compute the pixels' signals, (batch, ny, nx), of light (filters batch, ny, nx)."""
        if self.is_identity:
            return light
        values = device.download(light).reshape(self.filters, -1, *self.shape)
        read = self.read_values(values.astype(np.float64))
        return device.upload(np.ascontiguousarray(read, device.real))

    def read_values(self, light: Values) -> Values:
        """Apply `read` on the host: (batch, ny, nx), of light (filters, batch, ny, nx)."""
        if self.is_identity:
            return light[0]
        signal = np.einsum("fyx,fbyx->byx", self._masks(), light)
        return np.stack([self.pixels.read(picture) for picture in signal])

    def adjoint(self, images: Values) -> Values:
        """Apply the transpose of `read` on the host: shape (filters, batch, ny, nx)."""
        light = np.stack([self.pixels.read_adjoint(image) for image in images])
        return np.asarray(self._masks()[:, None] * light)

    def read_adjoint(self, images: cla.Array, device: Device) -> cla.Array:
        """Apply the transpose of `read`, shape (filters batch, ny, nx)."""
        if self.is_identity:
            return images
        light = self.adjoint(device.download(images).astype(np.float64))
        return device.upload(np.ascontiguousarray(light.reshape(-1, *self.shape), device.real))

    def _masks(self) -> Values:
        """Return 1 on the pixels behind each filter, shape (filters, ny, nx)."""
        filters, (ny, nx) = self.pixels.filters, self.shape
        if filters is None or self.filters == 1:
            return np.ones((1, ny, nx))
        down, across = filters.index.shape
        index = np.tile(filters.index, (-(-ny // down), -(-nx // across)))[:ny, :nx]
        return np.asarray(index == np.arange(self.filters)[:, None, None], np.float64)
