"""Checks of what public functions are given."""

from __future__ import annotations

import difflib
import inspect
import math
import sys
from collections.abc import Callable, Iterable
from functools import wraps
from numbers import Complex, Real
from typing import Any, Literal, TypeVar

import numpy as np

from clplen import units
from clplen.errors import SamplingError, SamplingWarning, ShapeError, warn_caller
from clplen.types import Array

Target = TypeVar("Target", bound=Callable[..., Any])


def require(kind: type, value: Any, what: str, source: str) -> None:
    """Refuse what is not of a kind, with what gives one."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise TypeError(
            f"{what} is {article} {kind.__name__}, as {source} gives it, not of type "
            f"{type(value).__name__}."
        )


_MIN_PYTHON = {"lenses": (3, 11), "zarr": (3, 11)}  # of the extras in pyproject.toml


def install_advice(extra: str) -> str:
    """Return how the optional libraries of an extra are installed, and in which Python."""
    advice = f'pip install "clplen[{extra}]"'
    least = _MIN_PYTHON.get(extra, (3,))
    if sys.version_info >= least:
        return advice
    wanted, found = (".".join(map(str, version[:2])) for version in (least, sys.version_info))
    return f"{advice} in Python {wanted} or newer (this is {found})"


def keywords_of(function: Callable[..., Any]) -> list[str]:
    """Names of the arguments that a function takes by keyword alone."""
    parameters = inspect.signature(function).parameters.values()
    return [one.name for one in parameters if one.kind is one.KEYWORD_ONLY]


def check_keywords(given: Iterable[str], known: Iterable[str], what: str) -> None:
    """Refuse keywords that a function does not have, with the nearest one that it has."""
    names = list(known)
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}=?" if near else f"it has {', '.join(names) or 'none'}."
            raise TypeError(f"{what} has no keyword {name!r}: {hint}")


def is_finite(value: object) -> bool:
    """Whether something is one finite real number that float64 holds."""
    return isinstance(value, Real) and fits_float64(value)


def fits_float64(value: Any) -> bool:
    """Whether a number is finite, as `math.isfinite`; whole numbers above 1.8e308 are not."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_finite(**numbers: Any) -> None:
    """Refuse what holds a number that is not finite; names as the caller knows them."""
    for name, value in numbers.items():
        if not np.isfinite(float64_array(value)).all():
            raise ValueError(f"{name} is finite, not {value!r}.")


def check_positive(**numbers: Any) -> None:
    """Refuse what is not a positive finite number; names as the caller knows them."""
    for name, value in numbers.items():
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} is positive and finite, not {value!r}.")


def float64_array(values: Any) -> Array:
    """Numbers as a float64 array; whole numbers above 1.8e308 are infinite."""
    try:
        return np.asarray(values, np.float64)
    except OverflowError:
        return _with_infinities(values, np.float64)


def _with_infinities(values: Any, dtype: Any) -> Array:
    """Numbers as an array in which whole numbers above 1.8e308 are infinite."""
    exact = np.asarray(values, object)
    floats = [
        one
        if not isinstance(one, int) or fits_float64(one)
        else math.copysign(math.inf, one > 0 or -1)
        for one in exact.flat
    ]
    return np.array(floats, dtype).reshape(exact.shape)


def is_integer(value: Any) -> bool:
    """Whether something is one whole number that int64 holds; True and False are none."""
    if isinstance(value, bool) or not is_finite(value):
        return False
    return bool(abs(value) < 2**63 and value == int(value))


def positive_integer(value: Any, what: str) -> int:
    """One whole number from 1 on."""
    if not is_integer(value) or value < 1:
        raise ValueError(f"{what} is a whole number from 1 on, not {value!r}.")
    return int(value)


_PROTOCOLS = ("__array__", "__array_interface__", "__dlpack__")


def is_array(value: Any) -> bool:
    """Whether something is an array of some library, a nested list or tuple, or a memoryview."""
    if isinstance(value, list | tuple):
        return bool(value) and (isinstance(value[0], list | tuple) or is_array(value[0]))
    has_samples = any(hasattr(value, name) for name in _PROTOCOLS) and not isinstance(value, type)
    return has_samples or isinstance(value, memoryview)


def host_array(values: Any, what: str) -> Array:
    """What is given as an array, on the host: of NumPy or of another library, without a copy.

    Arrays of other libraries come by ``__array__`` (PyTorch on the host, JAX, xarray, results of
    clplen) or, where they have none, by DLPack.
    """
    result, mask = masked_array(values, what)
    if mask is not None:
        raise ValueError(
            f"{what} must have no masked samples, got {np.count_nonzero(mask):,} of {mask.size:,}: "
            "replace them by array.filled(value), or leave them out."
        )
    return result


