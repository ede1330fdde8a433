"""Checks of what public functions are given."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any, Literal

import numpy as np

from clplen import units
from clplen.deprecation import warn_caller
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.types import Array


def require(kind: type, value: Any, what: str, source: str) -> None:
    """Refuse what is not of a kind, with what gives one.

    Raises
    ------
    TypeError
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise TypeError(
            f"{what} is {article} {kind.__name__}, as {source} gives it, not of type "
            f"{type(value).__name__}."
        )


def is_finite(value: object) -> bool:
    """Whether something is one finite real number."""
    return isinstance(value, Real) and math.isfinite(value)


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


def real_array(values: Any, what: str, dtype: Any = np.float32) -> Array:
    """An array of real numbers; those that ``dtype`` cannot hold are infinite.

    Raises
    ------
    TypeError
        For anything else.
    """
    try:
        result = np.asarray(values)
    except ValueError:
        raise TypeError(f"{what} is one array of numbers, not rows of unequal lengths.") from None
    if result.dtype.kind == "c":
        raise TypeError(f"{what} holds real numbers, not {result.dtype}: take the intensity.")
    if result.dtype.kind not in "biuf":
        raise TypeError(f"{what} is an array of numbers, not of type {type(values).__name__}.")
    with np.errstate(over="ignore"):
        return result.astype(dtype, copy=False)


def finite_batch(values: Any, shape: tuple[int, ...], what: str) -> Array:
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
    result = real_array(values, what)
    if result.shape[-len(shape) :] != shape or not result.size:
        raise ShapeError(
            f"{what} for this projector has shape (..., {', '.join(map(str, shape))}), "
            f"not {result.shape}."
        )
    bad = result.size - int(np.count_nonzero(np.isfinite(result)))
    if bad:
        raise ValueError(
            f"{what} has {bad:,} values that are not finite, which would spread over all: "
            "replace them."
        )
    return np.ascontiguousarray(result).reshape(-1, *shape)


Aliasing = Literal["raise", "warn", "allow"]


def check_centre(centre: tuple[float, float], what: str) -> None:
    """Refuse a centre that is not two finite numbers.

    Raises
    ------
    ValueError
    """
    if np.shape(centre) != (2,) or not np.isfinite(centre).all():
        raise ValueError(f"The centre of {what} is finite, (y, x) in metres, not {centre!r}.")


def check_diameter(diameter: float | None) -> None:
    """Refuse a diameter that is not positive; None is none.

    Raises
    ------
    ValueError
    """
    if diameter is not None and not (is_finite(diameter) and diameter > 0):
        raise ValueError(f"A diameter is positive, in metres, not {diameter!r}.")
    units.DIAMETER.check(diameter, "A diameter")


def check_aliasing(aliasing: str) -> None:
    """Refuse a word that says nothing about aliasing.

    Raises
    ------
    ValueError
    """
    if aliasing not in ("raise", "warn", "allow"):
        raise ValueError(f"aliasing is 'raise', 'warn' or 'allow', not {aliasing!r}.")


def act_on_aliasing(message: str, aliasing: Aliasing) -> None:
    """Raise, warn or go on, where ``message`` is not empty.

    Raises
    ------
    SamplingError
        Where there is a message and ``aliasing`` is "raise".
    ValueError
        If ``aliasing`` is none of the three words.

    Warns
    -----
    SamplingWarning
        Where there is a message and ``aliasing`` is "warn".
    """
    check_aliasing(aliasing)
    if message and aliasing == "raise":
        raise SamplingError(message + " aliasing='warn' or 'allow' goes on all the same.")
    if message and aliasing == "warn":
        warn_caller(message, SamplingWarning)
