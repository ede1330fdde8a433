"""Scenes of surfaces with exact disparity: planes with outlines, spheres, textures, highlights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.cameras.scenes import surface_tables
from clplen.cameras.scenes.ground_truth import Truth
from clplen.cameras.scenes.outlines import Outline, Vector
from clplen.cameras.scenes.textures import Texture, uniform
from clplen.compute.device import DeviceLike, as_device
from clplen.compute.oneline import OneLine
from clplen.errors import ShapeError
from clplen.lightfield.lightfield import LightField

if TYPE_CHECKING:
    pass

Pair = tuple[float, float]
MOST_SURFACES = 64  # bits of a mask in the kernels
EDGE_ON = 0.05  # smallest 1 - gy a - gx b: a plane seen at a smaller angle is refused


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
    d : float
        The disparity it moves with; that of a mirror image of a lamp differs from its surface's.

    Raises
    ------
    ValueError
        If a number is not finite, or the width not positive.
    """

    centre: Pair
    width: float
    _: KW_ONLY
    strength: float = 0.4
    d: float = 0.0

    def __post_init__(self) -> None:
        _numbers("A spot", *self.centre, self.width, self.strength, self.d)
        if not self.width > 0:
            raise ValueError(f"The width of a spot is positive, in pixels, not {self.width!r}.")


