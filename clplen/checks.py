"""Validation of arguments of public functions."""

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


def require(kind: type, value: Any, label: str, source: str) -> None:
    """Raise TypeError unless a value has a type; name the function that returns one."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise TypeError(
            f"{label} must be {article} {kind.__name__}, as {source} returns it, got "
            f"{type(value).__name__}."
        )


_MIN_PYTHON = {"lenses": (3, 11), "zarr": (3, 11)}  # lowest Python of extras in pyproject.toml


def install_advice(extra: str) -> str:
    """Return the command that installs an extra, with the Python version that it needs."""
    advice = f'pip install "clplen[{extra}]"'
    min_version = _MIN_PYTHON.get(extra, (3,))
    if sys.version_info >= min_version:
        return advice
    required, current = (
        ".".join(map(str, version[:2])) for version in (min_version, sys.version_info)
    )
    return f"{advice} in Python {required} or newer (this is {current})"


def keywords_of(function: Callable[..., Any]) -> list[str]:
    """Return the names of the keyword-only arguments of a function."""
    parameters = inspect.signature(function).parameters.values()
    return [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]


def check_keywords(keywords: Iterable[str], allowed: Iterable[str], label: str) -> None:
    """Raise TypeError for unknown keywords, with the most similar name."""
    names = list(allowed)
    for name in keywords:
        if name not in names:
            matches = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
            hint = (
                f"did you mean {matches[0]}=?"
                if matches
                else f"it has {', '.join(names) or 'none'}."
            )
            raise TypeError(f"{label} has no keyword {name!r}: {hint}")


def is_finite(value: object) -> bool:
    """Return True for a finite real number within float64."""
    return isinstance(value, Real) and fits_float64(value)


def fits_float64(value: Any) -> bool:
    """Return True for a finite number; integers above 1.8e308 are not finite."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_finite(**numbers: Any) -> None:
    """Raise ValueError for NaN or infinity, under the caller's argument names."""
    for name, value in numbers.items():
        if not np.isfinite(float64_array(value)).all():
            raise ValueError(f"{name} must be finite, got {value!r}.")


def check_positive(**numbers: Any) -> None:
    """Raise ValueError unless numbers are positive and finite, under the caller's names."""
    for name, value in numbers.items():
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}.")


def float64_array(values: Any) -> Array:
    """Convert numbers to float64; integers above 1.8e308 become infinite."""
    try:
        return np.asarray(values, np.float64)
    except OverflowError:
        return _with_infinities(values, np.float64)


def _with_infinities(values: Any, dtype: Any) -> Array:
    """Convert numbers to an array; integers above 1.8e308 become infinite."""
    exact = np.asarray(values, object)
    floats = [
        number
        if not isinstance(number, int) or fits_float64(number)
        else math.copysign(math.inf, number > 0 or -1)
        for number in exact.flat
    ]
    return np.array(floats, dtype).reshape(exact.shape)


def is_integer(value: Any) -> bool:
    """Return True for an integer within int64, but not for True and False."""
    if isinstance(value, bool) or not is_finite(value):
        return False
    return bool(abs(value) < 2**63 and value == int(value))


def positive_integer(value: Any, label: str) -> int:
    """Return a whole number from 1 on; raise ValueError otherwise."""
    if not is_integer(value) or value < 1:
        raise ValueError(f"{label} must be a whole number from 1 on, got {value!r}.")
    return int(value)


_PROTOCOLS = ("__array__", "__array_interface__", "__dlpack__")


def is_array(value: Any) -> bool:
    """Return True for an array of any library, a nested list or tuple, or a memoryview."""
    if isinstance(value, list | tuple):
        return bool(value) and (isinstance(value[0], list | tuple) or is_array(value[0]))
    has_samples = any(hasattr(value, name) for name in _PROTOCOLS) and not isinstance(value, type)
    return has_samples or isinstance(value, memoryview)


def host_array(values: Any, label: str) -> Array:
    """Return values as a NumPy array in host memory, without a copy where possible.

    Arrays of other libraries convert by ``__array__`` (PyTorch on the host, JAX, xarray, results of
    clplen) or else by DLPack.
    """
    result, mask = masked_array(values, label)
    if mask is not None:
        raise ValueError(
            f"{label} must have no masked samples, got {np.count_nonzero(mask):,} of "
            f"{mask.size:,}: replace them by array.filled(value), or leave them out."
        )
    return result


def masked_array(values: Any, label: str) -> tuple[Array, Array | None]:
    """Return `host_array` for weighted samples, with the mask or None if all are valid."""
    if getattr(values, "requires_grad", False) is True:
        raise TypeError(
            f"{label} must not be a tensor with requires_grad, whose gradient would end here: pass "
            "tensor.detach(), or keep the gradient with clplen.torch."
        )
    memory = _device_memory(values)
    if memory:
        raise TypeError(
            f"{label} must be in host memory, got an array on {memory}: copy it first by "
            "tensor.cpu() in PyTorch or cupy.asnumpy(array) in CuPy."
        )
    if hasattr(values, "resolve_conj"):  # tensors that are conj(x) by a flag only
        values = values.resolve_conj().resolve_neg()
    is_foreign = hasattr(values, "__dlpack__") and not hasattr(values, "__array__")
    if isinstance(getattr(values, "_meta", None), np.ma.MaskedArray):
        values = values.compute()  # Dask drops the mask in __array__
    try:
        if _has_masked_parts(values):
            values = _stack_masked(values)
        result = np.from_dlpack(values) if is_foreign else np.asanyarray(values)
    except ValueError:
        raise TypeError(f"{label} must not have rows of unequal lengths.") from None
    except (TypeError, RuntimeError, BufferError) as error:
        kind = getattr(values, "dtype", type(values).__name__)
        raise TypeError(
            f"{label} must be convertible by NumPy, got {kind} ({error}): convert it, for example "
            "to float32."
        ) from error
    if result.dtype == object and all(isinstance(element, Complex) for element in result.flat):
        is_real = all(isinstance(element, Real) for element in result.flat)
        result = _with_infinities(result, np.float64 if is_real else np.complex128)  # above 2^64
    if result.dtype.kind == "V" and result.dtype.names is None:
        raise TypeError(
            f"{label} has dtype {result.dtype}, which NumPy does not support: convert it to "
            "float32."
        )
    mask = None
    if isinstance(result, np.ma.MaskedArray) and result.mask is not np.ma.nomask:
        flags = np.ascontiguousarray(result.mask).view(np.bool_)  # every field of a record
        any_field = np.asarray(flags.reshape(*result.shape, -1).any(axis=-1))
        mask = any_field if flags.any() else None
    return np.asarray(result), mask


