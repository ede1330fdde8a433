"""Volumes to frames as the camera takes them, on any lattice of lenslets, and back.

`Projector` makes frames whose pixels repeat with the lattice. A camera's pixels do not: the lattice
is turned, has a fractional pitch, or is hexagonal. Here the model is interpolated to them, never
the frame:

    g = W H V,   V' = H' W' g,

H the point images as coefficients of cubic B-splines about their pixels,
f[k] = (c[k - 1] + 4 c[k] + c[k + 1])/6, W the sum of the splines at the centres of the camera's
pixels (Unser 1999), times the area of one in pixels of the other; W' its exact transpose. Counts
are then those of the camera: whole, independent, and Poisson's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.light_field_microscope import Microscope
from clplen.checks import require
from clplen.compute.device import DeviceLike, as_device
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.decode_adjoint import resample_adjoint
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.model.cells import Cell, Pair, place_of
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.reconstruction.volume_projector import checked_pair

Vector = np.ndarray[Any, Any]

COARSEST = 0.9  # pixels of the point images for one of the camera: fewer would step over light
APART = 0.02  # of the pitch, between the pixels that images integrate over and those of the lattice
_REACH = 2  # pixels that cubic interpolation mixes, on either side
_SPLINE = 1 / 6, 2 / 3  # a cubic B-spline at the next pixel and at its own


class FrameProjector(Projector):
    """Forward and backward projection onto the pixels of a camera, as `deconvolve` takes it.

    The volume lies along the lattice's own vectors, under all cells (`PointImages.cell`) that the
    frame shows a part of: see `place`. Light from beyond these cells is not part of it.

    Parameters
    ----------
    images : PointImages
        Of the microscope with the array along the axes; made with ``sensor_pixels``, and 1.5 to 2
        times as many pixels, they are those of pixels that integrate.
    lattice : Lattice
        Of the lenslets on the frame: square, oblong or hexagonal, turned and with any pitch.
        Lenslet (0, 0) is one of the first kind. Of a hexagonal lattice with its nearest neighbours
        along y, ``lattice.turned``, voxels' x runs down and y to the left.
    shape : tuple of int, optional
        (ny, nx) of frames; default that of the lattice.
    device : Device or str, optional
        None is ``Device.open()``.
    memory : int, optional
        Bytes for matrices, as of `Projector`.

    Attributes
    ----------
    images, lattice, device
        As given.
    shape : tuple of int
        (rows, columns) of cells.
    volume_shape : tuple of int
        (planes, rows vy, columns vx).
    frame_shape : tuple of int
        (ny, nx).

    Raises
    ------
    ShapeError
        If the shape of frames is not known, or not two positive integers.
    ValueError
        If the point images have fewer than 0.9 pixels for one of the camera, or are those of other
        ``sensor_pixels``, or of another kind of lattice.
    TypeError
        If images or lattice are none.
    DeviceError
        If the projection of one frame does not fit the device.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full", lattice="hexagonal"))
    >>> images = clplen.point_images(
    ...     camera, [50e-6], voxels_per_lenslet=2, sensor_pixels=7.5, cut=0.05)
    >>> lattice = clplen.lightfield.Lattice(
    ...     "hexagonal", (30.0, 31.0), (6.4, 1.2), (-1.3, 7.4), shape=(60, 64))
    >>> projector = clplen.microscopy.FrameProjector(images, lattice)
    >>> projector.volume_shape, projector.frame_shape
    ((1, 28, 22), (60, 64))
    """

    def __init__(
        self,
        images: PointImages,
        lattice: Lattice,
        *,
        shape: tuple[int, int] | None = None,
        device: DeviceLike | None = None,
        memory: int | None = None,
    ) -> None:
        device = as_device(device)
        require(PointImages, images, "images", "point_images")
        require(Lattice, lattice, "lattice", "estimate_lattice")
        shape = lattice.shape if shape is None else shape
        frame = checked_pair(shape, "(ny, nx) of frames, as of the lattice")
        _check_lattice(images, lattice)
        self.lattice = lattice
        self._steps = _steps(lattice, images.cell)
        self._first, cells = _cells_under(lattice, self._steps, images.cell, frame)
        self._grid = _grid(lattice, self._steps, self._first, images.cell, frame)
        self._area = _area(self._grid)
        if self._area < COARSEST**2:
            raise ValueError(
                f"The point images have {self._area:.3g} pixels for one of the camera and would "
                f"step over light: give their camera at least "
                f"{math.ceil(COARSEST * lattice.neighbour)} pixels a lenslet (times its binning)."
            )
        super().__init__(images, cells, device=device, memory=memory)
        self.frame_shape, pixels = frame, math.prod(frame)
        self._between = pixels * math.ceil(math.prod(self._model_shape) / pixels)
        self.require_memory(1)

    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        model = super().project(volumes, clamp=False)
        count, device = int(model.shape[0]), self.device
        out = device.empty((count, *self.frame_shape), np.float32)
        for number in range(count):
            one = model[number].copy() if count > 1 else model
            seen = self._on_camera(one.reshape(self._model_shape))
            device.copy_into(out, seen, 4 * number * math.prod(self.frame_shape))
        if clamp:
            with device.on_host(out) as values:
                np.maximum(values, 0, out=values)
        return out

    def back_project(self, frames: cla.Array) -> cla.Array:
        count, device = int(frames.shape[0]), self.device
        model = device.empty((count, *self._model_shape), np.float32)
        for number in range(count):
            one = self._on_model(frames[number].copy() if count > 1 else frames)
            device.copy_into(model, one, 4 * number * math.prod(self._model_shape))
        return super().back_project(model)

    def _on_camera(self, model: cla.Array) -> cla.Array:
        """W of a model's frame, on the device."""
        return resample(model, self._grid, self.device, interpolation="spline")

    def _on_model(self, frame: cla.Array) -> cla.Array:
        """W' of a frame, on the device."""
        views = frame.reshape(self._grid.shape)
        return resample_adjoint(
            views, self._model_shape, self._grid, device=self.device, interpolation="spline"
        )

    def of_cell(self, cell: Vector) -> Vector:
        """Return the frame of an array whose cells all have one picture.

        ``cell`` has coefficients of B-splines about the pixels of a cell, in counts of a pixel of
        the camera, shape (ny, nx). Those of an even cell are its level.
        """
        model = self.device.upload(np.tile(cell.astype(np.float32), self.shape))
        return self.device.download(self._on_camera(model)).reshape(self.frame_shape)

    def to_cells(self, frame: Vector) -> Vector:
        """Apply the adjoint of interpolation; float32, shape (rows, ny, columns, nx)."""
        values = self.device.upload(np.ascontiguousarray(frame, np.float32))
        model = self.device.download(self._on_model(values))
        (rows, columns), (ny, nx) = self.shape, self._cell.pixels
        return model.reshape(rows, ny, columns, nx)

    def _of_part(self, plane: int, part: int, start: int, count: int) -> Vector:
        """Coefficients of point images, for each pixel of the camera the light of one."""
        pictures = super()._of_part(plane, part, start, count)
        found = spline_coefficients(pictures)
        found *= self._area
        return found.astype(np.float32)

    def place(self) -> dict[str, tuple[float, float]]:
        """Return where columns of voxels lie on the frame, as `Preparation.place`."""
        voxels = np.array(self._cell.voxels)
        down, right = self._steps / voxels[:, None]
        start = (
            np.array(self.lattice.origin)
            + (np.array(self._first) - 0.5 + 0.5 / voxels) @ self._steps
        )
        return place_of(start, down, right)


