"""Linear maps and differentiable steps of a device between arrays of the host.

What engines of gradients share, whatever their tensors are: memory that is lent to the device,
checks of shapes and of values that are not finite, gradients of each input.
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

# Gradients of the inputs, of a gradient of the output; None of an input that has none.
Pullback = Callable[[cla.Array], Sequence[Any]]
# Of inputs, the output and its pullback, which may be called several times.
Forward = Callable[..., tuple[cla.Array, Pullback]]
HostPullback = Callable[[Array], list[Array | None]]

_SMALL = 2**15  # samples
_NAME = 60  # characters of an operator's name in a message
_PARTS = ("device", "in_shape", "out_shape", "dtype", "forward_data", "adjoint_data")


def require_linear_map(operator: Any) -> None:
    """Refuse what is no linear map."""
    if not all(hasattr(operator, part) for part in _PARTS):
        raise TypeError(
            "An operator is a linear map with its adjoint, such as a Projector, not of type "
            f"{type(operator).__name__}."
        )


def name_of(operator: Any) -> str:
    """How messages name an operator."""
    return textwrap.shorten(getattr(operator, "__name__", repr(operator)), _NAME)


def run_linear(
    linear: LinearMap,
    values: Array,
    *,
    adjoint: bool = False,
    of_gradient: bool = False,
    check_finite: bool = True,
) -> Array:
    """An array of the host through a linear map, on a CPU device without a copy."""
    name, device = name_of(linear), linear.device
    lead = leading_axes(linear, values.shape, adjoint=adjoint)
    shape = (*lead, *(linear.in_shape if adjoint else linear.out_shape))
    if 0 in shape or 0 in values.shape:
        return np.zeros(shape, linear.dtype)
    data = lend(values, device)
    try:
        if check_finite:
            _require_finite(values, data, device, _came(name, of_gradient))
        out = (linear.adjoint_data if adjoint else linear.forward_data)(data)
        message = _made(name, adjoint=adjoint) if check_finite else ""
        return _result(out, [data], device, shape, name, message)
    finally:
        device.finish()  # nothing reads the memory of the host any more


@dataclass(frozen=True)
class Step:
    """Differentiable step of a device: several arrays in, one out, gradients back.

    ``forward`` takes arrays of the device and then parameters, NumPy arrays of float64. It gives
    the output on the device and its pullback, which gives the gradient of each input, on the
    device or on the host, None where there is none.
    """

    forward: Forward
    device: Device
    arrays: int  # how many inputs are arrays of the device; the others are parameters
    name: str  # for messages
    check_finite: bool = True  # refuse values that are not finite

    def run(self, inputs: Sequence[Array]) -> tuple[Array, HostPullback]:
        """The output of inputs of the host, and its pullback between arrays of the host.

        The pullback may read the inputs, whose memory the device shares: they stay as they are.
        """
        device = self.device
        lent = [lend(values, device) for values in inputs[: self.arrays]]
        parameters = [np.asarray(values, np.float64) for values in inputs[self.arrays :]]
        try:
            for number, data in enumerate(lent if self.check_finite else ()):
                message = _came(self.name, False, f" {number + 1}")
                _require_finite(inputs[number], data, device, message)
            out, pullback = self.forward(*lent, *parameters)
            shape = tuple(int(n) for n in out.shape)
            message = _made(self.name, adjoint=False) if self.check_finite else ""
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
        """The gradient of each input, on the host."""
        device = self.device
        if g.shape != shape:
            raise ShapeError(
                f"The gradient that reaches {self.name} has shape {g.shape}, its output {shape}: "
                "they must agree."
            )
        data = lend(g, device)
        known = [*lent, data]  # of whose memory no gradient is made
        try:
            if self.check_finite:
                _require_finite(g, data, device, _came(self.name, True))
            found = list(pullback(data))
            if len(found) != len(inputs):
                raise ShapeError(
                    f"{self.name} has {len(inputs)} inputs, but its pullback gave {len(found)} "
                    "gradients: give one for each, None where there is none."
                )
            return [
                None if grad is None else self._gradient(grad, values, number, known)
                for number, (grad, values) in enumerate(zip(found, inputs, strict=True))
            ]
        finally:
            device.finish()

    def _gradient(self, grad: Any, values: Array, number: int, known: list[cla.Array]) -> Array:
        """One gradient on the host, real for a real input, in memory of its own."""
        shape = tuple(int(n) for n in np.shape(grad))
        if shape != values.shape:
            raise ShapeError(
                f"The gradient of input {number + 1} of {self.name} has shape {shape}, the input "
                f"{values.shape}: they must agree."
            )
        message = _made(self.name, adjoint=True) if self.check_finite else ""
        if isinstance(grad, cla.Array):
            result = _result(grad, known, self.device, shape, self.name, message)
            known.append(grad)
        else:
            result = np.asarray(grad)
            if message:
                _refuse(_count_on_host(result), message)
        is_real = values.dtype.kind != "c"
        return np.asarray(result.real if is_real else result, values.dtype)


def _result(
    out: cla.Array,
    known: list[cla.Array],
    device: Device,
    shape: tuple[int, ...],
    name: str,
    message: str,
) -> Array:
    """What a step made, on the host, in no memory that is known; with a message, if it is finite.

    A small array is looked at on the host, which takes less than the launch of a kernel.
    """
    if tuple(out.shape) != shape:
        raise ShapeError(f"{name} made an array of shape {tuple(out.shape)} in place of {shape}.")
    is_small = out.size <= _SMALL
    if message and not is_small:
        _refuse(count_bad(out, device), message)
    is_known = any(shares_memory(out, data) for data in known)
    values = device.download(out) if is_known else keep(out, device)
    if message and is_small:
        _refuse(_count_on_host(values), message)
    return values


def _require_finite(values: Array, data: cla.Array, device: Device, message: str) -> None:
    """Refuse values on the host, which are those of ``data``, if some are not finite."""
    is_small = values.size <= _SMALL
    _refuse(_count_on_host(values) if is_small else count_bad(data, device), message)


def _count_on_host(values: Array) -> int:
    return int(np.count_nonzero(~np.isfinite(values)))


def _refuse(bad: int, message: str) -> None:
    """Raise a message about ``{bad}``, if there are any."""
    if bad:
        raise ValueError(message.format(bad=_counted(bad)))


def _counted(bad: int) -> str:
    return f"{bad:,} {'value that is' if bad == 1 else 'values that are'} NaN or infinite"


def _came(name: str, of_gradient: bool, which: str = "") -> str:
    """The message about what a step was given."""
    plain = name.replace("{", "{{").replace("}", "}}")
    if of_gradient:
        return (
            f"The gradient that reaches {plain} has {{bad}}: the loss, or a step between it and "
            "this one, made them."
        )
    return f"The input{which} of {plain} has {{bad}}, which would spread: a step before made them."


def _made(name: str, *, adjoint: bool) -> str:
    """The message about what a step made."""
    plain = name.replace("{", "{{").replace("}", "}}")
    what = f"The gradient through {plain}" if adjoint else f"The output of {plain}"
    return f"{what} has {{bad}}, made of finite values here: scale them down."
