"""Linear maps of clplen as functions of tensors, with gradients by their adjoints."""

from __future__ import annotations

from typing import Any

import torch

from clplen.compute.differentiation import name_of, require_linear_map, run_linear
from clplen.compute.linear_map import LinearMap, leading_axes
from clplen.torch.tensors import complex_as, host_values, require_tensor, tensor_of


def apply(
    operator: LinearMap, x: torch.Tensor, *, adjoint: bool = False, check_finite: bool = True
) -> torch.Tensor:
    """Apply a linear map to a tensor; gradients go back through its adjoint.

    On a CPU device the tensor's own memory is read, and the result is the memory that the device
    wrote: nothing is copied. On a GPU there is one copy each way.

    Parameters
    ----------
    operator : LinearMap
        A map A with its adjoint A', such as a `clplen.Projector`.
    x : torch.Tensor
        In host memory, of the operator's dtype, shape ``(..., *in_shape)``: each index of the
        leading axes is mapped by itself. A real tensor is taken by a complex operator too. It is
        copied where it is not contiguous.
    adjoint : bool
        Whether A' is applied in place of A, to shape ``(..., *out_shape)``.
    check_finite : bool
        Whether NaN and infinity are refused, of ``x``, of the result and of gradients, with the
        name of the operator where they arise.

    Returns
    -------
    torch.Tensor
        A x, or A' x. It can be differentiated any number of times, forward (`torch.func.jvp`) and
        backward, and `torch.func.vmap` maps it as one batch.

    Raises
    ------
    TypeError
        If the operator is no linear map, or ``x`` no such tensor.
    ShapeError
        If its last axes are not those of the operator.
    ValueError
        If values are not finite; during ``backward`` those of gradients.

    Examples
    --------
    >>> import torch
    >>> import clplen.torch
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> volume = torch.ones(projector.volume_shape, requires_grad=True)
    >>> frame = clplen.torch.apply(projector, volume)
    >>> frame.sum().backward()
    >>> frame.shape, volume.grad.shape
    (torch.Size([55, 55]), torch.Size([2, 15, 15]))
    """
    require_linear_map(operator)
    name = name_of(operator)
    x = complex_as(x, operator.dtype) if isinstance(x, torch.Tensor) else x
    require_tensor(x, [operator.dtype], name)
    leading_axes(operator, tuple(x.shape), adjoint=adjoint)
    return _Linear.apply(operator, adjoint, False, check_finite, x)


class _Linear(torch.autograd.Function):
    """A x or A' x; whether x is a gradient is known for messages."""

    @staticmethod
    def forward(
        operator: LinearMap, adjoint: bool, of_gradient: bool, check: bool, x: torch.Tensor
    ) -> torch.Tensor:
        return tensor_of(
            run_linear(
                operator,
                host_values(x),
                adjoint=adjoint,
                of_gradient=of_gradient,
                check_finite=check,
            )
        )

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: torch.Tensor) -> None:
        ctx.operator, ctx.adjoint, _, ctx.check, _ = inputs

    @staticmethod
    def backward(ctx: Any, g: torch.Tensor) -> tuple[Any, ...]:
        grad = _Linear.apply(ctx.operator, not ctx.adjoint, True, ctx.check, g)
        return None, None, None, None, grad

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> torch.Tensor:
        return _Linear.apply(ctx.operator, ctx.adjoint, True, ctx.check, tangents[-1])

    @staticmethod
    def vmap(info: Any, in_dims: tuple[Any, ...], *inputs: Any) -> tuple[torch.Tensor, int]:
        *about, x = inputs
        return _Linear.apply(*about, x.movedim(in_dims[-1], 0)), 0
