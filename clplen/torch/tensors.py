"""Tensors of PyTorch as arrays of the host and back, without a copy; what is no such tensor."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch

from clplen.types import Array

_TYPES = {
    np.dtype(np.float32): torch.float32,
    np.dtype(np.float64): torch.float64,
    np.dtype(np.complex64): torch.complex64,
    np.dtype(np.complex128): torch.complex128,
}


def require_tensor(x: Any, dtypes: Iterable[np.dtype[Any]], what: str) -> None:
    """Refuse what is no dense tensor of one of some types in host memory."""
    if not isinstance(x, torch.Tensor):
        raise TypeError(
            f"{what} takes tensors, not of type {type(x).__name__}: make one with "
            "torch.as_tensor(x)."
        )
    if x.device.type != "cpu":
        raise TypeError(
            f"{what} takes tensors in host memory, from where OpenCL devices get them, not on "
            f"{x.device}: give x.cpu(), through which gradients go back."
        )
    if x.layout != torch.strided:
        raise TypeError(f"{what} takes dense tensors, not {x.layout}: give x.to_dense().")
    taken = [_TYPES[np.dtype(dtype)] for dtype in dtypes]
    if x.dtype not in taken:
        names = " or ".join(str(dtype).removeprefix("torch.") for dtype in taken)
        raise TypeError(
            f"{what} takes tensors of {names}, not {str(x.dtype).removeprefix('torch.')}: give "
            f"x.to({taken[0]})."
        )


def constant(value: Any, what: str) -> Any:
    """A value that has no gradient, of tensors as NumPy has it."""
    if not isinstance(value, torch.Tensor):
        return value
    if value.requires_grad:
        raise TypeError(
            f"{what} has no gradient here, but was given as a tensor with requires_grad: give "
            "tensor.detach()."
        )
    return host_values(value).item() if value.ndim == 0 else host_values(value)


def complex_as(x: torch.Tensor, dtype: np.dtype[Any]) -> torch.Tensor:
    """A real tensor as a complex one of the same precision, if a complex type is wanted."""
    wanted = _TYPES[np.dtype(dtype)]
    is_real_part = wanted.is_complex and x.dtype == wanted.to_real()
    return x.to(wanted) if is_real_part else x


def host_values(x: torch.Tensor) -> Array:
    """A tensor as an array: its own memory where it is contiguous, a copy else."""
    return np.asarray(x.detach().resolve_conj().resolve_neg().contiguous().numpy())


def tensor_of(values: Array) -> torch.Tensor:
    """An array as a tensor of the same memory, which the tensor keeps alive."""
    return torch.from_numpy(values)
