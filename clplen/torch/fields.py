"""Free-space propagation of tensors."""

from __future__ import annotations

import torch

from clplen.compute.device import DeviceLike, as_device
from clplen.torch.operators import apply
from clplen.torch.steps import apply_step
from clplen.wave.field.field import Grid
from clplen.wave.propagation.propagation_step import PropagationStep


def propagate(
    x: torch.Tensor,
    z: float | torch.Tensor,
    grid: Grid,
    *,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    device: DeviceLike | None = None,
) -> torch.Tensor:
    """Propagate a field through free space, with gradients of the field and of the distance.

    Parameters
    ----------
    x : torch.Tensor
        Complex amplitudes in host memory, complex64 (complex128 on a device of double precision),
        shape (..., ny, nx).
    z : float or torch.Tensor
        Distance in metres; a tensor with ``requires_grad`` gets a gradient, at the cost of one more
        propagation: see `Propagator.distance_slope`.
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
    torch.Tensor
        Field of shape (..., my, mx), without the carrier exp(ikz).

    Raises
    ------
    TypeError
        If ``x`` is not such a tensor.
    ShapeError
        If the last axes differ from the grid.
    ValueError, SamplingError
        If `clplen.propagate` raises it.

    Examples
    --------
    >>> import torch
    >>> import clplen.torch
    >>> grid = clplen.Grid((32, 48), 5e-6)
    >>> phase = torch.zeros(grid.shape, requires_grad=True)
    >>> z = torch.tensor(2e-3, requires_grad=True)
    >>> u = torch.polar(torch.ones(grid.shape), phase)
    >>> image = clplen.torch.propagate(u, z, grid, wavelength=500e-9).abs() ** 2
    >>> image[16, 24].backward()
    >>> phase.grad.shape, z.grad.shape
    (torch.Size([32, 48]), torch.Size([]))
    """
    step = PropagationStep(grid, wavelength, method, pad, out_grid, as_device(device))
    if isinstance(z, torch.Tensor) and z.requires_grad:
        return apply_step(step, x, parameters=[z], device=step.device, name="propagate")
    return apply(step.plan(float(z)), x)
