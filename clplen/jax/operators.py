"""Linear maps of clplen as functions of JAX arrays, with gradients by adjoints."""

from __future__ import annotations

import os
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from clplen.compute.differentiation import name_of, require_linear_map, run_linear
from clplen.compute.linear_map import LinearMap, leading_axes
from clplen.errors import warn_caller


def apply(
    operator: LinearMap, x: jax.Array, *, adjoint: bool = False, check_finite: bool = True
) -> jax.Array:
    """Apply a linear map to a JAX array; gradients pass through its adjoint.

    It works in `jax.jit` and `jax.vmap` (as one batch), and is differentiable any number of times
    in reverse mode (`jax.grad`, `jax.vjp`). JAX calls the host (`jax.pure_callback`); a CPU device
    reads the array in place.

    Parameters
    ----------
    operator : LinearMap
        Linear map A with its adjoint A', such as a `clplen.Projector`.
    x : jax.Array
        Array of the operator's dtype, shape ``(..., *in_shape)``; leading axes are a batch. A
        complex operator accepts real arrays.
    adjoint : bool
        True to apply A' instead of A, to shape ``(..., *out_shape)``.
    check_finite : bool
        True to raise for NaN and infinity in ``x``, in the result and in gradients, with the name
        of the operator.

    Returns
    -------
    jax.Array
        Result A x or A' x.

    Raises
    ------
    TypeError
        If the operator is not a linear map, or ``x`` has another dtype.
    ShapeError
        If the last axes differ from the operator's shape.

    Notes
    -----
    Cotangents of JAX are the complex conjugates of PyTorch's gradients: the cotangent of x is
    A^T ct = conj(A' conj(ct)).

    Examples
    --------
    >>> import jax
    >>> import clplen.jax
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> def light(volume):
    ...     return clplen.jax.apply(projector, volume).sum()
    >>> volume = jax.numpy.ones(projector.volume_shape)
    >>> jax.jit(jax.grad(light))(volume).shape
    (2, 15, 15)
    """
    require_linear_map(operator)
    warn_of_one_core()
    x = require_array(x, (np.dtype(operator.dtype),), name_of(operator))
    leading_axes(operator, tuple(x.shape), adjoint=adjoint)
    return _linear(IdentityKey(operator), adjoint, False, check_finite, x)


def require_array(x: Any, dtypes: tuple[np.dtype[Any], ...], label: str) -> jax.Array:
    """Return an array of an accepted dtype; convert real arrays to complex."""
    dtype = jnp.result_type(x)
    if dtype in dtypes:
        return jnp.asarray(x)
    complex_dtype = next(
        (d for d in dtypes if d.kind == "c" and np.zeros(0, d).real.dtype == dtype), None
    )
    if complex_dtype is not None:
        return jnp.asarray(x, complex_dtype)
    names = " or ".join(str(d) for d in dtypes)
    is_double = any(d.itemsize == (16 if d.kind == "c" else 8) for d in dtypes)
    advice = (
        'set jax.config.update("jax_enable_x64", True) first'
        if is_double and not jax.config.jax_enable_x64
        else f"pass x.astype({str(dtypes[0])!r})"
    )
    raise TypeError(f"{label} takes arrays of {names}, got {dtype}: {advice}.")


def warn_of_one_core() -> None:
    """Warn that JAX may deadlock on a single core when it passes arrays to the host."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    if cores == 1 and jax.config.values.get("jax_cpu_enable_async_dispatch", False):
        warn_caller(
            "On one core JAX can deadlock on large arrays for clplen: set "
            'jax.config.update("jax_cpu_enable_async_dispatch", False) before any computation.',
            RuntimeWarning,
        )


class IdentityKey:
    """Hashable wrapper of an object by identity, a key of JAX's compiled functions."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2, 3))
def _linear(
    operator: IdentityKey, adjoint: bool, of_gradient: bool, check: bool, x: jax.Array
) -> jax.Array:
    """Compute A x or A' x; ``of_gradient`` selects the messages."""
    linear = operator.value
    lead = leading_axes(linear, tuple(x.shape), adjoint=adjoint)
    shape = (*lead, *(linear.in_shape if adjoint else linear.out_shape))
    call = partial(_on_host, operator, adjoint, of_gradient, check)
    # a single operand, to which vmap adds a leading axis
    return jax.pure_callback(
        call, jax.ShapeDtypeStruct(shape, x.dtype), x, vmap_method="broadcast_all"
    )


def _on_host(operator: IdentityKey, adjoint: bool, of_gradient: bool, check: bool, x: Any) -> Any:
    return run_linear(
        operator.value,
        np.asarray(x),
        adjoint=adjoint,
        of_gradient=of_gradient,
        check_finite=check,
    )


def _forward(
    operator: IdentityKey, adjoint: bool, of_gradient: bool, check: bool, x: jax.Array
) -> tuple[jax.Array, None]:
    return _linear(operator, adjoint, of_gradient, check, x), None


def _backward(
    operator: IdentityKey, adjoint: bool, of_gradient: bool, check: bool, _: None, ct: jax.Array
) -> tuple[jax.Array]:
    return (jnp.conj(_linear(operator, not adjoint, True, check, jnp.conj(ct))),)


_linear.defvjp(_forward, _backward)
