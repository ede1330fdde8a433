"""Exact shifts of views by phase ramps in their spectra, and means of shifted views."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.compute.device import Device, DeviceLike
from clplen.errors import ShapeError
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.alpha_law import shifts
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

Vector = np.ndarray[Any, np.dtype[np.float64]]
Matrix = np.ndarray[Any, np.dtype[np.complex128]]


def channels_of(lf: LightField) -> int:
    """Return the number of channels of a light field."""
    return lf.shape[4] if len(lf.shape) == 5 else 1


def take_views(lf: LightField, weights: Any, views: Any, channel: int) -> cla.Array:
    """Return the weighted views of one channel, complex64, shape (k, y, x)."""
    ny, nx = lf.shape[2:4]
    views = np.asarray(views, np.int32)
    out = lf.device.empty((len(views), ny, nx), np.complex64)
    lf.device.launch_rows(
        lf.device.kernel("fourier.cl", "take_views", SAMPLE=C_TYPE[lf.dtype]),
        out.shape,
        out,
        lf.data,
        lf.device.upload(views),
        lf.device.upload(np.asarray(weights, np.float32)),
        *(np.int32(n) for n in (ny, nx, channels_of(lf), channel)),
    )
    return out


def keep_real(out: cla.Array, values: cla.Array, scale: Any, channel: int, lf: LightField) -> None:
    """Write scaled real parts of pictures (k, y, x) to a channel of (k, y, x[, c])."""
    count, ny, nx = (int(n) for n in values.shape)
    lf.device.launch_rows(
        lf.device.kernel("fourier.cl", "keep_real"),
        (count, ny, nx),
        out,
        values,
        lf.device.upload(np.asarray(scale, np.float32)),
        *(np.int32(n) for n in (ny, nx, channels_of(lf), channel)),
    )


def fourier_matrix(size: int, positions: np.ndarray[Any, Any], *, inverse: bool = False) -> Matrix:
    """Return exp(-2 pi i k t/size) for k = 0 .. size - 1 and positions t, shape (size, n).

    The inverse is the conjugate transpose over the size, (n, size).
    """
    turns = np.outer(np.arange(size), positions) / size
    matrix = np.exp(-2j * np.pi * (turns - np.rint(turns)))
    return matrix.conj().T / size if inverse else matrix


def transform_views(
    values: cla.Array, matrix: Matrix, *, batch: int, n: int, device: Device
) -> cla.Array:
    """Multiply an axis by a matrix (i, j): (batch, j, n) to (batch, i, n), complex64."""
    rows, columns = matrix.shape
    out = device.empty((batch, rows, n), np.complex64)
    device.launch_rows(
        device.kernel("fourier.cl", "transform_views"),
        (batch, rows, n),
        out,
        values,
        device.upload(matrix.astype(np.complex64)),
        *(np.int32(m) for m in (rows, columns, n)),
    )
    return out


def fourier_refocus(lf: LightField, disparities: Vector, weights: Any) -> cla.Array:
    """Average the views, shifted exactly by phase ramps of their spectra; periodic edges."""
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


def shift_spectra(lf: LightField, spectra: cla.Array, down: Vector, right: Vector) -> None:
    """Shift pictures, given as spectra (k, y, x), in place by some pixels each."""
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
    """Return exp(2 pi i f s) of every shift, shape (..., n)."""
    turns = np.multiply.outer(shift, np.fft.fftfreq(n))
    return np.exp(2j * np.pi * (turns - np.rint(turns))).astype(np.complex64)


def shift_views(
    lf: LightField | ArrayLike, steps: Any, *, device: DeviceLike | None = None
) -> LightField:
    """Shift each view of a light field by its own distance.

    The sample at (y + steps[v, u, 0], x + steps[v, u, 1]) of view (v, u) moves to (y, x), by the
    phase of its spectrum: exact below the Nyquist frequency, with periodic edges and constant sums.
    The views' positions on the main lens do not change.

    Parameters
    ----------
    lf : LightField or array_like
        The light field.
    steps : array_like
        Shifts (y, x) in pixels, shape (V, U, 2), finite.
    device : Device or str, optional
        Device for an array; default ``Device.open()``. A light field stays on its device.

    Returns
    -------
    LightField
        Light field, float32, of unchanged shape, without a raw image.

    Raises
    ------
    ShapeError
        If the steps are not a pair for each view.
    ValueError
        If a step is not finite.
    DeviceError
        If both light fields exceed the device's memory.

    Examples
    --------
    >>> L = np.random.default_rng(1).random((3, 3, 32, 32), np.float32)
    >>> moved = clplen.lightfield.shift_views(L, np.zeros((3, 3, 2)))
    >>> bool(np.allclose(moved.to_numpy(), L, atol=1e-6))
    True
    """
    lf = as_lightfield(lf, device=device)
    shift = real_array(steps, "steps", np.float64)
    V, U, ny, nx = lf.shape[:4]
    if shift.shape != (V, U, 2):
        raise ShapeError(f"steps must have shape {(V, U, 2)}, got {shift.shape}.")
    if not np.isfinite(shift).all():
        raise ValueError("steps must be finite, in pixels.")
    device, row_shape = lf.device, (U, ny, nx, *lf.shape[4:])
    device.require_memory(2 * 4 * int(np.prod(lf.shape)), "The light field of moved views")
    out = device.empty(lf.shape, np.float32)
    row = device.empty(row_shape, np.float32)
    for v in range(V):
        for channel in range(channels_of(lf)):
            views = take_views(lf, np.ones(U), np.arange(v * U, (v + 1) * U), channel)
            device.fft.forward(views, device)
            shift_spectra(lf, views, *shift[v].T)
            device.fft.inverse(views, device)
            keep_real(row, views, np.ones(U), channel, lf)
        device.copy_into(out, row, v * row.nbytes)
    return replace(lf, data=out, raw=None)
