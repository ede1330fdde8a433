"""Set-ups shared by the tests of propagation: fields with their exact solutions, float64.

Every function returns a SetUp on a grid [y, x] of SI metres, carrier exp(ikz) dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from reference_closed import (
    fresnel_slit,
    gauss_legendre,
    gaussian_exact,
    gaussian_paraxial,
)
from reference_elements import rectangle_coverage
from reference_optics import Complex, Pair, Real, axis, pair, radius_squared
from reference_propagation import line_kernel

LAM = 550e-9


@dataclass(frozen=True)
class SetUp:
    """A field at z = 0, and what it is after z on the same grid (`exact`)."""

    u: Complex
    pitch: tuple[float, float]
    z: float
    exact: Complex
    wavelength: float = LAM


def one_axis(u: Real | Complex, dx: float, z: float, exact: Complex) -> SetUp:
    """A 1-D (cylindrical) set-up as an array (1, n)."""
    return SetUp(np.asarray(u, complex).reshape(1, -1), (dx, dx), z, exact.reshape(1, -1))


# Set-up A: N = 1024, dx = 2 lam, exact theory ---------------------------------------------------


def set_up_a(z_over_s: float, *, n: int = 1024, dx: float = 2 * LAM) -> SetUp:
    """Slit of half the window whose edge samples weigh 1/2, RS-I quadrature on all samples."""
    s = n * dx
    u = rectangle_coverage((1, n), dx, (dx, s / 2))
    exact = slit_at(axis(n, dx), z_over_s * s, width=s / 2)
    return one_axis(u, dx, z_over_s * s, exact)


def slit_at(x: Real, z: float, *, width: float) -> Complex:
    """Exact RS-I field of a slit at all x, each gap between edge distances integrated once.

    The field is G(x + w/2) - G(x - w/2) with G(t) the integral of the line kernel from 0 to t:
    Gauss-Legendre over each gap, 24 nodes for every 2 wavelengths, then a running sum.
    """
    edges = np.array([x + width / 2, x - width / 2])
    distance, where = np.unique(np.round(np.abs(edges) / LAM, 11), return_inverse=True)
    ends = np.append(0.0, distance * LAM)
    panels = 1 + int(np.diff(ends).max() / (2 * LAM))
    t, weight = gauss_legendre(0, 1, panels=panels, nodes=24)
    gap = np.diff(ends)[:, None]
    line = line_kernel((ends[:-1, None] + gap * t) ** 2, z, 2 * np.pi / LAM)
    total = np.cumsum((line * gap) @ weight)
    high, low = np.sign(edges) * total[where.reshape(edges.shape)]
    return high - low


def gaussian_a(z_over_s: float, *, n: int = 1024, dx: float = 2 * LAM) -> SetUp:
    """1-D Gaussian w0 = S/16 on the grid of set-up A, exact by quadrature of its spectrum."""
    s, x = n * dx, axis(n, dx)
    exact = gaussian_exact(np.abs(x), z_over_s * s, waist=s / 16, wavelength=LAM, dim=1)
    return one_axis(np.exp(-((16 * x / s) ** 2)), dx, z_over_s * s, exact)


# Exact 2-D Gaussian ----------------------------------------------------------------------------


def gaussian_2d(
    shape: Sequence[int], pitch: Pair, z: float, *, waist: float, centre: Pair = 0.0
) -> SetUp:
    """Helmholtz-exact Gaussian beam centred at (y, x) on any rectangular grid."""
    r = np.sqrt(radius_squared(shape, pitch, tuple(-c for c in pair(centre))))
    u = np.exp(-((r / waist) ** 2)) + 0j
    return SetUp(u, pair(pitch), z, gaussian_at(r, z, waist=waist))


def gaussian_at(r: Real, z: float, *, waist: float, chunk: int = 1024) -> Complex:
    """gaussian_exact at every radius of r, a chunk of distinct radii at a time.

    Radii equal to 12 digits are evaluated once: a grid has up to four samples a radius.
    """
    flat = np.round(r.ravel() / waist, 12)
    distinct, where = np.unique(flat, return_inverse=True)
    parts = [
        gaussian_exact(waist * distinct[i : i + chunk], z, waist=waist, wavelength=LAM)
        for i in range(0, len(distinct), chunk)
    ]
    return np.concatenate(parts)[where].reshape(r.shape)


# Fresnel: N = 512 or 1024, dx = 6.6 um ----------------------------------------------------------


def slit_fresnel(z_units: float, *, n: int = 1024, dx: float = 6.6e-6) -> SetUp:
    """Slit S/4 with its Fresnel field at z = z_units N dx^2/lam."""
    z = z_units * n * dx**2 / LAM
    u = rectangle_coverage((1, n), dx, (dx, n * dx / 4))
    return one_axis(u, dx, z, fresnel_slit(axis(n, dx), z, width=n * dx / 4, wavelength=LAM))


def gaussian_fresnel(z_units: float, *, n: int = 1024, dx: float = 6.6e-6) -> SetUp:
    """1-D Gaussian w0 = S/16 with its Fresnel field at z = z_units N dx^2/lam."""
    z, waist, x = z_units * n * dx**2 / LAM, n * dx / 16, axis(n, dx)
    exact = gaussian_paraxial(x, z, waist=waist, wavelength=LAM, dim=1)
    return one_axis(np.exp(-((x / waist) ** 2)), dx, z, exact)
