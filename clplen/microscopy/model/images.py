"""Point images of a light-field microscope, the images of a volume's voxels."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np

from clplen.checks import check_finite
from clplen.microscopy.model.cells import Cell, cell_in

Vector = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False, repr=False)
class PointImages:
    """Point images of a microscope. Made by `clplen.microscopy.point_images`.

    Attributes
    ----------
    parameters : dict
        Parameters of the images by name: numbers in SI units and strings.
    planes : numpy.ndarray
        z of each plane in metres, farther positive, float64, shape (planes,).
    voxels : int
        Number v of voxels per lenslet along x; along y, too, in a square lattice.
    pixels : int
        Number n of pixels per lenslet along x; along y, too, in a square lattice.
    stored : tuple of numpy.ndarray
        Different images of each plane, float32 or float16, shape (u, ny ky, nx kx), in the order
        of ``cell.phases()``, on k = 2 r + 1 cells about the cell of the voxel. Cells of a square
        lattice with a single kind of lenslets are lenslets: shape (u, n k, n k), phases (a, b) with
        a <= b <= (v - 1)/2.
    scales : numpy.ndarray
        Factors of the stored numbers, float64, shape (planes,).
    notes : dict
        Further numbers, which do not change the images: "sensor_pixels", nominal sensor pixels per
        lenslet before rectification; "binning_error", relative difference (norm over norm) of an
        image to that with pixels half as large.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.microscopy.point_images(
    ...     camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> images
    <PointImages of 2 planes, 3 x 3 voxels and 11 x 11 pixels a lenslet, ... MiB>
    >>> f"voxels of {images.side * 1e6:.0f} um"
    'voxels of 2 um'
    """

    parameters: dict[str, Any]
    planes: Vector
    voxels: int
    pixels: int
    stored: tuple[Vector, ...]
    scales: Vector
    notes: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {
            name: value for name, value in self.parameters.items() if isinstance(value, Real)
        }
        check_finite(**numbers, planes=self.planes, voxels=self.voxels, pixels=self.pixels)

    def __repr__(self) -> str:
        size = sum(images.nbytes for images in self.stored) / 2**20
        (vy, vx), (ny, nx), (rows, columns) = self.cell.voxels, self.cell.pixels, self.cell.lenslets
        unit = "a lenslet" if rows * columns == 1 else f"a cell of {rows} x {columns} lenslets"
        return (
            f"<PointImages of {len(self.planes)} planes, {vy} x {vx} voxels and {ny} x {nx} pixels "
            f"{unit}, {size:.3g} MiB>"
        )

    @cached_property
    def cell(self) -> Cell:
        """Unit cell of the array: a lenslet, or a rectangle of several lenslets."""
        return cell_in(self.parameters, self.voxels, self.pixels)

    @property
    def side(self) -> float:
        """Side of a voxel along x, in metres."""
        return self.sides[1]

    @property
    def sides(self) -> tuple[float, float]:
        """Sides (dy, dx) of a voxel in metres, equal in a square lattice."""
        parameters = self.parameters
        lenslet = parameters["lenslet_pitch"] / parameters["magnification"]
        dx = lenslet / self.voxels
        (height, width), (vy, vx) = self.cell.size, self.cell.voxels
        return float(dx if height * vx == width * vy else lenslet * height / vy), float(dx)

    @property
    def radii(self) -> tuple[int, ...]:
        """Radius of the images of each plane along x, in cells."""
        return tuple(r for _, r in self.reaches)

    @property
    def reaches(self) -> tuple[tuple[int, int], ...]:
        """Radii (ry, rx) of the images of each plane in cells, equal in a square lattice."""
        ny, nx = self.cell.pixels
        shapes = (images.shape[1:] for images in self.stored)
        return tuple(((y // ny - 1) // 2, (x // nx - 1) // 2) for y, x in shapes)

    @property
    def blurs(self) -> Vector:
        """Blur radius of a point in lenslets, by plane; below 1/2 no lenslet resolves detail."""
        parameters = self.parameters
        tangent = parameters["na"] / np.sqrt(
            np.square(parameters["medium_index"]) - np.square(parameters["na"])
        )
        scale = parameters["magnification"] * tangent / parameters["lenslet_pitch"]
        return np.asarray(np.abs(self.planes) * scale)

    def image(self, plane: int, phase: tuple[int, int]) -> Vector:
        """Return the image of a voxel of energy 1, float32, shape (ny ky, nx kx).

        ``phase`` is the position (sy, sx) of the voxel in its cell, the centre of the image.
        """
        vy, vx = self.cell.voxels
        if not (0 <= phase[0] < vy and 0 <= phase[1] < vx):
            raise ValueError(f"phase must be (0, 0) to ({vy - 1}, {vx - 1}), got {phase!r}.")
        source, turned, exchanged = self.cell.folded(phase)
        image = self.stored[plane][self._numbers[source]]
        if exchanged:
            image = image.T
        down, right = (-1 if turn else 1 for turn in turned)
        values = image[::down, ::right].astype(np.float32)
        return np.ascontiguousarray(values * np.float32(self.scales[plane]))

    @cached_property
    def _numbers(self) -> dict[tuple[int, int], int]:
        """Index of the stored image of each phase."""
        return {phase: number for number, phase in enumerate(self.cell.phases())}

    def part(self, plane: int, phase: tuple[int, int], part: int) -> Vector:
        """Return the even or odd part of an image under the mirrors, see `Cell.parts`."""
        total = self.image(plane, phase)
        (vy, vx), (a, b), parts = self.cell.voxels, phase, self.cell.parts
        if len(parts) == 1:
            return total
        turned = self.image(plane, (vy - 1 - a, vx - 1 - b))[::-1, ::-1]
        total = (total + (-turned if part & 1 else turned)) / 2
        if not any(p & 2 for p in parts):
            return total
        mirrored = self.image(plane, (vy - 1 - a, b))[::-1]
        other = self.image(plane, (a, vx - 1 - b))[:, ::-1]
        mirrored = (mirrored + (-other if part & 1 else other)) / 2
        return np.asarray((total + (-mirrored if part & 2 else mirrored)) / 2)

    def captured_share(self, plane: int) -> float:
        """Return the minimum share of a voxel's light that its image in a plane contains."""
        sums = self.stored[plane].astype(np.float64).sum(axis=(1, 2))
        return float(sums.min() * self.scales[plane])
