"""Base class of linear operators on light fields, with forward and adjoint."""

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
    """A linear map A of float32 samples with its transpose A', <A x, y> = <x, A' y>."""

    _operand_types: ClassVar[tuple[type[OnDevice], type[OnDevice]]]

    device: Device
    in_shape: tuple[int, ...]
    out_shape: tuple[int, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of input and output, float32."""
        return np.dtype(np.float32)

    def __repr__(self) -> str:
        shapes = f"{self.in_shape} to {self.out_shape}"
        return f"<{type(self).__name__} {shapes}{self._details()}, {self.device.name}>"

    def _details(self) -> str:
        """Return further text for the representation."""
        return ""

    def _forward(self, data: cla.Array) -> cla.Array:
        raise NotImplementedError

    def _adjoint(self, data: cla.Array) -> cla.Array:
        raise NotImplementedError

    def _wrap(self, data: cla.Array, adjoint: bool) -> OnDevice:
        raise NotImplementedError

    def forward(self, x: Any) -> Any:
        """Apply A to an object or to an array of `in_shape`.

        An object gives an object, an array gives a float32 array. Leading axes are a batch.
        """
        return self._apply(x, False)

    def adjoint(self, y: Any) -> Any:
        """Apply A' to an object or to an array of `out_shape`, as `forward` does with A."""
        return self._apply(y, True)

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Apply A on the device: float32 ``(..., *in_shape)`` to ``(..., *out_shape)``."""
        return self._apply_batch(data, self.in_shape, self.out_shape, self._forward)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Apply A' on the device: float32 ``(..., *out_shape)`` to ``(..., *in_shape)``."""
        return self._apply_batch(data, self.out_shape, self.in_shape, self._adjoint)

    def _apply(self, values: Any, adjoint: bool) -> Any:
        shape, kind = (self.in_shape, self.out_shape)[adjoint], self._operand_types[adjoint]
        name = f"{'The adjoint of ' if adjoint else ''}{type(self).__name__}"
        if not isinstance(values, OnDevice):
            return mapped(self, real_array(values, f"The input of {name}"), adjoint=adjoint)
        if not isinstance(values, kind):
            raise TypeError(
                f"{name} must get a {kind.__name__} or an array of shape {shape}, got "
                f"{type(values).__name__}."
            )
        require_same_device(self.device, values.device)
        if values.data.dtype != np.float32:
            raise TypeError(
                f"{name} must get float32 samples, got a {kind.__name__} of "
                f"{values.data.dtype}; pass values.to_numpy(), which is converted to float32."
            )
        if tuple(values.data.shape) != shape:
            raise ShapeError(f"{name} must get shape {shape}, got {tuple(values.data.shape)}.")
        data = (self.adjoint_data if adjoint else self.forward_data)(values.data)
        return self._wrap(data, adjoint)

    def _apply_batch(
        self, data: cla.Array, shape: tuple[int, ...], to: tuple[int, ...], step: Step
    ) -> cla.Array:
        """Apply a step to every index of the leading axes."""
        sizes = tuple(int(n) for n in data.shape)
        lead = sizes[: len(sizes) - len(shape)]
        if sizes != (*lead, *shape) or data.dtype != np.float32 or not data.flags.c_contiguous:
            raise ShapeError(
                f"{type(self).__name__} must get a C-contiguous float32 array of shape "
                f"(..., {', '.join(map(str, shape))}), got {sizes} ({data.dtype})."
            )
        if data.context != self.device.context:
            raise DeviceError(f"The array belongs to another OpenCL context than {self.device!r}.")
        count = math.prod(lead)
        if count == 1:
            contiguous = data if data.offset == 0 else data.copy(queue=self.device.queue)
            return step(contiguous.reshape(shape)).reshape((*lead, *to))
        nbytes = 4 * (count + 1) * math.prod(to)
        self.device.require_memory(nbytes, f"{type(self).__name__} of {count} arrays")
        out = self.device.empty((*lead, *to), np.float32)
        flat = data.reshape((count, *shape))
        for index in range(count):
            part = step(flat[index].copy(queue=self.device.queue))
            self.device.copy_into(out, part, index * int(part.nbytes))
        return out
