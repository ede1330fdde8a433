"""How sharp a refocused picture is at every pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.gaussian import GaussianBlur

if TYPE_CHECKING:
    from clplen.compute.device import Device


class HighPass:
    """Energy of what a Gaussian takes away, (R - G * R)^2.

    Parameters
    ----------
    sigma : float
        Of the Gaussian, in pixels.
    shape : tuple of int
        (y, x) or (y, x, c) of one picture.
    device : Device
    luma : bool
        Colours weighted to luma (Rec. ITU-R BT.709) before squaring; otherwise the squares of the
        channels are added. Pictures without three channels have no luma.
    """

    def __init__(
        self, sigma: float, shape: tuple[int, ...], *, device: Device, luma: bool = False
    ) -> None:
        self._size = (*shape, 1)[:3]
        self._device = device
        self._blur = GaussianBlur(sigma, shape, device=device)
        self._low = device.empty(shape, np.float32)
        self._defines = {"LUMA": True} if luma and self._size[2] == 3 else {}

    def __call__(self, out: cla.Array, picture: cla.Array) -> None:
        """The energy of a picture (y, x[, c]) into ``out``, float32 (y, x)."""
        self._blur(self._low, picture)
        self._device.launch_rows(
            self._device.kernel("sharpness.cl", "local_energy", **self._defines),
            self._size[:2],
            out,
            picture,
            self._low,
            *(np.int32(n) for n in self._size),
        )
