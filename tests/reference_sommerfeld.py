"""Slow, simple float64 twin of the sampled Rayleigh-Sommerfeld kernel.

Nothing here imports the package under test. Sample j of an axis of n belongs to displacement j for
j < (n + 1)//2, else j - n; the carrier exp(ikz) is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from reference_optics import Complex, Pair, Real, pair
from scipy.special import hankel1e


def displacements(n: int, d: float) -> Real:
    """Displacements of the samples of an axis in circular order, in metres."""
    return np.array([j if j < (n + 1) // 2 else j - n for j in range(n)]) * d


def phase(rho2: Real, z: float, wavelength: float) -> Complex:
    """exp(ik(r - z)), z > 0, reduced in extended precision."""
    wide = np.asarray(rho2, np.longdouble)
    turns = wide / (np.sqrt(wide + np.longdouble(z) ** 2) + z) / wavelength
    return np.exp(2j * np.pi * (turns - np.rint(turns)).astype(float))


def impulse_response(shape: Sequence[int], pitch: Pair, z: float, wavelength: float) -> Complex:
    """h dx dy, h = z/(2 pi r^2)(1/r - ik) e^{ik(r-z)} (Goodman, eq. 3-43); conjugate for z < 0."""
    (dy, dx), far = pair(pitch), abs(z)
    y, x = displacements(shape[0], dy), displacements(shape[1], dx)
    rho2 = y[:, None] ** 2 + x[None, :] ** 2
    r = np.sqrt(rho2 + far**2)
    k = 2 * np.pi / wavelength
    h = far / (2 * np.pi * r**2) * (1 / r - 1j * k) * phase(rho2, far, wavelength) * dy * dx
    return h if z > 0 else h.conj()


def line_response(n: int, d: float, z: float, wavelength: float) -> Complex:
    """Line sources: h d, h = (ikz/2r) H1(kr) e^{-ikz}; conjugate for z < 0."""
    x, far, k = displacements(n, d), abs(z), 2 * np.pi / wavelength
    r = np.sqrt(x**2 + far**2)
    h = 0.5j * k * far / r * hankel1e(1, k * r) * phase(x**2, far, wavelength) * d
    return h if z > 0 else h.conj()


def sum_at(
    u: Complex,
    pitch: Pair,
    z: float,
    wavelength: float,
    points: Sequence[tuple[float, float]],
    *,
    origin: Pair = (0.0, 0.0),
) -> Complex:
    """The sum over all samples of u (ny, nx) at points (y, x) in metres, shape (points,).

    An axis of length 1 is one along which nothing varies.
    """
    (dy, dx), (oy, ox) = pair(pitch), pair(origin)
    ny, nx = u.shape
    y, x = (np.arange(ny) - ny // 2) * dy + oy, (np.arange(nx) - nx // 2) * dx + ox
    far, k, out = abs(z), 2 * np.pi / wavelength, []
    for py, px in points:
        if 1 in u.shape:
            rho2, d = ((px - x) ** 2, dx) if ny == 1 else ((py - y) ** 2, dy)
            r = np.sqrt(rho2 + far**2)
            h = 0.5j * k * far / r * hankel1e(1, k * r) * phase(rho2, far, wavelength) * d
        else:
            rho2 = ((py - y) ** 2)[:, None] + ((px - x) ** 2)[None, :]
            r = np.sqrt(rho2 + far**2)
            h = far / (2 * np.pi * r**2) * (1 / r - 1j * k) * phase(rho2, far, wavelength) * dy * dx
        out.append((u.reshape(h.shape) * (h if z > 0 else h.conj())).sum())
    return np.array(out)
