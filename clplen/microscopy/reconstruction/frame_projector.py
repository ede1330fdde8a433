"""Projection of volumes to raw camera frames on any lattice of lenslets, and its exact adjoint.

Frames of `Projector` are periodic with the lattice. Raw frames are not: the lattice is rotated, has
a fractional pitch, or is hexagonal. This module interpolates the model instead of the frame:

    g = W H V,   V' = H' W' g.

H gives the coefficients of cubic B-splines about the pixels of the point images,
f[k] = (c[k - 1] + 4 c[k] + c[k + 1])/6. W sums the splines at the centres of the camera pixels
(see Unser's 1999 review), times the ratio of pixel areas; W' is its transpose. The counts stay
integer, independent and Poisson distributed.
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
from clplen.microscopy.model.cells import Cell, Pair, voxel_grid
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.reconstruction.volume_projector import checked_pair

Vector = np.ndarray[Any, Any]

MIN_PIXEL_RATIO = 0.9  # pixels of the point images per camera pixel; fewer would lose light
PITCH_TOLERANCE = 0.02  # relative difference of the pitch of the frame and of the point images
_REACH = 2  # pixels, support of cubic interpolation on either side
_SPLINE = 1 / 6, 2 / 3  # cubic B-spline at the adjacent pixel and at the central pixel


class FrameProjector(Projector):
    """Forward and backward projection onto raw camera pixels, for `deconvolve`.

    The volume follows the lattice vectors (`voxel_grid`). It covers all cells (`PointImages.cell`)
    that are at least partly on the frame; light from outside is not modelled.

    Parameters
    ----------
    images : PointImages
        Point images of the microscope with an array along the axes. Make them with
        ``sensor_pixels`` and 1.5 to 2 times as many pixels, to model the area of camera pixels.
    lattice : Lattice
        Lattice of the lenslets on the frame: square, oblong or hexagonal, with any rotation and
        pitch. Lenslet (0, 0) has the first focal length. If the nearest neighbours of a hexagonal
        lattice are along y (``lattice.turned``), x of the voxels runs down and y to the left.
    shape : tuple of int, optional
        Shape (ny, nx) of frames; default the shape of the lattice.
    device : Device or str, optional
        OpenCL device; None is ``Device.open()``.
    memory : int, optional
        Memory for matrices in bytes; see `Projector`.

    Attributes
    ----------
    images, lattice, device
        Point images, lattice and device of the projector.
    shape : tuple of int
        Number (rows, columns) of cells.
    volume_shape : tuple of int
        Shape (planes, rows vy, columns vx) of a volume.
    frame_shape : tuple of int
        Shape (ny, nx) of a frame.

    Raises
    ------
    ShapeError
        If the shape of frames is missing, or not two positive integers.
    ValueError
        If the point images have fewer than 0.9 pixels per camera pixel, or do not match the lattice
        in kind or in ``sensor_pixels``.
    TypeError
        If images or lattice have another type.
    DeviceError
        If the projection of a frame does not fit the device.

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
        if self._area < MIN_PIXEL_RATIO**2:
            raise ValueError(
                f"The point images have only {self._area:.3g} pixels per camera pixel and would "
                "lose light: give their camera at least "
                f"{math.ceil(MIN_PIXEL_RATIO * lattice.neighbour)} pixels per lenslet (times its "
                "binning)."
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
            picture = model[number].copy() if count > 1 else model
            frame = self._on_camera(picture.reshape(self._model_shape))
            device.copy_into(out, frame, 4 * number * math.prod(self.frame_shape))
        if clamp:
            with device.on_host(out) as values:
                np.maximum(values, 0, out=values)
        return out

    def back_project(self, frames: cla.Array) -> cla.Array:
        count, device = int(frames.shape[0]), self.device
        model = device.empty((count, *self._model_shape), np.float32)
        for number in range(count):
            picture = self._on_model(frames[number].copy() if count > 1 else frames)
            device.copy_into(model, picture, 4 * number * math.prod(self._model_shape))
        return super().back_project(model)

    def _on_camera(self, model: cla.Array) -> cla.Array:
        """Apply W to a frame of the model, on the device."""
        return resample(model, self._grid, self.device, interpolation="spline")

    def _on_model(self, frame: cla.Array) -> cla.Array:
        """Apply W' to a camera frame, on the device."""
        views = frame.reshape(self._grid.shape)
        return resample_adjoint(
            views, self._model_shape, self._grid, device=self.device, interpolation="spline"
        )

    def tiled_frame(self, cell: Vector) -> Vector:
        """Return the frame of an array with identical cells.

        ``cell`` contains the B-spline coefficients of a cell in counts per camera pixel, shape (ny,
        nx). The coefficients of a uniform cell are its level.
        """
        model = self.device.upload(np.tile(cell.astype(np.float32), self.shape))
        return self.device.download(self._on_camera(model)).reshape(self.frame_shape)

    def to_cells(self, frame: Vector) -> Vector:
        """Apply the adjoint of the interpolation; return float32, (rows, ny, columns, nx)."""
        values = self.device.upload(np.ascontiguousarray(frame, np.float32))
        model = self.device.download(self._on_model(values))
        (rows, columns), (ny, nx) = self.shape, self._cell.pixels
        return model.reshape(rows, ny, columns, nx)

    def _part_images(self, plane: int, part: int, start: int, count: int) -> Vector:
        """Return the spline coefficients of point images, scaled to the area of camera pixels."""
        pictures = super()._part_images(plane, part, start, count)
        coefficients = spline_coefficients(pictures)
        coefficients *= self._area
        return coefficients.astype(np.float32)

    def voxel_grid(self) -> dict[str, tuple[float, float]]:
        """Return the voxel grid on the frame; see `Preparation.voxel_grid`."""
        voxels = np.array(self._cell.voxels)
        down, right = self._steps / voxels[:, None]
        start = (
            np.array(self.lattice.origin)
            + (np.array(self._first) - 0.5 + 0.5 / voxels) @ self._steps
        )
        return voxel_grid(start, down, right)


def lattice_of(camera: Microscope) -> Lattice:
    """Return the lattice of a camera's lenslets on its frames, in place of a white frame.

    Parameters
    ----------
    camera : Microscope
        Simulated camera with the rotation and offset of its array on the frames.

    Returns
    -------
    Lattice
        Lattice whose lenslet (0, 0) is of the first kind and near the centre of the array.

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
    is_first_kind = mla.types() == 0
    if mla.lattice == "hexagonal":
        is_first_kind[1::2] = False
    distance = np.hypot(*np.moveaxis(centres - (np.array(grid.shape) - 1) / 2, -1, 0))
    y, x = centres.reshape(-1, 2)[np.where(is_first_kind, distance, np.inf).argmin()]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    row = (mla.row_pitch * cos / pitch, -mla.row_pitch * sin / pitch)
    column = (mla.pitch * sin / pitch, mla.pitch * cos / pitch)
    return Lattice(
        mla.lattice, (float(y), float(x)), row, column, shape=grid.shape, verdict="of the camera"
    )


def _check_lattice(images: PointImages, lattice: Lattice) -> None:
    """Raise ValueError if the kinds or pitches of the frame and the point images differ."""
    kind = images.parameters.get("lattice", "square")
    if lattice.kind != kind:
        raise ValueError(
            f"The lattice of the frame is {lattice.kind} and the lattice of the point images "
            f"{kind}: give the camera of the point images the array of the frame."
        )
    pixels = images.parameters.get("sensor_pixels")
    if pixels is not None and abs(lattice.neighbour / pixels - 1) > PITCH_TOLERANCE:
        raise ValueError(
            f"The lenslet pitch is {lattice.neighbour:.5g} pixels on the frame and {pixels:.5g} in "
            f"the point images: give point_images sensor_pixels={lattice.neighbour:.5g}."
        )


def _steps(lattice: Lattice, cell: Cell) -> Vector:
    """Return the steps (y, x) to the next cell below and to the right in pixels, shape (2, 2)."""
    down, right = np.array(lattice.row), np.array(lattice.column)
    if lattice.turned:
        down, right = -right, down
    return np.array([cell.lenslets[0] * down, cell.lenslets[1] * right])


def _cells_under(lattice: Lattice, steps: Vector, cell: Cell, frame: Pair) -> tuple[Pair, Pair]:
    """Return the first cell under a frame, counted from lenslet (0, 0), and (rows, columns)."""
    corners = np.array([(y, x) for y in (0, frame[0] - 1) for x in (0, frame[1] - 1)])
    indices = (corners - lattice.origin) @ np.linalg.inv(steps)
    margin = _REACH / np.array(cell.pixels)
    first = np.floor(indices.min(axis=0) - margin + 0.5).astype(int)
    last = np.floor(indices.max(axis=0) + margin + 0.5).astype(int)
    return (int(first[0]), int(first[1])), (
        int(last[0] - first[0]) + 1,
        int(last[1] - first[1]) + 1,
    )


def _grid(lattice: Lattice, steps: Vector, first: Pair, cell: Cell, frame: Pair) -> LensletGrid:
    """Return the camera pixels on the model as a grid of lenslets with a single view."""
    pixels = np.array(cell.pixels)
    to_model = np.linalg.inv(steps) * pixels
    corner = -np.array(lattice.origin) @ to_model + (0.5 - np.array(first)) * pixels - 0.5
    (ay, ax), (by, bx) = to_model.tolist()
    return LensletGrid(frame, (1, 1), (float(corner[0]), float(corner[1])), (ay, ax), (by, bx))


def _area(grid: LensletGrid) -> float:
    """Return the area of a camera pixel in pixels of the model."""
    (ay, ax), (by, bx) = grid.row_step, grid.column_step
    return float(abs(ay * bx - ax * by))


def spline_coefficients(pictures: Vector) -> Vector:
    """Return the B-spline coefficients that interpolate pictures, 0 outside of them."""
    coefficients = np.asarray(pictures, np.float64)
    for axis in (-1, -2):
        coefficients = np.moveaxis(_along_last(np.moveaxis(coefficients, axis, -1)), -1, axis)
    return coefficients


def _along_last(values: Vector) -> Vector:
    """Return the B-spline coefficients along the last axis."""
    from scipy.linalg import solveh_banded  # a slow import

    n = values.shape[-1]
    if n == 1:
        return values / _SPLINE[1]
    bands = np.array([np.full(n, _SPLINE[0]), np.full(n, _SPLINE[1])])
    lines = values.reshape(-1, n).T
    return np.asarray(solveh_banded(bands, lines, check_finite=False)).T.reshape(values.shape)
