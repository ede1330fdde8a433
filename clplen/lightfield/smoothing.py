"""Maps smoothed by a symmetric window on a device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

if TYPE_CHECKING:
    from clplen.compute.device import Device

Vector = np.ndarray[Any, np.dtype[np.float64]]

_TRUNCATE = 4.0  # standard deviations
_GROUP = 64  # items of a GPU that share a stretch
_STRETCH = {True: 1024, False: 256}  # samples of a row in one group: on CPUs, on GPUs


class Smoother:
    """A separable window for maps of one size; beyond the edges they are reflected.

    d c b a | a b c d | d c b a, as often as needed.

    Parameters
    ----------
    taps : numpy.ndarray
        Weights at distance 0, 1, ... pixels, along both axes.
    device : Device
    """

    def __init__(self, taps: Vector, *, device: Device) -> None:
        self._device = device
        self._taps = device.upload(taps.astype(np.float32))

    def __call__(self, out: cla.Array, maps: cla.Array, *, start: int, count: int) -> None:
        """Smooth maps into another array.

        Parameters
        ----------
        out : pyopencl.array.Array
            float32, room for (start + count, y, x); not ``maps`` itself.
        maps : pyopencl.array.Array
            float32, shape (n, y, x) with n >= count.
        start, count : int
            How many maps, and the first of ``out``.
        """
        ny, nx = (int(n) for n in maps.shape[1:])
        radius = self._taps.size - 1
        launch_stretches(
            self._device,
            self._device.kernel("smooth.cl", "smooth"),
            (count, ny, nx),
            (out, maps, self._taps, *(np.int32(n) for n in (radius, start, ny, nx))),
            halos=(radius,),
        )


def launch_stretches(
    device: Device,
    kernel: cl.Kernel,
    shape: tuple[int, int, int],
    args: tuple[Any, ...],
    *,
    halos: tuple[int, ...],
    channels: int = 1,
) -> None:
    """Launch a kernel written with separated.cl over (n, y, samples of a row).

    Parameters
    ----------
    device : Device
    kernel : pyopencl.Kernel
        Its last arguments are the length of a stretch, whole pixels, and the lines of local memory.
    shape : tuple of int
    args : tuple
        What comes before.
    halos : tuple of int
        One for each line: a stretch with so many samples on either side.
    channels : int
        Samples of a pixel.
    """
    batch, ny, samples = shape
    most = max(_STRETCH[device.rows] // channels, 1) * channels
    length = min(most, samples)
    group = 1 if device.rows else _GROUP
    device.launch(
        kernel,
        (-(-samples // length) * group, ny, batch),
        *args,
        np.int32(length),
        *(cl.LocalMemory(4 * (length + 2 * halo)) for halo in halos),
        group=(group, 1, 1),
    )


def gaussian_taps(sigma: float) -> Vector:
    """Weights at distance 0, 1, ... of a Gaussian that sums to 1 over both sides.

    Cut off at 4 standard deviations.
    """
    t = np.arange(int(_TRUNCATE * sigma + 0.5) + 1)
    taps = np.exp(-0.5 * (t / sigma) ** 2)
    return taps / (2 * taps.sum() - taps[0])


def box_taps(width: int) -> Vector:
    """Weights at distance 0, 1, ... of a mean over an odd number of pixels."""
    return np.full((width + 1) // 2, 1 / width)
