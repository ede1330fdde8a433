"""Where the lenslets of a focused (plenoptic 2.0) camera lie, and what its magnification means.

A lenslet with its centre at x_k images the main lens' picture, at a in front of the array, onto
the sensor at b behind it: m = b/a, and the point X of that picture appears at x_k + m (x_k - X).
The chief ray of the point, through the middle of the main lens' pupil at z2 in front of the array,
meets the sensor at Y. With the centres s_k = (1 + b/z2) x_k of the sub-images the point appears at

    r_k = s_k + ratio (s_k - Y),    ratio = (m - b/z2)/(1 + b/z2),    m X = ratio Y,

from the axis, which is the law of a camera whose pupil is infinitely far, m = ratio. Pictures over
Y are registered for all depths, and ratio times the pitch of the sub-images is the size of a patch,
m p F/z2 with F = z2 - a (Georgiev & Lumsdaine 2010, with the pupil at a finite distance).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from operator import attrgetter
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
Whole = np.ndarray[Any, np.dtype[np.int32]]

_NEAR = 0.25  # lenslets: how far a step of a type may lie from the lattice


@dataclass(frozen=True, eq=False, repr=False)
class FocusedGeometry:
    """The sub-images of a focused camera on its sensor. Made by `FocusedGeometry.of`.

    Sub-image (i, j) has its centre at ``origin + i first + j second``; pixel centres are integers.

    Attributes
    ----------
    origin, first, second : tuple of float
        (y, x) in pixels; two of the shortest vectors of the lattice.
    kinds : numpy.ndarray
        int32, shape (lines, lenslets): the type of lenslet (i, j), -1 where there is none whose
        centre lies on the sensor.
    shape : tuple of int
        (ny, nx) of the sensor.
    cell : tuple of float
        Height and width in pixels by which the lenslets follow one another in y and x.
    pupil : float
        b/z2; 0 where a raw image does not tell cells from sub-images.
    axis : tuple of float
        (y, x) in pixels where the axis meets the sensor; the middle where ``pupil`` is 0.
    pixel_pitch : float
        In metres; NaN where not known.
    ranges : tuple
        (least, greatest) abs(m) at which each type is in focus; empty for lenses of one type.

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
    kinds: Whole
    shape: tuple[int, int]
    cell: Pair
    pupil: float
    axis: Pair
    pixel_pitch: float
    ranges: tuple[Pair, ...] = ()

    @classmethod
    def of(cls, raw: RawImage) -> FocusedGeometry:
        """The geometry of a raw image.

        Parameters
        ----------
        raw : RawImage
            Of a focused camera (its camera has ``m``) or captured, of any lattice.

        Raises
        ------
        ValueError
            If its camera is a plenoptic 1.0 camera, or its lens types do not fit its lattice.
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
        """Lenslets whose sub-image has its centre on the sensor."""
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
        """Centres (y, x) of sub-images in pixels, shape (lines, lenslets, 2), missing ones too."""
        index = np.moveaxis(np.indices(self.kinds.shape), 0, -1)
        return np.asarray(self.origin) + index @ np.array([self.first, self.second])

    places = property(attrgetter("centres"), doc="Alias of `centres`.")

    def ratio(self, m: Any) -> Any:
        """(m - b/z2)/(1 + b/z2), the size of a patch in pitches of the sub-images."""
        return (m - self.pupil) / (1 + self.pupil)

    def m(self, ratio: Any) -> Any:
        """The inverse of `ratio`."""
        return ratio * (1 + self.pupil) + self.pupil

    def patch(self, m: float) -> float:
        """mu = m p F/(z2 dx), pixels across the patch that is seen once by every lenslet."""
        return abs(float(self.ratio(m))) * self.pitch

    def tables(self, device: DeviceLike | None = None) -> tuple[cla.Array, cla.Array, cla.Array]:
        """Centres as integers and fractions, and kinds, for the kernels."""
        device = as_device(device)
        whole, part = split_positions(self.centres)
        return device.upload(whole), device.upload(part), device.upload(self.kinds)

    def lattice(self, view: Pair, device: DeviceLike | None = None) -> cla.Array:
        """Origin, base vectors and a view, float32, shape (4, 2)."""
        rows = np.array([self.origin, self.first, self.second, view], np.float32)
        return as_device(device).upload(rows)


def require_focused(raw: RawImage) -> None:
    """Refuse a raw image whose camera is known to be no focused one."""
    require(RawImage, raw, "raw", "read_raw or camera.expose")
    if raw.camera is not None and raw.camera.kind != "focused":
        raise ValueError(
            "This raw image is of a plenoptic 1.0 camera, whose lenslets hold directions and no "
            "pictures: decode it with LightField.from_raw and render that."
        )
    if raw.mosaic is not None:
        raise ValueError(
            "This raw image is a mosaic of colour filters: give its colours, "
            "clplen.lightfield.demosaic(raw)."
        )


def require_finite(raw: RawImage, what: str) -> None:
    """Refuse a raw image with pixels that are NaN or infinite before something is done with it."""
    bad = count_bad(raw.data, raw.device)
    if bad:
        raise ValueError(
            f"The raw image has {bad} pixels that are NaN or infinite: replace them before {what}, "
            "for example by the mean of their neighbours."
        )


def white_level(raw: RawImage, white: Any) -> Array:
    """Return a white image over its brightest pixel, float32, shape (ny, nx[, c])."""
    level = np.asarray(host_array(white, "The white image"), np.float32)
    if level.shape not in (raw.shape, tuple(raw.data.shape)):
        raise ShapeError(
            f"The white image has shape {level.shape}, the raw image {tuple(raw.data.shape)}: "
            "give the white image of this camera."
        )
    if not np.isfinite(level).all() or not level.max() > 0:
        raise ValueError("The white image is finite and not dark throughout.")
    return level / level.max()


def split_positions(values: Values) -> tuple[Whole, np.ndarray[Any, np.dtype[np.float32]]]:
    """Integers and fractions in [0, 1) of positions in pixels."""
    rounded = np.round(values * 2.0**24) / 2.0**24
    whole = np.floor(rounded)
    return whole.astype(np.int32), (rounded - whole).astype(np.float32)


def same_type_steps(geometry: FocusedGeometry, reach: float) -> Iterator[tuple[int, int]]:
    """Steps (i, j) between lenslets of one type, up to a distance in pitches, one of each +-."""
    n = math.ceil(2 * reach)
    base = np.array([geometry.first, geometry.second])
    for i, j in product(range(-n, n + 1), repeat=2):
        far = math.hypot(*(np.array([i, j]) @ base)) / geometry.pitch
        if (i, j) > (0, 0) and far <= reach and _joins_equals(geometry.kinds, i, j):
            yield i, j


def _joins_equals(kinds: Whole, i: int, j: int) -> bool:
    """Whether lenslets a step apart are of one type, and there are such."""
    lines, lenses = kinds.shape
    if abs(i) >= lines or abs(j) >= lenses:
        return False
    a = kinds[max(0, -i) : lines - max(0, i), max(0, -j) : lenses - max(0, j)]
    b = kinds[max(0, i) : lines - max(0, -i), max(0, j) : lenses - max(0, -j)]
    both = (a >= 0) & (b >= 0)
    return bool(both.any() and (a[both] == b[both]).all())


def _primitive(raw: RawImage) -> tuple[Pair, Pair, Pair]:
    """A lenslet's centre and two shortest vectors of the lattice."""
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
) -> tuple[tuple[int, int], Whole]:
    """First indices (i, j) of the box round all lenslets, and 0 for each that there is, else -1."""
    ny, nx = raw.shape
    corners = np.array([(y, x) for y in (-0.5, ny - 0.5) for x in (-0.5, nx - 0.5)]) - origin
    found = corners @ np.linalg.inv(np.array([first, second]))
    low, high = np.floor(found.min(0)).astype(int), np.ceil(found.max(0)).astype(int)
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
            f"Pictures of a focused camera are put together from many lenslets, but of {raw!r} "
            f"{inside.sum()} have their centre on the sensor: give a raw image with its lattice."
        )
    box = np.s_[lines[0] : lines[-1] + 1, lenses[0] : lenses[-1] + 1]
    start = (int(low[0] + lines[0]), int(low[1] + lenses[0]))
    return start, np.where(inside[box], 0, -1).astype(np.int32)


