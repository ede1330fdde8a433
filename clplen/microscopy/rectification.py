"""Frames of a real array, turned and of a fractional pitch, to whole pixels a lenslet."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from clplen.checks import positive_integer, real_array, require
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage

Vector = np.ndarray[Any, Any]

LEAST = 0.9  # of the pitch: with fewer pixels the energy of a spot depends on its place
REACH = 2  # pixels that cubic interpolation mixes, on either side


def rectify(
    frame: Any,
    lattice: Lattice,
    *,
    device: DeviceLike | None = None,
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
    device : Device or str, optional
        None is ``Device.open()``.
    pixels : int, optional
        n, along an axis, at least 0.9 of the pitch: fewer would step over light; default the pitch,
        rounded up.
    complete : bool
        Whether to leave out lenslets that do not lie on the frame with all their pixels; pixels at
        the rim of a frame are then repeated beyond it. Else it is dark there.

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
    TypeError
        If the frame is no array of real numbers, or the lattice none.
    """
    device = as_device(device)
    require(Lattice, lattice, "lattice", "estimate_lattice")
    values = real_array(frame, "A frame")
    if values.ndim != 2:
        raise ShapeError(f"A frame has shape (ny, nx), not {values.shape}: rectify each by itself.")
    if lattice.shape is not None and values.shape != lattice.shape:
        raise ShapeError(f"The lattice is that of a frame of {lattice.shape}, not {values.shape}.")
    if lattice.kind == "hexagonal":
        raise ValueError("Frames of hexagonal lattices are not rectified: the lattice is square.")
    n = max(map(math.ceil, lattice.pitch)) if pixels is None else positive_integer(pixels, "pixels")
    least = math.ceil(LEAST * max(lattice.pitch))
    if n < least:
        raise ValueError(
            f"The lenslets of the frame lie {max(lattice.pitch):.5g} pixels apart, and {n} pixels "
            f"a lenslet would step over light: give at least {least}."
        )
    grid = lattice.grid((n, n), complete=complete)
    if complete:
        values = np.pad(values, REACH, mode="edge")
        grid = replace(grid, first=(grid.first[0] + REACH, grid.first[1] + REACH))
    raw = RawImage(device.upload(values), device, math.nan, grid, grid)
    views = device.download(resample(raw, grid))
    rows, columns = views.shape[2:]
    cells = np.maximum(views, 0).transpose(2, 0, 3, 1) * np.float32(area(lattice, n))
    return np.ascontiguousarray(cells.reshape(rows * n, columns * n))


def area(lattice: Lattice, pixels: int) -> float:
    """Pixels of the camera that a rectified pixel holds the light of."""
    return math.prod(lattice.pitch) / pixels**2


def variance(lattice: Lattice, pixels: int) -> float:
    """Variance of a rectified pixel over its mean, where counts are photons.

    The area times the sum of the squared weights, mean of all pixels: (57/70)^2 where they lie
    evenly between those of the camera, 1 where they lie on them.
    """
    grid = lattice.grid((pixels, pixels))
    v, kept = np.arange(pixels) - (pixels - 1) / 2, np.ones(())
    for axis in (0, 1):
        across = np.add.outer(np.arange(grid.count[1]) * grid.column_step[axis],
                              v * grid.column_view_step[axis])  # fmt: skip
        down = np.add.outer(np.arange(grid.count[0]) * grid.row_step[axis],
                            v * grid.row_view_step[axis])  # fmt: skip
        t = (grid.first[axis] + np.add.outer(down.ravel(), across.ravel())) % 1
        weights = (
            ((1 - t / 2) * t - 1 / 2) * t,
            (1.5 * t - 2.5) * t**2 + 1,
            ((2 - 1.5 * t) * t + 1 / 2) * t,
            (t / 2 - 1 / 2) * t**2,
        )
        kept = kept * sum(np.square(weight) for weight in weights)
    return area(lattice, pixels) * float(kept.mean())
