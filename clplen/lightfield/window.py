"""A window of lenslets out of a light field, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter

if TYPE_CHECKING:
    from clplen.lightfield.lightfield import LightField

_SMOOTHING = 8  # windows are found in a picture smoothed by a Gaussian of window/8


def read_window(
    lf: LightField, near: tuple[int, int], size: int
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The samples round one lenslet.

    Parameters
    ----------
    lf : LightField
    near : tuple of int
        (x, y) of the central lenslet.
    size : int
        Lenslets across, odd.

    Returns
    -------
    numpy.ndarray
        float64, shape (c, v, u, size, size), c = 1 without colour; multiplied by the weights of
        the views; 0 beyond the border of the light field.
    """
    V, U, ny, nx = lf.shape[:4]
    colours = lf.shape[4] if len(lf.shape) == 5 else 1
    half = size // 2
    x0, x1 = max(near[0] - half, 0), min(near[0] + half + 1, nx)
    y0, y1 = max(near[1] - half, 0), min(near[1] + half + 1, ny)
    with lf.device.on_host(lf.data) as samples:
        part = samples[:, :, y0:y1, x0:x1].astype(np.float64)
    part = part.reshape(*part.shape[:4], colours) * lf.weights[:, :, None, None, None]
    window = np.zeros((colours, V, U, size, size))
    top, left = y0 - near[1] + half, x0 - near[0] + half
    window[..., top : top + y1 - y0, left : left + x1 - x0] = np.moveaxis(part, -1, 0)
    return window


def brightest(lf: LightField, size: int) -> tuple[int, int]:
    """(x, y) of the lenslet where a window of ``size`` lenslets holds the brightest region."""
    picture = lf.render().to_numpy().astype(np.float64)
    if picture.ndim == 3:
        picture = picture.sum(axis=-1)
    smooth = gaussian_filter(picture, size / _SMOOTHING, mode="constant")
    y, x = np.unravel_index(np.argmax(smooth), smooth.shape)
    return int(x), int(y)
