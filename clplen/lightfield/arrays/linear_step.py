"""Base of the linear steps of light fields: arrays and objects, forward and back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla

from clplen.checks import real_array
from clplen.compute.arrays import OnDevice
from clplen.compute.device import Device, require_same_device
from clplen.compute.linear_map import Solvable, mapped
from clplen.errors import DeviceError, ShapeError

Step = Callable[[cla.Array], cla.Array]


class LinearStep(Solvable):
    """A linear map A of float32 samples and its transpose A', <A x, y> = <x, A' y>."""

    _takes: ClassVar[tuple[type[OnDevice], type[OnDevice]]]

    device: Device
    in_shape: tuple[int, ...]
    out_shape: tuple[int, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32, of both sides."""
        return np.dtype(np.float32)

    def __repr__(self) -> str:
        shapes = f"{self.in_shape} to {self.out_shape}"
        return f"<{type(self).__name__} {shapes}{self._about()}, {self.device.name}>"

    def _about(self) -> str:
        """What the representation says besides shapes and device."""
        return ""

    def _forward(self, data: cla.Array) -> cla.Array:
        raise NotImplementedError

    def _adjoint(self, data: cla.Array) -> cla.Array:
        raise NotImplementedError

    def _made(self, data: cla.Array, adjoint: bool) -> OnDevice:
        raise NotImplementedError

    def forward(self, x: Any) -> Any:
        """Return A x: an object of an object, a float32 array of an array of `in_shape`.

        An array may have leading axes, each index of which is mapped by itself.
        """
        return self._through(x, False)

    def adjoint(self, y: Any) -> Any:
        """Return A' y, as `forward`, of `out_shape`."""
        return self._through(y, True)

    def forward_data(self, data: cla.Array) -> cla.Array:
        """A x on the device, shape ``(..., *out_shape)`` of ``(..., *in_shape)``, float32."""
        return self._each(data, self.in_shape, self.out_shape, self._forward)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """A' y on the device, shape ``(..., *in_shape)`` of ``(..., *out_shape)``, float32."""
        return self._each(data, self.out_shape, self.in_shape, self._adjoint)

    def _through(self, values: Any, adjoint: bool) -> Any:
        shape, kind = (self.in_shape, self.out_shape)[adjoint], self._takes[adjoint]
        name = f"{'The adjoint of ' if adjoint else ''}{type(self).__name__}"
        if not isinstance(values, OnDevice):
            return mapped(self, real_array(values, f"What {name} takes"), adjoint=adjoint)
        if not isinstance(values, kind):
            raise TypeError(
                f"{name} takes a {kind.__name__} or an array of shape {shape}, not a "
                f"{type(values).__name__}."
            )
        require_same_device(self.device, values.device)
        if values.data.dtype != np.float32:
            raise TypeError(
                f"{name} maps float32 samples, and this {kind.__name__} stores "
                f"{values.data.dtype}: give values.to_numpy(), whose samples become float32."
            )
        if tuple(values.data.shape) != shape:
            raise ShapeError(f"{name} takes shape {shape}, not {tuple(values.data.shape)}.")
        data = (self.adjoint_data if adjoint else self.forward_data)(values.data)
        return self._made(data, adjoint)

    def _each(
        self, data: cla.Array, shape: tuple[int, ...], to: tuple[int, ...], step: Step
    ) -> cla.Array:
        """Every index of the leading axes through a step."""
        given = tuple(int(n) for n in data.shape)
        lead = given[: len(given) - len(shape)]
        if given != (*lead, *shape) or data.dtype != np.float32 or not data.flags.c_contiguous:
            raise ShapeError(
                f"{type(self).__name__} maps C-contiguous float32 arrays of shape "
                f"(..., {', '.join(map(str, shape))}) here, not {given} ({data.dtype})."
            )
        if data.context != self.device.context:
            raise DeviceError(f"The array lives in another OpenCL context than {self.device!r}.")
        count = math.prod(lead)
        if count == 1:
            alone = data if data.offset == 0 else data.copy(queue=self.device.queue)
            return step(alone.reshape(shape)).reshape((*lead, *to))
        nbytes = 4 * (count + 1) * math.prod(to)
        self.device.require_memory(nbytes, f"What {type(self).__name__} makes of {count} arrays")
        out = self.device.empty((*lead, *to), np.float32)
        flat = data.reshape((count, *shape))
        for index in range(count):
            part = step(flat[index].copy(queue=self.device.queue))
            self.device.copy_into(out, part, index * int(part.nbytes))
        return out
