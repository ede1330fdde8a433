"""The images of a point behind every lenslet of a Fourier light-field microscope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.cameras.optics.lenslet_layout import rim_coverage as covered

Vector = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, repr=False)
class FourierPointImages:
    """Point images of a Fourier microscope. Made by `fourier_point_images`, or measured.

    Within a sub-image a point's image has the same form everywhere, so that one of each lenslet
    describes a plane: b x b of them where voxels are finer than pixels.

    Attributes
    ----------
    parameters : dict
        Everything that they depend on, by name: numbers in SI units, lists and strings.
    planes : numpy.ndarray
        float64, shape (planes,): z of each plane in metres, farther positive.
    voxels : int
        b, of a pixel along an axis.
    side : float
        Of a voxel along y and x, in metres.
    shape : tuple of int
        (ny, nx) pixels of the sensor.
    centres : numpy.ndarray
        float64, shape (lenslets, 2): (y, x) in pixels, whose centres are integers, of the axis
        point in the focal plane.
    radius : float
        Of a sub-image in pixels: the field stop's. Light beyond is cut off.
    stored : tuple of numpy.ndarray
        For each plane the images, float32, shape (b b, lenslets, k, k).
    corners : numpy.ndarray
        int32, shape (planes, lenslets, 2): pixel (y, x) of the sensor where an image of the axis
        pixel begins.

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
        size = sum(one.nbytes for one in self.stored) / 2**20
        return (
            f"<FourierPointImages of {len(self.planes)} planes, {len(self.centres)} lenslets, "
            f"{self.shape[0]} x {self.shape[1]} pixels, {size:.3g} MiB>"
        )

    @property
    def sides(self) -> tuple[float, float]:
        """(dy, dx) of a voxel in metres, which are the same."""
        return self.side, self.side

    @property
    def field(self) -> tuple[int, int]:
        """Pixels (rows, columns) of a volume as wide as a sub-image, odd."""
        across = 2 * int(np.ceil(self.radius)) + 1
        return across, across

    def inside(self, lenslet: int, corner: tuple[int, int], shape: tuple[int, int]) -> Vector:
        """Return the share of pixels from ``corner`` on in the sub-image of a lenslet, float32."""
        y, x = (
            first + np.arange(n) - middle
            for first, n, middle in zip(corner, shape, self.centres[lenslet], strict=True)
        )
        return covered(self.radius - np.hypot(y[:, None], x), 1.0).astype(np.float32)

    def image(self, plane: int, phase: tuple[int, int]) -> Vector:
        """Return the frame of one voxel of energy 1 in the pixel on the axis, float32.

        ``phase`` is (sy, sx) of the voxel in its pixel, each from 0 to b - 1.
        """
        b = self.voxels
        if not all(0 <= s < b for s in phase):
            raise ValueError(f"A pixel has voxels (0, 0) to ({b - 1}, {b - 1}), not {phase!r}.")
        ny, nx = self.shape
        frame = np.zeros((ny, nx), np.float32)
        stack = self.stored[plane][phase[0] * b + phase[1]]
        for lenslet, image in enumerate(stack):
            y, x = (int(one) for one in self.corners[plane, lenslet])
            lit = image * self.inside(lenslet, (y, x), (image.shape[0], image.shape[1]))
            rows = slice(max(y, 0), min(y + image.shape[0], ny))
            columns = slice(max(x, 0), min(x + image.shape[1], nx))
            if rows.start < rows.stop and columns.start < columns.stop:
                part = lit[rows.start - y : rows.stop - y, columns.start - x : columns.stop - x]
                frame[rows, columns] += part
        return frame

    def kept(self, plane: int) -> float:
        """The least share of a voxel's light, of that in the pupil, in its images of a plane."""
        return float(self.stored[plane].sum(axis=(1, 2, 3), dtype=np.float64).min())
