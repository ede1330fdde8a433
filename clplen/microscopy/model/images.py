"""The images of a volume's voxels behind a light-field microscope."""

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
        Everything that they depend on, by name: numbers in SI units and strings.
    planes : numpy.ndarray
        float64, shape (planes,): z of each plane in metres, farther positive.
    voxels : int
        v, of a lenslet along x; of a square lattice along y, too.
    pixels : int
        n, likewise.
    stored : tuple of numpy.ndarray
        For each plane the different images, float32 or float16, shape (u, ny ky, nx kx), k = 2 r +
        1 cells about that of the voxel, in the order of ``cell.phases()``. A square lattice of one
        kind of lenslets has cells of a lenslet: shape (u, n k, n k), phases (a, b), a <= b <= (v -
        1)/2.
    scales : numpy.ndarray
        float64, shape (planes,): what the stored numbers are multiplied by.
    notes : dict
        Numbers that tell more of them, without which they are the same: "sensor_pixels", pixels a
        lenslet of the sensor by the parameters, before rectification; "binning_error", how far an
        image is from that of pixels twice as fine, norm over norm.

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
        about = {name: one for name, one in self.parameters.items() if isinstance(one, Real)}
        check_finite(**about, planes=self.planes, voxels=self.voxels, pixels=self.pixels)

    def __repr__(self) -> str:
        size = sum(one.nbytes for one in self.stored) / 2**20
        (vy, vx), (ny, nx), (rows, columns) = self.cell.voxels, self.cell.pixels, self.cell.lenslets
        what = "a lenslet" if rows * columns == 1 else f"a cell of {rows} x {columns} lenslets"
        return (
            f"<PointImages of {len(self.planes)} planes, {vy} x {vx} voxels and {ny} x {nx} pixels "
            f"{what}, {size:.3g} MiB>"
        )

    @cached_property
    def cell(self) -> Cell:
        """What repeats: a lenslet, or a rectangle of some of them."""
        return cell_in(self.parameters, self.voxels, self.pixels)

    @property
    def side(self) -> float:
        """Of a voxel along x, in metres."""
        return self.sides[1]

    @property
    def sides(self) -> tuple[float, float]:
        """(dy, dx) of a voxel in metres; those of a square lattice are the same."""
        about = self.parameters
        lenslet = about["lenslet_pitch"] / about["magnification"]
        dx = lenslet / self.voxels
        (height, width), (vy, vx) = self.cell.size, self.cell.voxels
        return float(dx if height * vx == width * vy else lenslet * height / vy), float(dx)

    @property
    def radii(self) -> tuple[int, ...]:
        """r of each plane: cells along x from that of the voxel to the last one with light."""
        return tuple(r for _, r in self.reaches)

    @property
    def reaches(self) -> tuple[tuple[int, int], ...]:
        """(ry, rx) of each plane; those of a square lattice are the same."""
        ny, nx = self.cell.pixels
        shapes = (one.shape[1:] for one in self.stored)
        return tuple(((y // ny - 1) // 2, (x // nx - 1) // 2) for y, x in shapes)

    @property
    def blurs(self) -> Vector:
        """Lenslets that a point's light reaches to a side, by plane; below 1/2 none sees detail."""
        about = self.parameters
        tangent = about["na"] / np.sqrt(np.square(about["medium_index"]) - np.square(about["na"]))
        scale = about["magnification"] * tangent / about["lenslet_pitch"]
        return np.asarray(np.abs(self.planes) * scale)

    def image(self, plane: int, phase: tuple[int, int]) -> Vector:
        """Return the image of one voxel of energy 1, float32, shape (ny ky, nx kx).

        ``phase`` is (sy, sx) of the voxel in its cell; pixels are those of the cells about its own.
        """
        vy, vx = self.cell.voxels
        if not (0 <= phase[0] < vy and 0 <= phase[1] < vx):
            what = "lenslet" if self.cell.lenslets == (1, 1) else "cell"
            raise ValueError(f"A {what} has voxels (0, 0) to ({vy - 1}, {vx - 1}), not {phase!r}.")
        source, turned, exchanged = self.cell.folded(phase)
        found = self.stored[plane][self._numbers[source]]
        if exchanged:
            found = found.T
        down, right = (-1 if turn else 1 for turn in turned)
        values = found[::down, ::right].astype(np.float32)
        return np.ascontiguousarray(values * np.float32(self.scales[plane]))

    @cached_property
    def _numbers(self) -> dict[tuple[int, int], int]:
        """Where the images of phases are stored."""
        return {phase: number for number, phase in enumerate(self.cell.phases())}

    def part(self, plane: int, phase: tuple[int, int], part: int) -> Vector:
        """Return a part of an image, which keeps or changes its sign under the mirrors."""
        total = self.image(plane, phase)
        (vy, vx), (a, b), parts = self.cell.voxels, phase, self.cell.parts
        if len(parts) == 1:
            return total
        turned = self.image(plane, (vy - 1 - a, vx - 1 - b))[::-1, ::-1]
        total = (total + (-turned if part & 1 else turned)) / 2
        if not any(one & 2 for one in parts):
            return total
        mirrored = self.image(plane, (vy - 1 - a, b))[::-1]
        other = self.image(plane, (a, vx - 1 - b))[:, ::-1]
        mirrored = (mirrored + (-other if part & 1 else other)) / 2
        return np.asarray((total + (-mirrored if part & 2 else mirrored)) / 2)

    def kept(self, plane: int) -> float:
        """The least share of a voxel's light in its images of a plane."""
        sums = self.stored[plane].astype(np.float64).sum(axis=(1, 2))
        return float(sums.min() * self.scales[plane])
