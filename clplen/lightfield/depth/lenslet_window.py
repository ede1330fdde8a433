"""A window of lenslets out of a light field, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl

from clplen.compute.failures import device_errors
from clplen.lightfield.arrays.spectral_sharpness import Real

if TYPE_CHECKING:
    import scipy.sparse

    from clplen.lightfield.model.light_field import LightField

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
    part = _fetched(lf, rows, columns).astype(np.float64)
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
    from scipy.ndimage import gaussian_filter  # here: slow to import, and nothing else needs it

    picture = lf.render().to_numpy().astype(np.float64)
    if picture.ndim == 3:
        picture = picture.sum(axis=-1)
    smooth = gaussian_filter(picture, size / _SMOOTHING, mode="constant")
    y, x = np.unravel_index(np.argmax(smooth), smooth.shape)
    return int(x), int(y)


def _fetched(lf: LightField, rows: slice, columns: slice) -> np.ndarray[Any, Any]:
    """Some rows and columns of every view; no other sample leaves the device."""
    V, U, ny, nx = lf.shape[:4]
    sample = lf.data.nbytes // (V * U * ny * nx)  # bytes, of all colours
    shape = (V, U, rows.stop - rows.start, columns.stop - columns.start, *lf.shape[4:])
    part = np.empty(shape, lf.dtype)
    copy: Any = cl.enqueue_copy  # its types leave out buffer_origin
    with device_errors(lf.device.cl_device, "A copy to the host"):
        copy(
            lf.device.queue,
            part,
            lf.data.base_data,
            buffer_origin=(lf.data.offset + columns.start * sample, rows.start, 0),
            host_origin=(0, 0, 0),
            region=(shape[3] * sample, shape[2], V * U),
            buffer_pitches=(nx * sample, ny * nx * sample),
            host_pitches=(shape[3] * sample, shape[2] * shape[3] * sample),
            is_blocking=True,
        )
    return part


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
