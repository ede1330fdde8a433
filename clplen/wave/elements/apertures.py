"""Area-weighted hard apertures: a rim sample keeps the covered fraction of its cell."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.compute import lengths
from clplen.errors import ShapeError
from clplen.wave.elements.coverage import Vector, disc_coverage, interval_coverage, polygon_coverage
from clplen.wave.field.arguments import check_centre, check_diameter
from clplen.wave.field.field import Field, require_field
from clplen.wave.field.transmission import multiply, multiply_separable, offsets

Pair = tuple[float, float]


def aperture(
    field: Field,
    diameter: float,
    *,
    shape: Literal["circular", "square"] = "circular",
    centre: Pair = (0.0, 0.0),
) -> Field:
    """An area-weighted hard aperture: a rim sample keeps the fraction of its cell inside.

    Along an axis of length 1 there is no edge: there both shapes are a slit.

    Parameters
    ----------
    field : Field
    diameter : float
        Of the circle, or side of the square, in metres.
    shape : {"circular", "square"}
    centre : tuple of float
        (y, x) in metres.

    Returns
    -------
    Field

    Raises
    ------
    ValueError
        For a diameter that is not positive or another shape.
    """
    require_field(field)
    check_diameter(diameter)
    check_centre(centre, "an aperture")
    if shape == "circular":
        return disc(field, diameter / 2, centre)
    if shape != "square":
        raise ValueError(f"An aperture is 'circular' or 'square', not {shape!r}.")
    return _upright(field, (diameter, diameter), centre)


def rectangular_aperture(
    field: Field,
    size: float | Pair,
    *,
    centre: Pair = (0.0, 0.0),
    rotation: float = 0.0,
) -> Field:
    """An area-weighted rectangle, exact at every angle.

    Parameters
    ----------
    field : Field
    size : float or tuple of float
        Width along (y, x) before it is turned, or one number for both, in metres.
    centre : tuple of float
        (y, x) in metres.
    rotation : float
        In radians; positive turns +x towards +y.

    Returns
    -------
    Field

    Raises
    ------
    ValueError
        For a size that is not positive, or a centre or rotation that is not finite.
    ShapeError
        For a turned rectangle on a grid with an axis of length 1.
    """
    require_field(field)
    sides = np.asarray(size, np.float64)
    if sides.shape not in ((), (2,)) or not (np.isfinite(sides).all() and (sides > 0).all()):
        raise ValueError(f"A rectangle's size is positive, (y, x) in metres, not {size!r}.")
    lengths.DIAMETER.check(sides, "A rectangle's size")
    check_centre(centre, "an aperture")
    if not math.isfinite(rotation):
        raise ValueError(f"A rotation is finite, in radians, not {rotation!r}.")
    height, width = (float(side) for side in np.broadcast_to(sides, 2))
    if rotation == 0:
        return _upright(field, (height, width), centre)
    half_y, half_x = height / 2 * np.array([-1, -1, 1, 1]), width / 2 * np.array([-1, 1, 1, -1])
    cosine, sine = math.cos(rotation), math.sin(rotation)
    corners = np.stack([half_x * sine + half_y * cosine, half_x * cosine - half_y * sine], axis=-1)
    return polygonal_aperture(field, corners + centre)


def annular_aperture(
    field: Field, outer: float, *, inner: float, centre: Pair = (0.0, 0.0)
) -> Field:
    """An area-weighted ring: the exact area of every cell between two circles.

    Along an axis of length 1 there is no edge: there it is a pair of slits.

    Parameters
    ----------
    field : Field
    outer, inner : float
        Diameters in metres, 0 <= inner < outer.
    centre : tuple of float
        (y, x) in metres.

    Returns
    -------
    Field

    Raises
    ------
    ValueError
        For other diameters.
    """
    require_field(field)
    check_diameter(outer)
    check_centre(centre, "an aperture")
    if not 0 <= inner < outer:
        raise ValueError(
            f"The inner diameter of a ring is at least 0 and less than the outer, {outer!r} m, "
            f"not {inner!r}."
        )
    grid = field.grid
    if 1 not in grid.shape:
        covered = disc_coverage(grid, outer / 2, centre) - disc_coverage(grid, inner / 2, centre)
        return _masked(field, covered)
    sides = [_interval_tables(field, (d, d), centre) for d in (outer, inner)]
    covered = np.multiply.outer(*sides[0])
    if grid.shape != (1, 1):
        covered -= np.multiply.outer(*sides[1])
    return _masked(field, covered)


def polygonal_aperture(field: Field, vertices: Any) -> Field:
    """An area-weighted polygon: the exact area of every cell inside.

    Parameters
    ----------
    field : Field
    vertices : array_like
        Shape (n, 2), n >= 3, (y, x) in metres; any polygon that does not cross itself, convex or
        not, either way round; the last vertex joins the first.

    Returns
    -------
    Field

    Raises
    ------
    ValueError
        For vertices of another shape, that are not finite, enclose nothing or cross.
    ShapeError
        On a grid with an axis of length 1, along which a polygon has no meaning.
    """
    require_field(field)
    places = np.asarray(vertices, np.float64)
    if places.ndim != 2 or places.shape[0] < 3 or places.shape[1] != 2:
        raise ValueError(
            f"A polygon has vertices of shape (n, 2), n at least 3, (y, x) in metres, not "
            f"{places.shape}."
        )
    if not np.isfinite(places).all():
        raise ValueError("The vertices of a polygon are all finite, (y, x) in metres.")
    if 1 in field.grid.shape:
        raise ShapeError(
            f"A polygon or turned rectangle needs two axes; nothing varies along one of a grid of "
            f"shape {field.grid.shape}: use rectangular_aperture without rotation."
        )
    return _masked(field, polygon_coverage(field.grid, places))


def disc(field: Field, radius: float, centre: Pair, *, out: cla.Array | None = None) -> Field:
    """``field`` inside a circle (kernel aperture.cl), into ``out``, which may be its own data."""
    device, grid = field.device, field.grid
    if 1 in grid.shape:
        return _upright(field, (2 * radius, 2 * radius), centre)
    if out is None:
        out = device.empty(field.shape, device.complex)
    real = device.real.type
    kernel = device.kernel("aperture.cl", "disc", **device.wave_defines())
    device.launch_rows(
        kernel,
        field.shape,
        out,
        field.data,
        *(device.upload(t.astype(device.real)) for t in offsets(grid, centre)),
        real(radius),
        real(grid.pitch[0] / 2),
        real(grid.pitch[1] / 2),
        np.int32(grid.shape[0]),
        np.int32(grid.shape[1]),
    )
    return field.with_data(out)


def _upright(field: Field, size: Pair, centre: Pair) -> Field:
    """``field`` inside a rectangle along the axes."""
    ty, tx = _interval_tables(field, size, centre)
    return multiply_separable(
        field, ty.astype(field.device.complex), tx.astype(field.device.complex)
    )


def _interval_tables(field: Field, size: Pair, centre: Pair) -> tuple[Vector, Vector]:
    """Covered fractions along y and x, shapes (ny,) and (nx,); 1 along an axis of length 1."""
    ty, tx = (
        np.ones(1) if len(offset) == 1 else interval_coverage(offset, pitch, side / 2)
        for offset, pitch, side in zip(
            offsets(field.grid, centre), field.grid.pitch, size, strict=True
        )
    )
    return ty, tx


def _masked(field: Field, covered: Vector) -> Field:
    return multiply(field, field.device.upload(covered.astype(field.device.complex)))
