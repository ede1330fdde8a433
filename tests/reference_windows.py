"""Slow float64 simulations of a single point's light in a plenoptic camera with a fast main lens.

Nothing here imports the package under test. The pupil integral is a direct sum over the pupil
(Rayleigh and Sommerfeld, far from the pupil) or, at the image, Debye's integral over directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class MainLens:
    """A lens that images (x0, y0, z) from its plane, and a plane z2 behind it; metres."""

    f: float
    D: float
    z2: float
    wavelength: float
    thin: bool = False


def _pupil(radii: int, angles: int, D: float) -> tuple[Real, Real, Real]:
    """(v, u) and areas of nodes on the pupil."""
    x, w = np.polynomial.legendre.leggauss(radii)
    r = D / 2 * np.sqrt((x + 1) / 2)
    t = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    area = np.repeat(w / 2 * np.pi * (D / 2) ** 2 / angles, angles)
    return np.outer(r, np.sin(t)).ravel(), np.outer(r, np.cos(t)).ravel(), area


def field_on_plane(
    lens: MainLens,
    point: tuple[float, float, float],
    y: Real,
    x: Real,
    *,
    radii: int = 160,
    angles: int = 360,
) -> Complex:
    """The field of a point (x0, y0, z) at places on the plane z2, of energy 1 in the pupil.

    The density of energy is abs(U)^2 a square metre; the carrier exp(i k z2) is dropped.
    """
    x0, y0, z = point
    k, q = 2 * np.pi / lens.wavelength, 1 / lens.f - 1 / z
    v, u, area = _pupil(radii, angles, lens.D)
    if lens.thin:
        rho2 = (u - x0) ** 2 + (v - y0) ** 2
        path = rho2 / (np.sqrt(rho2 + z * z) + z) - (u * u + v * v) / (2 * lens.f)
        amplitude = np.ones_like(u)
    else:  # towards its image at 1/q, which the sense of the sine condition dims to the rim
        ty, tx = -y0 / z - q * v, -x0 / z - q * u
        slope = np.sqrt(1 + ty * ty + tx * tx)
        path, amplitude = -slope / q, slope**-1.5
    energy = (area * amplitude**2).sum()
    factor = area * amplitude / np.sqrt(energy) * np.exp(1j * k * (path - path.mean()))
    flat_y, flat_x = np.broadcast_arrays(y, x)
    out = np.empty(flat_y.size, complex)
    for start in range(0, out.size, 256):
        part = slice(start, start + 256)
        beside = (flat_y.ravel()[part, None] - v) ** 2 + (flat_x.ravel()[part, None] - u) ** 2
        r = np.sqrt(lens.z2**2 + beside)
        out[part] = (np.exp(1j * k * (beside / (r + lens.z2))) / r**2) @ factor
    return out.reshape(flat_y.shape) * lens.z2 / lens.wavelength