def _lens_types(
    kinds: Whole, start: tuple[int, int], types: tuple[LensType, ...], base: Values
) -> Whole:
    """The type of each lenslet, from the sub-lattices of the types."""
    i, j = np.indices(kinds.shape) + np.array(start)[:, None, None]
    typed = np.full_like(kinds, -1)
    for number, lens_type in enumerate(types):
        found = np.array([lens_type.offset, *lens_type.steps]) @ np.linalg.inv(base)
        (oi, oj), (ai, aj), (bi, bj) = np.round(found).astype(int)
        area = int(ai * bj - aj * bi)
        if np.abs(found - np.round(found)).max() > _NEAR or area == 0:
            raise ValueError(
                f"Lens type {number} lies at {lens_type.offset} px and repeats after "
                f"{lens_type.steps} px, which is no part of the lattice of lenslets: give the "
                "types of this array."
            )
        down, right = i - oi, j - oj
        mine = ((down * bj - right * bi) % area == 0) & ((right * ai - down * aj) % area == 0)
        typed[mine & (kinds >= 0)] = number
    if ((typed < 0) & (kinds >= 0)).any():
        raise ValueError(
            f"The {len(types)} lens types do not cover the lattice: some lenslets are of none."
        )
    return typed


def _pupil(raw: RawImage) -> tuple[float, Pair]:
    """b/z2 and the axis, by which sub-images are farther apart than their lenslets."""
    cells, images = raw.cells, raw.sub_images
    scale = math.hypot(*images.column_step) / math.hypot(*cells.column_step)
    middle = ((raw.shape[0] - 1) / 2, (raw.shape[1] - 1) / 2)
    if abs(scale - 1) < 1e-9:
        return 0.0, middle
    axis = (np.array(images.first) - scale * np.array(cells.first)) / (1 - scale)
    return scale - 1, _pair(axis)


