"""Checks of what public functions are given."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from numbers import Real
from typing import Any, Literal, TypeVar

import numpy as np

from clplen import units
from clplen.errors import SamplingError, SamplingWarning, ShapeError, warn_caller
from clplen.types import Array

Target = TypeVar("Target", bound=Callable[..., Any])


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


def host_array(values: Any, what: str) -> Array:
    """What is given as an array, on the host: of NumPy or of another library, without a copy.

    Arrays of other libraries come by ``__array__`` (PyTorch on the host, JAX, xarray, results of
    clplen) or, where they have none, by DLPack.

    Parameters
    ----------
    values : array_like
    what : str
        What they are, as the subject of a message.

    Returns
    -------
    numpy.ndarray

    Raises
    ------
    TypeError
        If they are no array, have gradients, which would be lost, lie in the memory of a GPU, or
        are of a type that NumPy does not have.
    """
    if getattr(values, "requires_grad", False) is True:
        raise TypeError(
            f"{what} is given as a tensor with requires_grad, whose gradient would end here: give "
            "tensor.detach(), or keep the gradient with clplen.torch."
        )
    place = _place_elsewhere(values)
    if place:
        raise TypeError(
            f"{what} is an array in host memory, not on {place}: bring it there first, with "
            "tensor.cpu() of PyTorch or cupy.asnumpy(array) of CuPy."
        )
    if hasattr(values, "resolve_conj"):  # tensors of which only a mark says that they are conj(x)
        values = values.resolve_conj().resolve_neg()
    is_foreign = hasattr(values, "__dlpack__") and not hasattr(values, "__array__")
    try:
        result = np.from_dlpack(values) if is_foreign else np.asarray(values)
    except ValueError:
        raise TypeError(f"{what} is one array of numbers, not rows of unequal lengths.") from None
    except (TypeError, RuntimeError, BufferError) as error:
        kind = getattr(values, "dtype", type(values).__name__)
        raise TypeError(
            f"{what} is an array that NumPy can take, not of {kind} ({error}): convert it, to "
            "float32 for instance."
        ) from error
    if result.dtype.kind == "V" and result.dtype.names is None:
        raise TypeError(f"{what} is of {result.dtype}, which NumPy lacks: convert it to float32.")
    return result


_ON_HOST = (1, 3)  # DLPack's kDLCPU, and kDLCUDAHost: memory of the host that a GPU reaches


def _place_elsewhere(values: Any) -> str:
    """The name of the memory where an array of another library lies; empty for the host's."""
    kind = getattr(getattr(values, "device", None), "type", None)  # of PyTorch
    if isinstance(kind, str) and hasattr(values, "data_ptr"):
        return "" if kind == "cpu" else str(values.device)
    if isinstance(values, np.ndarray | np.generic) or not hasattr(values, "__dlpack_device__"):
        return "a CUDA GPU" if hasattr(values, "__cuda_array_interface__") else ""
    if hasattr(values, "__array__") and not hasattr(values, "__cuda_array_interface__"):
        return ""  # as JAX, which brings it to the host itself
    kind, number = values.__dlpack_device__()
    return "" if kind in _ON_HOST else f"device {number} of DLPack's kind {int(kind)} (2 is CUDA)"


def real_array(values: Any, what: str, dtype: Any = np.float32) -> Array:
    """An array of real numbers; those that ``dtype`` cannot hold are infinite.

    Raises
    ------
    TypeError
        For anything else.
    """
    result = host_array(values, what)
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


def alias_argument(**aliases: str) -> Callable[[Target], Target]:
    """Decorate a function or class whose arguments have a second keyword.

    Parameters
    ----------
    **aliases : str
        Second keyword and the argument it stands for: ``f="focal_length"``. Both in one call
        raise a `TypeError`.
    """

    def decorate(target: Target) -> Target:
        if isinstance(target, type):
            target.__init__ = decorate(target.__init__)  # type: ignore[misc]
            return target

        @wraps(target)
        def aliased(*arguments: Any, **keywords: Any) -> Any:
            resolved = {aliases.get(key, key): value for key, value in keywords.items()}
            if len(resolved) < len(keywords):
                name = target.__qualname__.removesuffix(".__init__")
                pairs = ", ".join(f"{old}= is {new}=" for old, new in aliases.items())
                raise TypeError(f"{name}() got one argument twice: {pairs}.")
            return target(*arguments, **resolved)

        return aliased  # type: ignore[return-value]

    return decorate