def masked_array(values: Any, what: str) -> tuple[Array, Array | None]:
    """`host_array` for callers with weights: the samples and the mask, None where all are valid."""
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
    if isinstance(getattr(values, "_meta", None), np.ma.MaskedArray):
        values = values.compute()  # Dask drops the mask in __array__
    try:
        if _has_masked_parts(values):
            values = _stack_masked(values)
        result = np.from_dlpack(values) if is_foreign else np.asanyarray(values)
    except ValueError:
        raise TypeError(f"{what} is one array of numbers, not rows of unequal lengths.") from None
    except (TypeError, RuntimeError, BufferError) as error:
        kind = getattr(values, "dtype", type(values).__name__)
        raise TypeError(
            f"{what} is an array that NumPy can take, not of {kind} ({error}): convert it, to "
            "float32 for instance."
        ) from error
    if result.dtype == object and all(isinstance(one, Complex) for one in result.flat):
        is_real = all(isinstance(one, Real) for one in result.flat)
        result = _with_infinities(result, np.float64 if is_real else np.complex128)  # above 2^64
    if result.dtype.kind == "V" and result.dtype.names is None:
        raise TypeError(f"{what} is of {result.dtype}, which NumPy lacks: convert it to float32.")
    mask = None
    if isinstance(result, np.ma.MaskedArray) and result.mask is not np.ma.nomask:
        flags = np.ascontiguousarray(result.mask).view(np.bool_)  # of all fields of a record
        any_field = np.asarray(flags.reshape(*result.shape, -1).any(axis=-1))
        mask = any_field if flags.any() else None
    return np.asarray(result), mask


def _has_masked_parts(values: Any) -> bool:
    """Whether a nested list or tuple holds masked arrays, whose masks NumPy would drop."""
    return isinstance(values, list | tuple) and any(
        isinstance(part, np.ma.MaskedArray) or _has_masked_parts(part) for part in values
    )


def _stack_masked(values: Any) -> Any:
    """A nested list or tuple as one masked array."""
    is_nested = isinstance(values, list | tuple)
    return np.ma.stack([_stack_masked(part) for part in values]) if is_nested else values


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
    """Return an array of reals; what ``dtype`` cannot hold is infinite, None keeps the type."""
    result = host_array(values, what)
    if result.dtype.kind == "c":
        raise TypeError(f"{what} holds real numbers, not {result.dtype}: take the intensity.")
    if result.dtype.kind not in "biuf":
        raise TypeError(f"{what} is an array of numbers, not of type {type(values).__name__}.")
    with np.errstate(over="ignore"):
        return result if dtype is None else result.astype(dtype, copy=False)


def real_map(values: Any, what: str, dtype: Any = np.float32) -> Array:
    """`real_array` for maps in which NaN means unknown: masked samples become NaN."""
    given, mask = masked_array(values, what)
    result = real_array(given, what, dtype)
    return result if mask is None else np.where(mask, result.dtype.type(np.nan), result)


def finite_batch(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Volumes or frames for a projector, float32, with one leading axis."""
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
    """Refuse a centre that is not two finite numbers."""
    if np.shape(centre) != (2,) or not np.isfinite(float64_array(centre)).all():
        raise ValueError(f"The centre of {what} is finite, (y, x) in metres, not {centre!r}.")


def check_diameter(diameter: float | None) -> None:
    """Refuse a diameter that is not positive; None is none."""
    if diameter is not None and not (is_finite(diameter) and diameter > 0):
        raise ValueError(f"A diameter is positive, in metres, not {diameter!r}.")
    units.DIAMETER.check(diameter, "A diameter")


def check_aliasing(aliasing: str) -> None:
    """Refuse a word that says nothing about aliasing."""
    if aliasing not in ("raise", "warn", "allow"):
        raise ValueError(f"aliasing is 'raise', 'warn' or 'allow', not {aliasing!r}.")


def act_on_aliasing(message: str, aliasing: Aliasing) -> None:
    """Raise, warn or go on, where ``message`` is not empty."""
    check_aliasing(aliasing)
    if message and aliasing == "raise":
        raise SamplingError(message + " aliasing='warn' or 'allow' goes on all the same.")
    if message and aliasing == "warn":
        warn_caller(message, SamplingWarning)


def alias_argument(**aliases: str) -> Callable[[Target], Target]:
    """Decorate a function or class whose arguments have a second keyword."""

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
