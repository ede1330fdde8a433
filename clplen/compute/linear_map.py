"""Linear maps between arrays of a device, for adjoints, solvers and automatic differentiation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array
from clplen.errors import ShapeError
from clplen.types import Array

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


class LinearMap(Protocol):
    """A linear map A and its adjoint A', <A x, y> = <x, A' y> with <a, b> = sum conj(a) b.

    The adjoint of a real map is its transpose. Both directions take and return C-contiguous device
    arrays of `dtype` and leave their argument unchanged. Leading axes, which `in_shape` and
    `out_shape` omit, are a batch.
    """

    @property
    def device(self) -> Any: ...

    @property
    def in_shape(self) -> tuple[int, ...]: ...

    @property
    def out_shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Return A x, shape ``(..., *out_shape)``, for x of shape ``(..., *in_shape)``."""

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Return A' y, shape ``(..., *in_shape)``, for y of shape ``(..., *out_shape)``."""


class Solvable:
    """Base of linear maps that convert to SciPy's linear operators."""

    def as_linear_operator(self: LinearMap) -> LinearOperator:
        """Return the map as a SciPy operator, whose vectors are raveled arrays."""
        from scipy.sparse.linalg import LinearOperator

        def forward(x: Array) -> Array:
            return mapped(self, np.reshape(x, self.in_shape)).ravel()

        def adjoint(y: Array) -> Array:
            return mapped(self, np.reshape(y, self.out_shape), adjoint=True).ravel()

        shape = (math.prod(self.out_shape), math.prod(self.in_shape))
        return LinearOperator(shape, matvec=forward, rmatvec=adjoint, dtype=self.dtype)


class ArrayMap(Solvable):
    """Base of linear maps between arrays of the host, whose leading axes are a batch."""

    def forward(self: LinearMap, values: Any) -> Array:
        """Map arrays.

        Parameters
        ----------
        values : array_like
            Shape ``(..., *in_shape)``.

        Returns
        -------
        numpy.ndarray
            Shape ``(..., *out_shape)``.

        Raises
        ------
        ShapeError
            If the values have another shape.
        DeviceError
            If the values do not fit in the device's memory.
        """
        return mapped(self, values)

    def adjoint(self: LinearMap, values: Any) -> Array:
        """Map arrays by the adjoint, for real maps the transpose.

        Parameters
        ----------
        values : array_like
            Shape ``(..., *out_shape)``; a `RawImage` is accepted, too.

        Returns
        -------
        numpy.ndarray
            Shape ``(..., *in_shape)``.

        Raises
        ------
        ShapeError
            If the values have another shape.
        DeviceError
            If the values do not fit in the device's memory.
        """
        return mapped(self, values, adjoint=True)


def mapped(linear: LinearMap, values: Any, *, adjoint: bool = False) -> Array:
    """Apply a map or its adjoint to an array of the host and return the result on the host."""
    array = host_array(values, "The argument of a linear map")
    leading_axes(linear, array.shape, adjoint=adjoint)
    data = linear.device.upload(np.ascontiguousarray(array, linear.dtype))
    return np.asarray(
        linear.device.download((linear.adjoint_data if adjoint else linear.forward_data)(data))
    )


def leading_axes(
    linear: LinearMap, shape: tuple[int, ...], *, adjoint: bool = False
) -> tuple[int, ...]:
    """Return the leading axes of an array that a map or its adjoint takes."""
    core = tuple(linear.out_shape if adjoint else linear.in_shape)
    lead = len(shape) - len(core)
    if lead < 0 or tuple(shape[lead:]) != core:
        raise ShapeError(
            f"The argument of {'the adjoint of this map' if adjoint else 'this map'} must have "
            f"shape (..., {', '.join(map(str, core))}), got {tuple(shape)}."
        )
    return tuple(int(n) for n in shape[:lead])
