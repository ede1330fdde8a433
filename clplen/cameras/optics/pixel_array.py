"""Pixels that integrate: what part of a cell is active, and the sums over it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device

Values = np.ndarray[Any, np.dtype[np.float64]]

TAPS = 10  # samples of the field's intensity beyond a pixel that its sum takes in
SHAPE = 8.0  # of Kaiser's window over the interpolation


def pixel_weights(width: float) -> Values:
    """Factors of an intensity's samples whose sum is its integral over a width.

    Of the samples -n..n about the middle of the active width: the integral of sinc times Kaiser's
    window, scaled so that a constant is integrated exactly.

    Parameters
    ----------
    width : float
        In samples; 0: the middle sample alone.

    Returns
    -------
    numpy.ndarray
        Shape (2 n + 1,).
    """
    return _weights(float(width)).copy()


@lru_cache(maxsize=64)
def _weights(width: float) -> Values:
    if width == 0:
        return np.ones(1)
    n = math.ceil(width / 2 + TAPS)
    count = 32 * math.ceil(width)
    x, w = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(-width / 2, width / 2, count // 8 + 1)
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    places = (middle[:, None] + half[:, None] * x).ravel()
    areas = (half[:, None] * w).ravel()
    apart = places[:, None] - np.arange(-n, n + 1)
    root = np.sqrt(np.maximum(1 - (apart / TAPS) ** 2, 0))
    kernel = np.sinc(apart) * np.i0(SHAPE * root) / np.i0(SHAPE) * (np.abs(apart) < TAPS)
    sums = areas @ kernel
    return np.asarray(sums * (width / sums.sum()))


@dataclass(frozen=True)
class PixelSums:
    """Where the pixels of a patch lie among samples of the field, and where on the sensor.

    Attributes
    ----------
    first : tuple of int
        Sample (y, x) in the middle of the patch's first pixel.
    step : int
        Samples from pixel to pixel.
    width : float
        Of the active square in samples; 0 takes the sample in the middle for the whole pixel.
    place : tuple of int
        Pixel (y, x) of the sensor that is the patch's first.
    shape : tuple of int
        Pixels (y, x) of the patch.
    """

    first: tuple[int, int]
    step: int
    width: float
    place: tuple[int, int]
    shape: tuple[int, int]

    def put(
        self, total: cla.Array, fields: cla.Array, number: int, gain: float, device: Device,
        *, add: bool = True,
    ) -> None:  # fmt: skip
        """Sum abs(U)^2 times ``gain`` of one of several fields over pixels of a sensor's image.

        Parameters
        ----------
        total : pyopencl.array.Array
            Real, shape of the sensor; changed.
        fields : pyopencl.array.Array
            Complex, shape (n, ny, nx).
        number : int
            Which of them.
        gain : float
        device : Device
        add : bool
            Whether the sums are added to the image, or replace it.
        """
        if min(self.shape) < 1:
            return
        weights = pixel_weights(self.width)
        reach = len(weights) // 2
        ny, nx = fields.shape[-2:]
        down, across = self.shape
        rows = device.empty((ny, across), device.real)
        taps = device.upload(weights.astype(device.real))
        real, defines = device.real.type, device.wave_defines()
        numbers = (len(weights), self.first[1] - reach, self.step, number, ny, nx, across)
        device.launch_rows(
            device.kernel("pixels.cl", "pixel_rows", **defines),
            (ny, across), rows, fields, taps, *(np.int32(n) for n in numbers),
        )  # fmt: skip
        device.launch_rows(
            device.kernel("pixels.cl", "pixel_columns", **defines, **({} if add else {"SET": True})),
            (down, across), total, rows, taps,
            np.int32(len(weights)), np.int32(self.first[0] - reach), np.int32(self.step),
            real(gain),
            *(np.int32(n) for n in (*self.place, total.shape[-1], down, across)),
        )  # fmt: skip
