"""A point imaged 2f to 2f with f = 120 mm and D = 3.6 mm, by each method of propagation."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from closed import LAM
from scipy.special import j1

from clplen import Device, Field, Grid, OpticalSystem, Propagator, SamplingWarning
from clplen.wave import Lens

F, Z, D, PITCH, N = 0.12, 0.24, 3.6e-3, 6.6e-6, 1010  # Z: of the object and of the image
GRID = Grid((N, N), PITCH)
PEAK = np.pi * D**2 / (2 * LAM * Z) ** 2  # amplitude of the image of a unit point
EXTENT = np.array([-N / 2 - 0.5, N / 2 - 0.5] * 2) * PITCH * 1e3  # mm; sample N/2 lies at 0
METHODS: dict[str, dict[str, Any]] = {
    "multi-step, pad 1": {"method": "fresnel-multistep", "pad": 1, "border": 0},
    "multi-step, pad 2": {"method": "fresnel-multistep", "pad": 2},
    "AS, pad 1": {"method": "as", "pad": 1},
    "AS, pad 2": {"method": "as", "pad": 2},
    "BLAS, pad 1": {"method": "blas", "pad": 1},
    "BLAS, pad 2": {"method": "blas", "pad": 2},
    "corrected BLAS": {"method": "cblas"},
    "Fresnel IR, pad 2": {"method": "fresnel-ir", "pad": 2},
    "auto": {"method": "auto"},
}


def point(row: int, column: int, device: Device) -> Field:
    """A unit point so many samples from the axis: one sample of height 1/dx^2."""
    u = np.zeros(GRID.shape)
    u[N // 2 + row, N // 2 + column] = PITCH**-2
    return Field.from_array(u, GRID, wavelength=LAM, device=device)


def image(method: str, device: Device) -> np.ndarray:
    """Image of a unit point on the axis by one of METHODS; complex128."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # aliasing is what is shown
        step = Propagator(GRID, Z, wavelength=LAM, device=device, **METHODS[method])
    system = OpticalSystem([step, Lens(F, diameter=D), step])
    return system(point(0, 0, device)).to_numpy().astype(complex)


def airy_image() -> np.ndarray:
    """The paraxial image of a unit point on the axis; Goodman (2005), section 5.3."""
    r = np.hypot(GRID.y[:, None], GRID.x)
    v = np.pi * D * r / (LAM * Z)
    pattern = np.divide(2 * j1(v), v, out=np.ones_like(v), where=v > 0)
    return -PEAK * np.exp(1j * np.pi * r**2 / (LAM * Z)) * pattern
