"""Gaussian blur of pictures on a device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

if TYPE_CHECKING:
    from clplen.compute.device import Device

_TRUNCATE = 4.0  # standard deviations


class GaussianBlur:
    """A separable Gaussian for pictures of one shape; it keeps its taps and one scratch picture.

    Cut off at 4 standard deviations and normalised to the sum 1; beyond the edges the picture is
    reflected (d c b a | a b c d | d c b a).

    Parameters
    ----------
    sigma : float
        Standard deviation in pixels, positive.
    shape : tuple of int
        (y, x) or (y, x, c) of one picture.
    device : Device
    """

    def __init__(self, sigma: float, shape: tuple[int, ...], *, device: Device) -> None:
        self._ny, self._nx, self._channels = (*shape, 1)[:3]
        self._device = device
        self._taps = device.upload(gaussian_taps(sigma).astype(np.float32))
        self._scratch = device.empty(shape, np.float32)

    def __call__(self, out: cla.Array, pictures: cla.Array, *, index: int = 0) -> None:
        """Blur one picture of a batch into another array.

        Parameters
        ----------
        out : pyopencl.array.Array
            float32, the shape of one picture.
        pictures : pyopencl.array.Array
            float32, shape (n, y, x[, c]), or one picture; may be ``out``.
        index : int
            Which picture.
        """
        size = (self._ny, self._nx, self._channels)
        for name, target, source, b in (
            ("gaussian_x", self._scratch, pictures, index),
            ("gaussian_y", out, self._scratch, 0),
        ):
            self._device.launch_rows(
                self._device.kernel("gaussian.cl", name),
                (self._ny, self._nx * self._channels),
                target,
                source,
                self._taps,
                np.int32(self._taps.size - 1),
                *(np.int32(n) for n in (b, *size)),
            )


def gaussian_taps(sigma: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Weights at distance 0, 1, ... of a Gaussian that sums to 1 over both sides."""
    t = np.arange(int(_TRUNCATE * sigma + 0.5) + 1)
    taps = np.exp(-0.5 * (t / sigma) ** 2)
    return taps / (2 * taps.sum() - taps[0])
