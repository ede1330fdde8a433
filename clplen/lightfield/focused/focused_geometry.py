"""Geometry of the lenslets of a focused (plenoptic 2.0) camera, and its magnification.

A lenslet with its centre at x_k images the main lens' picture, at a in front of the array, onto
the sensor at b behind it: m = b/a, and the point X of that picture appears at x_k + m (x_k - X).
The chief ray of the point, through the middle of the main lens' pupil at z2 in front of the array,
meets the sensor at Y. With the centres s_k = (1 + b/z2) x_k of the sub-images the point appears at

    r_k = s_k + ratio (s_k - Y),    ratio = (m - b/z2)/(1 + b/z2),    m X = ratio Y,

from the axis, which is the law of a camera whose pupil is infinitely far, m = ratio. Pictures over
Y is common to all depths, and ratio times the pitch of the sub-images is the size of a patch,
m p F/z2 with F = z2 - a (Georgiev & Lumsdaine 2010, with the pupil at a finite distance).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array, require
from clplen.compute.arrays import count_bad
from clplen.compute.device import DeviceLike, as_device
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid, LensType
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage
from clplen.types import Array

Pair = tuple[float, float]
Values = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int32]]

_MAX_STEP_ERROR = 0.25  # lenslets: maximum distance of a type's step from the lattice


@dataclass(frozen=True, eq=False, repr=False)
class FocusedGeometry:
    """Sub-images of a focused camera on its sensor, from `FocusedGeometry.of`.

    Sub-image (i, j) has its centre at ``origin + i first + j second``; pixel centres are integers.

    Attributes
    ----------
    origin, first, second : tuple of float
        Origin (y, x) and two of the shortest lattice vectors, in pixels.
    kinds : numpy.ndarray
        Type of lenslet (i, j), int32, shape (lines, lenslets); -1 without a lenslet centre on the
        sensor.
    shape : tuple of int
        Size (ny, nx) of the sensor.
    cell : tuple of float
        Height and width of a lenslet's cell in pixels.
    pupil : float
        Ratio b/z2; 0 if the raw image does not separate cells from sub-images.
    axis : tuple of float
        Position (y, x) in pixels of the axis on the sensor; the middle where ``pupil`` is 0.
    pixel_pitch : float
        Pixel pitch in metres; NaN if unknown.
    ranges : tuple
        (lowest, highest) abs(m) in focus for each type; empty for lenses of one type.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)), model="rays")
    >>> clplen.render_focused(raw).geometry.shape
    (144, 144)
    """

    origin: Pair
    first: Pair
    second: Pair
    kinds: Integers
    shape: tuple[int, int]
    cell: Pair
    pupil: float
    axis: Pair
    pixel_pitch: float
    ranges: tuple[Pair, ...] = ()

    @classmethod
    def of(cls, raw: RawImage) -> FocusedGeometry:
        """Return the geometry of a raw image.

        Parameters
        ----------
        raw : RawImage
            Raw image of a focused camera (its camera has ``m``), or a captured one of any lattice.

        Raises
        ------
        ValueError
            If the camera is a plenoptic 1.0 camera, or lens types and lattice do not agree.
        ShapeError
            If fewer than two by two lenslets lie on the sensor.
        """
        require_focused(raw)
        origin, first, second = _primitive(raw)
        indices, kinds = _sensor_lenslets(raw, origin, first, second)
        if raw.lens_types:
            kinds = _lens_types(kinds, indices, raw.lens_types, np.array([first, second]))
        pupil, axis = _pupil(raw)
        position = np.array(origin) + indices[0] * np.array(first) + indices[1] * np.array(second)
        return cls(
            _pair(position),
            first,
            second,
            kinds,
            raw.shape,
            _cell(raw.lattice, raw.sub_images),
            pupil,
            axis,
            raw.pixel_pitch,
            tuple(_focus_range(lens_type) for lens_type in raw.lens_types),
        )

    def __repr__(self) -> str:
        return f"<FocusedGeometry {self.count} lenslets {self.pitch:.4g} px apart>"

    @property
    def count(self) -> int:
        """Number of lenslets whose sub-image centre lies on the sensor."""
        return int((self.kinds >= 0).sum())

    @property
    def pitch(self) -> float:
        """Mean distance in pixels of a sub-image from its nearest neighbours."""
        a, b = np.array(self.first), np.array(self.second)
        lengths = sorted(math.hypot(*step) for step in (a, b, a - b, a + b))
        near = [length for length in lengths if length < 1.2 * lengths[0]]
        return float(np.mean(near)) if len(near) > 1 else lengths[0]

    @property
    def centres(self) -> Values:
        """Centres (y, x) of sub-images in pixels, shape (lines, lenslets, 2), absent ones too."""
        index = np.moveaxis(np.indices(self.kinds.shape), 0, -1)
        return np.asarray(self.origin) + index @ np.array([self.first, self.second])

    def ratio(self, m: Any) -> Any:
        """Return (m - b/z2)/(1 + b/z2), the size of a patch in pitches of the sub-images."""
        return (m - self.pupil) / (1 + self.pupil)

    def m(self, ratio: Any) -> Any:
        """Return m of a ratio, the inverse of `ratio`."""
        return ratio * (1 + self.pupil) + self.pupil

    def patch(self, m: float) -> float:
        """Return mu = m p F/(z2 dx), the pixels across the patch that each lenslet contributes."""
        return abs(float(self.ratio(m))) * self.pitch

    def tables(self, device: DeviceLike | None = None) -> tuple[cla.Array, cla.Array, cla.Array]:
        """Upload the centres as integers and fractions, and the kinds, for the kernels."""
        device = as_device(device)
        pixels, fractions = split_positions(self.centres)
        return device.upload(pixels), device.upload(fractions), device.upload(self.kinds)

    def lattice(self, view: Pair, device: DeviceLike | None = None) -> cla.Array:
        """Upload origin, base vectors and a view, float32, shape (4, 2)."""
        rows = np.array([self.origin, self.first, self.second, view], np.float32)
        return as_device(device).upload(rows)


def require_focused(raw: RawImage) -> None:
    """Reject a raw image of another type of camera, or with a colour mosaic."""
    require(RawImage, raw, "raw", "read_raw or camera.expose")
    if raw.camera is not None and raw.camera.kind != "focused":
        raise ValueError(
            "This raw image is of a plenoptic 1.0 camera, whose lenslets record directions, not "
            "pictures; decode it with LightField.from_raw and render the light field."
        )
    if raw.mosaic is not None:
        raise ValueError(
            "This raw image is a mosaic of colour filters; pass its colours, "
            "clplen.lightfield.demosaic(raw)."
        )


def require_finite(raw: RawImage, what: str) -> None:
    """Reject a raw image with NaN or infinite pixels before an operation."""
    bad = count_bad(raw.data, raw.device)
    if bad:
        raise ValueError(
            f"The raw image has {bad} pixels that are NaN or infinite; replace them before {what}, "
            "for example by the mean of their neighbours."
        )


def white_level(raw: RawImage, white: Any) -> Array:
    """Return a white image over its brightest pixel, float32, shape (ny, nx[, c])."""
    level = np.asarray(host_array(white, "The white image"), np.float32)
    if level.shape not in (raw.shape, tuple(raw.data.shape)):
        raise ShapeError(
            f"white must have the shape of the raw image, {tuple(raw.data.shape)}, got "
            f"{level.shape}; pass the white image of this camera."
        )
    if not np.isfinite(level).all() or not level.max() > 0:
        raise ValueError("The white image must be finite and not black.")
    return level / level.max()


def split_positions(values: Values) -> tuple[Integers, np.ndarray[Any, np.dtype[np.float32]]]:
    """Split positions in pixels into integers and fractions in [0, 1)."""
    rounded = np.round(values * 2.0**24) / 2.0**24
    integers = np.floor(rounded)
    return integers.astype(np.int32), (rounded - integers).astype(np.float32)


def same_type_steps(geometry: FocusedGeometry, reach: float) -> Iterator[tuple[int, int]]:
    """Yield steps (i, j) between equal lenslets up to a distance in pitches, without -(i, j)."""
    n = math.ceil(2 * reach)
    base = np.array([geometry.first, geometry.second])
    for i, j in product(range(-n, n + 1), repeat=2):
        distance = math.hypot(*(np.array([i, j]) @ base)) / geometry.pitch
        if (i, j) > (0, 0) and distance <= reach and _joins_equals(geometry.kinds, i, j):
            yield i, j


def _joins_equals(kinds: Integers, i: int, j: int) -> bool:
    """Return True if some lenslets are a step apart and all such pairs are of one type."""
    lines, lenses = kinds.shape
    if abs(i) >= lines or abs(j) >= lenses:
        return False
    a = kinds[max(0, -i) : lines - max(0, i), max(0, -j) : lenses - max(0, j)]
    b = kinds[max(0, i) : lines - max(0, -i), max(0, j) : lenses - max(0, -j)]
    present = (a >= 0) & (b >= 0)
    return bool(present.any() and (a[present] == b[present]).all())


def _primitive(raw: RawImage) -> tuple[Pair, Pair, Pair]:
    """Return a lenslet's centre and two shortest vectors of the lattice."""
    if raw.lattice is not None:
        lattice = raw.lattice
        row, column = np.array(lattice.row), np.array(lattice.column)
        if lattice.kind == "hexagonal" and lattice.turned:
            column = column + row / 2
        elif lattice.kind == "hexagonal":
            row = row + column / 2
        return lattice.origin, _pair(row), _pair(column)
    grid = raw.sub_images
    row = np.array(grid.row_step) + grid.odd_row_shift * np.array(grid.column_step)
    return grid.first, _pair(row), _pair(np.array(grid.column_step))


