"""Exact shifts of views by phase ramps in their spectra, and means of what was shifted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.model.alpha_law import shifts
from clplen.lightfield.refocus.view_spectra import Vector, channels_of, keep_real, take_views

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField


def phase_ramps(lf: LightField, disparities: Vector, weights: Any) -> cla.Array:
    """Mean of the views, each shifted exactly by a phase ramp in its spectrum; periodic edges.

    Parameters
    ----------
    lf : LightField
    disparities : numpy.ndarray
        Shape (n,), float64.
    weights : numpy.ndarray
        Shape (V, U), not all 0.

    Returns
    -------
    pyopencl.array.Array
        float32, shape (n, y, x[, c]).
    """
    device, count = lf.device, len(disparities)
    _, U, ny, nx = lf.shape[:4]
    down, right = shifts(lf, disparities)
    if lf.positions is None:
        down, right = np.broadcast_arrays(down[:, :, None], right[:, None, :])
    out = device.empty((count, *lf.shape[2:]), np.float32)
    scale = np.full(count, 1 / weights.sum(dtype=np.float64))
    rows = [v for v in range(len(weights)) if weights[v].any()]
    for channel in range(channels_of(lf)):
        total = device.zeros((count, ny, nx), np.complex64)
        for v in rows:
            views = take_views(lf, weights[v], np.arange(v * U, (v + 1) * U), channel)
            device.fft.forward(views, device)
            device.launch_rows(
                device.kernel("fourier.cl", "ramp_sum"),
                total.shape,
                total,
                views,
                device.upload(_ramp(down[:, v], ny)),
                device.upload(_ramp(right[:, v], nx)),
                *(np.int32(n) for n in (U, ny, nx)),
            )
        device.fft.inverse(total, device)
        keep_real(out, total, scale, channel, lf)
    return out


def turned(lf: LightField, spectra: cla.Array, down: Vector, right: Vector) -> None:
    """Move pictures, given by their spectra (k, y, x), by so many pixels each, in place.

    Parameters
    ----------
    lf : LightField
        Of whose views they are.
    spectra : pyopencl.array.Array
        complex64, shape (k, y, x).
    down, right : numpy.ndarray
        Shape (k,): what becomes sample (y, x) lay at (y + down, x + right).
    """
    count, ny, nx = (int(n) for n in spectra.shape)
    lf.device.launch_rows(
        lf.device.kernel("fourier.cl", "turn_views"),
        (count, ny, nx),
        spectra,
        lf.device.upload(_ramp(down, ny)),
        lf.device.upload(_ramp(right, nx)),
        *(np.int32(n) for n in (ny, nx)),
    )


def _ramp(shift: Vector, n: int) -> np.ndarray[Any, np.dtype[np.complex64]]:
    """exp(2 pi i f s) of every shift, shape (..., n)."""
    turns = np.multiply.outer(shift, np.fft.fftfreq(n))
    return np.exp(2j * np.pi * (turns - np.rint(turns))).astype(np.complex64)
