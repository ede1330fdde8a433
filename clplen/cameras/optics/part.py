"""Fields that fill only the aperture's part of a camera's grid."""

from __future__ import annotations

import math
from dataclasses import replace

from clplen.compute.blocks import window
from clplen.errors import ShapeError
from clplen.wave.field import Field, Grid
from clplen.wave.propagation import Propagator


def aperture_grid(grid: Grid, diameter: float) -> Grid:
    """The samples of a grid whose cells a circular aperture about the axis touches.

    Parameters
    ----------
    grid : Grid
    diameter : float
        Of the aperture, in metres.

    Returns
    -------
    Grid
        About the same centre, at most as large as ``grid``: sample n//2 stays where it is.
    """
    shape = []
    for n, pitch, centre in zip(grid.shape, grid.pitch, grid.origin, strict=True):
        half = math.ceil((diameter / 2 + abs(centre)) / pitch + 0.5)
        shape.append(min(n, 2 * half + 1))
    return replace(grid, shape=(shape[0], shape[1]))


def from_part(plan: Propagator, field: Field) -> Field:
    """A field on a part of a plan's grid, propagated with zeros beside it.

    Parameters
    ----------
    plan : Propagator
    field : Field
        Shape (..., ny, nx), on the plan's grid or on fewer samples about the same centre.

    Returns
    -------
    Field
        On the plan's output grid.

    Raises
    ------
    ShapeError
        If the field is on another grid.
    """
    if field.grid == plan.grid:
        return plan(field)
    fits = all(n <= m for n, m in zip(field.grid.shape, plan.grid.shape, strict=True))
    if not fits or replace(field.grid, shape=plan.grid.shape) != plan.grid:
        raise ShapeError(
            f"The plan is for {plan.grid}; the field is on {field.grid}, which is no part of it."
        )
    shape = (*field.shape[:-2], *plan.grid.shape)
    whole = window(field.data, shape, field.device)
    return plan(Field(whole, plan.grid, field.wavelength, field.device))
