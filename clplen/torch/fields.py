"""Free-space propagation of fields that are tensors."""

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
    """Propagate a field through free space, with gradients by the field and by the distance.

    Parameters
    ----------
    x : torch.Tensor
        Complex amplitudes in host memory, complex64 (complex128 on a device of double precision),
        shape (..., ny, nx).
    z : float or torch.Tensor
        Distance in metres; a tensor with ``requires_grad`` gets a gradient, which costs one more
        propagation: see `Propagator.distance_slope`.
    grid : Grid
        Of the field.
    wavelength : float
        In metres.
    method : str
        As in `clplen.propagate`.
    pad : float
        As in `clplen.propagate`.
    out_grid : Grid, optional
        Of the result, as in `clplen.propagate`.
    device : Device or str, optional
        Default ``Device.open()``.

    Returns
    -------
    torch.Tensor
        Shape (..., my, mx), without the carrier exp(ikz).

    Raises
    ------
    TypeError
        If ``x`` is no such tensor.
    ShapeError
        If its last axes are not those of the grid.
    ValueError, SamplingError
        As `clplen.propagate`.

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
