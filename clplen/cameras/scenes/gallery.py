"""Varied synthetic scenes of exact disparity, to develop and evaluate depth estimation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import (
    Bars,
    Ellipse,
    Pair,
    Plane,
    Polygon,
    Sphere,
    Spot,
    rectangle,
)
from clplen.cameras.scenes.textures import Texture, bricks, checker, noise, picture
from clplen.checks import positive_integer
from clplen.reprs import OneLine

Random = np.random.Generator
NOISE_LEVELS = (0.0, 0.01, 0.02, 0.05)  # noise levels as fractions of white, used in turn
FILL_SIDES = 4.0  # half sides of surfaces that fill every view, in pictures
SEAM_PIXELS = 0.01  # overlap in pixels of surfaces that meet in a line


@dataclass(frozen=True, eq=False, repr=False)
class SampleScene(OneLine):
    """Scene with a name and its noise.

    Attributes
    ----------
    name : str
        Kind of the scene, such as "layers".
    scene : SurfaceScene
        Scene of the light field.
    noise : float or numpy.ndarray
        Noise argument of `SurfaceScene.light_field`.

    Examples
    --------
    >>> sample = next(clplen.cameras.sample_scenes(seed=1, shape=(64, 64)))
    >>> sample.name, sample.noise
    ('plane', 0.01)
    >>> lf, truth = sample.scene.light_field((3, 3), (64, 64), noise=sample.noise)
    >>> lf.shape[:4]
    (3, 3, 64, 64)
    """

    name: str
    scene: SurfaceScene
    noise: Any


@dataclass(frozen=True, eq=False)
class Studio:
    """Random generator and options for the constructors of scenes."""

    random: Random
    shape: tuple[int, int]  # (ny, nx) of a view
    pictures: Sequence[Any]
    colour: bool

    @property
    def unit(self) -> float:
        """Half the shorter side in pixels."""
        return min(self.shape) / 2

    @property
    def side(self) -> int:
        """Side of tables of noise in samples."""
        return min(256, max(64, 2 ** int(np.ceil(np.log2(max(self.shape))))))

    def uniform(self, low: float, high: float) -> float:
        """Draw a number between two."""
        return float(self.random.uniform(low, high))

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.random.choice([-1, 1]))

    def position(self, reach: float = 0.8) -> Pair:
        """Draw (Y, X) within a part of the picture."""
        ny, nx = self.shape
        y, x = self.random.uniform(-reach / 2, reach / 2, 2)
        return (float(y) * ny, float(x) * nx)

    def texture(self, contrast: float | None = None) -> Texture:
        """Draw a texture of any kind."""
        kind = self.random.integers(8)
        if kind == 0 and self.pictures and contrast is None:
            chosen = np.asarray(self.pictures[int(self.random.integers(len(self.pictures)))])
            if not self.colour and chosen.ndim == 3:
                chosen = chosen.mean(axis=2) / (255 if chosen.dtype.kind == "u" else 1)
            return picture(chosen, scale=self.uniform(0.7, 1.5))
        seed = int(self.random.integers(2**31))
        if kind == 1 and contrast is None:
            high = int(self.random.integers(8, 20))
            return bricks(seed, size=(high, 2 * high + 4), colour=self.colour)
        if kind == 2 and contrast is None:
            return checker(self.uniform(12, 40), low=self.uniform(0, 0.4), high=0.8)
        return noise(
            seed,
            self.side,
            mean=self.uniform(0.35, 0.65),
            contrast=self.uniform(0.06, 0.2) if contrast is None else contrast,
            exponent=float(self.random.choice([0.5, 1.0, 1.5])),
            finest=self.uniform(0.2, 0.35),
            colour=self.colour,
        )

    def ground(self, low: float = -1.6, high: float = -0.6) -> Plane:
        """Draw a slightly slanted plane behind everything."""
        slope = self.random.uniform(-0.15, 0.15, 2) / self.unit
        return Plane(self.uniform(low, high), (slope[0], slope[1]), texture=self.texture())


def sample_scenes(
    seed: int = 0, shape: tuple[int, int] = (512, 512), *, pictures: Sequence[Any] = ()
) -> Iterator[SampleScene]:
    """Yield a random scene of each kind.

    Disparities lie between -2 and 2 for 9 x 9 views.

    Parameters
    ----------
    seed : int
        Seed of `numpy.random.default_rng`; other seeds draw other scenes of these kinds.
    shape : tuple of int
        (ny, nx) of a view of the light fields.
    pictures : sequence of array_like
        Pictures among the textures, shape (ny, nx) or (ny, nx, 3).

    Yields
    ------
    SampleScene
        Scene with a name of `SCENES`. Noise of 0, 1, 2 and 5 % in turn; every second scene has
        colour.

    Examples
    --------
    >>> names = [sample.name for sample in clplen.cameras.sample_scenes(shape=(32, 32))]
    >>> len(names), names[:5]
    (15, ['plane', 'slant', 'layers', 'roof', 'valley'])
    """
    shape = (
        positive_integer(shape[0], "ny of a scene"),
        positive_integer(shape[1], "nx of a scene"),
    )
    for number, (name, make) in enumerate(SCENES.items()):
        random = np.random.default_rng([seed, number])
        studio = Studio(random, shape, pictures, bool((seed + number) % 2))
        level: Any = NOISE_LEVELS[(seed + number) % len(NOISE_LEVELS)]
        if name == "dots":
            level = np.linspace(0, 0.2, shape[0])[:, None]
        yield SampleScene(name, SurfaceScene(make(studio)), level)


def _plane(s: Studio) -> list[Any]:
    return [Plane(s.uniform(-1.9, 1.9), texture=s.texture())]


def _slant(s: Studio) -> list[Any]:
    reach = s.uniform(0.4, 0.9) * s.random.choice([-1, 1], 2) / np.asarray(s.shape) * 2
    return [Plane(s.uniform(-0.1, 0.1), (reach[0], reach[1]), texture=s.texture())]


def _layers(s: Studio) -> list[Any]:
    depths = np.sort(s.random.uniform(-1.5, 1.9, 6))
    sizes = [tuple(s.random.uniform(0.3, 0.9, 2) * s.unit) for _ in depths]
    return [s.ground(-1.6, -1.5)] + [
        Plane(d, texture=s.texture(), outline=rectangle(s.position(), size, angle=s.uniform(0, 3)))
        for d, size in zip(depths, sizes, strict=True)
    ]


def _roof(s: Studio) -> list[Any]:
    g, wide = s.uniform(0.7, 1.4) / s.unit, FILL_SIDES * s.unit
    across = s.uniform(-0.3, 0.3) / s.unit
    return [
        Plane(1.0, (slope, across), texture=s.texture(), outline=Polygon(_band(*rows, wide)))
        for slope, rows in ((g, (-wide, SEAM_PIXELS)), (-g, (wide, -SEAM_PIXELS)))
    ]


def _valley(s: Studio) -> list[Any]:
    g = s.uniform(0.7, 1.4) / s.unit
    return [Plane(-1.0, (0.0, sign * g), texture=s.texture()) for sign in (-1, 1)]


def _staircase(s: Studio) -> list[Any]:
    steps, wide, slope = 7, FILL_SIDES * s.unit, s.uniform(-0.3, 0.3) / s.unit
    edges = np.linspace(-1, 1, steps + 1)[1:-1] * s.shape[0] / 2
    depths = np.linspace(-1.6, 1.6, steps)
    first = Plane(depths[0], (0.0, slope), texture=s.texture())
    return [first] + [
        Plane(d, (0.0, slope), texture=s.texture(), outline=Polygon(_band(y, wide, wide)))
        for d, y in zip(depths[1:], edges, strict=True)
    ]


def _spheres(s: Studio) -> list[Any]:
    surfaces: list[Any] = [s.ground(-1.2, -0.8)]
    for _ in range(6):
        radius = s.uniform(0.15, 0.45) * s.unit
        height = s.uniform(0.4, 1.2)
        centre, rim = s.position(), s.uniform(-0.7, 0.6)
        surfaces.append(Sphere(centre, radius, disparity=rim, height=height, texture=s.texture()))
    return surfaces


def _bars(s: Studio) -> list[Any]:
    surfaces: list[Any] = [s.ground(-1.2, -0.4)]
    rows = np.linspace(-0.85, 0.85, 6) * s.unit
    for y, gap in zip(rows, (1, 2, 3, 5, 8, 12), strict=True):
        width = float(s.random.integers(1, 12))
        count = int(1.4 * s.unit // (width + gap))
        outline = Bars((y, s.uniform(-0.2, 0.2) * s.unit), 0.22 * s.unit, count=max(1, count),
                       period=width + gap, width=width, angle=s.uniform(-0.3, 0.3))  # fmt: skip
        surfaces.append(Plane(s.uniform(0.2, 1.6), texture=s.texture(), outline=outline))
    return surfaces


def _backgammon(s: Studio) -> list[Any]:
    slope = s.uniform(0.5, 1.0) / s.unit
    surfaces: list[Any] = [Plane(-1.1, (0.0, slope / 2), texture=s.texture())]
    for sign in (-1, 1):
        outline = Bars((sign * 0.5 * s.unit, 0.0), 0.9 * s.unit, count=16, period=s.unit / 9,
                       width=(0.0, s.unit / 9) if sign > 0 else (s.unit / 9, 0.0))  # fmt: skip
        surfaces.append(Plane(0.6, (0.0, slope), texture=s.texture(), outline=outline))
    return surfaces


def _dots(s: Studio) -> list[Any]:
    surfaces: list[Any] = [Plane(-0.8, texture=s.texture(0.1))]
    texture = s.texture(0.1)
    rows, columns = 7, 8
    radii = np.geomspace(0.09, 0.008, columns) * s.unit
    for y in np.linspace(-0.85, 0.85, rows):
        for x, radius in zip(np.linspace(-0.85, 0.85, columns), radii, strict=True):
            outline = Ellipse((y * s.shape[0] / 2, x * s.shape[1] / 2), max(1.0, float(radius)))
            surfaces.append(Plane(0.5, texture=texture, outline=outline))
    return surfaces


def _stripes(s: Studio) -> list[Any]:
    surfaces: list[Any] = []
    ny, nx = s.shape
    edges = np.linspace(-1, 1, 7) * ny / 2
    edges[0], edges[-1] = -FILL_SIDES * ny, FILL_SIDES * ny
    for top, bottom, contrast in zip(edges, edges[1:], np.geomspace(0.2, 0.01, 6), strict=False):
        band = Polygon(_band(top, bottom, FILL_SIDES * nx))
        surfaces.append(Plane(-0.5, texture=s.texture(contrast), outline=band))
        middle = float(np.clip((top + bottom) / 2, -ny / 2.4, ny / 2.4))
        bars = Bars((middle, 0.0), ny / 6, count=8, period=nx / 9, width=nx / 18)
        surfaces.append(Plane(0.4, texture=s.texture(contrast), outline=bars))
    return surfaces


def _pyramids(s: Studio) -> list[Any]:
    half = 0.24 * s.unit
    centres = [(y * s.unit, x * s.unit) for y in (-0.6, 0, 0.6) for x in (-0.6, 0, 0.6)]
    wide = FILL_SIDES * s.unit
    holes = [_square(c, half) for c in centres[::2]]
    outline = Polygon(_band(-wide, wide, wide), *holes)
    surfaces: list[Any] = [Plane(0.0, texture=s.texture(), outline=outline)]
    for number, (y, x) in enumerate(centres):
        height, texture = s.uniform(0.5, 1.3), s.texture()
        corners = _square((y, x), half)
        for k, (gy, gx) in enumerate(((1, 0), (0, -1), (-1, 0), (0, 1))):
            slope = np.array([gy, gx]) * height / half
            if number % 2 == 0:  # a pit: the largest of four planes
                d, slope, shape = -height, -slope, corners
            else:
                d, shape = height, [corners[k], corners[(k + 1) % 4], (y, x)]
            at_middle = d - slope @ np.array([y, x])
            surfaces.append(Plane(at_middle, (slope[0], slope[1]), texture=texture,
                               outline=Polygon(shape)))  # fmt: skip
    return surfaces


def _room(s: Studio) -> list[Any]:
    back, depth = s.uniform(-1.5, -1.0), s.uniform(0.8, 1.4)
    ny, nx = s.shape
    surfaces: list[Any] = []
    slopes: tuple[Pair, ...] = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
    for y, x in slopes:
        slope = (y * depth / (0.3 * ny), x * depth / (0.3 * nx))
        contrast = s.uniform(0.015, 0.05)
        texture = noise(int(s.random.integers(2**31)), s.side, contrast=contrast, colour=s.colour)
        shade = (s.uniform(-0.3, 0.3) / s.unit, s.uniform(-0.3, 0.3) / s.unit)
        d = back - depth * 0.6 * (y * y + x * x)
        surfaces.append(Plane(d, slope, texture=texture, shade=shade))
    for _ in range(4):  # thin objects before the wall
        outline = Bars(s.position(0.7), s.uniform(0.4, 1.1) * s.unit, count=1, period=20,
                       width=s.uniform(1, 6), angle=s.uniform(-1.5, 1.5))  # fmt: skip
        surfaces.append(Plane(s.uniform(-0.2, 1.2), texture=s.texture(), outline=outline))
    table = rectangle((0.55 * s.unit, s.uniform(-0.3, 0.3) * s.unit), (0.3 * s.unit, s.unit))
    surfaces.append(Plane(-0.6, (1.4 / s.unit, 0.0), texture=s.texture(), outline=table))
    centre = s.position(0.5)
    lamp = Spot((centre[0] - 0.05 * s.unit, centre[1]), 0.04 * s.unit, strength=0.4, disparity=-0.3)
    surfaces.append(
        Sphere(
            centre, 0.2 * s.unit, disparity=0.2, height=0.6, texture=s.texture(0.04), spots=[lamp]
        )
    )
    return surfaces


def _glossy(s: Studio) -> list[Any]:
    surfaces = _spheres(s)[:4]
    for number, sphere in enumerate(surfaces[1:], 1):
        Y, X = sphere.centre
        offset = 0.3 * sphere.radius
        lamp = Spot((Y - offset, X - offset), 0.1 * sphere.radius, strength=0.6,
                    disparity=sphere.disparity + s.uniform(-1, 0.5))  # fmt: skip
        surfaces[number] = replace(sphere, texture=s.texture(0.05), spots=[lamp])
    return surfaces


def _clutter(s: Studio) -> list[Any]:
    surfaces: list[Any] = [s.ground(-1.6, -1.3)]
    for _ in range(24):
        centre, size = np.array(s.position(1.0)), s.uniform(0.1, 0.5) * s.unit
        turns = np.sort(s.random.uniform(0, 2 * np.pi, int(s.random.integers(3, 7))))
        corners = centre + size * np.column_stack([np.cos(turns), np.sin(turns)])
        slope = s.random.uniform(-0.25, 0.25, 2) / s.unit
        d = s.uniform(-1.2, 1.6) - slope @ centre
        surfaces.append(
            Plane(d, (slope[0], slope[1]), texture=s.texture(), outline=Polygon(corners))
        )
    return surfaces


def _band(first: float, last: float, wide: float) -> list[Pair]:
    """Return the corners of a rectangle between two rows, ``wide`` to both sides."""
    return [(first, -wide), (first, wide), (last, wide), (last, -wide)]


def _square(centre: Pair, half: float) -> list[Pair]:
    """Return the corners of a square; edge k lies at -Y, +X, +Y, -X of its centre."""
    y, x = centre
    signs = ((-1, -1), (-1, 1), (1, 1), (1, -1))
    return [(y + a * half, x + b * half) for a, b in signs]


SCENES = {
    "plane": _plane,
    "slant": _slant,
    "layers": _layers,
    "roof": _roof,
    "valley": _valley,
    "staircase": _staircase,
    "spheres": _spheres,
    "bars": _bars,
    "backgammon": _backgammon,
    "dots": _dots,
    "stripes": _stripes,
    "pyramids": _pyramids,
    "room": _room,
    "glossy": _glossy,
    "clutter": _clutter,
}
