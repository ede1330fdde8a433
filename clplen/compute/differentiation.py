"""Linear maps and differentiable steps of a device between arrays of the host.

The parts that all automatic differentiation engines share: memory lent to the device, checks of
shapes and of finite values, and the gradient of each input.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.compute.linear_map import LinearMap, leading_axes
from clplen.compute.shared_memory import keep, lend, shares_memory
from clplen.errors import ShapeError
from clplen.types import Array

# Map from a gradient of the output to those of the inputs; None for an input without gradient.
Pullback = Callable[[cla.Array], Sequence[Any]]
# Map from inputs to the output and its pullback, which may be called several times.
Forward = Callable[..., tuple[cla.Array, Pullback]]
HostPullback = Callable[[Array], list[Array | None]]

MAX_HOST_CHECK_SAMPLES = 2**15  # above this size a kernel checks for finite values
MAX_NAME_LENGTH = 60  # characters of an operator's name in a message
_PARTS = ("device", "in_shape", "out_shape", "dtype", "forward_data", "adjoint_data")


def require_linear_map(operator: Any) -> None:
    """Raise a TypeError unless an operator is a linear map."""
    if not all(hasattr(operator, part) for part in _PARTS):
        raise TypeError(
            "operator must be a linear map with an adjoint, such as a Projector, got "
            f"{type(operator).__name__}."
        )


def name_of(operator: Any) -> str:
    """Return the name of an operator for messages."""
    return textwrap.shorten(getattr(operator, "__name__", repr(operator)), MAX_NAME_LENGTH)


def run_linear(
    linear: LinearMap,
    values: Array,
    *,
    adjoint: bool = False,
    of_gradient: bool = False,
    check_finite: bool = True,
) -> Array:
    """Apply a linear map or its adjoint to an array of the host; a CPU device copies nothing."""
    name, device = name_of(linear), linear.device
    lead = leading_axes(linear, values.shape, adjoint=adjoint)
    shape = (*lead, *(linear.in_shape if adjoint else linear.out_shape))
    if 0 in shape or 0 in values.shape:
        return np.zeros(shape, linear.dtype)
    data = lend(values, device)
    try:
        if check_finite:
            _require_finite(values, data, device, _input_message(name, of_gradient))
        out = (linear.adjoint_data if adjoint else linear.forward_data)(data)
        message = _output_message(name, adjoint=adjoint) if check_finite else ""
        return _result(out, [data], device, shape, name, message)
    finally:
        device.finish()  # the device must not read the host's memory after the return


@dataclass(frozen=True)
class Step:
    """Differentiable step of a device with several input arrays and one output array.

    ``forward`` takes arrays of the device, then parameters as NumPy arrays of float64. It returns
    the output on the device and a pullback. The pullback returns the gradient of each input, on
    the device or on the host, or None for an input without a gradient.
    """

    forward: Forward
    device: Device
    arrays: int  # number of inputs that are arrays of the device; the others are parameters
    name: str  # name in messages
    check_finite: bool = True  # raise if values are not finite

    def run(self, inputs: Sequence[Array]) -> tuple[Array, HostPullback]:
        """Return the output for inputs of the host, and its pullback between arrays of the host.

        The pullback may read the inputs, whose memory the device shares: do not change them.
        """
        device = self.device
        lent = [lend(values, device) for values in inputs[: self.arrays]]
        parameters = [np.asarray(values, np.float64) for values in inputs[self.arrays :]]
        try:
            for number, data in enumerate(lent if self.check_finite else ()):
                message = _input_message(self.name, False, f" {number + 1}")
                _require_finite(inputs[number], data, device, message)
            out, pullback = self.forward(*lent, *parameters)
            shape = tuple(int(n) for n in out.shape)
            message = _output_message(self.name, adjoint=False) if self.check_finite else ""
            result = _result(out, lent, device, shape, self.name, message)
        finally:
            device.finish()

        def back(g: Array) -> list[Array | None]:
            return self._back(pullback, g, shape, inputs, lent)

        return result, back

    def _back(
        self,
        pullback: Pullback,
        g: Array,
        shape: tuple[int, ...],
        inputs: Sequence[Array],
        lent: list[cla.Array],
    ) -> list[Array | None]:
        """Return the gradient of each input on the host."""
        device = self.device
        if g.shape != shape:
            raise ShapeError(
                f"The gradient passed to {self.name} must have the shape of its output, {shape}, "
                f"got {g.shape}."
            )
        data = lend(g, device)
        borrowed = [*lent, data]  # arrays whose memory no gradient may share
        try:
            if self.check_finite:
                _require_finite(g, data, device, _input_message(self.name, True))
            gradients = list(pullback(data))
            if len(gradients) != len(inputs):
                raise ShapeError(
                    f"{self.name} has {len(inputs)} inputs, but its pullback returned "
                    f"{len(gradients)} gradients; return one for each input, or None."
                )
            return [
                None if grad is None else self._gradient(grad, values, number, borrowed)
                for number, (grad, values) in enumerate(zip(gradients, inputs, strict=True))
            ]
        finally:
            device.finish()

    def _gradient(self, grad: Any, values: Array, number: int, borrowed: list[cla.Array]) -> Array:
        """Return a gradient on the host, real for a real input, in memory that nothing shares."""
        shape = tuple(int(n) for n in np.shape(grad))
        if shape != values.shape:
            raise ShapeError(
                f"The gradient of input {number + 1} of {self.name} must have the shape of the "
                f"input, {values.shape}, got {shape}."
            )
        message = _output_message(self.name, adjoint=True) if self.check_finite else ""
        if isinstance(grad, cla.Array):
            result = _result(grad, borrowed, self.device, shape, self.name, message)
            borrowed.append(grad)
        else:
            result = np.asarray(grad)
            if message:
                _refuse(_count_on_host(result), message)
        is_real = values.dtype.kind != "c"
        return np.asarray(result.real if is_real else result, values.dtype)


def _result(
    out: cla.Array,
    borrowed: list[cla.Array],
    device: Device,
    shape: tuple[int, ...],
    name: str,
    message: str,
) -> Array:
    """Return the output of a step on the host; copy it if it shares the memory of a borrowed array.

    A message asks for a check that values are finite, which small arrays get on the host.
    """
    if tuple(out.shape) != shape:
        raise ShapeError(f"{name} must return an array of shape {shape}, got {tuple(out.shape)}.")
    is_small = out.size <= MAX_HOST_CHECK_SAMPLES
    if message and not is_small:
        _refuse(count_bad(out, device), message)
    is_shared = any(shares_memory(out, data) for data in borrowed)
    values = device.download(out) if is_shared else keep(out, device)
    if message and is_small:
        _refuse(_count_on_host(values), message)
    return values


def _require_finite(values: Array, data: cla.Array, device: Device, message: str) -> None:
    """Raise if values of the host, equal to ``data`` on the device, are not all finite."""
    is_small = values.size <= MAX_HOST_CHECK_SAMPLES
    _refuse(_count_on_host(values) if is_small else count_bad(data, device), message)


def _count_on_host(values: Array) -> int:
    return int(np.count_nonzero(~np.isfinite(values)))


def _refuse(bad: int, message: str) -> None:
    """Raise a ValueError if there are bad values; the message has a field ``{bad}``."""
    if bad:
        raise ValueError(message.format(bad=_counted(bad)))


def _counted(bad: int) -> str:
    return f"{bad:,} {'value that is' if bad == 1 else 'values that are'} NaN or infinite"


def _input_message(name: str, of_gradient: bool, which: str = "") -> str:
    """Return the message about an input that is not finite."""
    plain = name.replace("{", "{{").replace("}", "}}")
    if of_gradient:
        return (
            f"The gradient passed to {plain} has {{bad}}; check the loss and the steps between it "
            "and this step."
        )
    return f"The input{which} of {plain} has {{bad}}; check the steps before this step."


def _output_message(name: str, *, adjoint: bool) -> str:
    """Return the message about an output that is not finite."""
    plain = name.replace("{", "{{").replace("}", "}}")
    what = f"The gradient through {plain}" if adjoint else f"The output of {plain}"
    return f"{what} has {{bad}}, although the input is finite; scale the input down."
