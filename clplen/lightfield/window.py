"""A window of lenslets out of a light field, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter

if TYPE_CHECKING:
    from clplen.lightfield.lightfield import LightField

_SMOOTHING = 8  # windows are found in a picture smoothed by a Gaussian of window/8


def read_window(
    lf: LightField, near: tuple[int, int], size: int, *, fill: bool = False
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The samples round one lenslet.

    Parameters
    ----------
    lf : LightField
    near : tuple of int
        (x, y) of the central lenslet.
    size : int
        Lenslets across, odd.
    fill : bool
        Zeros for the lenslets beyond the border of the light field; otherwise they are left out.

    Returns
    -------
    numpy.ndarray
        float64, shape (c, v, u, y, x), c = 1 without colour; multiplied by the weights of the
        views.
    """
    colours = lf.shape[4] if len(lf.shape) == 5 else 1
    ranges = [
        (max(centre - size // 2, 0), min(centre + size // 2 + 1, n))
        for centre, n in zip(near[::-1], lf.shape[2:4], strict=True)
    ]
    rows, columns = (slice(*ends) for ends in ranges)
    with lf.device.on_host(lf.data) as samples:
        part = samples[:, :, rows, columns].astype(np.float64)
    part = part.reshape(*part.shape[:4], colours) * lf.weights[:, :, None, None, None]
    window = np.moveaxis(part, -1, 0)
    if not fill:
        return window
    missing = [
        (first - centre + size // 2, centre + size // 2 + 1 - end)
        for centre, (first, end) in zip(near[::-1], ranges, strict=True)
    ]
    return np.pad(window, [(0, 0)] * 3 + missing)


def brightest(lf: LightField, size: int) -> tuple[int, int]:
    """(x, y) of the lenslet where a window of ``size`` lenslets holds the brightest region."""
    picture = lf.render().to_numpy().astype(np.float64)
    if picture.ndim == 3:
        picture = picture.sum(axis=-1)
    smooth = gaussian_filter(picture, size / _SMOOTHING, mode="constant")
    y, x = np.unravel_index(np.argmax(smooth), smooth.shape)
    return int(x), int(y)
