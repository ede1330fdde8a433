"""Surfaces with exact disparity: planes with outlines, spheres, textures, highlights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import numpy as np

from clplen.cameras.scenes.textures import Texture, uniform
from clplen.checks import float64_array, is_integer, real_array
from clplen.reprs import OneLine

Pair = tuple[float, float]
Vector = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True)
class Ellipse:
    """Disc or ellipse.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    radii : float or tuple of float
        Radius, or radii along Y and X before the rotation, in pixels, positive.
    angle : float
        Rotation of +Y towards +X in radians.

    Raises
    ------
    ValueError
        If a number is not finite or a radius not positive.

    Examples
    --------
    >>> disc = clplen.cameras.Ellipse((0, 0), 8)
    >>> ground, patch = clplen.cameras.Plane(-0.5), clplen.cameras.Plane(1.0, outline=disc)
    >>> scene = clplen.cameras.SurfaceScene([ground, patch])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> int((truth.surface == 1).sum())  # pixels of the disc; its area is 201
    208
    """

    centre: Pair
    radii: float | Pair
    _: KW_ONLY
    angle: float = 0.0

    def __post_init__(self) -> None:
        _finite(self.centre, 2, "The centre of an ellipse")
        _finite(self.half, 2, "The radii of an ellipse", positive=True)

    @property
    def half(self) -> Pair:
        """Radii along both axes in pixels."""
        return _pair(self.radii)

    def corners(self) -> Vector:
        """Return the corners of a rectangle about it, (Y, X), shape (4, 2)."""
        return _rectangle(self.centre, self.half, self.angle)


@dataclass(frozen=True)
class Bars:
    """Parallel bars with gaps between them, of constant or tapered width.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) of the middle of all bars in pixels from the middle of the picture.
    length : float
        Length of each bar in pixels.
    count : int
        Number of bars, at least 1.
    period : float
        Distance of neighbouring bars in pixels: width of a bar plus gap.
    width : float or tuple of float
        Width of a bar in pixels, or its widths at the first and the last end, 0 to ``period``.
    angle : float
        Rotation of +Y towards +X in radians; at 0 the bars run along Y, side by side along X.

    Raises
    ------
    ValueError
        If a number is outside its range.

    Examples
    --------
    >>> bars = clplen.cameras.Bars((0, 0), 16, count=3, period=8, width=4)
    >>> scene = clplen.cameras.SurfaceScene(clplen.cameras.Plane(0.5, outline=bars))
    >>> lf, truth = scene.light_field((1, 1), (32, 32))
    >>> "".join("#" if seen == 0 else "." for seen in truth.surface[16])
    '......####....####....####......'
    """

    centre: Pair
    length: float
    _: KW_ONLY
    count: int
    period: float
    width: float | Pair
    angle: float = 0.0

    def __post_init__(self) -> None:
        _finite(self.centre, 2, "The centre of bars")
        _finite((self.length, self.period), 2, "Length and period of bars", positive=True)
        if not is_integer(self.count) or self.count < 1:
            raise ValueError(f"count must be an integer >= 1, got {self.count!r}.")
        if not all(0 <= width <= self.period for width in self.widths):
            raise ValueError(
                f"width must be 0 to {self.period:g} pixels (the period), got {self.width!r}."
            )

    @property
    def widths(self) -> Pair:
        """Widths of a bar at its first and its last end."""
        return _pair(self.width)

    @property
    def half(self) -> Pair:
        """Half the length, and half the extent of all bars side by side."""
        return (self.length / 2, self.count * self.period / 2)

    def corners(self) -> Vector:
        """Return the corners of the rectangle about all bars, (Y, X), shape (4, 2)."""
        return _rectangle(self.centre, self.half, self.angle)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Polygon(OneLine):
    """Closed lines of straight edges, one or several; the even-odd rule defines the inside.

    Parameters
    ----------
    *contours : array_like
        Vertices (Y, X) of each line in pixels from the middle of the picture, shape (n, 2), n >= 3.

    Attributes
    ----------
    contours : tuple of numpy.ndarray
        Vertices, float64, shape (n, 2) each.

    Raises
    ------
    ValueError
        If there are no contours, or a contour is not a list of at least three points.

    Examples
    --------
    >>> outer = [(-8, -8), (-8, 8), (8, 8), (8, -8)]
    >>> hole = [(-4, -4), (-4, 4), (4, 4), (4, -4)]
    >>> frame = clplen.cameras.Polygon(outer, hole)
    >>> scene = clplen.cameras.SurfaceScene(clplen.cameras.Plane(0.5, outline=frame))
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> int((truth.surface == 0).sum()) == 16**2 - 8**2
    True
    """

    contours: tuple[Vector, ...]

    def __init__(self, *contours: Sequence[Pair] | np.ndarray[Any, Any]) -> None:
        lines = tuple(
            np.array(real_array(contour, "A contour", np.float64)) for contour in contours
        )
        for line in lines:
            if line.ndim != 2 or line.shape[1] != 2 or len(line) < 3:
                raise ValueError(
                    f"A contour must be (Y, X) of at least three points, got shape {line.shape}."
                )
            _finite(line.ravel(), line.size, "The vertices of a polygon")
        if not lines:
            raise ValueError("A polygon must have at least one contour.")
        object.__setattr__(self, "contours", lines)

    def corners(self) -> Vector:
        """Return all vertices, (Y, X), shape (n, 2)."""
        return np.concatenate(self.contours)

    def edges(self) -> Vector:
        """Return (y0, x0, y1, x1) of every edge, shape (n, 4)."""
        parts = [np.hstack([line, np.roll(line, -1, axis=0)]) for line in self.contours]
        return np.concatenate(parts)


Outline = Ellipse | Bars | Polygon


def rectangle(centre: Pair, size: Pair, *, angle: float = 0.0) -> Polygon:
    """Return a rectangle as a polygon.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    size : tuple of float
        (height, width) in pixels, positive.
    angle : float
        Rotation of +Y towards +X in radians.

    Returns
    -------
    Polygon
        Polygon of one contour with four vertices.

    Raises
    ------
    ValueError
        If a number is not finite or a size not positive.

    Examples
    --------
    >>> clplen.cameras.rectangle((0, 10), (8, 16)).corners().tolist()
    [[-4.0, 2.0], [-4.0, 18.0], [4.0, 18.0], [4.0, 2.0]]
    """
    _finite(centre, 2, "The centre of a rectangle")
    _finite(size, 2, "The size of a rectangle", positive=True)
    return Polygon(_rectangle(centre, (size[0] / 2, size[1] / 2), angle))


def _pair(value: float | Pair) -> Pair:
    """Return two numbers, equal for a single value."""
    if isinstance(value, tuple | list):
        return (float(value[0]), float(value[1]))
    return (float(float64_array(value)),) * 2


def _rectangle(centre: Pair, half: Pair, angle: float) -> Vector:
    along = np.array([math.cos(angle), math.sin(angle)]) * half[0]
    across = np.array([-math.sin(angle), math.cos(angle)]) * half[1]
    signs = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return np.array([np.asarray(centre) + s * along + t * across for s, t in signs])


def _finite(numbers: Any, count: int, what: str, positive: bool = False) -> None:
    values = float64_array(numbers)
    if values.size != count or not np.isfinite(values).all() or (positive and (values <= 0).any()):
        kind = "positive and finite" if positive else "finite"
        raise ValueError(f"{what} must be {count} numbers, {kind}, in pixels, got {numbers!r}.")


@dataclass(frozen=True)
class Spot:
    """Highlight: a Gaussian spot of light on a surface that moves with the view.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in the centre view, pixels from the middle of the picture.
    width : float
        Standard deviation in pixels, positive.
    strength : float
        Brightness added in the middle.
    disparity : float
        Disparity of its motion; the mirror image of a lamp has another disparity than its surface.

    Raises
    ------
    ValueError
        If a number is not finite, or the width not positive.

    Examples
    --------
    >>> lamp = clplen.cameras.Spot((0, 0), 2, disparity=3)
    >>> scene = clplen.cameras.SurfaceScene(clplen.cameras.Plane(0.0, spots=[lamp]))
    >>> lf, truth = scene.light_field((1, 3), (33, 33))
    >>> lf.to_numpy()[0, :, 16].argmax(axis=1).tolist()  # it moves, the plane stays
    [19, 16, 13]
    """

    centre: Pair
    width: float
    _: KW_ONLY
    strength: float = 0.4
    disparity: float = 0.0

    def __post_init__(self) -> None:
        require_numbers("A spot", *self.centre, self.width, self.strength, self.disparity)
        if not self.width > 0:
            raise ValueError(f"The width of a spot must be > 0 pixels, got {self.width!r}.")


@dataclass(frozen=True, eq=False, repr=False)
class Plane(OneLine):
    """Plane, d = d0 + gy Y + gx X with (Y, X) in pixels from the middle of the picture.

    The disparity of any plane in space is affine in the picture, because 1/z is.

    Parameters
    ----------
    disparity : float
        Disparity in the middle of the picture, pixels a view step; nearer is larger.
    slope : tuple of float
        (gy, gx), disparity a pixel.
    texture : Texture
        Brightness over (Y, X); uniform grey of 0.5 by default.
    outline : Ellipse, Bars, Polygon or None
        Boundary of the surface in (Y, X); None for an infinite plane.
    shade : tuple of float
        (sy, sx): the texture is multiplied by 1 + sy Y + sx X, not below 0.
    spots : sequence of Spot
        Highlights, whose light is added.

    Raises
    ------
    ValueError
        If a number is not finite.

    Examples
    --------
    >>> slanted = clplen.cameras.Plane(0.5, (0.0, 0.02), texture=clplen.cameras.checker(8))
    >>> lf, truth = clplen.cameras.SurfaceScene(slanted).light_field((3, 3), (33, 33))
    >>> lf.shape
    (3, 3, 33, 33)
    >>> [f"{d:.2f}" for d in truth.disparity[16, ::8]]
    ['0.18', '0.34', '0.50', '0.66', '0.82']
    """

    disparity: float
    slope: Pair = (0.0, 0.0)
    _: KW_ONLY
    texture: Texture = field(default_factory=uniform)
    outline: Outline | None = None
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    def __post_init__(self) -> None:
        require_numbers("A plane", self.disparity, *self.slope, *self.shade)

    def bounds(self) -> Vector | None:
        """Return (Y, X, d) of points whose hull contains the outline, or None without one."""
        if self.outline is None:
            return None
        corners = self.outline.corners()
        return np.column_stack([corners, self.disparity + corners @ np.asarray(self.slope)])


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(OneLine):
    """Ellipsoid, (d - d0)^2/height^2 + r^2/radius^2 = 1, r from its centre in (Y, X).

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    radius : float
        Radius in the centre view in pixels, positive.
    disparity : float
        Disparity of its rim in the centre view.
    height : float
        Disparity of the nearest point minus that of the rim, positive.
    texture : Texture
        Brightness over (Y, X); uniform grey of 0.5 by default.
    shade : tuple of float
        (sy, sx): the texture is multiplied by 1 + sy Y + sx X, not below 0.
    spots : sequence of Spot
        Highlights, whose light is added.

    Raises
    ------
    ValueError
        If a number is not finite, or radius or height not positive.

    Examples
    --------
    >>> ball = clplen.cameras.Sphere((0, 0), 12, disparity=0.0, height=1.0)
    >>> lf, truth = clplen.cameras.SurfaceScene(ball).light_field((3, 3), (33, 33))
    >>> f"{truth.disparity[16, 16]:.2f} in the middle, {truth.disparity[16, 26]:.2f} near the rim"
    '1.00 in the middle, 0.55 near the rim'
    """

    centre: Pair
    radius: float
    _: KW_ONLY
    disparity: float
    height: float
    texture: Texture = field(default_factory=uniform)
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    def __post_init__(self) -> None:
        lengths = (self.radius, self.disparity, self.height)
        require_numbers("A sphere", *self.centre, *lengths, *self.shade)
        if not (self.radius > 0 and self.height > 0):
            raise ValueError(
                "radius and height of a sphere must be > 0, got "
                f"{self.radius!r} and {self.height!r}."
            )

    def bounds(self) -> Vector:
        """Return (Y, X, d) of the corners of a box about it."""
        Y, X = self.centre
        signs = [(s, t, q) for s in (-1, 1) for t in (-1, 1) for q in (-1, 1)]
        return np.array(
            [(Y + s * self.radius, X + t * self.radius, self.disparity + q * self.height)
             for s, t, q in signs]
        )  # fmt: skip


def require_numbers(what: str, *values: float) -> None:
    """Raise for numbers that are not finite."""
    if not np.isfinite(values).all():
        raise ValueError(f"{what} must have finite numbers, got {values}.")
