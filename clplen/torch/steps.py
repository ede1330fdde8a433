"""Steps with a pullback of their own, linear or not, as functions of tensors with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from clplen.compute.device import DeviceLike, as_device
from clplen.compute.differentiation import Forward, Step, name_of
from clplen.torch.tensors import host_values, require_tensor, tensor_of


def apply_step(
    forward: Forward,
    *arrays: torch.Tensor,
    parameters: Sequence[torch.Tensor] = (),
    device: DeviceLike | None = None,
    name: str | None = None,
    check_finite: bool = True,
) -> torch.Tensor:
    """Apply a step that brings its own gradients, between tensors.

    Parameters
    ----------
    forward : callable
        ``forward(*arrays, *parameters)`` returns ``(output, pullback)``; ``pullback(g)`` takes the
        gradient of a real loss L with respect to the output y, dL/dRe y + i dL/dIm y, and returns
        a sequence with that of each input, None where there is none. Arrays, the output, g and
        gradients of arrays are arrays of the device (`pyopencl.array.Array`), C-contiguous, which
        are not changed; parameters are NumPy arrays of float64, their gradients arrays or numbers.
        A pullback may be called several times.
    *arrays : torch.Tensor
        In host memory, real or complex of the device's precision. A CPU device reads their own
        memory and a GPU copies of them; what is not contiguous is copied.
    parameters : sequence of torch.Tensor
        Real ones that are needed on the host, such as distances or coefficients: float32 or
        float64 of any shape.
    device : Device or str, optional
        Default ``Device.open()``.
    name : str, optional
        Of the step in messages; default that of ``forward``.
    check_finite : bool
        Whether NaN and infinity are refused, of arrays, of the output and of gradients, with the
        name of the step where they arise.

    Returns
    -------
    torch.Tensor
        The output, which can be differentiated once.

    Raises
    ------
    TypeError
        If an input is no such tensor.
    ShapeError
        If a gradient has another shape than its input (during ``backward``).
    ValueError
        If values are not finite; during ``backward`` if a gradient is needed that there is not.

    Examples
    --------
    Intensity, with the pullback 2 g u:

    >>> import torch
    >>> import clplen.torch
    >>> device = clplen.Device.open()
    >>> def intensity(u):
    ...     amplitude = u.get()
    ...     def pullback(g):
    ...         return [device.upload(2 * g.get() * amplitude)]
    ...     return device.upload(np.abs(amplitude) ** 2), pullback
    >>> u = torch.tensor([[1 + 1j, 2.0]], requires_grad=True)
    >>> clplen.torch.apply_step(intensity, u, device=device).sum().backward()
    >>> u.grad
    tensor([[2.+2.j, 4.+0.j]])
    """
    device = as_device(device)
    step = Step(forward, device, len(arrays), name or name_of(forward), check_finite)
    for x in arrays:
        require_tensor(x, (device.real, device.complex), step.name)
    for x in parameters:
        types = (np.dtype(np.float64), np.dtype(np.float32))
        require_tensor(x, types, f"{step.name} as a parameter")
    return _Step.apply(step, *arrays, *parameters)


class _Step(torch.autograd.Function):
    """The output of a step; its pullback is kept where an input needs a gradient."""

    @staticmethod
    def forward(ctx: Any, step: Step, *inputs: torch.Tensor) -> torch.Tensor:
        out, pullback = step.run([host_values(x) for x in inputs])
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*inputs)  # PyTorch refuses backward where they were changed
            ctx.step, ctx.pullback = step, pullback
        return tensor_of(out)

    @staticmethod
    def backward(ctx: Any, g: torch.Tensor) -> tuple[Any, ...]:
        inputs, name = ctx.saved_tensors, ctx.step.name
        found = ctx.pullback(host_values(g))
        needed = ctx.needs_input_grad[1:]
        for number, (grad, wanted) in enumerate(zip(found, needed, strict=True)):
            if wanted and grad is None:
                raise ValueError(
                    f"{name} has no gradient of its input {number + 1}, of shape "
                    f"{tuple(inputs[number].shape)}: give it as tensor.detach()."
                )
        grads = [
            tensor_of(np.ascontiguousarray(grad)) if wanted else None
            for grad, wanted in zip(found, needed, strict=True)
        ]
        if torch.is_grad_enabled():  # create_graph: what is differentiated again is refused then
            known = [grad for grad in grads if grad is not None]
            last = iter(_Last.apply(name, len(known), *known, g, *inputs))
            grads = [None if grad is None else next(last) for grad in grads]
        return None, *grads


class _Last(torch.autograd.Function):
    """Gradients as they are, of which there are no further ones."""

    @staticmethod
    def forward(ctx: Any, name: str, count: int, *tensors: torch.Tensor) -> tuple[Any, ...]:
        ctx.name = name
        return tuple(grad.view_as(grad) for grad in tensors[:count])

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[Any, ...]:
        raise RuntimeError(
            f"{ctx.name} can be differentiated once, but a second derivative was asked for: take "
            "gradients without create_graph=True, or detach them."
        )