def _has_masked_parts(values: Any) -> bool:
    """Return True if a nested list or tuple contains masked arrays."""
    return isinstance(values, list | tuple) and any(
        isinstance(part, np.ma.MaskedArray) or _has_masked_parts(part) for part in values
    )


def _stack_masked(values: Any) -> Any:
    """Stack a nested list or tuple into one masked array."""
    is_nested = isinstance(values, list | tuple)
    return np.ma.stack([_stack_masked(part) for part in values]) if is_nested else values


_ON_HOST = (1, 3)  # DLPack's kDLCPU, and kDLCUDAHost: host memory that a GPU can access


def _device_memory(values: Any) -> str:
    """Return the name of an array's device memory, or an empty string for host memory."""
    kind = getattr(getattr(values, "device", None), "type", None)  # PyTorch
    if isinstance(kind, str) and hasattr(values, "data_ptr"):
        return "" if kind == "cpu" else str(values.device)
    if isinstance(values, np.ndarray | np.generic) or not hasattr(values, "__dlpack_device__"):
        return "a CUDA GPU" if hasattr(values, "__cuda_array_interface__") else ""
    if hasattr(values, "__array__") and not hasattr(values, "__cuda_array_interface__"):
        return ""  # JAX, for one, copies to the host itself
    kind, number = values.__dlpack_device__()
    return "" if kind in _ON_HOST else f"device {number} of DLPack's kind {int(kind)} (2 is CUDA)"


def real_array(values: Any, label: str, dtype: Any = np.float32) -> Array:
    """Convert values to real numbers; overflow becomes infinity, a dtype of None keeps the type."""
    result = host_array(values, label)
    if result.dtype.kind == "c":
        raise TypeError(f"{label} must hold real numbers, got {result.dtype}: take the intensity.")
    if result.dtype.kind not in "biuf":
        raise TypeError(f"{label} must be an array of numbers, got {type(values).__name__}.")
    with np.errstate(over="ignore"):
        return result if dtype is None else result.astype(dtype, copy=False)


def real_map(values: Any, label: str, dtype: Any = np.float32) -> Array:
    """Convert a map like `real_array`, with NaN for masked samples."""
    samples, mask = masked_array(values, label)
    result = real_array(samples, label, dtype)
    return result if mask is None else np.where(mask, result.dtype.type(np.nan), result)


def finite_batch(values: Any, shape: tuple[int, ...], label: str) -> Array:
    """Return volumes or frames for a projector, float32, with one leading axis."""
    result = real_array(values, label)
    if result.shape[-len(shape) :] != shape or not result.size:
        raise ShapeError(
            f"{label} for this projector must have shape (..., {', '.join(map(str, shape))}), "
            f"got {result.shape}."
        )
    bad = result.size - int(np.count_nonzero(np.isfinite(result)))
    if bad:
        raise ValueError(
            f"{label} has {bad:,} values that are not finite and would spread over the result: "
            "replace them."
        )
    return np.ascontiguousarray(result).reshape(-1, *shape)


Aliasing = Literal["raise", "warn", "allow"]


def check_centre(centre: tuple[float, float], label: str) -> None:
    """Raise ValueError unless a centre is two finite numbers."""
    if np.shape(centre) != (2,) or not np.isfinite(float64_array(centre)).all():
        raise ValueError(f"The centre of {label} must be finite (y, x) in metres, got {centre!r}.")


def check_diameter(diameter: float | None) -> None:
    """Raise ValueError unless a diameter is positive or None."""
    if diameter is not None and not (is_finite(diameter) and diameter > 0):
        raise ValueError(f"A diameter must be positive, in metres, got {diameter!r}.")
    units.DIAMETER.check(diameter, "A diameter")


def check_aliasing(aliasing: str) -> None:
    """Raise ValueError unless ``aliasing`` is a known setting."""
    if aliasing not in ("raise", "warn", "allow"):
        raise ValueError(f"aliasing must be 'raise', 'warn' or 'allow', got {aliasing!r}.")


def act_on_aliasing(message: str, aliasing: Aliasing) -> None:
    """Raise, warn or continue for a nonempty message, according to ``aliasing``."""
    check_aliasing(aliasing)
    if message and aliasing == "raise":
        raise SamplingError(message + " Set aliasing='warn' or 'allow' to continue anyway.")
    if message and aliasing == "warn":
        warn_caller(message, SamplingWarning)


def alias_argument(**aliases: str) -> Callable[[Target], Target]:
    """Decorate a function or class to accept alternative keywords."""

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
