"""One step of the package under test, arrays in and arrays out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clplen import Device, Field, Grid, propagate


def field_of(
    u: np.ndarray, pitch: float | Sequence[float], device: Device, *, wavelength: float = 550e-9
) -> Field:
    """u (..., ny, nx) as a field centred on the axis."""
    grid = Grid(u.shape[-2:], pitch)
    return Field.from_array(u, grid, wavelength=wavelength, device=device)


def step(
    u: np.ndarray,
    pitch: float | Sequence[float],
    z: float,
    device: Device,
    *,
    wavelength: float = 550e-9,
    **options: Any,
) -> np.ndarray:
    """u (..., ny, nx) after z, by `propagate` with its options."""
    return propagate(field_of(u, pitch, device, wavelength=wavelength), z, **options).to_numpy()
