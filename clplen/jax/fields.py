"""Free-space propagation of JAX arrays."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from clplen.compute.device import DeviceLike, as_device
from clplen.jax.operators import apply
from clplen.jax.steps import apply_step
from clplen.wave.field.field import Grid
from clplen.wave.propagation.propagation_step import PropagationStep


def propagate(
    x: jax.Array,
    z: float | jax.Array,
    grid: Grid,
    *,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    device: DeviceLike | None = None,
) -> jax.Array:
    """Propagate a field through free space, with gradients of the field and of the distance.

    Parameters
    ----------
    x : jax.Array
        Complex amplitudes, complex64 (complex128 on a device of double precision), shape
        (..., ny, nx).
    z : float or jax.Array
        Distance in metres. A JAX array may be traced and gets a gradient; a float has no gradient,
        and its plan is created at once.
    grid : Grid
        Grid of the field.
    wavelength : float
        Wavelength in metres.
    method : str
        Propagation method, see `clplen.propagate`.
    pad : float
        Padding factor, see `clplen.propagate`.
    out_grid : Grid, optional
        Grid of the result, see `clplen.propagate`.
    device : Device or str, optional
        OpenCL device; default ``Device.open()``.

    Returns
    -------
    jax.Array
        Field of shape (..., my, mx), without the carrier exp(ikz).

    Raises
    ------
    TypeError
        If ``x`` has another dtype.
    ValueError, SamplingError
        If `clplen.propagate` raises it.

    Examples
    --------
    >>> import jax
    >>> import clplen.jax
    >>> grid = clplen.Grid((32, 48), 5e-6)
    >>> def middle(z):
    ...     u = jax.numpy.ones(grid.shape, np.complex64)
    ...     behind = clplen.jax.propagate(u, z, grid, wavelength=500e-9)
    ...     return abs(behind[16, 24]) ** 2
    >>> jax.grad(middle)(jax.numpy.float32(2e-3)).shape
    ()
    """
    step = PropagationStep(grid, wavelength, method, pad, out_grid, as_device(device))
    if not isinstance(z, jax.Array):
        return apply(step.plan(float(z)), x)
    out = grid if out_grid is None else out_grid
    struct = jax.ShapeDtypeStruct((*jnp.shape(x)[:-2], *out.shape), step.device.complex)
    return apply_step(step, x, out=struct, parameters=[z], device=step.device, name="propagate")
