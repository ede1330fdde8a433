"""Richardson and Lucy's iteration from points that lie ahead of where it is.

    y = max(x + a (x - x'), 0),   a = <g, g'>/<g', g'> within 0 to 1,

x' the volume of the iteration before, g = x - y the last step and g' the one before it (Biggs and
Andrews 1997, "Acceleration of iterative image restoration algorithms"). Voxels that come to 0 stay
there, dark ones for the most part: to leave them a tenth changes residuals and errors by no more
than 1 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.device import Device

Vector = np.ndarray[Any, Any]

LARGEST = 0.999  # of a, which is below 1


class Ahead:
    """Where an iteration goes on from. Holds four more volumes than the iteration itself.

    Parameters
    ----------
    volumes : pyopencl.array.Array
        float32, shape (frames, planes, rows, columns): where it starts.
    device : Device
    """

    def __init__(self, volumes: cla.Array, device: Device) -> None:
        self.device = device
        self.begun, self.before = (device.empty(volumes.shape, np.float32) for _ in range(2))
        for target in (self.begun, self.before):
            device.copy_into(target, volumes, 0)
        self.last: cla.Array | None = None

    def move(self, volumes: cla.Array) -> Vector:
        """Move volumes, as a step left them, ahead in place; a of each frame."""
        frames, planes, rows, columns = volumes.shape
        shape, device = (frames, planes * rows, columns), self.device
        step = device.empty(volumes.shape, np.float32)
        sizes = (np.int32(planes * rows), np.int32(columns))
        kernel = device.kernel("richardson_lucy.cl", "moved")
        device.launch_rows(kernel, shape, step, volumes, self.begun, *sizes)
        a = self._length(step, int(frames))
        kernel = device.kernel("richardson_lucy.cl", "ahead")
        device.launch_rows(
            kernel, shape, volumes, self.begun, self.before, device.upload(a), *sizes
        )
        self.last = step
        return a

    def _length(self, step: cla.Array, frames: int) -> Vector:
        """a of each frame, 0 after the first step."""
        if self.last is None:
            return np.zeros(frames, np.float32)
        on_host = self.device.on_host
        with on_host(step, write=False) as these, on_host(self.last, write=False) as those:
            pairs = [(g.ravel(), h.ravel()) for g, h in zip(these, those, strict=True)]
            found = [float(np.vdot(g, h)) / max(float(np.vdot(h, h)), 1e-30) for g, h in pairs]
        return np.clip(found, 0, LARGEST).astype(np.float32)
