"""What the scripts of chapter 2 compare with: diffraction by a slit and a circle in closed form.

Everything is float64, without the carrier exp(ikz), at LAM = 550 nm. A slit is a cylindrical
problem: nothing varies along y.
"""

import numpy as np
from scipy.special import fresnel, hankel1e

from clplen import Device, Field, Grid, aperture

LAM = 550e-9
SETUP_A = Grid((1, 1024), 2 * LAM)  # of figures 2.4 to 2.9; its slit is half as wide
S = SETUP_A.extent[1]


def slit(grid: Grid, width: float, device: Device) -> Field:
    """A slit lit by a unit plane wave; a sample on an edge weighs 1/2."""
    plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    return aperture(plane, width)


def fresnel_slit(x: np.ndarray, z: float, *, width: float) -> np.ndarray:
    """Paraxial field behind a slit, by Fresnel's integrals; Goodman (2005), section 4.5.1."""
    scale = np.sqrt(2 / (LAM * z))
    s_high, c_high = fresnel(scale * (width / 2 - x))
    s_low, c_low = fresnel(scale * (-width / 2 - x))
    return np.exp(-0.25j * np.pi) / np.sqrt(2) * (c_high - c_low + 1j * (s_high - s_low))


def line_source(x: np.ndarray, z: float) -> np.ndarray:
    """Rayleigh-Sommerfeld (first kind) kernel of a line, (ikz/2r) H1(kr), per metre."""
    r, k = np.hypot(x, z), 2 * np.pi / LAM
    return 0.5j * k * z / r * hankel1e(1, k * r) * np.exp(1j * k * x**2 / (r + z))


def exact_slit(x: np.ndarray, z: float, *, width: float) -> np.ndarray:
    """Rayleigh-Sommerfeld (first kind) field behind a slit, by quadrature.

    The integral of `line_source` over the slit is G(x + width/2) - G(x - width/2), G(t) being
    that from 0 to t: Gauss-Legendre with 24 nodes for every two wavelengths between neighbouring
    edge distances, added up.
    """
    edges = np.array([x + width / 2, x - width / 2])
    reached, where = np.unique(np.round(np.abs(edges) / LAM, 9), return_inverse=True)
    ends = np.append(0, reached) * LAM
    panels = 1 + int(np.diff(ends).max() / (2 * LAM))
    t, weight = np.polynomial.legendre.leggauss(24)
    t = (np.arange(panels)[:, None] + (t + 1) / 2).ravel() / panels
    gaps = np.diff(ends)[:, None]
    line = line_source(ends[:-1, None] + gaps * t, z)
    whole = np.cumsum((line * gaps) @ np.tile(weight / (2 * panels), panels))
    high, low = np.sign(edges) * whole[where.reshape(edges.shape)]
    return high - low


def exact_circle(z: np.ndarray, *, radius: float) -> np.ndarray:
    """Rayleigh-Sommerfeld (first kind) field on the axis behind a circle, 1 - (z/R) e^{ik(R-z)}."""
    far = np.hypot(z, radius)
    return 1 - z / far * np.exp(2j * np.pi / LAM * radius**2 / (far + z))


def fresnel_circle(z: np.ndarray, *, radius: float) -> np.ndarray:
    """Its paraxial form, 1 - e^{ik a^2/(2z)}."""
    return 1 - np.exp(1j * np.pi * radius**2 / (LAM * z))


def err_db(exact: np.ndarray, found: np.ndarray) -> float:
    """Error in dB, nothing fitted."""
    return float(-20 * np.log10(np.linalg.norm(found - exact) / np.linalg.norm(exact)))


def fitted(exact: np.ndarray, found: np.ndarray) -> np.ndarray:
    """``found`` times the complex constant that brings it nearest to ``exact``."""
    return found * (np.vdot(found, exact) / np.vdot(found, found))


def snr_db(exact: np.ndarray, found: np.ndarray) -> float:
    """Signal-to-noise ratio in dB of Matsushima and Shimobaba (2009), one constant fitted."""
    return err_db(exact, fitted(exact, found.astype(complex)))
