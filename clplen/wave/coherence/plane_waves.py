"""The sum of many plane waves on a grid."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.phase_tables import phasor

Vector = np.ndarray[Any, Any]

_STRETCH = 32  # samples between two phases that are made by themselves


class _Blocks(NamedTuple):
    """What one work-item sums in registers: see plane_waves.cl."""

    LANES: int
    VECTORS: int
    HEIGHT: int


def plane_waves(
    frequencies: Vector, amplitudes: Vector, *, grid: Grid, wavelength: float, device: Device
) -> Field:
    """sum_p a_p exp(2 pi i (fy_p y + fx_p x)).

    Parameters
    ----------
    frequencies : numpy.ndarray
        Shape (points, 2), float64: (fy, fx) in cycles a metre. Along an axis of length 1 nothing
        varies: there the frequency does not count.
    amplitudes : numpy.ndarray
        Shape (points,), complex128.
    grid : Grid
        Phases are 0 at its coordinate (0, 0), wherever its samples lie.
    wavelength : float
        In metres, of the field returned.
    device : Device

    Returns
    -------
    Field
        Shape (ny, nx).

    Raises
    ------
    ShapeError
        If the shapes of frequencies and amplitudes do not fit.
    """
    points = len(amplitudes)
    if np.shape(frequencies) != (points, 2) or points == 0:
        raise ShapeError(
            f"{points} plane waves take frequencies of shape ({points}, 2), at least one, not "
            f"{np.shape(frequencies)}."
        )
    (ny, nx), blocks = grid.shape, _blocks(device)
    middle = grid.origin[1] + ((nx - 1) / 2 - nx // 2) * grid.pitch[1]
    fy, fx = (f if n > 1 else 0 * f for f, n in zip(frequencies.T, grid.shape, strict=True))
    rows = _waves(fy, grid.y[0], grid.pitch[0], ny)
    rows *= (amplitudes * phasor(fx * middle))[:, None]
    columns = _waves(fx, (nx - 1) % 2 * grid.pitch[1] / 2, grid.pitch[1], (nx + 1) // 2)
    out = device.empty(grid.shape, device.complex)
    kernel = device.kernel(
        "plane_waves.cl", "plane_waves", **blocks._asdict(), **device.wave_defines()
    )
    down, across = -(-ny // blocks.HEIGHT), -(-((nx + 1) // 2) // (blocks.LANES * blocks.VECTORS))
    device.launch(
        kernel,
        (down, across) if device.rows else (across, down),
        out,
        device.upload(_row_blocks(rows, blocks.HEIGHT, device.complex)),
        device.upload(_column_blocks(columns, blocks.LANES * blocks.VECTORS, device.real)),
        np.int32(points),
        np.int32(ny),
        np.int32(nx),
    )
    return Field(out, grid, float(wavelength), device)


def _blocks(device: Device) -> _Blocks:
    """Accumulators (4 LANES VECTORS HEIGHT) that fit the registers."""
    if not device.rows:
        return _Blocks(1, 1, 4)
    single = device.precision == "single"
    cl_device, most = device.cl_device, 16 if single else 8
    wide = cl_device.native_vector_width_float if single else cl_device.native_vector_width_double
    lanes = min(max(int(wide), most // 4), most)
    return _Blocks(lanes, 2 if lanes == most else 1, 3)


def _waves(frequency: Vector, first: float, pitch: float, count: int) -> Vector:
    """exp(2 pi i f (first + i pitch)), shape (points, count), complex128.

    A product of the phases of every 32nd sample and of the samples in between: a tenth of the
    exponentials.
    """
    stretches = -(-count // _STRETCH)
    coarse = phasor(np.multiply.outer(frequency, first + np.arange(stretches) * _STRETCH * pitch))
    fine = phasor(np.multiply.outer(frequency, np.arange(min(_STRETCH, count)) * pitch))
    waves = coarse[:, :, None] * fine[:, None, :]
    return waves.reshape(len(frequency), -1)[:, :count]


def _row_blocks(waves: Vector, height: int, dtype: np.dtype[Any]) -> Vector:
    """(points, n) as (n / height, points, height), filled up with 0."""
    points, n = waves.shape
    count = -(-n // height)
    packed = np.zeros((points, count * height), dtype)
    packed[:, :n] = waves
    return packed.reshape(points, count, height).swapaxes(0, 1)


def _column_blocks(waves: Vector, width: int, dtype: np.dtype[Any]) -> Vector:
    """(points, n) as (n / width, points, 2, width): cosines and sines, filled up with 0."""
    points, n = waves.shape
    count = -(-n // width)
    packed = np.zeros((count, points, 2, width), dtype)
    for i in range(count):
        part = waves[:, i * width : (i + 1) * width]
        packed[i, :, 0, : part.shape[1]] = part.real
        packed[i, :, 1, : part.shape[1]] = part.imag
    return packed
