"""A picture on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

if TYPE_CHECKING:
    from clplen.compute.device import Device


@dataclass(frozen=True, eq=False, repr=False)
class Image:
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

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """The values on the host, same shape and dtype."""
        return self.device.download(self.data)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray[Any, Any]:
        """What ``numpy.asarray`` takes: the values on the host, always a copy.

        Raises
        ------
        ValueError
            If ``copy`` is False.
        """
        if copy is False:
            raise ValueError("An image on a device is an array only by a copy: leave out copy.")
        values = self.to_numpy()
        return values if dtype is None else values.astype(dtype, copy=False)
