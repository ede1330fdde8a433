"""Conversion between PyTorch tensors and host arrays without copies, and validation of tensors."""

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


def require_tensor(x: Any, dtypes: Iterable[np.dtype[Any]], label: str) -> None:
    """Raise TypeError unless x is a dense tensor of given dtypes in host memory."""
    if not isinstance(x, torch.Tensor):
        raise TypeError(
            f"{label} takes tensors, got {type(x).__name__}: convert it by torch.as_tensor(x)."
        )
    if x.device.type != "cpu":
        raise TypeError(
            f"{label} takes tensors in host memory, got a tensor on {x.device}: pass x.cpu(), "
            "which keeps gradients."
        )
    if x.layout != torch.strided:
        raise TypeError(f"{label} takes dense tensors, got {x.layout}: pass x.to_dense().")
    accepted = [_TYPES[np.dtype(dtype)] for dtype in dtypes]
    if x.dtype not in accepted:
        names = " or ".join(str(dtype).removeprefix("torch.") for dtype in accepted)
        raise TypeError(
            f"{label} takes tensors of {names}, got {str(x.dtype).removeprefix('torch.')}: pass "
            f"x.to({accepted[0]})."
        )


def constant(value: Any, label: str) -> Any:
    """Return a value without gradient, converted from a tensor to NumPy."""
    if not isinstance(value, torch.Tensor):
        return value
    if value.requires_grad:
        raise TypeError(
            f"{label} has no gradient here, got a tensor with requires_grad: pass tensor.detach()."
        )
    return host_values(value).item() if value.ndim == 0 else host_values(value)


def complex_as(x: torch.Tensor, dtype: np.dtype[Any]) -> torch.Tensor:
    """Convert a real tensor to complex of equal precision if the dtype is complex."""
    tensor_type = _TYPES[np.dtype(dtype)]
    is_real_part = tensor_type.is_complex and x.dtype == tensor_type.to_real()
    return x.to(tensor_type) if is_real_part else x


def host_values(x: torch.Tensor) -> Array:
    """Return a tensor as an array, in its own memory if contiguous, else as a copy."""
    return np.asarray(x.detach().resolve_conj().resolve_neg().contiguous().numpy())


def tensor_of(values: Array) -> torch.Tensor:
    """Return an array as a tensor that shares its memory."""
    return torch.from_numpy(values)
