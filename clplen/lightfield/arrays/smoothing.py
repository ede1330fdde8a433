"""Smoothing of maps by a symmetric window on a device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.lightfield.arrays.shear import vector_lanes

Vector = np.ndarray[Any, np.dtype[np.float64]]

_TRUNCATE = 4.0  # standard deviations at which a Gaussian is cut off
_GROUP = 64  # work-items of a GPU's group
_STRETCH = {True: 512, False: 256}  # samples of a row in one group, on CPUs and GPUs
_LINES = {True: 8, False: 1}  # rows of one group, on CPUs and GPUs


class Smoother:
    """A separable window for maps of one size, edges reflected (d c b a | a b c d | d c b a)."""

    def __init__(self, taps: Vector, *, device: Device) -> None:
        self._device = device
        self._radius = taps.size - 1
        self._taps = device.upload(whole_taps(taps, device))

    def __call__(self, out: cla.Array, maps: cla.Array, *, start: int, count: int) -> None:
        """Smooth maps into another array."""
        ny, nx = (int(n) for n in maps.shape[1:])
        launch_stretches(
            self._device,
            ("smooth.cl", "smooth"),
            (count, ny, nx),
            (out, maps, self._taps, *(np.int32(n) for n in (self._radius, start, ny, nx))),
            halos=(self._radius,),
        )


def launch_stretches(
    device: Device,
    name: tuple[str, str],
    shape: tuple[int, int, int],
    args: tuple[Any, ...],
    *,
    halos: tuple[int, ...],
    channels: int = 1,
    **defines: Any,
) -> None:
    """Launch a kernel that includes separated.cl over (n, y, samples of a row)."""
    batch, ny, samples = shape
    limit = max(_STRETCH[device.rows] // channels, 1) * channels
    length = min(limit, samples)
    group, lines = 1 if device.rows else _GROUP, _LINES[device.rows]
    device.launch(
        device.kernel(*name, LINES=lines, LANES=vector_lanes(device)[0], **defines),
        (-(-samples // length) * group, -(-ny // lines), batch),
        *args,
        np.int32(length),
        *(cl.LocalMemory(4 * lines * (length + 2 * halo)) for halo in halos),
        group=(group, 1, 1),
    )


def whole_taps(taps: Vector, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Mirror the weights at distances 0, 1, ... to both sides, in the layout of separated.cl."""
    symmetric = np.concatenate((taps[..., :0:-1], taps), axis=-1)
    margins = [(0, 0)] * (taps.ndim - 1) + [(_LINES[device.rows] - 1,) * 2]
    return np.pad(symmetric, margins).astype(np.float32)


def gaussian_taps(sigma: float) -> Vector:
    """Return the weights at distances 0, 1, ... of a Gaussian that sums to 1 over both sides.

    The window is cut off at 4 standard deviations.
    """
    t = np.arange(int(_TRUNCATE * sigma + 0.5) + 1)
    taps = np.exp(-0.5 * (t / sigma) ** 2)
    return taps / (2 * taps.sum() - taps[0])


def box_taps(width: int) -> Vector:
    """Return the weights at distances 0, 1, ... of a mean over an odd number of pixels."""
    return np.full((width + 1) // 2, 1 / width)