def _sensor_lenslets(
    raw: RawImage, origin: Pair, first: Pair, second: Pair
) -> tuple[tuple[int, int], Integers]:
    """Return the first indices (i, j) of the box of all lenslets, and kinds of 0 or -1."""
    ny, nx = raw.shape
    corners = np.array([(y, x) for y in (-0.5, ny - 0.5) for x in (-0.5, nx - 0.5)]) - origin
    indices = corners @ np.linalg.inv(np.array([first, second]))
    low, high = np.floor(indices.min(0)).astype(int), np.ceil(indices.max(0)).astype(int)
    i, j = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
    position = np.array(origin) + i[..., None] * np.array(first) + j[..., None] * np.array(second)
    inside = ((position >= -0.5) & (position < np.array([ny, nx]) - 0.5)).all(-1)
    if raw.lattice is None:
        grid = raw.sub_images
        k = j + np.floor_divide(i, 2) * round(2 * grid.odd_row_shift)
        inside &= (i >= 0) & (i < grid.count[0]) & (k >= 0) & (k < grid.count[1])
    lines, lenses = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    if len(lines) < 2 or len(lenses) < 2:
        raise ShapeError(
            f"A focused camera's picture needs at least two by two lenslets, but {inside.sum()} of "
            f"{raw!r} have their centre on the sensor; pass a raw image with its lattice."
        )
    box = np.s_[lines[0] : lines[-1] + 1, lenses[0] : lenses[-1] + 1]
    start = (int(low[0] + lines[0]), int(low[1] + lenses[0]))
    return start, np.where(inside[box], 0, -1).astype(np.int32)