def lattice_of(camera: Microscope) -> Lattice:
    """Return the lattice of a camera's lenslets on its frames, as a white frame would tell it.

    Parameters
    ----------
    camera : Microscope
        Simulated, with its array as it lies on the frames.

    Returns
    -------
    Lattice
        Its lenslet (0, 0) is one of the first kind, near the middle of the array.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full", rotation=0.1))
    >>> lattice = clplen.microscopy.lattice_of(camera)
    >>> lattice.origin, lattice.shape, f"{lattice.rotation:.2f}"
    ((29.5, 29.5), (60, 60), '0.10')
    """
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    mla, grid, pitch = camera.mla, camera.grid, camera.pixel_pitch
    centres = (mla.centres() - np.array(grid.origin)) / pitch + np.array(grid.shape) // 2
    known = mla.types() == 0
    if mla.lattice == "hexagonal":
        known[1::2] = False
    away = np.hypot(*np.moveaxis(centres - (np.array(grid.shape) - 1) / 2, -1, 0))
    y, x = centres.reshape(-1, 2)[np.where(known, away, np.inf).argmin()]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    row = (mla.row_pitch * cos / pitch, -mla.row_pitch * sin / pitch)
    column = (mla.pitch * sin / pitch, mla.pitch * cos / pitch)
    return Lattice(
        mla.lattice, (float(y), float(x)), row, column, shape=grid.shape, verdict="of the camera"
    )


