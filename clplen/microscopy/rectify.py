"""Frames of a real array, turned and of a fractional pitch, to whole pixels a lenslet."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.compute.device import Device, require_device
from clplen.errors import ShapeError
from clplen.lightfield.decode import resample
from clplen.lightfield.lattice import Lattice
from clplen.lightfield.raw import RawImage

Vector = np.ndarray[Any, Any]

LEAST = 0.9  # of the pitch: with fewer pixels the energy of a spot depends on its place


def rectify(
    frame: Any,
    lattice: Lattice,
    *,
    device: Device,
    pixels: int | None = None,
    complete: bool = True,
) -> Vector:
    """A frame on the lattice of its lenslets, n x n pixels each, as `Projector` takes it.

    Pixels lie along the lattice's own vectors, so that turning, a stretch of x against y and a
    fractional pitch go at once, by separable cubic convolution (Keys 1981, eq. 15, a = -1/2), and
    carry the light of their area: the sum is kept. What interpolation leaves below 0 is 0, and so
    is what was below it. Dark and white frames are rectified alike, after the dark frame was
    subtracted.

    Parameters
    ----------
    frame : array_like
        Counts, shape (ny, nx), finite.
    lattice : Lattice
        Rectangular, as `estimate_lattice` finds it on the white frame.
    device : Device
    pixels : int, optional
        n, along an axis, at least 0.9 of the pitch: fewer would step over light; default the pitch,
        rounded up.
    complete : bool
        Whether to leave out lenslets that do not lie on the frame with all their pixels.

    Returns
    -------
    numpy.ndarray
        float32, shape (rows n, columns n).

    Raises
    ------
    ShapeError
        If the frame has another shape than the lattice's picture, or no lenslet lies on it.
    ValueError
        If the lattice is hexagonal, ``pixels`` is no positive whole number or too small, or a pixel
        is NaN.
    """
    require_device(device)
    values = np.asarray(frame, np.float32)
    if lattice.shape is not None and values.shape != lattice.shape:
        raise ShapeError(f"The lattice is that of a frame of {lattice.shape}, not {values.shape}.")
    if lattice.kind == "hexagonal":
        raise ValueError("Frames of hexagonal lattices are not rectified: the lattice is square.")
    n = max(math.ceil(pitch) for pitch in lattice.pitch) if pixels is None else pixels
    if n != int(n) or n < 1:
        raise ValueError(f"pixels is a whole number from 1 on, not {pixels!r}.")
    n, least = int(n), math.ceil(LEAST * max(lattice.pitch))
    if n < least:
        raise ValueError(
            f"The lenslets of the frame lie {max(lattice.pitch):.5g} pixels apart, and {n} pixels "
            f"a lenslet would step over light: give at least {least}."
        )
    grid = lattice.grid((n, n), complete=complete)
    raw = RawImage(device.upload(values), device, math.nan, grid, grid)
    views = device.download(resample(raw, grid))
    rows, columns = views.shape[2:]
    area = math.prod(lattice.pitch) / n**2
    cells = np.maximum(views, 0).transpose(2, 0, 3, 1) * np.float32(area)
    return np.ascontiguousarray(cells.reshape(rows * n, columns * n))
