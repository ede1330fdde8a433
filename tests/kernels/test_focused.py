"""focused_render.cl and focused_depth.cl against float64 twins, on tiny random pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from reference_focused import MatchTwin, Twin, keys, triangle
from tolerance import relative_max

from clplen.compute.device import Device
from clplen.lightfield.focused.focused_depth import FocusedDepth
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_matching import Matcher
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.raw.lenslet_grid import LensletGrid, LensType
from clplen.lightfield.raw.raw_image import RawImage

# Places are off by 2^-24 px in the tables and 2^-21 by the product with the ratio; a pixel's value
# changes by at most 2.5 a pixel and axis, each of some 20 sums of 16 terms is off by 1e-6. A weight
# of the rim's ramp moves as the place does.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Array:
    """A small array of lenslets: two base vectors (y, x), a centre, and how many (i, j)."""

    shape: tuple[int, int]
    first: tuple[float, float]
    second: tuple[float, float]
    origin: tuple[float, float]
    count: tuple[int, int]

    def places(self, margin: int = 0) -> np.ndarray:
        i, j = np.indices(np.array(self.count) + 2 * margin)[..., None] - margin
        return np.array(self.origin) + i * np.array(self.first) + j * np.array(self.second)

    def grid(self, scale: float = 1.0) -> LensletGrid:
        """Places divided by a scale about (10, 11), as cells of these sub-images."""
        first = np.array((10, 11)) + (np.array(self.origin) - (10, 11)) / scale
        steps = (tuple(np.array(v) / scale) for v in (self.first, self.second))
        return LensletGrid(self.count, (3, 3), tuple(first), *steps)


SQUARE = Array((31, 37), (9.3, -0.4), (0.4, 9.3), (4.1, 4.9), (3, 4))
HEXAGONAL = Array((37, 33), (8.0, 4.6), (-0.2, 9.2), (3.2, 0.3), (4, 3))
ARRAYS = {"square": SQUARE, "hexagonal": HEXAGONAL}
THREE = ((0.3, 0.5), (0.2, 0.3), (0.1, 0.22))  # abs(m) in focus


def types(array: Array) -> tuple[LensType, ...]:
    """Three types, (i + 2 j) mod 3 from the first lenslet on."""
    a, b = np.array(array.first), np.array(array.second)
    return tuple(
        LensType(tuple(k * a), (1 / high, 1 / low), (tuple(a + b), tuple(3 * a)))
        for k, (low, high) in enumerate(THREE)
    )


def pixels(array: Array, channels: int = 1, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).random((*array.shape, channels)).astype(np.float32)


def raw_of(
    device: Device, array: Array, values: np.ndarray, scale: float = 1.0, several: bool = False
) -> RawImage:
    values = values[..., 0] if values.shape[2] == 1 else values
    return RawImage(
        device.upload(np.ascontiguousarray(values)),
        device,
        math.nan,
        array.grid(),
        array.grid(scale),
        lens_types=types(array) if several else (),
    )


def on_sensor(array: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places and kinds of the lenslets with their centre on the sensor; other lattice points."""
    around = array.places(4)
    i, j = np.indices(around.shape[:2]) - 4
    there = ((around >= -0.5) & (around < np.array(array.shape) - 0.5)).all(-1)
    there &= (i >= 0) & (i < array.count[0]) & (j >= 0) & (j < array.count[1])
    return around[there], ((i + 2 * j) % 3)[there], around[~there]


def twin_of(raw: RawImage, array: Array, values: np.ndarray, **more) -> Twin:
    places, kinds, missing = on_sensor(array)
    geometry = FocusedGeometry.of(raw)
    kinds = kinds if raw.lens_types else np.zeros(len(places), int)
    pitch = geometry.pitch
    more = {"radius": pitch / 2, "pupil": geometry.pupil} | more
    return Twin(values.astype(float), places, kinds, missing, pitch, **more)


def compare(picture, twin: Twin, name: str, ratios) -> None:
    """Every third sample of a picture with the twin's."""
    values = picture.to_numpy().reshape(*picture.grid.shape, -1)
    y, x = picture.grid.axes()
    ratios = np.broadcast_to(ratios, picture.grid.shape)
    expected, got = [], []
    for r in range(0, len(y), 2):
        for c in range(r % 3, len(x), 3):
            expected.append(getattr(twin, name)(y[r], x[c], ratios[r, c]))
            got.append(values[r, c])
    assert len(got) > 30
    assert relative_max(np.array(expected), np.array(got, float)) < TOLERANCE


@pytest.mark.parametrize(
    ("name", "m", "view"), [("square", 0.31, (0.0, 0.0)), ("hexagonal", -0.43, (0.7, -1.3))]
)
def test_nearest(device: Device, name: str, m: float, view: tuple[float, float]) -> None:
    """focused_render.cl, nearest: patches of both signs, elsewhere in the sub-image too."""
    array, channels = ARRAYS[name], 3 if m > 0 else 1
    values = pixels(array, channels)
    raw = raw_of(device, array, values, scale=1.06)
    picture = render_focused(raw, method="basic", m=m, view=view, step=2.37)
    assert picture.ratio == pytest.approx((m - 0.06) / 1.06)
    compare(picture, twin_of(raw, array, values, view=view), "nearest", picture.ratio)


