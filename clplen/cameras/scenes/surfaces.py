"""Surfaces with exact disparity: planes with outlines, spheres, textures, highlights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field

import numpy as np

from clplen.cameras.scenes.outlines import Outline, Vector
from clplen.cameras.scenes.textures import Texture, uniform
from clplen.deprecation import renamed_argument, renamed_attribute
from clplen.reprs import OneLine

Pair = tuple[float, float]


@renamed_argument(old="d", new="disparity")
@dataclass(frozen=True)
class Spot:
    """A highlight: a Gaussian spot of light on a surface that moves with the view.

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in the centre view, pixels from the middle of the picture.
    width : float
        Standard deviation in pixels, positive.
    strength : float
        Brightness that it adds in its middle.
    disparity : float
        What it moves with; that of a mirror image of a lamp differs from its surface's.

    Raises
    ------
    ValueError
        If a number is not finite, or the width not positive.
    """

    centre: Pair
    width: float
    _: KW_ONLY
    strength: float = 0.4
    disparity: float = 0.0

    d = renamed_attribute("d", "disparity")

    def __post_init__(self) -> None:
        require_numbers("A spot", *self.centre, self.width, self.strength, self.disparity)
        if not self.width > 0:
            raise ValueError(f"The width of a spot is positive, in pixels, not {self.width!r}.")


@renamed_argument(old="d", new="disparity")
@dataclass(frozen=True, eq=False, repr=False)
class Plane(OneLine):
    """A plane, d = d0 + gy Y + gx X with (Y, X) in pixels from the middle of the picture.

    Disparity is affine in the picture, as 1/z is on any plane in space.

    Parameters
    ----------
    disparity : float
        In the middle of the picture, pixels a view step, nearer is larger.
    slope : tuple of float
        (gy, gx), disparity a pixel.
    texture : Texture
    outline : Ellipse, Bars, Polygon or None
        What there is of it, in (Y, X); None: all of the plane.
    shade : tuple of float
        (sy, sx): the texture is multiplied by 1 + sy Y + sx X, not below 0.
    spots : sequence of Spot

    Raises
    ------
    ValueError
        If a number is not finite.
    """

    disparity: float
    slope: Pair = (0.0, 0.0)
    _: KW_ONLY
    texture: Texture = field(default_factory=uniform)
    outline: Outline | None = None
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    d = renamed_attribute("d", "disparity")

    def __post_init__(self) -> None:
        require_numbers("A plane", self.disparity, *self.slope, *self.shade)

    def bounds(self) -> Vector | None:
        """(Y, X, d) of points whose hull holds the plane's outline; None if it has none."""
        if self.outline is None:
            return None
        corners = self.outline.corners()
        return np.column_stack([corners, self.disparity + corners @ np.asarray(self.slope)])


@renamed_argument(old="d", new="disparity")
@dataclass(frozen=True, eq=False, repr=False)
class Sphere(OneLine):
    """An ellipsoid, (d - d0)^2/height^2 + r^2/radius^2 = 1, r from its centre in (Y, X).

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    radius : float
        In the centre view, pixels, positive.
    disparity : float
        Of its rim as the centre view sees it.
    height : float
        Its nearest point has the ``disparity + height``; positive.
    texture : Texture
    shade, spots
        As for `Plane`.

    Raises
    ------
    ValueError
        If a number is not finite, or radius or height not positive.
    """

    centre: Pair
    radius: float
    _: KW_ONLY
    disparity: float
    height: float
    texture: Texture = field(default_factory=uniform)
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    d = renamed_attribute("d", "disparity")

    def __post_init__(self) -> None:
        lengths = (self.radius, self.disparity, self.height)
        require_numbers("A sphere", *self.centre, *lengths, *self.shade)
        if not (self.radius > 0 and self.height > 0):
            raise ValueError(
                "Radius and height of a sphere are positive, not "
                f"{self.radius!r} and {self.height!r}."
            )

    def bounds(self) -> Vector:
        """(Y, X, d) of the corners of a box about it."""
        Y, X = self.centre
        signs = [(s, t, q) for s in (-1, 1) for t in (-1, 1) for q in (-1, 1)]
        return np.array(
            [(Y + s * self.radius, X + t * self.radius, self.disparity + q * self.height)
             for s, t, q in signs]
        )  # fmt: skip


def require_numbers(what: str, *values: float) -> None:
    """Refuse numbers that are not finite.

    Raises
    ------
    ValueError
        With what they are.
    """
    if not np.isfinite(values).all():
        raise ValueError(f"{what} has finite numbers, not {values}.")
