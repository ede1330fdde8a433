"""A light-field microscope in float64: the twin of clplen.cameras.light_field_microscope.

Lengths in metres, arrays [y, x], z > 0 farther from the objective, carrier dropped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from reference_optics import Complex, Real
from scipy import special

Path = Callable[[Real, Real], Real]


@dataclass(frozen=True)
class Setup:
    """Objective, full square lenslets of pitch p, n pixels each, wavelength lam, index, e."""

    M: float = 20.0
    na: float = 0.5
    p: float = 125e-6
    f_mu: float = 2.5e-3
    n: int = 25
    lam: float = 525e-9
    index: float = 1.0
    power: float = 0.5

    @property
    def dx(self) -> float:
        """Pixel pitch."""
        return self.p / self.n


def debye(setup: Setup, r: Real, z: float, *, nodes: int = 2000) -> Complex:
    """int cos^(1/2) sin cos exp(ikz(cos - 1)) J0(k r sin/M) dtheta, r on the image side.

    The weight is that of P(f) d^2f: cos^(1/2) with |f| d|f| proportional to sin cos dtheta.
    """
    edge = np.arcsin(setup.na / setup.index)
    t, w = leggauss(nodes)
    theta, weight = edge * (t + 1) / 2, edge * w / 2
    k = 2 * np.pi * setup.index / setup.lam
    sine, cosine = np.sin(theta), np.cos(theta)
    a = weight * np.sqrt(cosine) * sine * cosine * np.exp(1j * k * z * (cosine - 1))
    return np.asarray(special.j0(k * r[:, None] * sine / setup.M) @ a)


def axis(setup: Setup, lenslets: int) -> Real:
    """Coordinates of the pixels of a row of lenslets, the axis in the middle."""
    count = lenslets * setup.n
    return (np.arange(count) - (count - 1) / 2) * setup.dx


def native(
    setup: Setup, point: tuple[float, float, float], lenslets: int, path: Path | None = None
) -> Complex:
    """Field on the native plane of a point (x0, y0, z), sum |U|^2 = 1, by sums over frequencies.

    ``path``: metres over the pupil, of (rho, theta).
    """
    x = axis(setup, lenslets)
    f = np.fft.fftfreq(x.size, setup.dx)
    f = f[np.abs(f) < 1.2 * setup.na / (setup.M * setup.lam)]
    radius = np.hypot(f[:, None], f[None, :])
    rim = radius <= setup.na / (setup.M * setup.lam)
    longest = setup.index / setup.lam
    axial = np.sqrt(np.maximum(longest**2 - (setup.M * radius) ** 2, 0))
    pupil = (
        rim
        * np.where(rim, axial / longest, 1) ** setup.power
        * np.exp(2j * np.pi * point[2] * (axial - longest))
    )
    if path is not None:
        rho = np.minimum(radius * setup.M * setup.lam / setup.na, 1)
        theta = np.arctan2(f[:, None], f[None, :])
        pupil = pupil * np.exp(2j * np.pi / setup.lam * path(rho, theta))
    ky, kx = (np.exp(2j * np.pi * np.outer(x - setup.M * c, f)) for c in (point[1], point[0]))
    field = ky @ pupil @ kx.T
    return np.asarray(field / np.sqrt((np.abs(field) ** 2).sum()))


def sensor(
    setup: Setup, point: tuple[float, float, float], lenslets: int, path: Path | None = None
) -> Real:
    """Energy on the pixels of a point of unit energy in the pupil."""
    x = axis(setup, lenslets)
    inside = x - (np.floor(x / setup.p + lenslets / 2) + 0.5 - lenslets / 2) * setup.p
    lens = np.exp(-1j * np.pi * inside**2 / (setup.lam * setup.f_mu))
    behind = native(setup, point, lenslets, path) * lens[:, None] * lens[None, :]
    f = np.fft.fftfreq(x.size, setup.dx)
    axial = np.sqrt(setup.lam**-2 - f[:, None] ** 2 - f[None, :] ** 2 + 0j)
    turned = np.exp(2j * np.pi * setup.f_mu * (axial - 1 / setup.lam))
    return np.asarray(np.abs(np.fft.ifft2(np.fft.fft2(behind) * turned)) ** 2)