def _lens_types(
    kinds: Integers, start: tuple[int, int], types: tuple[LensType, ...], base: Values
) -> Integers:
    """Return the type of each lenslet, from the sub-lattices of the types."""
    i, j = np.indices(kinds.shape) + np.array(start)[:, None, None]
    typed = np.full_like(kinds, -1)
    for number, lens_type in enumerate(types):
        indices = np.array([lens_type.offset, *lens_type.steps]) @ np.linalg.inv(base)
        (oi, oj), (ai, aj), (bi, bj) = np.round(indices).astype(int)
        area = int(ai * bj - aj * bi)
        if np.abs(indices - np.round(indices)).max() > _MAX_STEP_ERROR or area == 0:
            raise ValueError(
                f"Lens type {number} lies at {lens_type.offset} px and repeats after "
                f"{lens_type.steps} px, which does not match the lattice of lenslets; pass the "
                "types of this array."
            )
        down, right = i - oi, j - oj
        members = ((down * bj - right * bi) % area == 0) & ((right * ai - down * aj) % area == 0)
        typed[members & (kinds >= 0)] = number
    if ((typed < 0) & (kinds >= 0)).any():
        raise ValueError(
            f"The {len(types)} lens types do not cover the lattice: some lenslets have no type."
        )
    return typed


def _pupil(raw: RawImage) -> tuple[float, Pair]:
    """Return b/z2, the excess distance of sub-images over lenslets, and the axis."""
    cells, images = raw.cells, raw.sub_images
    scale = math.hypot(*images.column_step) / math.hypot(*cells.column_step)
    middle = ((raw.shape[0] - 1) / 2, (raw.shape[1] - 1) / 2)
    if abs(scale - 1) < 1e-9:
        return 0.0, middle
    axis = (np.array(images.first) - scale * np.array(cells.first)) / (1 - scale)
    return scale - 1, _pair(axis)


def _cell(lattice: Lattice | None, grid: LensletGrid) -> Pair:
    source = grid if lattice is None else lattice
    steps = (
        (source.row_step, source.column_step)
        if isinstance(source, LensletGrid)
        else (source.row, source.column)
    )
    return _pair(np.abs(np.array(steps)).max(0))


def _focus_range(lens_type: LensType) -> Pair:
    """Return the abs(m) range of a type from its virtual depths 1/m."""
    low, high = sorted(abs(depth) for depth in lens_type.depth_range)
    return (1 / high if high else math.inf, 1 / low if low else math.inf)


def _pair(values: Values) -> Pair:
    return float(values[0]), float(values[1])


def alpha_of_m(raw: RawImage, m: Any) -> Values:
    """Return alpha = F/F' for m = z3/(z2 - F').

    z2 is the distance from the main lens to the array, z3 from the array to the (moved) sensor.
    """
    m = np.asarray(m, np.float64)
    camera: Any = raw.camera
    if camera is None:
        return np.full(m.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        image = camera.array_distance - camera.sensor_distance / m
        return np.where(image > 0, camera.image_distance / image, np.nan)


def z_of_m(raw: RawImage, m: Any) -> Values:
    """Return dz in metres, positive beyond the focused plane, as in `PointSources`."""
    alpha = alpha_of_m(raw, m)
    if raw.camera is None:
        return alpha
    valid = np.isfinite(alpha)
    z = np.asarray(raw.camera.dz(np.where(valid, alpha, 1.0)), np.float64)
    return np.where(valid, z, np.nan)
