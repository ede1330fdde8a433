"""Point images of a Fourier light-field microscope, one behind each lenslet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.cameras.optics.lenslet_layout import rim_coverage as covered

Vector = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, repr=False)
class FourierPointImages:
    """Point images of a Fourier microscope, simulated by `fourier_point_images` or measured.

    The image of a point is shift-invariant within a sub-image. A plane is therefore described by
    an image per lenslet, or by b x b images if voxels are finer than pixels.

    Attributes
    ----------
    parameters : dict
        Parameters of the images by name: numbers in SI units, lists and strings.
    planes : numpy.ndarray
        z of each plane in metres, farther positive, float64, shape (planes,).
    voxels : int
        Number b of voxels per pixel along an axis.
    side : float
        Side of a voxel along y and x, in metres.
    shape : tuple of int
        Shape (ny, nx) of the sensor in pixels.
    centres : numpy.ndarray
        Images (y, x) of the axis point in the focal plane, in pixels with integer centres,
        float64, shape (lenslets, 2).
    radius : float
        Radius of a sub-image in pixels, set by the field stop, which blocks light beyond it.
    stored : tuple of numpy.ndarray
        Images of each plane, float32, shape (b b, lenslets, k, k).
    corners : numpy.ndarray
        First sensor pixel (y, x) of each image of the axis pixel, int32, shape (planes, lenslets,
        2).

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> images
    <FourierPointImages of 2 planes, 9 lenslets, 188 x 188 pixels, ... MiB>
    >>> f"voxels of {images.side * 1e6:.2f} um"
    'voxels of 1.67 um'
    """

    parameters: dict[str, Any]
    planes: Vector
    voxels: int
    side: float
    shape: tuple[int, int]
    centres: Vector
    radius: float
    stored: tuple[Vector, ...]
    corners: Vector

    def __repr__(self) -> str:
        size = sum(images.nbytes for images in self.stored) / 2**20
        return (
            f"<FourierPointImages of {len(self.planes)} planes, {len(self.centres)} lenslets, "
            f"{self.shape[0]} x {self.shape[1]} pixels, {size:.3g} MiB>"
        )

    @property
    def sides(self) -> tuple[float, float]:
        """Equal sides (dy, dx) of a voxel in metres."""
        return self.side, self.side

    @property
    def field(self) -> tuple[int, int]:
        """Shape (rows, columns) in pixels of a volume as wide as a sub-image, odd."""
        across = 2 * int(np.ceil(self.radius)) + 1
        return across, across

    def inside(self, lenslet: int, corner: tuple[int, int], shape: tuple[int, int]) -> Vector:
        """Return the share of each pixel from ``corner`` on inside a lenslet's sub-image."""
        y, x = (
            first + np.arange(n) - middle
            for first, n, middle in zip(corner, shape, self.centres[lenslet], strict=True)
        )
        return covered(self.radius - np.hypot(y[:, None], x), 1.0).astype(np.float32)

    def image(self, plane: int, phase: tuple[int, int]) -> Vector:
        """Return the frame of a single voxel of energy 1 in the pixel on the axis, float32.

        ``phase`` is the position (sy, sx) of the voxel in its pixel, each from 0 to b - 1.
        """
        b = self.voxels
        if not all(0 <= s < b for s in phase):
            raise ValueError(f"phase must be (0, 0) to ({b - 1}, {b - 1}), got {phase!r}.")
        ny, nx = self.shape
        frame = np.zeros((ny, nx), np.float32)
        stack = self.stored[plane][phase[0] * b + phase[1]]
        for lenslet, image in enumerate(stack):
            y, x = map(int, self.corners[plane, lenslet])
            lit = image * self.inside(lenslet, (y, x), (image.shape[0], image.shape[1]))
            rows = slice(max(y, 0), min(y + image.shape[0], ny))
            columns = slice(max(x, 0), min(x + image.shape[1], nx))
            if rows.start < rows.stop and columns.start < columns.stop:
                part = lit[rows.start - y : rows.stop - y, columns.start - x : columns.stop - x]
                frame[rows, columns] += part
        return frame

    def captured_share(self, plane: int) -> float:
        """Return the minimum share of a voxel's light in the pupil that its images contain."""
        return float(self.stored[plane].sum(axis=(1, 2, 3), dtype=np.float64).min())
