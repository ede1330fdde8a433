"""Linear maps of clplen as functions of tensors, with gradients by adjoints."""

from __future__ import annotations

from typing import Any

import torch

from clplen.compute.differentiation import name_of, require_linear_map, run_linear
from clplen.compute.linear_map import LinearMap, leading_axes
from clplen.torch.tensors import complex_as, host_values, require_tensor, tensor_of


def apply(
    operator: LinearMap, x: torch.Tensor, *, adjoint: bool = False, check_finite: bool = True
) -> torch.Tensor:
    """Apply a linear map to a tensor; gradients pass through its adjoint.

    A CPU device reads the tensor's own memory, and the result is the device's memory, without
    copies. A GPU needs one copy each way.

    Parameters
    ----------
    operator : LinearMap
        Linear map A with its adjoint A', such as a `clplen.Projector`.
    x : torch.Tensor
        Tensor in host memory, of the operator's dtype, shape ``(..., *in_shape)``; leading axes are
        a batch. A complex operator accepts real tensors. A tensor that is not contiguous is copied.
    adjoint : bool
        True to apply A' instead of A, to shape ``(..., *out_shape)``.
    check_finite : bool
        True to raise for NaN and infinity in ``x``, in the result and in gradients, with the name
        of the operator.

    Returns
    -------
    torch.Tensor
        Result A x or A' x, differentiable any number of times, forward (`torch.func.jvp`) and
        backward; `torch.func.vmap` maps it as one batch.

    Raises
    ------
    TypeError
        If the operator is not a linear map, or ``x`` not such a tensor.
    ShapeError
        If the last axes differ from the operator's shape.
    ValueError
        If values are not finite; for gradients during ``backward``.

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
    """Autograd function A x or A' x; ``of_gradient`` selects the messages."""

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
        *settings, x = inputs
        return _Linear.apply(*settings, x.movedim(in_dims[-1], 0)), 0
