"""The rectangle of an array of lenslets that repeats, with the voxels and pixels of it.

    square, one kind       1 x 1 lenslet       both mirrors, and y <-> x
    square, two kinds      2 x 2               both mirrors, and y <-> x
    square, n kinds        n/gcd(n, s) x n     y -> -y for n = 4
    hexagonal, one kind    2 x 1, sqrt(3) p high, a lenslet in the middle and one in the corners
                                               both mirrors
    hexagonal, three kinds 2 x 3               y -> -y; x -> -x exchanges the second and the third

Cells are centred on a lenslet of the first kind, and are rows and columns without offset, so that a
lattice of any kind is a rectangular lattice of cells.
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
    """A rectangle of an array that repeats, centred on a lenslet of the first kind."""

    lenslets: Pair  # (rows, columns) of lenslets whose area it has
    size: tuple[float, float]  # (height, width) over the pitch
    voxels: Pair  # (vy, vx)
    pixels: Pair  # (ny, nx)
    mirror_y: bool  # whether y -> -y leaves the array as it is
    mirror_x: bool  # x -> -x
    transposed: bool  # the exchange of y and x
    turned: bool  # (y, x) -> (-y, -x)

    @property
    def parts(self) -> tuple[int, ...]:
        """Parts of the point images that the projector keeps matrices of.

        Bit 0: what changes its sign where y and x are reversed; bit 1: where y is.
        """
        return tuple(part for part in range(4) if self._has(part))

    def _has(self, part: int) -> bool:
        """Whether anything has the signs of a part: not those that a mirror forbids."""
        turn, down = (-1 if part & bit else 1 for bit in (1, 2))
        right = turn * down
        signs = ((self.mirror_y, down), (self.mirror_x, right), (self.turned, turn))
        return all(sign > 0 or not mirror for mirror, sign in signs)

    def behind(self, orders: Sequence[int]) -> Cell:
        """The cell as light sees it whose pupil has aberrations."""
        return replace(
            self,
            mirror_y=self.mirror_y and all(m >= 0 for m in orders),
            mirror_x=self.mirror_x and all((m < 0) == (m % 2 == 1) for m in orders),
            transposed=self.transposed and not any(orders),
            turned=self.turned and all(m % 2 == 0 for m in orders),
        )

    def phases(self) -> list[Pair]:
        """Voxels (sy, sx) of a cell whose images are not mirror images of others."""
        vy, vx = self.voxels
        rows = range((vy + 1) // 2 if self.mirror_y else vy)
        columns = range((vx + 1) // 2 if self.mirror_x else vx)
        return [(a, b) for a in rows for b in columns if not self.transposed or a <= b]

    @property
    def count(self) -> int:
        """How many `phases` there are."""
        rows, columns = (
            (v + 1) // 2 if mirror else v
            for v, mirror in zip(self.voxels, (self.mirror_y, self.mirror_x), strict=True)
        )
        return rows * (rows + 1) // 2 if self.transposed else rows * columns

    def folded(self, phase: Pair) -> tuple[Pair, tuple[bool, bool], bool]:
        """The one of `phases` whose image that of a voxel is made of."""
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


def place_of(first: Any, down: Any, right: Any) -> dict[str, tuple[float, float]]:
    """Where columns of voxels lie on a frame: the first one, and steps, (y, x) in pixels."""
    return {
        name: (round(float(y), 4), round(float(x), 4))
        for name, (y, x) in (("first", first), ("down", down), ("right", right))
    }


def cell_of(lattice: str, kinds: int, *, voxels: int, pixels: int) -> Cell:
    """The cell of an array with some voxels and pixels a lenslet.

    A hexagonal lattice has about as many of them along y, where rows are sqrt(3)/2 of the pitch
    apart: the next whole number of voxels of a cell, none higher than wide, and the next one of
    pixels that transforms quickly.
    """
    if lattice == "hexagonal":
        high = smooth_length(math.ceil(_ROOT * pixels))
        size, many = (_ROOT, float(kinds)), (math.ceil(_ROOT * voxels), kinds * voxels)
        mirror_x = kinds == 1
        return Cell((2, kinds), size, many, (high, kinds * pixels), True, mirror_x, False, mirror_x)
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
    """The cell of what `PointImages.parameters` describe."""
    kinds = len(parameters.get("lenslet_focal_lengths", (0,)))
    cell = cell_of(parameters.get("lattice", "square"), kinds, voxels=voxels, pixels=pixels)
    return cell.behind([noll(int(j))[1] for j in parameters.get("pupil") or ()])
