"""A window of lenslets out of a light field, on the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl

from clplen.compute.drivers.failures import device_errors

if TYPE_CHECKING:
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
