"""Closed forms and quadratures of scalar diffraction, float64, carrier exp(ikz) removed.

Each is exact for the theory it names: Helmholtz (exact) or Fresnel (paraxial). Nothing here
imports the package under test.
"""

from __future__ import annotations

import numpy as np
from reference_optics import Complex, Real
from scipy.special import fresnel, j0, j1


def tilted_plane_wave(
    y: Real | float,
    x: Real | float,
    z: float,
    *,
    fy: Real | float,
    fx: Real | float,
    wavelength: float,
) -> Complex:
    """Exact plane wave of frequency (fy, fx), s < 1: exp(i2pi(fy y + fx x)) times H(z)."""
    s = wavelength**2 * (fy**2 + fx**2)
    turns = -z / wavelength * s / (1 + np.sqrt(1 - s))
    return np.exp(2j * np.pi * (fy * y + fx * x)) * np.exp(2j * np.pi * turns)


def gaussian_paraxial(
    r: Real, z: float, *, waist: float, wavelength: float, dim: int = 2
) -> Complex:
    """Fresnel-exact Gaussian beam q^(-dim/2) exp(-r^2/(w0^2 q)), q = 1 + i z lam/(pi w0^2)."""
    q = 1 + 1j * z * wavelength / (np.pi * waist**2)
    return q ** (-dim / 2) * np.exp(-(r**2) / (waist**2 * q))


def gaussian_exact(r: Real, z: float, *, waist: float, wavelength: float, dim: int = 2) -> Complex:
    """Helmholtz-exact Gaussian exp(-r^2/w0^2) after z, by quadrature of its angular spectrum.

    dim=2: int pi w0^2 exp(-(pi w0 f)^2) H(f) J0(2 pi f r) 2 pi f df from 0 to 6.2/(pi w0), where
    the spectrum has fallen to 2e-17; dim=1: the cosine transform. Waist at least 2 wavelengths,
    so that no wave is evanescent.
    """
    if waist < 2 * wavelength:
        raise ValueError(f"waist {waist} is below 2 wavelengths: its evanescent part is missing")
    top = 6.2 / (np.pi * waist)
    turns = abs(z) / wavelength * (wavelength * top) ** 2 + top * np.max(np.abs(r))
    f, weight = gauss_legendre(0, top, panels=4 + int(2 * turns))
    gaussian = np.exp(-((np.pi * waist * f) ** 2))
    h = tilted_plane_wave(0.0, 0.0, z, fy=0.0, fx=f, wavelength=wavelength)
    phase = 2 * np.pi * f * np.asarray(r, dtype=float)[..., None]
    if dim == 1:
        return np.cos(phase) @ (2 * np.sqrt(np.pi) * waist * gaussian * h * weight)
    return j0(phase) @ (2 * (np.pi * waist) ** 2 * gaussian * h * f * weight)


def gauss_legendre(start: float, stop: float, *, panels: int, nodes: int = 8) -> tuple[Real, Real]:
    """Nodes and weights of a composite Gauss-Legendre rule."""
    t, w = np.polynomial.legendre.leggauss(nodes)
    half = (stop - start) / (2 * panels)
    middle = start + half * (2 * np.arange(panels) + 1)
    return (middle[:, None] + half * t).ravel(), np.tile(half * w, panels)


def circle_on_axis(z: float, *, radius: float, wavelength: float) -> complex:
    """RS-I field on the axis behind a circular aperture: 1 - (z/R) exp(ik(R-z))."""
    far = np.hypot(z, radius)
    return 1 - z / far * np.exp(2j * np.pi / wavelength * radius**2 / (far + z))


def fresnel_slit(x: Real, z: float, *, width: float, wavelength: float) -> Complex:
    """Fresnel field behind a slit: (exp(-i pi/4)/sqrt 2) (dC + i dS); a rectangle: a product."""
    scale = np.sqrt(2 / (wavelength * z))
    s_high, c_high = fresnel(scale * (width / 2 - x))
    s_low, c_low = fresnel(scale * (-width / 2 - x))
    return np.exp(-0.25j * np.pi) / np.sqrt(2) * (c_high - c_low + 1j * (s_high - s_low))


def airy(v: Real) -> Real:
    """2 J1(v)/v, 1 at v = 0."""
    v = np.asarray(v, dtype=float)
    return np.divide(2 * j1(v), v, out=np.ones_like(v), where=v != 0)


def lens_focus(r: Real, *, f: float, diameter: float, wavelength: float) -> Complex:
    """Fresnel field in the focal plane of a lens lit by a unit plane wave."""
    area = np.pi * diameter**2 / 4
    chirp = np.exp(1j * np.pi * np.asarray(r) ** 2 / (wavelength * f))
    return area / (1j * wavelength * f) * chirp * airy(np.pi * diameter * r / (wavelength * f))


def talbot_distance(period: float, wavelength: float) -> float:
    """Exact self-imaging distance of a grating, lam (1 + sqrt(1-q))/q, q = (lam/d)^2."""
    q = (wavelength / period) ** 2
    return wavelength * (1 + np.sqrt(1 - q)) / q
