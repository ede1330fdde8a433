"""Period of the pattern behind a camera's lenslets, and the samples that it needs.

A point whose chief ray meets the array at X puts U(x) = G(x - X) exp(i pi x^2/(lam z2)) there
(paraxially; z2 from the main lens to the array), G with frequencies up to f_c = D/(2 lam z2). The
quadratic phase magnifies all that follows by m = 1 + z3/z2, z3 to the sensor, so that a shift of X
by a vector a of the lattice shifts the raw pattern by m a. As a function of X, the raw intensity at
a pixel is band-limited to 2 f_c: patterns of q x q positions of X in one cell, q > 4 f_c p,
determine those of every position (Whittaker 1915, Shannon 1949). A picture is resampled onto these
positions on every lenslet. Its raw image is the sum over the q^2 positions of pattern times weight,
shifted by m a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.cameras.optics.ray_optics import RayOptics
from clplen.cameras.scenes.scene_sources import PicturePlane

Vector = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]
OVERSAMPLING = 1.05  # positions a cell and axis over the minimum; shortens the kernel
STOP_DB = 80.0  # attenuation of the interpolating kernel's images
TOLERANCE = 5e-4  # maximum change of the pattern across a picture, of a raw image's maximum
Powers = tuple[tuple[int, int], ...]
CONSTANT: Powers = ((0, 0),)
LINEAR: Powers = ((0, 0), (1, 0), (0, 1))
EVEN: Powers = ((0, 0), (2, 0), (1, 1), (0, 2))
QUADRATIC: Powers = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
OUTERMOST_NODE = 0.9  # fraction of the distance to the edge; balances both interpolation errors
CHANGE_PER_RADIAN = 0.35  # measured change of a raw image, of its maximum per radian of aberration


@dataclass(frozen=True)
class PatternGrid:
    """Positions of X at which patterns are simulated, about one lenslet."""

    # height, pitch: spacing of rows of lenslets and of neighbours in a row, in metres
    height: float
    pitch: float
    kinds: int  # 1, or 2 if every second row is shifted by half a pitch
    count: int  # q, along either axis of a cell
    spare: float  # q/(4 f_c p), above 1

    @property
    def half_width(self) -> float:
        """Half width of the interpolating kernel, in positions (Kaiser's estimate)."""
        transition = 2 * math.pi * (1 - 1 / self.spare)
        return math.ceil((STOP_DB - 8) / (2.285 * transition) / 2)

    def offsets(self) -> Vector:
        """Return (y, x) of the positions from the lenslet's centre in metres, shape (q^2, 2)."""
        q = self.count
        j, k = (axis.ravel() - q // 2 for axis in np.indices((q, q)))
        return np.stack([j / q * self.height, k / q * self.pitch], axis=-1)

    def kernel(self, distance: Vector, pitch: float) -> Vector:
        """Compute a position's weight at a distance from a point: a sinc under a Kaiser window.

        Kaiser (1974): sinc(t) I0(beta sqrt(1 - (t/h)^2))/I0(beta), beta = 0.1102 (STOP_DB - 8.7),
        t in positions.
        """
        t = distance * (self.count / pitch)
        root = np.sqrt(np.maximum(1 - (t / self.half_width) ** 2, 0))
        beta = 0.1102 * (STOP_DB - 8.7)
        window = np.where(root > 0, np.i0(beta * root) / np.i0(beta), 0.0)
        return np.sinc(t) * window


def pattern_grid(optics: RayOptics) -> PatternGrid:
    """Return the positions for a camera; their number follows from 4 f_c p = 2 D p/(lam z2)."""
    mla = optics.mla
    min_count = (
        2 * optics.aperture_diameter * mla.pitch / (optics.wavelength * optics.array_distance)
    )
    count = math.ceil(OVERSAMPLING * min_count)
    kinds = 2 if mla.lattice == "hexagonal" else 1
    return PatternGrid(mla.row_pitch, mla.pitch, kinds, count, count / min_count)


@dataclass(frozen=True, eq=False)
class Patch:
    """Part of a picture that is composed of the patterns about one lenslet."""

    centre: tuple[float, float]  # (y, x) of the lenslet in metres
    # first, count: first row and column of the lenslets with weight, from this one, and their
    # number; the first row is even
    first: tuple[int, int]
    count: tuple[int, int]
    y: Vector  # y, x: positions of the picture's images on the array, from the lenslet, in metres
    x: Vector
    # fraction of each sample of the picture that this patch makes; the patches add up to 1
    share: Vector

    def weights(self, image: Complex, grid: PatternGrid, offset: Vector) -> Complex:
        """Compute weights of the lenslets, shape ``count``, for positions at ``offset`` from each.

        ``image`` is the picture times ``share``.
        """
        rows = (self.first[0] + np.arange(self.count[0])) * grid.height
        columns = (self.first[1] + np.arange(self.count[1])) * grid.pitch
        down = grid.kernel(rows[:, None] + offset[0] - self.y, grid.height)
        lines = down @ image
        out = np.empty(self.count, np.complex128)
        for kind in range(grid.kinds):
            moved = columns[:, None] + (kind / 2 * grid.pitch + offset[1]) - self.x
            across = grid.kernel(moved, grid.pitch)
            out[kind :: grid.kinds] = lines[kind :: grid.kinds] @ across.T
        return out


def aberrations(optics: RayOptics, plane: PicturePlane, distance: float) -> tuple[float, float]:
    """Compute coma and astigmatism in radians at the rim of the main lens, for a point.

    Its chief ray meets the array at ``distance`` X from the axis. The terms X u^3 and X^2 u^2 of
    both spherical waves' fourth order, k r^4/(8 z^3) (Goodman 2005, sec. 4.2), with u = D/2 and
    F = z2: k X u^3/(2 F) (1/z^2 - 1/F^2) and (3/4) k X^2 u^2/F^2 (1/z + 1/F).
    """
    F, u = optics.array_distance, optics.aperture_diameter / 2
    z, k = optics.object_distance + plane.z, 2 * math.pi / optics.wavelength
    coma = k * distance * u**3 / (2 * F) * abs(1 / z**2 - 1 / F**2)
    return coma, 0.75 * k * (distance * u / F) ** 2 * (1 / z + 1 / F)


def powers(optics: RayOptics, plane: PicturePlane) -> Powers:
    """Return exponents of y and x for the interpolation of the pattern across a picture.

    Coma grows with X, astigmatism with X^2. Terms that change little from the middle of the picture
    are omitted.
    """
    y, x = lit_axes(optics, plane)
    farthest = max(math.hypot(np.abs(y).max(), np.abs(x).max()), optics.mla.pitch)
    middle = math.hypot((y.max() + y.min()) / 2, (x.max() + x.min()) / 2)
    half = math.hypot(np.ptp(y) / 2, np.ptp(x) / 2)
    coma, all_astigmatism = aberrations(optics, plane, farthest)
    limit = TOLERANCE / CHANGE_PER_RADIAN
    if coma * half / farthest + all_astigmatism * (1 - (middle / farthest) ** 2) <= limit:
        return CONSTANT
    if all_astigmatism * (half / farthest) ** 2 <= limit:
        return LINEAR
    return QUADRATIC if coma > limit else EVEN


def lit_axes(optics: RayOptics, plane: PicturePlane) -> tuple[Vector, Vector]:
    """Return image positions of the rows and columns with light on the array, y and x in metres."""
    scale = float(optics.array_scale(plane.z))
    lit = plane.image > 0
    return plane.y[lit.any(axis=1)] * scale, plane.x[lit.any(axis=0)] * scale


def patches(
    optics: RayOptics, plane: PicturePlane, grid: PatternGrid, monomials: Powers
) -> list[Patch]:
    """Divide the picture into patches, one for each lenslet whose patterns are simulated.

    The pattern changes slowly with X (aberrations). It is interpolated by ``monomials`` through the
    patterns of as many lenslets, the best of 5 x 5 across the picture (approximate Fekete points:
    Sommariva and Vianello 2009).
    """
    scale = float(optics.array_scale(plane.z))
    y, x = plane.y * scale, plane.x * scale
    ys, xs = lit_axes(optics, plane)
    steps = (
        np.zeros(1) if monomials == CONSTANT else np.linspace(-OUTERMOST_NODE, OUTERMOST_NODE, 5)
    )
    nodes_y, nodes_x = (
        _lenslets(optics, axis, (c.max() + c.min()) / 2 + np.ptp(c) / 2 * steps)
        for axis, c in enumerate((ys, xs))
    )
    unit = max(np.abs(y).max(), np.abs(x).max(), optics.mla.pitch)
    values = _monomials(nodes_y / unit, nodes_x / unit, monomials)
    chosen = _independent_rows(values)
    through = np.linalg.pinv(values[chosen])
    shares = _monomials(y / unit, x / unit, monomials) @ through
    result = []
    for n, node in enumerate(chosen):
        row, column = (
            float(c) for c in (nodes_y[node // nodes_x.size], nodes_x[node % nodes_x.size])
        )
        share = shares[:, n].reshape(y.size, x.size)
        result.append(_patch(grid, (row, column), (y, x), (ys, xs), share))
    return result


def _monomials(y: Vector, x: Vector, exponents: Powers) -> Vector:
    """Compute y^i x^k at every pair of coordinates, shape (ny nx, monomials)."""
    return np.stack([np.outer(y**i, x**k).ravel() for i, k in exponents], axis=-1)


def _independent_rows(values: Vector) -> list[int]:
    """Return as many rows of a matrix as its rank that span the others (QR with pivoting)."""
    from scipy import linalg  # a slow import

    _, r, order = linalg.qr(values.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return [int(n) for n in order[: np.count_nonzero(size > 1e-3 * size[0])]]


def _patch(
    grid: PatternGrid,
    centre: tuple[float, float],
    picture: tuple[Vector, Vector],
    lit: tuple[Vector, Vector],
    share: Vector,
) -> Patch:
    reach = grid.half_width / grid.count + 1.5
    first, count = [], []
    for middle, ends, pitch in zip(centre, lit, (grid.height, grid.pitch), strict=True):
        low = 2 * math.floor(((ends.min() - middle) / pitch - reach) / 2)
        first.append(low)
        count.append(math.ceil((ends.max() - middle) / pitch + reach) - low + 1)
    y, x = (axis - middle for axis, middle in zip(picture, centre, strict=True))
    return Patch(centre, (first[0], first[1]), (count[0], count[1]), y, x, share)


def _lenslets(optics: RayOptics, axis: int, coordinates: Vector) -> Vector:
    """Return coordinates of the lenslets nearest to given ones along an axis, without duplicates.

    On a hexagonal lattice only even rows count.
    """
    mla = optics.mla
    pitch = (mla.row_pitch, mla.pitch)[axis]
    step = 2 if axis == 0 and mla.lattice == "hexagonal" else 1
    first, last = mla.centres()[0, 0][axis], (mla.count[axis] - 1) // step
    index = np.clip(np.rint((coordinates - first) / (pitch * step)), 0, last)
    return np.asarray(first + np.unique(index) * pitch * step)
