"""Energy of the detail of refocused pictures at every pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.smoothing import gaussian_taps, launch_stretches, whole_taps
from clplen.lightfield.depth.interpolation_blur import NO_TAPS, stack_taps

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.refocus.focal_stack import FocalStack

Vector = np.ndarray[Any, np.dtype[np.float64]]


class LocalEnergy:
    """Energy of what a Gaussian takes away from the pictures of focal stacks, (R - G * R)^2.

    Every picture is first blurred until it has lost as much to interpolation as by half a pixel
    (`evening_taps`), which costs nothing here: both filters are one. Beyond the edges pictures are
    reflected.

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
        self._low = gaussian_taps(sigma)
        self._known: tuple[FocalStack, cla.Array, cla.Array] | None = None
        self._defines: dict[str, Any] = {"CHANNELS": self._size[2]}
        self._defines |= {"LUMA": True} if luma and self._size[2] == 3 else {}

    def __call__(self, out: cla.Array, stack: FocalStack, *, start: int, count: int) -> None:
        """Energies of some pictures of a stack.

        Parameters
        ----------
        out : pyopencl.array.Array
            float32, shape (count, y, x) or larger.
        stack : FocalStack
            Not evened if it has no weights.
        start, count : int
            Which pictures.
        """
        ny, nx, channels = self._size
        radius = self._low.size - 1 + NO_TAPS.size - 1
        launch_stretches(
            self._device,
            ("detail.cl", "detail_energy"),
            (count, ny, nx * channels),
            (
                out,
                stack.data,
                *self._tables(stack),
                *(np.int32(n) for n in (radius, start, ny, nx)),
            ),
            halos=((NO_TAPS.size - 1) * channels, radius * channels, 0),
            channels=channels,
            **self._defines,
        )

    def _tables(self, stack: FocalStack) -> tuple[cla.Array, cla.Array]:
        """Both filters of every picture, kept until another stack comes."""
        known = self._known
        if known is None or known[0] is not stack:
            even = stack_taps(stack, slice(None))
            low = np.array([[_convolved(taps, self._low) for taps in plane] for plane in even])
            tables = [self._device.upload(whole_taps(one, self._device)) for one in (even, low)]
            known = self._known = (stack, tables[0], tables[1])
        return known[1:]


def reach_of(sigma: float) -> int:
    """Pixels on every side that `LocalEnergy` depends on."""
    return int(gaussian_taps(sigma).size + NO_TAPS.size - 2)


def _convolved(a: Vector, b: Vector) -> Vector:
    """Taps at distance 0, 1, ... of one symmetric filter after another."""
    first, second = (np.concatenate((taps[:0:-1], taps)) for taps in (a, b))
    both = np.convolve(first, second)
    return np.asarray(both[both.size // 2 :])
