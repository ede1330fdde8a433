"""Depth from focus as the thesis prints it: a baseline with known bias, to compare with.

It shears the lenslets' own cells by eq. 3.9, with indices of lenslets and pixels in the place of
lengths, and knows nothing of diffraction: all three pull alpha towards 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clplen.lightfield.arrays.spectral_sharpness import Real

if TYPE_CHECKING:
    import scipy.sparse

THESIS_WINDOW = 31
THESIS_ALPHAS = np.round(0.7 + 0.005 * np.arange(121), 3)
_LOWEST = 0.1  # cycles a lenslet


def thesis_curve(window: Real) -> Real:
    """Focus measure at `THESIS_ALPHAS`.

    I(x') = sum_u L(x'/alpha + u (1 - 1/alpha), u), x' in lenslets from the centre of the window,
    u in pixels from the centre of the cell, linear, 0 outside; E = sum of |FFT I|^2 over radii
    above 0.1 cycles a lenslet.

    Parameters
    ----------
    window : numpy.ndarray
        float64, shape (c, v, u, y, x): naive cells in raw pixel order.

    Returns
    -------
    numpy.ndarray
        float64, shape (121,).
    """
    c, V, U, ny, nx = window.shape
    colours = window.transpose(0, 1, 3, 2, 4).reshape(c, V * ny, U * nx)
    radius = np.hypot(np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :])
    energies = np.zeros(THESIS_ALPHAS.size)
    for i, alpha in enumerate(THESIS_ALPHAS):
        down, along = _shear(ny, V, alpha), _shear(nx, U, alpha)
        for rows in colours:
            image = down @ (along @ rows.T).T
            energies[i] += np.sum(np.abs(np.fft.fft2(image)[radius > _LOWEST]) ** 2)
    return energies


def _shear(count: int, views: int, alpha: float) -> scipy.sparse.csr_array:
    """Matrix (count, views count) that samples one axis linearly and sums over its views."""
    import scipy.sparse  # here: slow to import, and only this baseline needs it

    x = np.arange(count) - (count - 1) / 2
    u = np.arange(views) - (views - 1) / 2
    sampled = x[:, None] / alpha + u * (1 - 1 / alpha)
    weights = np.maximum(1 - np.abs(sampled[:, :, None] - x), 0)
    return scipy.sparse.csr_array(weights.reshape(count, views * count))