def _check_lattice(images: PointImages, lattice: Lattice) -> None:
    """Refuse the lattice of another array than that of the point images."""
    of = images.parameters.get("lattice", "square")
    if lattice.kind != of:
        raise ValueError(
            f"The lattice of the frame is {lattice.kind} and that of the point images {of}: give "
            "the camera of the point images the array of the frame."
        )
    pixels = images.parameters.get("sensor_pixels")
    if pixels is not None and abs(lattice.neighbour / pixels - 1) > APART:
        raise ValueError(
            f"The lenslets of the frame lie {lattice.neighbour:.5g} pixels apart, and those of the "
            f"point images {pixels:.5g}: give point_images sensor_pixels={lattice.neighbour:.5g}."
        )


def _steps(lattice: Lattice, cell: Cell) -> Vector:
    """From a cell to the next one below and to the right, (y, x) in pixels, shape (2, 2)."""
    down, right = np.array(lattice.row), np.array(lattice.column)
    if lattice.turned:
        down, right = -right, down
    return np.array([cell.lenslets[0] * down, cell.lenslets[1] * right])


def _cells_under(lattice: Lattice, steps: Vector, cell: Cell, frame: Pair) -> tuple[Pair, Pair]:
    """The first cell under a frame, from that of lenslet (0, 0), and how many (rows, columns)."""
    corners = np.array([(y, x) for y in (0, frame[0] - 1) for x in (0, frame[1] - 1)])
    places = (corners - lattice.origin) @ np.linalg.inv(steps)
    beyond = _REACH / np.array(cell.pixels)
    first = np.floor(places.min(axis=0) - beyond + 0.5).astype(int)
    last = np.floor(places.max(axis=0) + beyond + 0.5).astype(int)
    return (int(first[0]), int(first[1])), (
        int(last[0] - first[0]) + 1,
        int(last[1] - first[1]) + 1,
    )


def _grid(lattice: Lattice, steps: Vector, first: Pair, cell: Cell, frame: Pair) -> LensletGrid:
    """Where the pixels of a frame lie on the model: a "lenslet" with one view each."""
    pixels = np.array(cell.pixels)
    to_model = np.linalg.inv(steps) * pixels
    corner = -np.array(lattice.origin) @ to_model + (0.5 - np.array(first)) * pixels - 0.5
    (ay, ax), (by, bx) = to_model.tolist()
    return LensletGrid(frame, (1, 1), (float(corner[0]), float(corner[1])), (ay, ax), (by, bx))


def _area(grid: LensletGrid) -> float:
    """Pixels of the model that have the area of one of the camera."""
    (ay, ax), (by, bx) = grid.row_step, grid.column_step
    return float(abs(ay * bx - ax * by))


def spline_coefficients(pictures: Vector) -> Vector:
    """The coefficients c of B-splines that pass through all pixels; none lie outside a picture."""
    found = np.asarray(pictures, np.float64)
    for axis in (-1, -2):
        found = np.moveaxis(_along_last(np.moveaxis(found, axis, -1)), -1, axis)
    return found


def _along_last(values: Vector) -> Vector:
    """The same along the last axis."""
    from scipy.linalg import solveh_banded  # a slow import

    n = values.shape[-1]
    if n == 1:
        return values / _SPLINE[1]
    bands = np.array([np.full(n, _SPLINE[0]), np.full(n, _SPLINE[1])])
    lines = values.reshape(-1, n).T
    return np.asarray(solveh_banded(bands, lines, check_finite=False)).T.reshape(values.shape)
