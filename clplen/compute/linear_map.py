"""Linear maps between arrays of a device: what adjoints, solvers and engines of gradients share."""

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

    Of real arrays the adjoint is the transpose. Both directions take and return arrays of the
    device, C-contiguous, of `dtype`, with any number of leading axes (not in `in_shape` and
    `out_shape`), each index of which is mapped by itself; neither changes its argument.
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
        """A x, shape ``(..., *out_shape)`` of ``(..., *in_shape)``."""

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """A' y, shape ``(..., *in_shape)`` of ``(..., *out_shape)``."""


class Solvable:
    """Base of linear maps that solvers of SciPy take."""

    def as_linear_operator(self: LinearMap) -> LinearOperator:
        """Return the map for solvers of SciPy, whose vectors are raveled arrays."""
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
            If they do not fit the device.
        """
        return mapped(self, values)

    def adjoint(self: LinearMap, values: Any) -> Array:
        """Map arrays by the transpose.

        Parameters
        ----------
        values : array_like
            Shape ``(..., *out_shape)``; a `RawImage` is one, too.

        Returns
        -------
        numpy.ndarray
            Shape ``(..., *in_shape)``.

        Raises
        ------
        ShapeError
            If the values have another shape.
        DeviceError
            If they do not fit the device.
        """
        return mapped(self, values, adjoint=True)


def mapped(linear: LinearMap, values: Any, *, adjoint: bool = False) -> Array:
    """An array of the host through a map, or through its adjoint, on the host again."""
    array = host_array(values, "What a linear map takes")
    leading_axes(linear, array.shape, adjoint=adjoint)
    data = linear.device.upload(np.ascontiguousarray(array, linear.dtype))
    return np.asarray(
        linear.device.download((linear.adjoint_data if adjoint else linear.forward_data)(data))
    )


def leading_axes(
    linear: LinearMap, shape: tuple[int, ...], *, adjoint: bool = False
) -> tuple[int, ...]:
    """The leading axes of an array that a map takes, or its adjoint."""
    wanted = tuple(linear.out_shape if adjoint else linear.in_shape)
    lead = len(shape) - len(wanted)
    if lead < 0 or tuple(shape[lead:]) != wanted:
        raise ShapeError(
            f"{'The adjoint of this map' if adjoint else 'This map'} takes arrays of shape "
            f"(..., {', '.join(map(str, wanted))}), not {tuple(shape)}."
        )
    return tuple(int(n) for n in shape[:lead])
