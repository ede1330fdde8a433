"""Differentiable steps with their own pullback, linear or not, as functions of JAX arrays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from clplen.compute.device import DeviceLike, as_device
from clplen.compute.differentiation import Forward, Step, name_of
from clplen.jax.operators import require_array, warn_of_one_core


def apply_step(
    forward: Forward,
    *arrays: jax.Array,
    out: Any,
    parameters: Sequence[jax.Array] = (),
    device: DeviceLike | None = None,
    name: str | None = None,
    check_finite: bool = True,
) -> jax.Array:
    """Apply a step with its own gradients to JAX arrays.

    It works in `jax.jit` and, index by index, in `jax.vmap`. JAX may call ``forward`` several
    times: the backward pass repeats it for its pullback.

    Parameters
    ----------
    forward : callable
        Function ``forward(*arrays, *parameters)`` that returns ``(output, pullback)``, see
        `clplen.torch.apply_step`. Pass the same function object again to reuse compiled functions.
    *arrays : jax.Array
        Real or complex arrays, of the device's precision.
    out : jax.ShapeDtypeStruct
        Shape and dtype of the output.
    parameters : sequence of jax.Array
        Real values for the host, such as distances or coefficients.
    device : Device or str, optional
        OpenCL device; default ``Device.open()``.
    name : str, optional
        Name of the step in messages; default the name of ``forward``.
    check_finite : bool
        True to raise for NaN and infinity, with the name of the step.

    Returns
    -------
    jax.Array
        Output, differentiable once in reverse mode.

    Raises
    ------
    TypeError
        If an array has another dtype, or a parameter is not real.

    Examples
    --------
    Intensity, with the pullback 2 g u:

    >>> import jax
    >>> import clplen.jax
    >>> device = clplen.Device.open()
    >>> def intensity(u):
    ...     amplitude = u.get()
    ...     def pullback(g):
    ...         return [device.upload(2 * g.get() * amplitude)]
    ...     return device.upload(np.abs(amplitude) ** 2), pullback
    >>> shape = jax.ShapeDtypeStruct((1, 2), np.float32)
    >>> def light(u):
    ...     return clplen.jax.apply_step(intensity, u, out=shape, device=device).sum()
    >>> u = jax.numpy.array([[1 + 1j, 2.0]], np.complex64)
    >>> jax.grad(light)(u).conj()  # JAX gives the conjugate of PyTorch's gradient
    Array([[2.+2.j, 4.+0.j]], dtype=complex64)
    """
    warn_of_one_core()
    device = as_device(device)
    step = Step(forward, device, len(arrays), name or name_of(forward), check_finite)
    for x in arrays:
        require_array(x, (device.real, device.complex), step.name)
    for x in parameters:
        if jnp.result_type(x).kind != "f":
            raise TypeError(
                f"{step.name} takes real parameters, got {jnp.result_type(x)}: pass floats."
            )
    inputs = tuple(jnp.asarray(x) for x in (*arrays, *parameters))
    return _step(step, (tuple(out.shape), np.dtype(out.dtype)), *inputs)


@partial(jax.custom_vjp, nondiff_argnums=(0, 1))
def _step(step: Step, out: tuple[tuple[int, ...], Any], *inputs: jax.Array) -> jax.Array:
    """Return the output of a step."""
    struct = jax.ShapeDtypeStruct(*out)
    return jax.pure_callback(partial(_output, step), struct, *inputs, vmap_method="sequential")


def _output(step: Step, *inputs: Any) -> Any:
    return step.run([np.asarray(x) for x in inputs])[0]


def _forward(step: Step, out: Any, *inputs: Any) -> tuple[jax.Array, Any]:
    """Return output and residuals: the inputs, and a mark for each that needs a gradient."""
    values = tuple(x.value for x in inputs)
    return _step(step, out, *values), (values, tuple(None if x.perturbed else () for x in inputs))


def _backward(step: Step, out: Any, residuals: Any, ct: Any) -> tuple[jax.Array, ...]:
    inputs, marks = residuals
    if isinstance(ct, jax.custom_derivatives.SymbolicZero):
        ct = jnp.zeros(ct.shape, ct.dtype)
    structs = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in inputs)
    call = partial(_gradients, step, tuple(mark is None for mark in marks))
    gradients = jax.pure_callback(call, structs, jnp.conj(ct), *inputs, vmap_method="sequential")
    return tuple(jnp.conj(grad) for grad in gradients)


def _gradients(step: Step, required: tuple[bool, ...], g: Any, *inputs: Any) -> tuple[Any, ...]:
    """Return the gradient of each input, 0 where none is required."""
    values = [np.asarray(x) for x in inputs]
    gradients = step.run(values)[1](np.asarray(g))
    for number, (grad, is_required) in enumerate(zip(gradients, required, strict=True)):
        if is_required and grad is None:
            raise ValueError(
                f"{step.name} has no gradient of its input {number + 1}, of shape "
                f"{values[number].shape}: pass jax.lax.stop_gradient(x)."
            )
    return tuple(
        np.zeros(x.shape, x.dtype) if grad is None else grad
        for x, grad in zip(values, gradients, strict=True)
    )


_step.defvjp(_forward, _backward, symbolic_zeros=True)
