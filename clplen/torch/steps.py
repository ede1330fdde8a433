"""Differentiable steps with their own pullback, linear or not, as functions of tensors."""

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
    """Apply a step with its own gradients to tensors.

    Parameters
    ----------
    forward : callable
        Function ``forward(*arrays, *parameters)`` that returns ``(output, pullback)``.
        ``pullback(g)`` takes the gradient of a real loss L for the output y, dL/dRe y + i dL/dIm y,
        and returns a sequence with the gradient of each input, or None. Arrays, output, g and
        gradients of arrays are C-contiguous device arrays (`pyopencl.array.Array`) and must not be
        changed. Parameters are NumPy float64 arrays, their gradients arrays or numbers. A pullback
        may be called several times.
    *arrays : torch.Tensor
        Tensors in host memory, real or complex, of the device's precision. A CPU device reads
        their own memory and a GPU copies them; a tensor that is not contiguous is copied.
    parameters : sequence of torch.Tensor
        Real values for the host, such as distances or coefficients: float32 or float64 of any
        shape.
    device : Device or str, optional
        OpenCL device; default ``Device.open()``.
    name : str, optional
        Name of the step in messages; default the name of ``forward``.
    check_finite : bool
        True to raise for NaN and infinity in arrays, output and gradients, with the name of the
        step.

    Returns
    -------
    torch.Tensor
        Output, differentiable once.

    Raises
    ------
    TypeError
        If an input is not such a tensor.
    ShapeError
        If a gradient differs in shape from its input (during ``backward``).
    ValueError
        If values are not finite, or a required gradient is missing (during ``backward``).

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
    """Autograd function of a step; it stores the pullback if an input needs a gradient."""

    @staticmethod
    def forward(ctx: Any, step: Step, *inputs: torch.Tensor) -> torch.Tensor:
        out, pullback = step.run([host_values(x) for x in inputs])
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*inputs)  # PyTorch raises in backward if they were changed
            ctx.step, ctx.pullback = step, pullback
        return tensor_of(out)

    @staticmethod
    def backward(ctx: Any, g: torch.Tensor) -> tuple[Any, ...]:
        inputs, name = ctx.saved_tensors, ctx.step.name
        gradients = ctx.pullback(host_values(g))
        required = ctx.needs_input_grad[1:]
        for number, (grad, is_required) in enumerate(zip(gradients, required, strict=True)):
            if is_required and grad is None:
                raise ValueError(
                    f"{name} has no gradient of its input {number + 1}, of shape "
                    f"{tuple(inputs[number].shape)}: pass tensor.detach()."
                )
        grads = [
            tensor_of(np.ascontiguousarray(grad)) if is_required else None
            for grad, is_required in zip(gradients, required, strict=True)
        ]
        if torch.is_grad_enabled():  # create_graph: a second derivative raises
            final = [grad for grad in grads if grad is not None]
            outputs = iter(_FinalGradients.apply(name, len(final), *final, g, *inputs))
            grads = [None if grad is None else next(outputs) for grad in grads]
        return None, *grads


class _FinalGradients(torch.autograd.Function):
    """Identity of gradients that cannot be differentiated further."""

    @staticmethod
    def forward(ctx: Any, name: str, count: int, *tensors: torch.Tensor) -> tuple[Any, ...]:
        ctx.name = name
        return tuple(grad.view_as(grad) for grad in tensors[:count])

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> tuple[Any, ...]:
        raise RuntimeError(
            f"{ctx.name} can be differentiated once, got a second derivative: take gradients "
            "without create_graph=True, or detach them."
        )
