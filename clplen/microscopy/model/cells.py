"""Unit cell of a lenslet array: the rectangle that repeats, with its voxels and pixels.

    square, one kind       1 x 1 lenslet       both mirrors, and y <-> x
    square, two kinds      2 x 2               both mirrors, and y <-> x
    square, n kinds        n/gcd(n, s) x n     y -> -y for n = 4
    hexagonal, one kind    2 x 1, sqrt(3) p high, a lenslet in the middle and one in the corners
                                               both mirrors
    hexagonal, three kinds 2 x 3               y -> -y; x -> -x exchanges the second and the third

Cells are centred on a lenslet of the first kind and form rows and columns without offset: a lattice
of any kind is a rectangular lattice of cells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from clplen.compute.fft.lines import smooth_length
from clplen.wave.elements.zernike import noll

Pair = tuple[int, int]

_ROOT = math.sqrt(3)


@dataclass(frozen=True)
class Cell:
    """Unit cell of an array, centred on a lenslet of the first kind."""

    lenslets: Pair  # (rows, columns) of lenslets with the area of the cell
    size: tuple[float, float]  # (height, width) over the pitch
    voxels: Pair  # (vy, vx)
    pixels: Pair  # (ny, nx)
    mirror_y: bool  # True if the array is symmetric under y -> -y
    mirror_x: bool  # True if the array is symmetric under x -> -x
    transposed: bool  # True if the array is symmetric under the exchange of y and x
    turned: bool  # True if the array is symmetric under (y, x) -> (-y, -x)

    @property
    def parts(self) -> tuple[int, ...]:
        """Parity classes of the point images, each with matrices of its own in the projector.

        Bit 0 marks parts that are odd under the reversal of y and x, bit 1 under that of y.
        """
        return tuple(part for part in range(4) if self._has(part))

    def _has(self, part: int) -> bool:
        """Return True if the symmetries of the array allow the signs of a part."""
        turn, down = (-1 if part & bit else 1 for bit in (1, 2))
        right = turn * down
        signs = ((self.mirror_y, down), (self.mirror_x, right), (self.turned, turn))
        return all(sign > 0 or not mirror for mirror, sign in signs)

    def with_aberrations(self, orders: Sequence[int]) -> Cell:
        """Return the cell without the symmetries that Zernike orders of the pupil break."""
        return replace(
            self,
            mirror_y=self.mirror_y and all(m >= 0 for m in orders),
            mirror_x=self.mirror_x and all((m < 0) == (m % 2 == 1) for m in orders),
            transposed=self.transposed and not any(orders),
            turned=self.turned and all(m % 2 == 0 for m in orders),
        )

    def phases(self) -> list[Pair]:
        """Return the voxels (sy, sx) of a cell that are not mirror images of other voxels."""
        vy, vx = self.voxels
        rows = range((vy + 1) // 2 if self.mirror_y else vy)
        columns = range((vx + 1) // 2 if self.mirror_x else vx)
        return [(a, b) for a in rows for b in columns if not self.transposed or a <= b]

    @property
    def count(self) -> int:
        """Number of `phases`."""
        rows, columns = (
            (v + 1) // 2 if mirror else v
            for v, mirror in zip(self.voxels, (self.mirror_y, self.mirror_x), strict=True)
        )
        return rows * (rows + 1) // 2 if self.transposed else rows * columns

    def folded(self, phase: Pair) -> tuple[Pair, tuple[bool, bool], bool]:
        """Return the phase with the mirrored image of a voxel, the mirrors (y, x) and exchange."""
        mirrors = (self.mirror_y, self.mirror_x)
        turned = [
            mirror and s > v - 1 - s
            for s, v, mirror in zip(phase, self.voxels, mirrors, strict=True)
        ]
        a, b = (
            v - 1 - s if turn else s for s, v, turn in zip(phase, self.voxels, turned, strict=True)
        )
        exchanged = self.transposed and a > b
        return ((b, a) if exchanged else (a, b)), (turned[0], turned[1]), exchanged


def voxel_grid(first: Any, down: Any, right: Any) -> dict[str, tuple[float, float]]:
    """Return the first position and the steps of the voxels on a frame, (y, x) in pixels."""
    return {
        name: (round(float(y), 4), round(float(x), 4))
        for name, (y, x) in (("first", first), ("down", down), ("right", right))
    }


def cell_of(lattice: str, kinds: int, *, voxels: int, pixels: int) -> Cell:
    """Return the cell of an array from the voxels and pixels per lenslet.

    Rows of a hexagonal lattice are sqrt(3)/2 of the pitch apart. Along y its cell gets the next
    integer number of voxels, none higher than wide. Its number of pixels is rounded up to a length
    with fast transforms.
    """
    if lattice == "hexagonal":
        high = smooth_length(math.ceil(_ROOT * pixels))
        size, count = (_ROOT, float(kinds)), (math.ceil(_ROOT * voxels), kinds * voxels)
        mirror_x, shape = kinds == 1, (high, kinds * pixels)
        return Cell((2, kinds), size, count, shape, True, mirror_x, False, mirror_x)
    step = 2 if kinds > 3 else 1
    rows = kinds // math.gcd(kinds, step)
    lenslets = (rows, kinds)
    return Cell(
        lenslets,
        (float(rows), float(kinds)),
        (rows * voxels, kinds * voxels),
        (rows * pixels, kinds * pixels),
        2 * step % kinds == 0,
        kinds <= 2,
        kinds <= 2,
        kinds <= 2,
    )


def cell_in(parameters: Mapping[str, Any], voxels: int, pixels: int) -> Cell:
    """Return the cell of the array described by `PointImages.parameters`."""
    kinds = len(parameters.get("lenslet_focal_lengths", (0,)))
    cell = cell_of(parameters.get("lattice", "square"), kinds, voxels=voxels, pixels=pixels)
    return cell.with_aberrations([noll(int(j))[1] for j in parameters.get("pupil") or ()])
