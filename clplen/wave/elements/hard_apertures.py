"""Hard apertures, whose rim samples have the covered fraction of their cell, or 0 or 1."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen import units
from clplen.checks import check_centre, check_diameter, fits_float64, float64_array, real_array
from clplen.errors import ShapeError
from clplen.wave.elements.edges import (
    COORDINATE_TOLERANCE,
    Edges,
    check_edges,
    disc_middles,
    interval_middles,
    polygon_middles,
    square_samples,
)
from clplen.wave.field.field import Field, Grid, map_samples, require_field
from clplen.wave.field.transmission import Vector, multiply, multiply_separable, offsets


def interval_coverage(offset: Vector, pitch: float, half: float) -> Vector:
    """Return the fraction of each cell of width ``pitch`` about ``offset`` within +-half."""
    low = np.maximum(offset - pitch / 2, -half)
    high = np.minimum(offset + pitch / 2, half)
    return np.maximum(high - low, 0) / pitch


def disc_coverage(grid: Grid, radius: float, centre: tuple[float, float]) -> Vector:
    """Return the fraction of each cell inside a disc, shape (ny, nx); rim cells are integrated."""
    if radius == 0:
        return np.zeros(grid.shape)
    y, x = (offset / radius for offset in offsets(grid, centre))
    hy, hx = (pitch / (2 * radius) for pitch in grid.pitch)
    far = np.add.outer((np.abs(y) + hy) ** 2, (np.abs(x) + hx) ** 2)
    near = np.add.outer(np.maximum(np.abs(y) - hy, 0) ** 2, np.maximum(np.abs(x) - hx, 0) ** 2)
    covered = (far <= 1).astype(np.float64)
    row, column = np.nonzero((near < 1) & (far > 1))
    top, bottom = y[row] - hy, y[row] + hy
    left, right = x[column] - hx, x[column] + hx
    area = _corner_area(bottom, right) - _corner_area(bottom, left)
    area += _corner_area(top, left) - _corner_area(top, right)
    covered[row, column] = np.clip(area / (4 * hy * hx), 0, 1)
    return covered


def _corner_area(y: Vector, x: Vector) -> Vector:
    """Return the area of the unit disc between the axes and the lines at y and x; odd in both."""
    sign = np.sign(y) * np.sign(x)
    y, x = np.minimum(np.abs(y), 1), np.minimum(np.abs(x), 1)
    beyond = x * np.sqrt(1 - x**2) + y * np.sqrt(1 - y**2) + np.arcsin(x) + np.arcsin(y) - np.pi / 2
    return sign * np.where(x**2 + y**2 <= 1, x * y, beyond / 2)


def polygon_coverage(grid: Grid, vertices: Any) -> Vector:
    """Return the fraction of each cell inside a polygon, shape (ny, nx), by signed areas.

    Edges are cut at the borders of cells. A piece of height h along y adds h to all cells to its
    right and, in its own cell, h times the part of the cell to its right. Running sums along x are
    the fractions (Green's theorem).
    """
    corner = np.array([grid.y[0], grid.x[0]]) - np.array(grid.pitch) / 2
    corners = (np.asarray(vertices, np.float64) - corner) / grid.pitch
    middle = corners - corners.mean(axis=0)
    following = np.roll(middle, -1, axis=0)
    area = np.sum(middle[:, 1] * following[:, 0] - middle[:, 0] * following[:, 1]) / 2
    if abs(area) <= 1e-12 * np.ptp(corners, axis=0).prod():
        raise ValueError("vertices must enclose an area, not lie on a line or cross.")
    covered = _signed_coverage(corners, grid.shape) * np.sign(area)
    if covered.min() < -1e-6 or covered.max() > 1 + 1e-6:
        raise ValueError("The polygon must not cross itself; give its outline once, in order.")
    covered[covered < COORDINATE_TOLERANCE] = 0
    covered[covered > 1 - COORDINATE_TOLERANCE] = 1
    return covered


def _signed_coverage(corners: Vector, shape: tuple[int, int]) -> Vector:
    """Return the coverage by a polygon in cells; negative where it runs from +y to +x."""
    ny, nx = shape
    pieces = [_cut(a, b, shape) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    start, end = (np.concatenate(ends) for ends in zip(*pieces, strict=True))
    y, x = ((start + end) / 2).T
    row, column = np.floor(y).astype(np.int64), np.clip(np.floor(x), 0, nx).astype(np.int64)
    inside = (row >= 0) & (row < ny) & (column < nx)
    cell = (row * (nx + 1) + column)[inside]
    height = (start - end)[inside, 0]
    left = np.clip(x - column, 0, 1)[inside]
    sums = np.bincount(cell, height * (1 - left), ny * (nx + 1))
    sums += np.bincount(cell + 1, height * left, ny * (nx + 1))
    return np.cumsum(sums.reshape(ny, nx + 1), axis=1, dtype=np.float64)[:, :nx]


def _cut(a: Vector, b: Vector, shape: tuple[int, int]) -> tuple[Vector, Vector]:
    """Return starts and ends (m, 2) of the pieces of an edge between borders of cells, in cells."""
    cuts = [np.array([0.0, 1.0])]
    for p, q, n in zip(a, b, shape, strict=True):
        if p != q:
            low, high = max(min(p, q), 0), min(max(p, q), n)
            cuts.append((np.arange(np.ceil(low), np.floor(high) + 1) - p) / (q - p))
    t = np.sort(np.clip(np.concatenate(cuts), 0, 1))[:, None]
    points = a + t * (b - a)
    return points[:-1], points[1:]


Pair = tuple[float, float]


def aperture(
    field: Field,
    diameter: float,
    *,
    shape: Literal["circular", "square"] = "circular",
    centre: Pair = (0.0, 0.0),
    edges: Edges = "area",
) -> Field:
    """Multiply a field by a hard circular or square aperture.

    By default a sample on the rim transmits the fraction of its cell inside. If the field has
    length 1 along an axis, both shapes are a slit.

    Parameters
    ----------
    field : Field
        Shape (..., ny, nx).
    diameter : float
        Diameter of the circle or side of the square in metres, positive.
    shape : {"circular", "square"}
        Outline of the aperture.
    centre : tuple of float
        Centre (y, x) in metres.
    edges : {"samples", "area", "pixels"}
        Transmission of samples on the rim. "samples": 1 if the centre of the sample lies inside or
        on the rim, else 0. "area": the fraction of its cell inside. "pixels": for a mask of square
        pixels with the pitch of the samples, open or closed as for "samples". The samples then have
        the mask's spectrum up to the Nyquist frequency, that of "samples" times sinc(f dx) along
        each axis; 0 and 1 become 0.064 and 0.936 next to a straight edge.

    Returns
    -------
    Field
        Field behind the aperture, on the same grid.

    Raises
    ------
    ValueError
        If the diameter is not positive, or the shape or edges are unknown.

    Notes
    -----
    The accuracy at 5 N dx^2/lam behind a slit, N = 512, against Fresnel integrals is 36 dB for
    "samples" and 58 dB for "area" at arbitrary edges. It is 139 dB for "pixels" with edges on the
    borders of cells (claims "apertures"; docs/accuracy.md has more masks).

    Examples
    --------
    >>> wave = clplen.wave.plane_wave(clplen.Grid((64, 64), 10e-6), wavelength=500e-9)
    >>> hole = clplen.aperture(wave, 0.4e-3)
    >>> f"{np.abs(hole.to_numpy()).sum():.0f} samples"  # pi 20^2 = 1257
    '1257 samples'
    >>> square = clplen.aperture(wave, 0.4e-3, shape="square")
    >>> f"{np.abs(square.to_numpy()).sum():.0f} samples"
    '1600 samples'
    """
    require_field(field)
    check_diameter(diameter)
    check_centre(centre, "an aperture")
    check_edges(edges)
    if shape not in ("circular", "square"):
        raise ValueError(f"shape must be 'circular' or 'square', got {shape!r}.")
    if shape == "square" or 1 in field.grid.shape:
        return _upright(field, (diameter, diameter), centre, edges)
    if edges == "area":
        return disc(field, diameter / 2, centre)
    return _masked(field, disc_middles(field.grid, diameter / 2, centre), edges)


def rectangular_aperture(
    field: Field,
    size: float | Pair,
    *,
    centre: Pair = (0.0, 0.0),
    rotation: float = 0.0,
    edges: Edges = "area",
) -> Field:
    """Multiply a field by a rectangular aperture, exact at every angle.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    size : float or tuple of float
        Widths along (y, x) before rotation, or a single width for both, in metres.
    centre : tuple of float
        Centre (y, x) in metres.
    rotation : float
        Angle in radians; positive turns +x towards +y.
    edges : {"samples", "area", "pixels"}
        Transmission of samples on the rim, as in `aperture`.

    Returns
    -------
    Field
        Field behind the aperture, with the shape of ``field``.

    Raises
    ------
    ValueError
        If the size is not positive, the centre or rotation not finite, or the edges unknown.
    ShapeError
        If a rotated rectangle meets a grid with an axis of length 1.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> behind = clplen.wave.rectangular_aperture(wave, (200e-6, 400e-6), rotation=np.pi / 6)
    >>> f"{behind.to_numpy().real.sum() * 1e-4:.3f} mm^2 of 0.2 mm x 0.4 mm"
    '0.080 mm^2 of 0.2 mm x 0.4 mm'
    """
    require_field(field)
    sides = float64_array(size)
    if sides.shape not in ((), (2,)) or not (np.isfinite(sides).all() and (sides > 0).all()):
        raise ValueError(f"A rectangle's size must be positive, (y, x) in metres, got {size!r}.")
    units.DIAMETER.check(sides, "A rectangle's size")
    check_centre(centre, "an aperture")
    check_edges(edges)
    if not fits_float64(rotation):
        raise ValueError(f"A rotation must be finite, in radians, got {rotation!r}.")
    height, width = (float(side) for side in np.broadcast_to(sides, 2))
    if rotation == 0:
        return _upright(field, (height, width), centre, edges)
    half_y, half_x = height / 2 * np.array([-1, -1, 1, 1]), width / 2 * np.array([-1, 1, 1, -1])
    cosine, sine = math.cos(rotation), math.sin(rotation)
    corners = np.stack([half_x * sine + half_y * cosine, half_x * cosine - half_y * sine], axis=-1)
    return polygonal_aperture(field, corners + centre, edges=edges)


def annular_aperture(
    field: Field,
    outer: float,
    *,
    inner: float,
    centre: Pair = (0.0, 0.0),
    edges: Edges = "area",
) -> Field:
    """Multiply a field by a ring; by default each cell has the exact area between two circles.

    If the field has length 1 along an axis, the aperture is a pair of slits.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    outer, inner : float
        Diameters in metres, 0 <= inner < outer.
    centre : tuple of float
        Centre (y, x) in metres.
    edges : {"samples", "area", "pixels"}
        Transmission of samples on the rim, as in `aperture`.

    Returns
    -------
    Field
        Field behind the aperture, with the shape of ``field``.

    Raises
    ------
    ValueError
        If the diameters are out of range or the edges unknown.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> behind = clplen.wave.annular_aperture(wave, 400e-6, inner=200e-6)
    >>> covered = behind.to_numpy().real.sum() * (10e-6) ** 2
    >>> f"{covered / (np.pi / 4 * (400e-6**2 - 200e-6**2)):.4f} of the ring's area"
    "1.0000 of the ring's area"
    """
    require_field(field)
    check_diameter(outer)
    check_centre(centre, "an aperture")
    check_edges(edges)
    if not 0 <= inner < outer:
        raise ValueError(
            f"The inner diameter of a ring must be at least 0 and less than the outer, {outer!r} "
            f"m, got {inner!r}."
        )
    grid = field.grid
    if edges != "area" and grid.shape != (1, 1):
        return _masked(field, disc_middles(grid, outer / 2, centre, inner=inner / 2), edges)
    if 1 not in grid.shape:
        covered = disc_coverage(grid, outer / 2, centre) - disc_coverage(grid, inner / 2, centre)
        return _masked(field, covered)
    outer_tables, inner_tables = (_interval_tables(field, (d, d), centre) for d in (outer, inner))
    covered = np.multiply.outer(*outer_tables)
    if grid.shape != (1, 1):
        covered -= np.multiply.outer(*inner_tables)
    return _masked(field, covered)


def polygonal_aperture(field: Field, vertices: Any, *, edges: Edges = "area") -> Field:
    """Multiply a field by a polygon; by default each cell has the exact area inside.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    vertices : array_like
        Vertices (y, x) in metres, shape (n, 2), n >= 3, of a polygon that does not cross itself,
        convex or not, in either direction. The last vertex joins the first.
    edges : {"samples", "area", "pixels"}
        Transmission of samples on the rim, as in `aperture`.

    Returns
    -------
    Field
        Field behind the aperture, with the shape of ``field``.

    Raises
    ------
    ValueError
        If the vertices have another shape, are not finite, enclose no area or cross, or the edges
        are unknown.
    ShapeError
        If the grid has an axis of length 1.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> triangle = [(-200e-6, -200e-6), (-200e-6, 200e-6), (200e-6, 0.0)]
    >>> behind = clplen.wave.polygonal_aperture(wave, triangle)
    >>> f"{behind.to_numpy().real.sum() * 1e-4:.3f} mm^2"
    '0.080 mm^2'
    """
    require_field(field)
    check_edges(edges)
    corners = real_array(vertices, "vertices", np.float64)
    if corners.ndim != 2 or corners.shape[0] < 3 or corners.shape[1] != 2:
        raise ValueError(
            f"vertices must have shape (n, 2), n at least 3, (y, x) in metres, got {corners.shape}."
        )
    if not np.isfinite(corners).all():
        raise ValueError("vertices must be all finite, (y, x) in metres.")
    if 1 in field.grid.shape:
        raise ShapeError(
            "A polygon or rotated rectangle requires a grid without axes of length 1, got shape "
            f"{field.grid.shape}; use rectangular_aperture without rotation."
        )
    covered = polygon_coverage(field.grid, corners)
    return _masked(
        field, covered if edges == "area" else polygon_middles(field.grid, corners), edges
    )


def disc(field: Field, radius: float, centre: Pair, *, out: cla.Array | None = None) -> Field:
    """Multiply ``field`` by a disc (kernel aperture.cl), into ``out``, which may be its data."""
    device, grid = field.device, field.grid
    if 1 in grid.shape:
        return _upright(field, (2 * radius, 2 * radius), centre)
    real = device.real.type
    return map_samples(
        field,
        device.kernel("aperture.cl", "disc", **device.wave_defines()),
        *(device.upload(t.astype(device.real)) for t in offsets(grid, centre)),
        real(radius),
        real(grid.pitch[0] / 2),
        real(grid.pitch[1] / 2),
        out=out,
    )


def _upright(field: Field, size: Pair, centre: Pair, edges: Edges = "area") -> Field:
    """Multiply ``field`` by a rectangle along the axes."""
    ty, tx = _interval_tables(field, size, centre, edges)
    if edges == "pixels":
        ty, tx = square_samples(ty), square_samples(tx)
    return multiply_separable(
        field, ty.astype(field.device.complex), tx.astype(field.device.complex)
    )


def _interval_tables(
    field: Field, size: Pair, centre: Pair, edges: Edges = "area"
) -> tuple[Vector, Vector]:
    """Return the transmission along y and x, (ny,) and (nx,); 1 along an axis of length 1."""
    cover = interval_coverage if edges == "area" else interval_middles
    ty, tx = (
        np.ones(1) if len(offset) == 1 else cover(offset, pitch, side / 2)
        for offset, pitch, side in zip(
            offsets(field.grid, centre), field.grid.pitch, size, strict=True
        )
    )
    return ty, tx


def _masked(field: Field, covered: Vector, edges: Edges = "area") -> Field:
    if edges == "pixels":
        covered = square_samples(covered)
    return multiply(field, field.device.upload(covered.astype(field.device.complex)))
