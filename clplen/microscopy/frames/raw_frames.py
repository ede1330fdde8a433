"""Preparation of raw frames without rectification, for `FrameProjector`.

Unlike `preparation`, nothing is resampled. The white frame gives the lattice and the sensitivity of
each pixel: its level over that of the interpolated mean cell. The mean cell is fitted to the white
frame by Richardson-Lucy iterations over the pixels of a cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from clplen.checks import require
from clplen.compute.device import DeviceLike, as_device
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.prepare import (
    MIN_WHITE_LEVEL,
    Preparation,
    dark_frame,
    white_frame,
)
from clplen.microscopy.frames.sharpness import projected_sharpness
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.frame_projector import FrameProjector

Vector = np.ndarray[Any, Any]

ITERATIONS = 12  # Richardson-Lucy iterations for the mean cell


@dataclass(frozen=True, eq=False, repr=False)
class RawPreparation(Preparation):
    """Preparation shared by all raw frames of a camera. Made by `raw_preparation`.

    Attributes
    ----------
    pixels, device, dark, lattice, sensitivity, level, mask, sharpest
        Attributes of `Preparation`, on camera pixels instead of rectified pixels.
    projector : FrameProjector or None
        Projector onto the raw frames.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(
    ...     camera, [50e-6], voxels_per_lenslet=1, sensor_pixels=9.6, cut=0.05)
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> prepare = clplen.microscopy.raw_preparation(images, white=1000 * np.outer(wave, wave))
    >>> prepare(500 * np.outer(wave, wave)).counts.shape, prepare.projector.frame_shape
    ((60, 60), (60, 60))
    """

    projector: FrameProjector | None = None

    _MIN_LIGHT: ClassVar[float] = 0.5  # excludes cells cut off by the border of a frame

    @property
    def _map(self) -> FrameProjector:
        assert self.projector is not None
        return self.projector

    @property
    def area(self) -> float:
        """Area of a pixel in camera pixels, 1 without rectification."""
        return 1.0

    @property
    def variance(self) -> float:
        """Variance of a pixel over its mean if counts are photons, 1 without rectification."""
        return 1.0

    def voxel_grid(self, voxels: int) -> dict[str, tuple[float, float]]:
        """Return the voxel grid on the raw frame; see `Preparation.voxel_grid`."""
        return self._map.voxel_grid()

    def _cells(self, frame: Vector) -> Vector:
        return self._map.to_cells(frame)

    def _resampled(self, light: Vector) -> Vector:
        return light

    def _reached(self, bad: Vector) -> Vector:
        return bad


def raw_preparation(
    images: PointImages,
    *,
    white: Any,
    device: DeviceLike | None = None,
    dark: Any = None,
    saturation: float | None = None,
    force: bool = False,
    mask: Any = None,
    find_hot: bool = False,
    memory: int | None = None,
) -> RawPreparation:
    """Estimate lattice and pixel sensitivity from a white frame; build the projector.

    For an array of several focal lengths, comparing the white frame with the uniform light of the
    point images identifies the lenslets of the first kind.

    Parameters
    ----------
    images : PointImages
        Point images as in `FrameProjector`.
    white : array_like
        White frame, shape (ny, nx).
    device : Device or str, optional
        OpenCL device; None is ``Device.open()``.
    dark : array_like, optional
        Dark frame, shape (ny, nx).
    saturation : float, optional
        Saturation level as in `preparation`.
    force : bool
        True to continue with an unreliable lattice of the white frame.
    mask : array_like, optional
        Mask, shape (ny, nx), with nonzero values at pixels excluded from all frames.
    find_hot : bool
        True to exclude hot pixels; see `hot_pixels`.
    memory : int, optional
        Memory for matrices in bytes; see `Projector`.

    Returns
    -------
    RawPreparation
        Preparation to be called with each raw frame of the camera.

    Raises
    ------
    ShapeError, ValueError, DeviceError
        See `preparation` and `FrameProjector`.
    TypeError
        If ``images`` are not PointImages.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(
    ...     camera, [50e-6], voxels_per_lenslet=1, sensor_pixels=9.6, cut=0.05)
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> prepare = clplen.microscopy.raw_preparation(images, white=1000 * np.outer(wave, wave))
    >>> f"{prepare.lattice.pitch[0]:.1f} pixels per lenslet", prepare.sensitivity.shape
    ('9.6 pixels per lenslet', (60, 60))
    """
    device = as_device(device)
    require(PointImages, images, "images", "point_images")
    reference = white_frame(
        white, dark, saturation, kind=images.parameters.get("lattice", "square"),
        pitch=float(images.parameters.get("sensor_pixels", images.pixels)), mask=mask,
        find_hot=find_hot, force=force,
    )  # fmt: skip
    lattice = _first_kind_lattice(images, reference.lattice, reference.light, device)
    projector = FrameProjector(images, lattice, device=device, memory=memory)
    level = np.where(reference.bad, np.float32(0), reference.light)
    return RawPreparation(
        images.pixels,
        projector.device,
        dark_frame(dark),
        projector.lattice,
        _sensitivity(projector, level, ~reference.bad),
        level,
        reference.mask,
        projected_sharpness(projector, images) if find_hot else None,
        projector,
    )


def _first_kind_lattice(
    images: PointImages, lattice: Lattice, light: Vector, device: Any
) -> Lattice:
    """Shift the origin of the lattice to a lenslet of the first kind."""
    kinds = images.cell.lenslets[1]
    if kinds == 1:
        return lattice
    uniform = evenly_lit(images)
    along = np.array(lattice.row if lattice.turned else lattice.column)
    best, best_correlation = lattice, -np.inf
    for number in range(kinds):
        y, x = np.array(lattice.origin) + number * along
        candidate = replace(lattice, origin=(float(y), float(x)))
        frame = FrameProjector(images, candidate, device=device).tiled_frame(uniform)
        correlation = float(np.corrcoef(frame.ravel(), light.ravel())[0, 1])
        if correlation > best_correlation:
            best, best_correlation = candidate, correlation
    return best


def evenly_lit(images: PointImages) -> Vector:
    """Return the picture of a cell under even light from the plane with the widest blur."""
    (ny, nx), total = images.cell.pixels, np.zeros(images.cell.pixels)
    plane = int(np.abs(images.planes).argmax())
    for phase in np.ndindex(images.cell.voxels):
        image = images.image(plane, (phase[0], phase[1]))
        blocks = image.reshape(-1, ny, image.shape[1] // nx, nx)
        total += blocks.sum(axis=(0, 2), dtype=np.float64)
    return total


def _sensitivity(projector: FrameProjector, level: Vector, valid: Vector) -> Vector:
    """Divide the levels by the interpolated mean cell; dark pixels become 0."""

    def sums(frame: Vector) -> Vector:
        return np.asarray(projector.to_cells(frame).sum(axis=(0, 2), dtype=np.float64))

    weight = np.maximum(sums(valid.astype(np.float32)), 1e-6)
    cell = np.full(weight.shape, float(level[valid].mean(dtype=np.float64)))
    for _ in range(ITERATIONS):
        mean = projector.tiled_frame(cell)
        ratio = np.divide(level, mean, out=np.zeros_like(level), where=valid & (mean > 0))
        cell *= np.maximum(sums(ratio), 0) / weight
    mean = projector.tiled_frame(cell)
    bright = valid & (mean > MIN_WHITE_LEVEL * level.mean(dtype=np.float64)) & (level > 0)
    ratio = np.divide(level, mean, out=np.zeros_like(level), where=bright)
    return np.asarray(ratio, np.float32)
