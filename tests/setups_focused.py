"""Focused cameras for the tests: rigs of `reference_focused` and their raw images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from reference_focused import Array, Rig, Texture, waves

from clplen.compute.device import Device
from clplen.io.raw.raytrix import FocusType, RaytrixCalibration
from clplen.lightfield.raw.lenslet_grid import LensletGrid, LensType
from clplen.lightfield.raw.raw_image import RawImage

PIXEL = 5e-6
PITCH = 30.0  # of lenslets on the array, in pixels
Z2 = 51600.0  # 258 mm
FOCAL = 24000.0  # 120 mm, of the main lens


@dataclass(frozen=True)
class Camera:
    """What a focused camera tells the light-field tower; lengths in metres."""

    m: float
    a: float
    b: float
    image_distance: float
    focal_length: float
    kind: str = "focused"

    @property
    def array_distance(self) -> float:
        return self.image_distance + self.a

    @property
    def sensor_distance(self) -> float:
        return self.b

    def alpha(self, dz):
        return self.image_distance * (1 / self.focal_length - 1 / (self.object_distance + dz))

    def dz(self, alpha):
        return 1 / (1 / self.focal_length - alpha / self.image_distance) - self.object_distance

    @property
    def object_distance(self) -> float:
        return 1 / (1 / self.focal_length - 1 / self.image_distance)


def camera_of(rig: Rig, m: float) -> Camera:
    a = rig.b / m
    return Camera(m, a * PIXEL, rig.b * PIXEL, (rig.z2 - a) * PIXEL, FOCAL * PIXEL)


def square(m: float, count: tuple[int, int] = (9, 10), focal: float = 600.0) -> Rig:
    """f_mu = 3 mm, m = b/a in focus; axis off the middle, as is the array."""
    shape = tuple(int(n * PITCH * 1.014) for n in count)
    b = focal * (1 + m)
    centre = tuple(
        (n - 1) / 2 - (c - 1) / 2 * PITCH + 0.3 for n, c in zip(shape, count, strict=True)
    )
    middle = ((shape[0] - 1) / 2 + 2.2, (shape[1] - 1) / 2 - 1.7)
    base = ((PITCH, 0.0), (0.0, PITCH))
    pupil = PITCH * (1 + b / Z2) * Z2 / b
    return Rig(shape, base, centre, b, Z2, (focal,), PITCH, pupil, middle)


HEXAGONAL_MS = (0.3, 0.2, 0.13)  # in focus, one a type
HEXAGONAL_RANGES = ((0.24, 0.4), (0.16, 0.26), (0.1, 0.17))


def hexagonal(shape: tuple[int, int] = (260, 310), b: float = 700.0) -> Rig:
    """Three types, sub-images 34.9 px apart, rows turned by 0.35 degrees."""
    t, scale = math.radians(0.35), 1 + b / Z2
    turn = np.array([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]])
    pitch = 34.9 / scale
    row, column = (turn @ np.array(v) * pitch for v in ((math.sqrt(3) / 2, 0.5), (0.0, 1.0)))
    focal = tuple(b / (1 + m) for m in HEXAGONAL_MS)
    centre = tuple((n - 1) / 2 - 3.3 * v for n, v in zip(shape, (row + column), strict=True))
    pupil = 0.98 * pitch * scale * Z2 / b
    return Rig(shape, (tuple(row), tuple(column)), centre, b, Z2, focal, 0.98 * pitch, pupil)


def grids(rig: Rig, count: tuple[int, int], start: tuple[int, int]) -> tuple[LensletGrid, ...]:
    """Sub-images and cells of the lenslets from (i, j) on, as a camera gives them."""
    is_square = abs(np.dot(*np.array(rig.base))) < 1
    first, second = (np.array(v) for v in rig.base)
    row = first if is_square else first - second / 2
    shift = 0.0 if is_square else 0.5
    lens = rig.lens(*start)
    images = 1 + rig.t
    return (
        LensletGrid(
            count,
            (3, 3),
            tuple(rig.image(lens)),
            tuple(row * images),
            tuple(second * images),
            shift,
        ),
        LensletGrid(count, (3, 3), tuple(lens), tuple(row), tuple(second), shift),
    )


def lens_types(rig: Rig, ranges=HEXAGONAL_RANGES) -> tuple[LensType, ...]:
    """Types of the lenslets (i + 2 j) mod 3, by their virtual depths 1/m."""
    first, second = (np.array(v) * (1 + rig.t) for v in rig.base)
    steps = (tuple(first + second), tuple(3 * second))
    return tuple(
        LensType(tuple(k * first), (1 / high, 1 / low), steps)
        for k, (low, high) in enumerate(ranges)
    )


def raw_of(device: Device, rig: Rig, image: Array, *, m: float | None = None, **more) -> RawImage:
    """With a camera of m where given; every lenslet that can be on the sensor."""
    count = more.pop("count", (9, 10))
    images, cells = grids(rig, count, more.pop("start", (0, 0)))
    data = device.upload(np.ascontiguousarray(image, np.float32))
    camera = None if m is None else camera_of(rig, m)
    return RawImage(data, device, PIXEL, images, cells, camera=camera, **more)


def slanted(rig: Rig) -> tuple[float, tuple[float, float]]:
    """Distance and slope of a plane from m = .13 to .3 across the sensor, mostly along x."""
    near, far = rig.b / 0.3, rig.b / 0.13
    return (near + far) / 2, (1.5, (far - near) / rig.shape[1] * 0.8)


@lru_cache
def exposed(kind: str, m: float = 0.2, at: float | None = None) -> tuple[Rig, Array, object]:
    """Rig, raw image and texture: "square" in focus at m, the texture at ``at``; "slanted"."""
    if kind == "square":
        rig, texture = square(m), waves(3, 70, 500)
        return rig, rig.expose(texture, rig.b / (at or m), rays=5), texture
    rig, texture = hexagonal(), waves(5, 40, 500)
    return rig, rig.expose(texture, *slanted(rig)), texture


@lru_cache
def whites(kind: str, m: float = 0.2) -> Array:
    rig = square(m) if kind == "square" else hexagonal()
    return rig.white(rays=5)


@dataclass(frozen=True, eq=False)
class Captured:
    """A frame as of a Raytrix camera: its calibration, the rig by which rays made it, its scene."""

    calibration: RaytrixCalibration
    rig: Rig
    texture: Texture
    plane: tuple[float, tuple[float, float]]
    image: Array
    white: Array

    def ratio(self, places: Array) -> Array:
        """What m is taken for where only sub-images are known, at their centres (y, x)."""
        return (self.rig.m(places, *self.plane) - self.rig.t) / (1 + self.rig.t)


@lru_cache
def captured() -> Captured:
    """Sub-images 34.9 px apart, hexagonal, turned, three types; a slanted plane, m .14 to .21."""
    shape, b, t = (250, 270), 70.0, 0.012
    ranges = ((0.2, 0.4), (0.16, 0.26), (0.1, 0.19))
    kinds = tuple(
        FocusType(((-k) % 3, 0.0), (1 / high, 1 / low)) for k, (low, high) in enumerate(ranges)
    )
    calibration = RaytrixCalibration(
        (3.2, -4.4),
        34.9,
        (1.0, 0.0),
        (0.5, math.sqrt(3) / 2),
        rotation=0.006,
        sub_grid_base=(3.0, math.sqrt(3)),
        lens_types=kinds,
    )
    middle = (np.array(shape) - 1) / 2
    images = np.array([calibration.on_sensor(v) for v in ((0.5, math.sqrt(3) / 2), (1.0, 0.0))])
    base = images / (1 + t)
    centre = middle + (np.array(calibration.origin(shape)) - middle) / (1 + t)
    focal = tuple(b / (1 + m) for m in (0.3, 0.2, 0.13))
    width = 0.98 * 34.9 / (1 + t)
    rig = Rig(
        shape, tuple(map(tuple, base)), tuple(centre), b, b / t, focal, width, 34.0 / t
    )  # fmt: skip
    texture, plane = waves(8, 25, 200), (385.0, (0.1, -0.6))
    return Captured(calibration, rig, texture, plane, rig.expose(texture, *plane), rig.white())
