"""Checks of what the functions of this package are given."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.errors import ShapeError
from clplen.wave.checks import is_finite

Vector = np.ndarray[Any, Any]


def is_integer(value: Any) -> bool:
    """Whether something is one whole number; True and False are none."""
    return not isinstance(value, bool) and is_finite(value) and value == int(value)


def positive_integer(value: Any, what: str) -> int:
    """One whole number from 1 on.

    Raises
    ------
    ValueError
        For anything else.
    """
    if not is_integer(value) or value < 1:
        raise ValueError(f"{what} is a whole number from 1 on, not {value!r}.")
    return int(value)


def real_array(values: Any, what: str, dtype: Any = np.float32) -> Vector:
    """An array of real numbers; those that ``dtype`` cannot hold are infinite.

    Raises
    ------
    TypeError
        For anything else.
    """
    try:
        found = np.asarray(values)
    except ValueError:
        raise TypeError(f"{what} is one array of numbers, not rows of unequal lengths.") from None
    if found.dtype.kind == "c":
        raise TypeError(f"{what} holds real numbers, not {found.dtype}: take the intensity.")
    if found.dtype.kind not in "biuf":
        raise TypeError(f"{what} is an array of numbers, not of type {type(values).__name__}.")
    with np.errstate(over="ignore"):
        return found.astype(dtype, copy=False)


def finite_array(values: Any, shape: tuple[int, ...], what: str) -> Vector:
    """Volumes or frames for a projector, float32, with one leading axis.

    Raises
    ------
    TypeError
        If they are no array of real numbers.
    ShapeError
        If their last axes are others, or there are none.
    ValueError
        If some are not finite.
    """
    found = real_array(values, what)
    if found.shape[-len(shape) :] != shape or not found.size:
        raise ShapeError(
            f"{what} for this projector has shape (..., {', '.join(map(str, shape))}), "
            f"not {found.shape}."
        )
    bad = found.size - int(np.count_nonzero(np.isfinite(found)))
    if bad:
        raise ValueError(
            f"{what} has {bad:,} values that are not finite, which would spread over all: "
            "replace them."
        )
    return np.ascontiguousarray(found).reshape(-1, *shape)