def _cell(lattice: Lattice | None, grid: LensletGrid) -> Pair:
    of = grid if lattice is None else lattice
    steps = (of.row_step, of.column_step) if isinstance(of, LensletGrid) else (of.row, of.column)
    return _pair(np.abs(np.array(steps)).max(0))


def _focus_range(lens_type: LensType) -> Pair:
    """abs(m) from its virtual depths 1/m."""
    low, high = sorted(abs(depth) for depth in lens_type.depth_range)
    return (1 / high if high else math.inf, 1 / low if low else math.inf)


def _pair(values: Values) -> Pair:
    return float(values[0]), float(values[1])


def alpha_of_m(raw: RawImage, m: Any) -> Values:
    """alpha = F/F' of what the lenslets see with m = z3/(z2 - F').

    z2 is the distance from the main lens to the array, z3 that from there to the sensor, where this
    has moved too.
    """
    m = np.asarray(m, np.float64)
    camera: Any = raw.camera
    if camera is None:
        return np.full(m.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        image = camera.array_distance - camera.sensor_distance / m
        return np.where(image > 0, camera.image_distance / image, np.nan)


def z_of_m(raw: RawImage, m: Any) -> Values:
    """dz of the object in metres, farther than the focused plane positive, as in `PointSources`."""
    alpha = alpha_of_m(raw, m)
    if raw.camera is None:
        return alpha
    known = np.isfinite(alpha)
    z = np.asarray(raw.camera.dz(np.where(known, alpha, 1.0)), np.float64)
    return np.where(known, z, np.nan)