@dataclass(frozen=True, eq=False, repr=False)
class Plane(OneLine):
    """A plane, d = d0 + gy Y + gx X with (Y, X) in pixels from the middle of the picture.

    Disparity is affine in the picture, as 1/z is on any plane in space.

    Parameters
    ----------
    d : float
        Disparity in the middle of the picture, pixels a view step, nearer is larger.
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

    d: float
    slope: Pair = (0.0, 0.0)
    _: KW_ONLY
    texture: Texture = field(default_factory=uniform)
    outline: Outline | None = None
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    def __post_init__(self) -> None:
        _numbers("A plane", self.d, *self.slope, *self.shade)

    def bounds(self) -> Vector | None:
        """(Y, X, d) of points whose hull holds the plane's outline; None if it has none."""
        if self.outline is None:
            return None
        corners = self.outline.corners()
        return np.column_stack([corners, self.d + corners @ np.asarray(self.slope)])


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(OneLine):
    """An ellipsoid, (d - d0)^2/height^2 + r^2/radius^2 = 1, r from its centre in (Y, X).

    Parameters
    ----------
    centre : tuple of float
        (Y, X) in pixels from the middle of the picture.
    radius : float
        In the centre view, pixels, positive.
    d : float
        Disparity of its rim as the centre view sees it.
    height : float
        Its nearest point has the disparity ``d + height``; positive.
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
    d: float
    height: float
    texture: Texture = field(default_factory=uniform)
    shade: Pair = (0.0, 0.0)
    spots: Sequence[Spot] = ()

    def __post_init__(self) -> None:
        _numbers("A sphere", *self.centre, self.radius, self.d, self.height, *self.shade)
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
            [(Y + s * self.radius, X + t * self.radius, self.d + q * self.height)
             for s, t, q in signs]
        )  # fmt: skip


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SurfaceScene(OneLine):
    """Opaque surfaces in the space (Y, X, d) of a light field's centre view.

    The ray of L[v, u, y, x] is the straight line (Y, X) = (y + d (v - vc), x + d (u - uc)) for all
    d, y and x from the middle of the picture, and shows the surface of the largest d on it. So
    views and their disparity are exact, with occlusions, for any number of views.

    Parameters
    ----------
    surfaces : Plane, Sphere or sequence of them
        At most 64.
    background : float
        Brightness where a ray meets none; such pixels have no disparity (nan).

    Raises
    ------
    TypeError
        If a member is neither `Plane` nor `Sphere`.
    ValueError
        If there is none, or more than 64, or the background is not finite.
    """

    surfaces: tuple[Plane | Sphere, ...]
    background: float

    def __init__(
        self, surfaces: Plane | Sphere | Sequence[Plane | Sphere], background: float = 0.0
    ) -> None:
        members = (surfaces,) if isinstance(surfaces, Plane | Sphere) else tuple(surfaces)
        if not 1 <= len(members) <= MOST_SURFACES:
            raise ValueError(
                f"A scene has 1 to {MOST_SURFACES} surfaces, not {len(members)}: bars and polygons "
                "of several contours are one surface."
            )
        for one in members:
            if not isinstance(one, Plane | Sphere):
                raise TypeError(f"A surface is a Plane or a Sphere, not {type(one).__name__}.")
        _numbers("The background", background)
        object.__setattr__(self, "surfaces", members)
        object.__setattr__(self, "background", float(background))

    @property
    def channels(self) -> int:
        """3 if a texture has colour, else 1."""
        return max(one.texture.channels for one in self.surfaces)

    def light_field(
        self,
        views: tuple[int, int] = (9, 9),
        shape: tuple[int, int] = (512, 512),
        *,
        device: DeviceLike,
        noise: Any = 0.0,
        seed: int = 0,
        dtype: Any = np.float32,
        gain: Any = None,
    ) -> tuple[LightField, Truth]:
        """Views of the scene, and what is exactly so in its centre view.

        Edges are anti-aliased by 8 x 8 rays a pixel. Textures are as pixels see them: the same
        average over a pixel in every view.

        Parameters
        ----------
        views : tuple of int
            (V, U), at least 1 each.
        shape : tuple of int
            (ny, nx) of a view, at least 1 each.
        device : Device or str
        noise : float or array_like
            Standard deviation of additive Gaussian noise, as a fraction of white; broadcast over
            (ny, nx), so shape (ny, 1) gives each row its own.
        seed : int
            Of the noise (`numpy.random.default_rng`); the same on every device.
        dtype : dtype-like
            float32, or uint8 or uint16 with white at the largest number, rounded and clipped.
        gain : array_like, optional
            Shape (V, U), finite: brightness of each view, before the noise. 1 by default.

        Returns
        -------
        LightField
            Shape (V, U, ny, nx), or (V, U, ny, nx, 3) where a texture has colour.
        Truth

        Raises
        ------
        ValueError
            If a plane is so steep that a view sees it from its edge or from behind, or a number is
            outside its range.
        ShapeError
            If noise or gain do not fit, or views or shape are no two positive whole numbers.
        DeviceError
            If the light field does not fit the device.
        """
        device = as_device(device)
        V, U = _counts(views, "views")
        ny, nx = _counts(shape, "shape")
        kind = np.dtype(dtype)
        if kind not in (np.float32, np.uint8, np.uint16):
            raise ValueError(f"dtype is float32, uint8 or uint16, not {kind}.")
        sd = _spread(noise, (ny, nx))
        levels = _gains(gain, (V, U))
        self.check_views((V - 1) / 2, (U - 1) / 2)
        tables = surface_tables.tables(self, device)
        full = (V, U, ny, nx) if self.channels == 1 else (V, U, ny, nx, 3)
        device.require_memory(kind.itemsize * math.prod(full), "This light field")
        result = np.empty(full, kind)
        random = np.random.default_rng(seed)
        for v, row in enumerate(surface_tables.rows_of_views(tables, levels, (ny, nx))):
            result[v] = _stored(row.reshape(full[1:]), sd, random, kind)
        weights = np.ones((V, U), np.float32)
        lf = LightField.from_array(result, device=device, weights=weights)
        return lf, surface_tables.truth(tables, (ny, nx))

    def check_views(self, down: float, right: float) -> None:
        """Refuse planes that a view up to (down, right) from the centre sees edge-on.

        Raises
        ------
        ValueError
            Naming the plane and the slope that would do.
        """
        for number, one in enumerate(self.surfaces):
            if not isinstance(one, Plane):
                continue
            turn = abs(one.slope[0]) * down + abs(one.slope[1]) * right
            if turn > 1 - EDGE_ON:
                raise ValueError(
                    f"Surface {number}, a plane of slope {one.slope} disparities a pixel, is seen "
                    f"edge-on or from behind by views up to {max(down, right):g} from the centre: "
                    f"|gy| {down:g} + |gx| {right:g} = {turn:.3g} is at most {1 - EDGE_ON:g}."
                )


def _numbers(what: str, *values: float) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{what} has finite numbers, not {values}.")


def _counts(pair: Any, what: str) -> tuple[int, int]:
    """Two positive whole numbers."""
    values = np.asarray(pair)
    if values.shape != (2,) or values.dtype.kind not in "iu" or (values < 1).any():
        raise ShapeError(f"{what} is two positive whole numbers, not {pair!r}.")
    return int(values[0]), int(values[1])


def _spread(noise: Any, shape: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Standard deviation of the noise, broadcastable to (ny, nx, 1)."""
    values = np.asarray(noise, np.float32)
    try:
        np.broadcast_to(values, shape)
    except ValueError as error:
        raise ShapeError(f"noise of shape {values.shape} does not fit pixels {shape}.") from error
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError("The standard deviation of noise is finite and not negative.")
    return values


def _gains(gain: Any, views: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Brightness of each view, float32, shape (V, U)."""
    values = np.ones(views, np.float32) if gain is None else np.asarray(gain, np.float32)
    if values.shape != views:
        raise ShapeError(f"gain has one number for each of {views} views, not {values.shape}.")
    if not np.isfinite(values).all():
        raise ValueError("The gains of views are finite.")
    return values


def _stored(row: Any, sd: Any, random: np.random.Generator, kind: np.dtype[Any]) -> Any:
    """A row of views with noise, in its storage type."""
    if sd.any():
        grown = sd if row.ndim == 3 else np.broadcast_to(sd, row.shape[1:3])[..., None]
        row = row + grown * random.standard_normal(row.shape, np.float32)
    if kind == np.float32:
        return row
    top = np.iinfo(kind).max
    return np.clip(np.rint(row * np.float32(top)), 0, top).astype(kind)
