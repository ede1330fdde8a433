"""The stages of a propagation by its spectrum, as arrays: figures 2.3, 2.4 and 2.6."""

from dataclasses import dataclass

import numpy as np
from closed import LAM

from clplen import Field, Grid, Propagator


@dataclass(frozen=True)
class Stages:
    """U(0), A, H, A H and U(z) in the padded window, zero frequency in the middle."""

    plan: Propagator
    window: Grid
    arrays: dict[str, np.ndarray]


def phase(f: np.ndarray, z: float) -> np.ndarray:
    """Phase of H in rad, -k z s/(1 + sqrt(1 - s)), s = (lam f)^2; Goodman (2005), eq. 3-66."""
    s = (LAM * f) ** 2
    return -2 * np.pi * z / LAM * s / (1 + np.sqrt(1 - s))


def transfer(plan: Propagator) -> np.ndarray:
    """H of a plan, zero frequency in the middle; the plan holds the quadrant up to the middle."""
    H, (ny, nx) = plan.spectrum, plan.spectrum.shape
    y, x = (np.minimum(i, n - i) for i, n in ((np.arange(ny), ny), (np.arange(nx), nx)))
    return np.fft.fftshift(H.values.get()[np.ix_(y, x)])


def stages(field: Field, z: float, method: str) -> Stages:
    """Every stage, the transforms by NumPy and H from the plan."""
    plan = Propagator(field.grid, z, wavelength=LAM, method=method, device=field.device)
    H = transfer(plan)
    window = Grid(H.shape, field.grid.pitch)
    start = np.zeros(H.shape, complex)
    start[inner(window, field.grid)] = field.to_numpy()
    A = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(start))) * np.prod(window.pitch)
    end = np.fft.fftshift(np.fft.ifft2(np.fft.ifftshift(A * H))) / np.prod(window.pitch)
    return Stages(plan, window, {"U(0)": start, "A": A, "H": H, "A H": A * H, "U(z)": end})


def inner(window: Grid, grid: Grid) -> tuple[slice, slice]:
    """Where a grid lies in a padded window: centre upon centre."""
    y, x = (slice(L // 2 - n // 2, L // 2 - n // 2 + n)
            for L, n in zip(window.shape, grid.shape, strict=True))
    return y, x
