"""Raw frames to counts and sensitivities of the camera's own pixels, for `FrameProjector`.

As `preparation`, but nothing is resampled. The white frame gives the lattice, and the sensitivity
of a pixel: its level over that of the mean cell at its place, the cell whose interpolation explains
the white frame best (Richardson and Lucy's iteration over the pixels of a cell).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from clplen.checks import require
from clplen.compute.device import DeviceLike, as_device
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.prepare import (
    DARKEST,
    Preparation,
    dark_frame,
    white_frame,
)
from clplen.microscopy.frames.sharpness import projected_sharpness
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.frame_projector import FrameProjector

Vector = np.ndarray[Any, Any]

STEPS = 12  # of the iteration that finds the mean cell


@dataclass(frozen=True, eq=False, repr=False)
class RawPreparation(Preparation):
    """What raw frames of one camera share. Made by `raw_preparation`; called with each of them.

    Attributes
    ----------
    pixels, device, dark, lattice, sensitivity, level, mask, sharpest
        As of `Preparation`, but of the camera's own pixels.
    projector : FrameProjector or None
        Onto the frames.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(
    ...     camera, [50e-6], voxels_per_lenslet=1, sensor_pixels=9.6, cut=0.05)
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> found = clplen.microscopy.raw_preparation(images, white=1000 * np.outer(wave, wave))
    >>> found(500 * np.outer(wave, wave)).counts.shape, found.projector.frame_shape
    ((60, 60), (60, 60))
    """

    projector: FrameProjector | None = None

    _MIN_LIGHT: ClassVar[float] = 0.5  # cells at the rim of a frame have less

    @property
    def _map(self) -> FrameProjector:
        assert self.projector is not None
        return self.projector

    @property
    def area(self) -> float:
        """1: pixels are those of the camera."""
        return 1.0

    @property
    def variance(self) -> float:
        """1: of a pixel over its mean, where counts are photons."""
        return 1.0

    def place(self, voxels: int) -> dict[str, tuple[float, float]]:
        """Where the columns of voxels lie on the raw frame, as of `Preparation`."""
        return self._map.place()

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
    """Find the lattice, the sensitivity of the pixels, and the projector onto raw frames.

    Of an array of several focal lengths the white frame tells which lenslets are of the first kind:
    it is compared with even light as the point images give it.

    Parameters
    ----------
    images : PointImages
        As of `FrameProjector`.
    white : array_like
        White frame, shape (ny, nx).
    device : Device or str, optional
        None is ``Device.open()``.
    dark : array_like, optional
        Dark frame, shape (ny, nx).
    saturation : float, optional
        As of `preparation`.
    force : bool
        As of `preparation`.
    mask : array_like, optional
        Shape (ny, nx), not 0 where pixels are left out of white and other frames.
    find_hot : bool
        Whether pixels that stand out as no light does are left out; see `hot_pixels`.
    memory : int, optional
        Bytes for matrices, as of `Projector`.

    Returns
    -------
    RawPreparation
        To be called with each raw frame of the same camera.

    Raises
    ------
    ShapeError, ValueError, DeviceError
        As `preparation` and `FrameProjector`.
    TypeError
        If the images are none.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=12,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(
    ...     camera, [50e-6], voxels_per_lenslet=1, sensor_pixels=9.6, cut=0.05)
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(60) / 9.6)  # lenslets 9.6 pixels apart
    >>> found = clplen.microscopy.raw_preparation(images, white=1000 * np.outer(wave, wave))
    >>> f"{found.lattice.pitch[0]:.1f} pixels a lenslet", found.sensitivity.shape
    ('9.6 pixels a lenslet', (60, 60))
    """
    device = as_device(device)
    require(PointImages, images, "images", "point_images")
    seen = white_frame(
        white, dark, saturation, kind=images.parameters.get("lattice", "square"),
        pitch=float(images.parameters.get("sensor_pixels", images.pixels)), mask=mask,
        find_hot=find_hot, force=force,
    )  # fmt: skip
    first = _of_first_kind(images, seen.lattice, seen.light, device)
    projector = FrameProjector(images, first, device=device, memory=memory)
    level = np.where(seen.bad, np.float32(0), seen.light)
    return RawPreparation(
        images.pixels,
        projector.device,
        dark_frame(dark),
        projector.lattice,
        _sensitivity(projector, level, ~seen.bad),
        level,
        seen.mask,
        projected_sharpness(projector, images) if find_hot else None,
        projector,
    )


def _of_first_kind(images: PointImages, lattice: Lattice, light: Vector, device: Any) -> Lattice:
    """The same lattice from a lenslet of the first kind on."""
    kinds = images.cell.lenslets[1]
    if kinds == 1:
        return lattice
    even = evenly_lit(images)
    along = np.array(lattice.row if lattice.turned else lattice.column)
    best, alike = lattice, -np.inf
    for number in range(kinds):
        y, x = np.array(lattice.origin) + number * along
        moved = replace(lattice, origin=(float(y), float(x)))
        seen = FrameProjector(images, moved, device=device).of_cell(even)
        found = float(np.corrcoef(seen.ravel(), light.ravel())[0, 1])
        if found > alike:
            best, alike = moved, found
    return best


def evenly_lit(images: PointImages) -> Vector:
    """The picture of a cell under even light, that of the plane farthest from the native one."""
    (ny, nx), even = images.cell.pixels, np.zeros(images.cell.pixels)
    plane = int(np.abs(images.planes).argmax())
    for phase in np.ndindex(images.cell.voxels):
        image = images.image(plane, (phase[0], phase[1]))
        blocks = image.reshape(-1, ny, image.shape[1] // nx, nx)
        even += blocks.sum(axis=(0, 2), dtype=np.float64)
    return even


def _sensitivity(projector: FrameProjector, level: Vector, known: Vector) -> Vector:
    """Levels over those of the mean cell; 0 where there is no light."""

    def sums(frame: Vector) -> Vector:
        return np.asarray(projector.to_cells(frame).sum(axis=(0, 2), dtype=np.float64))

    weight = np.maximum(sums(known.astype(np.float32)), 1e-6)
    cell = np.full(weight.shape, float(level[known].mean(dtype=np.float64)))
    for _ in range(STEPS):
        mean = projector.of_cell(cell)
        ratio = np.divide(level, mean, out=np.zeros_like(level), where=known & (mean > 0))
        cell *= np.maximum(sums(ratio), 0) / weight
    mean = projector.of_cell(cell)
    bright = known & (mean > DARKEST * level.mean(dtype=np.float64)) & (level > 0)
    found = np.divide(level, mean, out=np.zeros_like(level), where=bright)
    return np.asarray(found, np.float32)
