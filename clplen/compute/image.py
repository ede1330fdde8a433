"""A picture on a device."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.hostarray import OnDevice


@dataclass(frozen=True, eq=False, repr=False)
class Image(OnDevice):
    """What an intensity, a view, a rendering or a refocus returns.

    Attributes
    ----------
    data : pyopencl.array.Array
        Real values, shape (y, x) or (y, x, c); an EPI has (u, x[, c]) or (v, y[, c]).
    device : Device
        The device that holds them.
    """

    data: cla.Array
    device: Device

    def __repr__(self) -> str:
        return f"<Image {self.shape} {self.data.dtype}, {self.device.name}>"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the values."""
        return tuple(self.data.shape)
