"""What linear interpolation between pixels costs the detail of a refocused picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.lightfield.gaussian import gaussian_taps

Vector = np.ndarray[Any, np.dtype[np.floating[Any]]]

_FREQUENCIES = 32  # samples from 0 to half a cycle a pixel
_FALL = 4  # power of the frequency in the reference spectrum


def kept_energy(shift_y: Vector, shift_x: Vector, weights: Vector, *, sigma: float) -> Vector:
    """Share of a high-passed picture's energy that linear interpolation leaves, in focus.

    A view moved by whole pixels keeps all its detail, one moved by half a pixel the least, so that
    the sharpness of a focal stack has false peaks at whole disparities. At the frequency k a
    fraction f of a pixel multiplies the spectrum by (1 - f + f exp(2 pi i k)) exp(-2 pi i k f);
    the share is the squared mean of that over the views, averaged over the energy that a Gaussian
    high pass leaves of a power spectrum 1/k^4: natural pictures fall as 1/k^2 (Field 1987,
    "Relations between the statistics of natural images and the response properties of cortical
    cells"), lens and pixels take the rest.

    Parameters
    ----------
    shift_y, shift_x : numpy.ndarray
        Shifts of the views in pixels, shape (planes, V) and (planes, U).
    weights : numpy.ndarray
        Of the views, shape (V, U), not all 0.
    sigma : float
        Of the Gaussian whose blur the high pass takes away, in pixels.

    Returns
    -------
    numpy.ndarray
        float64, shape (planes,), at most 1.
    """
    k = (np.arange(_FREQUENCIES) + 0.5) / (2 * _FREQUENCIES)
    along_y, along_x = _transfer(shift_y, k), _transfer(shift_x, k)
    rows = np.einsum("pvk,vu->puk", along_y, weights / weights.sum())
    mean = np.einsum("puk,puj->pkj", rows, along_x)
    taps = gaussian_taps(sigma)
    distance = np.arange(1, taps.size)
    blur = taps[0] + 2 * np.cos(2 * np.pi * np.outer(k, distance)) @ taps[1:]
    detail = (1 - np.outer(blur, blur)) ** 2 / np.hypot(k[:, None], k[None, :]) ** _FALL
    return (np.abs(mean) ** 2 * detail).sum(axis=(1, 2)) / detail.sum()


def _transfer(shift: Vector, k: Vector) -> np.ndarray[Any, Any]:
    """Transfer function of each view's interpolation, shape (planes, views, k)."""
    part = (shift - np.floor(shift))[..., None]
    return (1 - part + part * np.exp(2j * np.pi * k)) * np.exp(-2j * np.pi * k * part)
