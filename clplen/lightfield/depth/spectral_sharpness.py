"""Sharpness of refocused images in the Fourier domain, corrected for the camera's blur.

A refocused image is a slice through the Fourier transform of the light field (Ng 2005,
"Fourier slice photography", eq. 9). A lenslet records the Wigner function of the light smoothed by
that of its aperture (Zhang and Levoy 2009, "Wigner distributions and how they relate to the light
field"). In the Fourier domain this is a product with the aperture's ambiguity function, so a slice
can be divided by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.depth.camera_optics import LensletBlur, Real

Complex = np.ndarray[Any, np.dtype[np.complex128]]

_COARSE = 49  # minimum number of disparities of the first search
_FINE = 9  # disparities of each refinement, over two steps to either side
_REFINEMENTS = 2
_FLOOR = 0.05  # minimum of the transfer function
_BETA = 0.9  # power of the transfer function that is divided out


@dataclass(frozen=True)
class Sharpness:
    """Spectral energy of the refocused image as a function of disparity."""

    spectra: Complex  # complex128, shape (c, v, u, ky, kx): transforms of the views
    ky: Real  # ky, kx: frequencies in cycles a lenslet; kx of a real transform
    kx: Real
    weights: Real  # Shape (ky, kx): 1 or 2 (half plane) inside the band, 0 outside
    aspect: float  # Shear along y over shear along x
    blur: LensletBlur | None  # Blur that is divided out, if any

    def __call__(self, disparity: float) -> float:
        """Return E(disparity), summed over the band and the colours."""
        image, weights, _, _ = self._refocused(disparity)
        power = (image.real**2 + image.imag**2).sum(axis=0) * weights
        return float(power.sum())

    def deviation(self, disparity: float, variance: Real, *, step: float) -> float:
        """Return the standard deviation of the peak due to independent noise of the samples.

        To first order noise n moves the peak by -n dE'/dL / E'', with differences over ``step``.
        """
        below, at, above = (self(disparity + side * step) for side in (-1, 0, 1))
        curvature = (below - 2 * at + above) / step**2
        if not curvature < 0:
            return math.inf
        shape = variance.shape[-2:]
        change = self._gradient(disparity + step, shape) - self._gradient(disparity - step, shape)
        return float(np.sqrt((variance * change**2).sum()) / (2 * step) / -curvature)

    def _refocused(self, disparity: float) -> tuple[Complex, Real, Complex, Complex]:
        """Return the picture's transform (c, ky, kx), weights of its power, and the ramps."""
        shear = (self.aspect * disparity, disparity)
        _, V, U, _, _ = self.spectra.shape
        down, along = _ramp(V, shear[0], self.ky), _ramp(U, shear[1], self.kx)
        rows = np.einsum("cvuyx,ux->cvyx", self.spectra, along)
        image = np.einsum("cvyx,vy->cyx", rows, down)
        weights = self.weights
        if self.blur is not None:
            transfer = self.blur.transfer(self.ky, self.kx, shear=shear)
            weights = weights / np.maximum(np.abs(transfer), _FLOOR) ** (2 * _BETA)
        return image, weights, down, along

    def _gradient(self, disparity: float, shape: tuple[int, ...]) -> Real:
        """Return dE/dL of every sample, shape (c, v, u, *shape)."""
        image, weights, down, along = self._refocused(disparity)
        y, x = (
            np.exp(2j * np.pi * k[:, None] * np.arange(n))
            for k, n in zip((self.ky, self.kx), shape, strict=True)
        )
        columns = along.conj()[:, :, None] * x  # (u, kx, x)
        rows = down.conj()[:, :, None] * y  # (v, ky, y)
        half = np.einsum("ckl,ulx->cukx", image * weights, columns)
        return np.asarray(2 * np.einsum("cukx,vky->cvuyx", half, rows, optimize=True).real)


def _ramp(views: int, shear: float, k: Real) -> Complex:
    """Return phase factors (view, k) that shift view j by (j - jc) shear."""
    step = (np.arange(views) - (views - 1) / 2) * shear
    return np.exp(-2j * np.pi * step[:, None] * k[None, :])


def sharpness(
    window: Real,
    *,
    pad: int,
    band: tuple[float, float],
    aspect: float = 1.0,
    blur: LensletBlur | None = None,
) -> Sharpness:
    """Compute the sharpness measure of one window of a light field."""
    ny, nx = (n + 2 * pad for n in window.shape[-2:])
    ky = np.fft.fftfreq(ny)
    kx = np.fft.rfftfreq(nx)
    rows, columns = np.abs(ky) <= band[1], kx <= band[1]
    spectra = np.fft.rfft2(window, s=(ny, nx))[..., rows, :][..., columns]
    ky, kx = ky[rows], kx[columns]
    radius = np.hypot(ky[:, None], kx[None, :])
    inside = ((radius >= band[0]) & (radius <= band[1])).astype(np.float64)
    return Sharpness(spectra, ky, kx, inside * np.where(kx == 0, 1.0, 2.0), aspect, blur)


@dataclass(frozen=True)
class Peak:
    """Maximum of a curve."""

    position: float
    # False if the curve is highest at an end of the search, without a peak
    inside: bool
    positions: Real  # positions, values: curve of the first search
    values: Real


def find_peak(measure: Callable[[float], float], limit: float, *, step: float = math.inf) -> Peak:
    """Find the maximum of a positive function on [-limit, limit].

    A coarse search in steps of at most ``step`` is refined twice around the highest value; then a
    parabola through the logarithms of the three highest values is solved.
    """
    coarse = np.linspace(-limit, limit, max(_COARSE, 2 * math.ceil(limit / step) + 1))
    values = np.array([measure(x) for x in coarse])
    x, y = coarse, values
    for _ in range(_REFINEMENTS):
        best, reach = x[np.argmax(y)], 2 * (x[1] - x[0])
        x = np.linspace(max(best - reach, -limit), min(best + reach, limit), _FINE)
        y = np.array([measure(position) for position in x])
    i = int(np.argmax(y))
    if i in (0, _FINE - 1):
        return Peak(float(x[i]), False, coarse, values)
    below, at, above = np.log(y[i - 1 : i + 2])
    offset = (below - above) / (2 * (below - 2 * at + above))
    return Peak(float(x[i] + offset * (x[1] - x[0])), True, coarse, values)
