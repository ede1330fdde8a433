"""Slow float64 simulations of a single point's light in a plenoptic camera with a fast main lens.

Nothing here imports the package under test. The pupil integral is a direct sum over the pupil
(Rayleigh and Sommerfeld, far from the pupil) or, at the image, Debye's integral over directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

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


def debye_on_axis_image(lens: MainLens, radius: Real) -> Real:
    """abs(U) at the image of a point far away on the axis, by Debye's integral over angles.

    int cos^(1/2) sin J0(k rho sin) dtheta, of a lens that obeys the sine condition, up to the rim
    of a plane pupil; relative to the middle.
    """
    largest = np.arctan(lens.D / 2 / lens.z2)
    x, w = np.polynomial.legendre.leggauss(200)
    theta, w = largest * (x + 1) / 2, w * largest / 2
    k = 2 * np.pi / lens.wavelength
    weight = w * np.sqrt(np.cos(theta)) * np.sin(theta)
    values = j0(k * np.outer(radius, np.sin(theta))) @ weight
    return np.abs(values / weight.sum())


def finer(field: Complex, times: int) -> Complex:
    """The same field on a lattice ``times`` as fine, sample 0 kept, by its Fourier transform."""
    n = field.shape[0]
    spectrum = np.fft.fftshift(np.fft.fft2(field))
    wide = np.zeros((times * n, times * n), complex)
    low = times * n // 2 - n // 2
    wide[low : low + n, low : low + n] = spectrum
    return np.fft.ifft2(np.fft.ifftshift(wide)) * times**2


def lenslets(
    y: Real, x: Real, *, pitch: float, f: float, wavelength: float, hexagonal: bool, rows: int = 9,
    within: int = 1,
) -> Complex:  # fmt: skip
    """Transmission of round lenslets (hexagonal lattice) or full square cells about the axis.

    Lenslet (0, 0) has its centre on the axis; ``rows`` odd, odd rows of the hexagonal lattice are
    moved by +pitch/2 as in an array whose middle row has an even index. A sample is the mean of
    ``within`` squared places in its cell, y and x equally spaced.
    """
    if within > 1:
        step = float(x.ravel()[1] - x.ravel()[0])
        parts = (np.arange(within) - (within - 1) / 2) / within * step
        shared = {"pitch": pitch, "f": f, "wavelength": wavelength, "hexagonal": hexagonal}
        moved = (lenslets(y + a, x + b, rows=rows, **shared) for a in parts for b in parts)
        return sum(moved, np.zeros(())) / within**2
    out = np.zeros((y.size, x.size), complex)
    half = rows // 2
    height = pitch * (np.sqrt(3) / 2 if hexagonal else 1)
    flat_y, flat_x = y.ravel(), x.ravel()
    for i in range(-half, half + 1):
        for k in range(-half, half + 1):
            shift = 0.5 * ((i + half) % 2 - half % 2) if hexagonal else 0.0
            down, right = flat_y - i * height, flat_x - (k + shift) * pitch
            near = np.ix_(np.abs(down) < pitch / 2, np.abs(right) < pitch / 2)
            dy, dx = down[near[0]], right[near[1]]
            phase = np.exp(-1j * np.pi * (dy**2 + dx**2) / (wavelength * f))
            out[near] += phase * (dy**2 + dx**2 <= (pitch / 2) ** 2) if hexagonal else phase
    return out


def onward(field: Complex, step: float, z: float, wavelength: float) -> Complex:
    """Angular spectrum over z."""
    f = np.fft.fftfreq(field.shape[0], step)
    s2 = wavelength**2 * (f[:, None] ** 2 + f[None, :] ** 2)
    cosine = np.sqrt(np.maximum(1 - s2, 0))
    h = (s2 < 1) * np.exp(-2j * np.pi * z / wavelength * s2 / (1 + cosine))
    return np.fft.ifft2(np.fft.fft2(field) * h)
