"""Channels of a light field as complex arrays, transforms over its view axes, and the way back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.stored_samples import C_TYPE

if TYPE_CHECKING:
    from clplen.compute.device import Device
    from clplen.lightfield.model.light_field import LightField

Vector = np.ndarray[Any, np.dtype[np.float64]]
Matrix = np.ndarray[Any, np.dtype[np.complex128]]


def channels_of(lf: LightField) -> int:
    """Colours of a light field, 1 without."""
    return lf.shape[4] if len(lf.shape) == 5 else 1


def take_views(lf: LightField, weights: Any, views: Any, channel: int) -> cla.Array:
    """Views of one channel times their weights, complex64, shape (k, y, x).

    Parameters
    ----------
    lf : LightField
    weights : array_like
        Shape (k,).
    views : array_like
        Shape (k,): v U + u of each.
    channel : int
    """
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
    """Real parts of pictures (k, y, x), each times its scale, into a channel of (k, y, x[, c])."""
    count, ny, nx = (int(n) for n in values.shape)
    lf.device.launch_rows(
        lf.device.kernel("fourier.cl", "keep_real"),
        (count, ny, nx),
        out,
        values,
        lf.device.upload(np.asarray(scale, np.float32)),
        *(np.int32(n) for n in (ny, nx, channels_of(lf), channel)),
    )


def fourier_matrix(size: int, places: np.ndarray[Any, Any], *, inverse: bool = False) -> Matrix:
    """exp(-2 pi i k t / size) of frequencies k = 0 .. size - 1 and places t, shape (size, n).

    The inverse is its conjugate over the size, transposed: (n, size).
    """
    turns = np.outer(np.arange(size), places) / size
    matrix = np.exp(-2j * np.pi * (turns - np.rint(turns)))
    return matrix.conj().T / size if inverse else matrix


def mix(values: cla.Array, matrix: Matrix, *, batch: int, n: int, device: Device) -> cla.Array:
    """A matrix (i, j) times one axis of an array: (batch, j, n) becomes (batch, i, n), complex64.

    Parameters
    ----------
    values : pyopencl.array.Array
        complex64; any shape of batch j n samples.
    matrix : numpy.ndarray
    batch, n : int
        Lengths of what comes before and behind the axis.
    device : Device
    """
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
