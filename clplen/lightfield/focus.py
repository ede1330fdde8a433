"""How sharp a refocused picture is at every pixel, and the plane where it is sharpest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.gaussian import GaussianBlur

if TYPE_CHECKING:
    from clplen.compute.device import Device

Map = np.ndarray[Any, np.dtype[np.float32]]


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


class PeakTracker:
    """The highest of a curve at every pixel, while its planes come one after the other.

    Three planes are held, whatever their number.

    Parameters
    ----------
    shape : tuple of int
        (y, x).
    device : Device
    start : float
        Value where no plane has any energy.
    """

    def __init__(self, shape: tuple[int, int], *, device: Device, start: float) -> None:
        self._shape = shape
        self._device = device
        self._best, self._second, self._curvature = (
            device.zeros(shape, np.float32) for _ in range(3)
        )
        self._place = device.upload(np.full(shape, start, np.float32))
        self._planes = [device.empty(shape, np.float32) for _ in range(3)]
        self._values: list[float] = []

    def next_plane(self, value: float) -> cla.Array:
        """Where to write the plane of the next value; values rise.

        Parameters
        ----------
        value : float
            Above the last one.

        Returns
        -------
        pyopencl.array.Array
            float32, shape (y, x); to be filled before the next call.
        """
        count = len(self._values)
        if count >= 2:
            self._track(count - 2, (count - 3) % 3, (count - 1) % 3)
        self._values.append(value)
        return self._planes[count % 3]

    def finish(self) -> tuple[Map, Map]:
        """(values, confidence) of the peaks, float32, shape (y, x)."""
        last = len(self._values) - 1
        self._track(last - 1, (last - 2) % 3, last % 3)
        self._track(last, (last - 1) % 3, last % 3)
        ny, nx = (np.int32(n) for n in self._shape)
        self._device.launch_rows(
            self._device.kernel("sharpness.cl", "confidence"),
            self._shape,
            self._planes[0],
            self._best,
            self._second,
            self._curvature,
            ny,
            nx,
        )
        return self._device.download(self._place), self._device.download(self._planes[0])

    def _track(self, i: int, below: int, above: int) -> None:
        """Compare plane i, whose neighbours lie in the buffers ``below`` and ``above``."""
        steps = np.diff(self._values)
        self._device.launch_rows(
            self._device.kernel("sharpness.cl", "track_peak"),
            self._shape,
            self._best,
            self._second,
            self._place,
            self._curvature,
            self._planes[below],
            self._planes[i % 3],
            self._planes[above],
            np.float32(self._values[i]),
            np.float32(steps[i - 1] if i > 0 else 0),
            np.float32(steps[i] if i < len(steps) else 0),
            *(np.int32(n) for n in self._shape),
        )