@pytest.mark.parametrize(
    ("name", "m", "view", "aperture", "channels", "linear"),
    [
        ("hexagonal", 0.27, (0.0, 0.0), 1.0, 1, False),
        ("square", -0.3, (1.1, -0.6), 0.6, 3, True),
    ],
)
def test_blend(device, name, m, view, aperture, channels, linear) -> None:
    """focused_render.cl, blend: one plane, cubic and linear, a view, colours."""
    array = ARRAYS[name]
    values = pixels(array, channels)
    raw = raw_of(device, array, values, scale=1.04)
    interpolation = "linear" if linear else "cubic"
    picture = render_focused(
        raw, m=m, view=view, aperture=aperture, step=2.37, interpolation=interpolation
    )
    radius = aperture * FocusedGeometry.of(raw).pitch / 2
    profile = triangle if linear else keys
    twin = twin_of(raw, array, values, view=view, radius=radius, profile=profile)
    compare(picture, twin, "blend", picture.ratio)


@pytest.mark.parametrize("m", [0.215])
def test_blend_of_types_by_a_white_image(device: Device, m: float) -> None:
    """Types in focus only; samples count by their white level."""
    values, white = pixels(HEXAGONAL), 0.2 + pixels(HEXAGONAL, seed=9)
    raw = raw_of(device, HEXAGONAL, values, scale=1.03, several=True)
    picture = render_focused(raw, m=m, step=2.37, white=white[..., 0])
    level = white.astype(float) / white.max()
    twin = twin_of(raw, HEXAGONAL, values, ranges=THREE, white=level)
    assert len(set(twin._of_type(picture.ratio))) > 1
    compare(picture, twin, "blend", picture.ratio)


def test_blend_by_a_map_and_on_planes(device: Device) -> None:
    """A ratio of every sample, and several planes in one launch."""
    values = pixels(SQUARE)
    raw = raw_of(device, SQUARE, values)
    geometry = FocusedGeometry.of(raw)
    i, j = np.indices(geometry.kinds.shape)
    m = 0.2 + 0.03 * i + 0.02 * j
    known = np.ones_like(m)
    depth = FocusedDepth(geometry, m, known, known, known)
    picture = render_focused(raw, method="depth", depth=depth, step=2.37)
    twin = twin_of(raw, SQUARE, values)
    compare(picture, twin, "blend", depth.ratios(picture.grid))
    stack = focused_stack(raw, ms=[0.2, -0.4, 0.33], step=2.37)
    for plane, m in zip(stack.to_numpy(), stack.ms, strict=True):
        assert np.array_equal(plane, render_focused(raw, m=m, step=2.37).to_numpy())


WIDE = Array((40, 39), (12.4, -0.5), (0.6, 12.1), (7.0, 6.4), (3, 3))


def matcher_of(device: Device, channels: int) -> tuple[Matcher, MatchTwin]:
    """Of a smooth random picture with one lenslet missing at a corner."""
    values = pixels(WIDE, channels)
    y, x = np.indices(WIDE.shape)
    values = (0.1 * values + np.sin(0.5 * y - 0.3 * x + 1)[..., None]).astype(np.float32)
    raw = raw_of(device, WIDE, values)
    geometry = FocusedGeometry.of(raw)
    geometry.kinds[2, 2] = -1
    matcher = Matcher(raw, geometry, 2.7)
    twin = MatchTwin(
        values.mean(2, dtype=float),
        WIDE.places(),
        geometry.kinds,
        2.7,
        geometry.pitch / 2 - 1,
        geometry.pitch / 2,
    )
    return matcher, twin


@pytest.mark.parametrize("channels", [1, 3])
def test_match(device: Device, channels: int) -> None:
    """focused_depth.cl, match: costs of planes of both signs."""
    matcher, twin = matcher_of(device, channels)
    planes = np.array([-0.21, 0.13, 0.34])
    got = matcher.costs(planes)
    expected = np.array(
        [
            [
                [twin.cost(matcher.near, ratio, matcher.noise, i, j) for j in range(3)]
                for i in range(3)
            ]
            for ratio in planes
        ]
    )
    # Texture of order 1 from differences of squares: some ten units of 2^-24 of their sum.
    assert np.abs(got - expected).max() < 2e-5
    assert expected.min() < 0.8 < 1.3 < np.median(expected)


def test_refine(device: Device) -> None:
    """focused_depth.cl, refine: the step by slopes of the cubic, and the sums at its place."""
    matcher, twin = matcher_of(device, 1)
    start = 0.17 + 0.01 * np.arange(9.0).reshape(3, 3)
    still, moved = matcher.refined(start, rounds=0), matcher.refined(start, rounds=1)
    for i in range(3):
        for j in range(3):
            expected = twin.sums(matcher.pairs, start[i, j], i, j)
            got = [still.slope, still.difference, still.energy, still.weight]
            got = np.array([one[i, j] for one in got])
            assert np.allclose(got, expected[1:], rtol=2e-4, atol=1e-4)
            after = twin.refined(matcher.pairs, start[i, j], 1, matcher.step, i, j)
            assert moved.ratio[i, j] == pytest.approx(after, abs=2e-5)
    assert np.abs(moved.ratio - start).max() > 0.005


def test_spots(device: Device) -> None:
    """focused_depth.cl, spots: the place of a point from Gaussian spots at the law's places."""
    centre, ratio = np.array([19.2, 17.9]), -0.23
    y, x = np.indices(WIDE.shape)
    values = np.zeros(WIDE.shape)
    for k, s in enumerate(WIDE.places().reshape(-1, 2)):
        at = s + ratio * (s - centre)
        values += (1 + 0.1 * k) * np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / 1.2)
    raw = raw_of(device, WIDE, values[..., None].astype(np.float32))
    found = point_m(raw)
    # Squared Gaussians of sigma 0.55 px, cut at the rim, if at all, at 3 sigma.
    assert found.m == pytest.approx(ratio, abs=1e-3)
    assert found.position == pytest.approx(tuple(centre), abs=0.03)
    assert found.spots >= 6
