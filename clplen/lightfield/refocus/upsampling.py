"""Refocusing on a finer grid: the samples of all views interleave."""

from __future__ import annotations

from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.alpha_law import unit_steps

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField

BASE = 1e-3  # share of plain interpolation, which fills what no sample comes near
_MOST = 16


def upsampled(lf: LightField, disparity: float, n: int, weights: Any) -> cla.Array:
    """A picture focused on one disparity with n times the pixels along each axis.

    For a disparity off the integers, samples of different views fall between each other. Each is
    put at its own place with a tent of one fine pixel to each side, and the sum divided by the
    weights; a tent of one pixel of the views with weight `BASE` fills what none comes near.
    Fine pixel Y lies at (Y + 1/2)/n - 1/2 in pixels of the views.

    Parameters
    ----------
    lf : LightField
    disparity : float
        Pixels (of the views) a view step along x.
    n : int
        1 to 16.
    weights : numpy.ndarray
        Shape (V, U), not all 0.

    Returns
    -------
    pyopencl.array.Array
        float32, shape (n y, n x[, c]).

    Raises
    ------
    ValueError
        If n is out of range.
    DeviceError
        If the picture is larger than the device's memory.
    """
    if not isinstance(n, Integral) or not 1 <= n <= _MOST:
        raise ValueError(f"upsample is a whole number from 1 to {_MOST}, not {n!r}.")
    n = int(n)
    _, _, ny, nx = lf.shape[:4]
    channels = lf.shape[4] if len(lf.shape) == 5 else 1
    kept = np.flatnonzero(weights)
    out_shape = (n * ny, n * nx, *lf.shape[4:])
    lf.device.require_memory(4 * n * n * ny * nx * channels + lf.data.nbytes, "The finer picture")
    out = lf.device.empty(out_shape, np.float32)
    steps = unit_steps(lf).reshape(-1, 2)[kept] * disparity
    phases = (np.arange(n) + 0.5) / n - 0.5
    tables: list[Any] = [kept.astype(np.int32), np.float32(weights).ravel()[kept]]
    for along in (0, 1):
        place = steps[:, along, None] + phases
        whole = np.floor(place)
        away = np.stack((place - whole, 1 - (place - whole)), axis=-1)
        tents = np.concatenate((np.maximum(1 - n * away, 0), 1 - away), axis=-1)
        tables += [np.clip(whole, -(2**20), 2**20).astype(np.int32), tents.astype(np.float32)]
    lf.device.launch_rows(
        lf.device.kernel("upsample.cl", "interleave", SAMPLE=C_TYPE[lf.dtype]),
        (n * ny, n * nx * channels),
        out,
        lf.data,
        *(lf.device.upload(table) for table in tables),
        *(np.int32(m) for m in (kept.size, n)),
        np.float32(BASE),
        *(np.int32(m) for m in (ny, nx, channels)),
    )
    return out
