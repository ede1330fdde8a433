"""Outlines of flat surfaces, in pixels of the centre view from the middle of the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from clplen.reprs import OneLine

Vector = np.ndarray[Any, np.dtype[np.float64]]
Pair = tuple[float, float]


@dataclass(frozen=True)
class Ellipse:
    """A disc, or an ellipse.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    radii : float or tuple of float
        One radius, or two (along Y, along X before the turn), in pixels, positive.
    angle : float
        Radians by which +Y is turned towards +X.

    Raises
    ------
    ValueError
        If a number is not finite or a radius not positive.
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
        """Both radii."""
        if isinstance(self.radii, tuple | list):
            return (float(self.radii[0]), float(self.radii[1]))
        return (float(self.radii), float(self.radii))

    def corners(self) -> Vector:
        """Corners of a rectangle about it, (Y, X), shape (4, 2)."""
        return _rectangle(self.centre, self.half, self.angle)


@dataclass(frozen=True)
class Bars:
    """Parallel bars with gaps between them, of one width or tapered.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) of the middle of all bars in pixels from the middle of the picture.
    length : float
        Of each bar in pixels.
    count : int
        Bars, at least 1.
    period : float
        From bar to bar in pixels; what the bars leave of it is the gap.
    width : float or tuple of float
        Of a bar in pixels, or (at its first end, at its last), 0 to ``period``.
    angle : float
        0: bars run along Y, side by side along X; radians by which +Y is turned towards +X.

    Raises
    ------
    ValueError
        If a number is outside its range.
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
        if self.count != int(self.count) or self.count < 1:
            raise ValueError(f"There is at least one bar, not {self.count!r}.")
        if not all(0 <= width <= self.period for width in self.widths):
            raise ValueError(
                f"A bar is 0 to {self.period:g} pixels wide (its period), not {self.width!r}."
            )

    @property
    def widths(self) -> Pair:
        """Of a bar at its first end and at its last."""
        if isinstance(self.width, tuple | list):
            return (float(self.width[0]), float(self.width[1]))
        return (float(self.width), float(self.width))

    @property
    def half(self) -> Pair:
        """Half the length, and half the extent of all bars side by side."""
        return (self.length / 2, self.count * self.period / 2)

    def corners(self) -> Vector:
        """Corners of the rectangle about all bars, (Y, X), shape (4, 2)."""
        return _rectangle(self.centre, self.half, self.angle)


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Polygon(OneLine):
    """One closed line of straight edges, or several; inside by the even-odd rule.

    Parameters
    ----------
    *contours : array_like
        Each shape (n, 2), n >= 3: (Y, X) of its vertices in pixels from the middle of the picture.

    Raises
    ------
    ValueError
        If there is none, or one is no list of at least three points.
    """

    contours: tuple[Vector, ...]

    def __init__(self, *contours: Sequence[Pair] | np.ndarray[Any, Any]) -> None:
        lines = tuple(np.array(contour, np.float64) for contour in contours)
        for line in lines:
            if line.ndim != 2 or line.shape[1] != 2 or len(line) < 3:
                raise ValueError(
                    f"A contour of a polygon is (Y, X) for three points or more, not {line.shape}."
                )
            _finite(line.ravel(), line.size, "The vertices of a polygon")
        if not lines:
            raise ValueError("A polygon has at least one contour.")
        object.__setattr__(self, "contours", lines)

    def corners(self) -> Vector:
        """All vertices, (Y, X), shape (n, 2)."""
        return np.concatenate(self.contours)

    def edges(self) -> Vector:
        """(y0, x0, y1, x1) of every edge, shape (n, 4)."""
        parts = [np.hstack([line, np.roll(line, -1, axis=0)]) for line in self.contours]
        return np.concatenate(parts)


Outline = Ellipse | Bars | Polygon


def rectangle(centre: Pair, size: Pair, *, angle: float = 0.0) -> Polygon:
    """A rectangle as a polygon.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    size : tuple of float
        (height, width) in pixels, positive.
    angle : float
        Radians by which +Y is turned towards +X.

    Returns
    -------
    Polygon

    Raises
    ------
    ValueError
        If a number is not finite or a size not positive.
    """
    _finite(centre, 2, "The centre of a rectangle")
    _finite(size, 2, "The size of a rectangle", positive=True)
    return Polygon(_rectangle(centre, (size[0] / 2, size[1] / 2), angle))


def _rectangle(centre: Pair, half: Pair, angle: float) -> Vector:
    along = np.array([math.cos(angle), math.sin(angle)]) * half[0]
    across = np.array([-math.sin(angle), math.cos(angle)]) * half[1]
    signs = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return np.array([np.asarray(centre) + s * along + t * across for s, t in signs])


def _finite(numbers: Any, count: int, what: str, positive: bool = False) -> None:
    values = np.asarray(numbers, np.float64)
    if values.size != count or not np.isfinite(values).all() or (positive and (values <= 0).any()):
        kind = "positive and finite" if positive else "finite"
        raise ValueError(f"{what}: {count} numbers, {kind}, in pixels, not {numbers!r}.")
