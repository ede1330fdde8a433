"""m and distance from the raw images of focused cameras, against rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from reference_focused import waves
from setups_focused import (
    camera_of,
    exposed,
    lens_types,
    raw_of,
    slanted,
    square,
    whites,
)

from clplen.compute.device import Device
from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps, refine_outliers
from clplen.lightfield.focused.focused_geometry import FocusedGeometry, alpha_of_m, z_of_m
from clplen.lightfield.focused.focused_matching import Matcher
from clplen.lightfield.focused.focused_rendering import render_focused
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.raw.lenslet_grid import LensType
from clplen.lightfield.raw.raw_image import RawImage

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize(("m", "at"), [(-0.3, -0.3), (0.2, 0.17)])
def test_planes_are_found_within_a_percent(device: Device, m: float, at: float) -> None:
    rig, image, _ = exposed("square", m, at if at != m else None)
    raw = raw_of(device, rig, image, m=m)
    depth = focused_depth(raw)
    sure = depth.confidence >= depth.sure
    assert sure.mean() > 0.9
    assert np.abs(depth.m[sure] / at - 1).max() < 0.01
    assert depth.median == pytest.approx(at, rel=2e-3)
    assert depth.virtual_depth[sure] == pytest.approx(1 / depth.m[sure])
    camera = raw.camera
    image_at = camera.image_distance + camera.a - camera.b / at
    distance = 1 / (1 / camera.focal_length - 1 / image_at)
    z = distance - camera.object_distance
    assert np.abs(depth.z[sure] - z).max() < 0.002 * camera.object_distance
    alone = focused_depth(raw_of(device, rig, image))  # without a camera both signs are tried
    assert alone.median == pytest.approx(at, rel=2e-3)
    assert np.isnan(alone.z).all()


def test_a_white_image_serves_where_rims_leave_nothing(device: Device) -> None:
    rig, image, _ = exposed("square", 0.4)
    raw = raw_of(device, rig, image, m=0.4)
    assert not (focused_depth(raw).confidence > 0).any()
    depth = focused_depth(raw, white=whites("square", 0.4))
    assert (depth.confidence >= depth.sure).all()
    assert np.abs(depth.m / 0.4 - 1).max() < 0.002  # measured .0004


def test_distance_is_the_inverse_of_the_main_lens(device: Device) -> None:
    rig, image, _ = exposed("square", 0.2)
    raw = raw_of(device, rig, image, m=0.2)
    camera = raw.camera
    for z in (-0.02, 0.0, 0.015):
        inside = 1 / (1 / camera.focal_length - 1 / (camera.object_distance + z))
        m = camera.b / (camera.image_distance + camera.a - inside)
        assert float(z_of_m(raw, m)) == pytest.approx(z, abs=1e-9)
        assert float(alpha_of_m(raw, m)) == pytest.approx(camera.alpha(z))
    # nearer objects are imaged farther from the lens, nearer to the array: m is larger
    assert z_of_m(raw, 0.25) < 0 < z_of_m(raw, 0.15)
    assert np.isnan(z_of_m(raw, [0.0, math.nan])).all()
    assert np.isnan(z_of_m(replace(raw, camera=None), 0.2))


def test_a_slanted_plane_under_three_types(device: Device) -> None:
    rig, image, _ = exposed("slanted")
    more = {"lens_types": lens_types(rig)}
    raw = raw_of(device, rig, image, m=0.2, count=(20, 20), start=(-8, -2), **more)
    depth = focused_depth(raw)
    sure = depth.confidence >= depth.sure
    true = rig.m(depth.geometry.centres, *slanted(rig))
    assert sure.sum() > 0.85 * depth.geometry.count
    assert np.std(depth.m[sure] / true[sure]) < 0.03
    off = depth.z[sure] - z_of_m(raw, true)[sure]
    assert np.sqrt((off**2).mean()) < 0.003 * raw.camera.object_distance
    picture = render_focused(raw, method="depth", depth=depth, step=6.0)
    y, x = picture.grid.axes()
    place = np.stack(np.meshgrid(y, x, indexing="ij"), -1)
    here = rig.m(place, *slanted(rig))
    inside = np.s_[8:-8, 8:-8]
    assert np.abs(depth.on(picture.grid) / here - 1)[inside].mean() < 0.03
    maps = focused_maps(raw, depth, grid=picture.grid)
    assert np.array_equal(maps.m, depth.on(picture.grid))
    assert np.abs(maps.virtual_depth * here - 1)[inside].mean() < 0.03
    off = (maps.z - z_of_m(raw, here))[inside]
    assert np.sqrt((off**2).mean()) < 0.003 * raw.camera.object_distance
    assert maps.confidence[inside].mean() > 0.8
    assert maps.confidence.min() >= 0


def test_flat_places_are_not_trusted_and_filled(device: Device) -> None:
    rig = square(0.2, (9, 12))
    texture = waves(4, 60, 300)

    def half(y, x):
        return np.where(x > 0, 0.5, texture(y, x))

    image = rig.expose(half, rig.b / 0.2, rays=5)
    raw = raw_of(device, rig, image, m=0.2, count=(9, 12))
    depth = focused_depth(raw)
    x = depth.geometry.centres[..., 1]
    flat = x > rig.axis[1] + 60
    assert depth.confidence[flat].max() < 0.05
    assert depth.confidence[x < rig.axis[1] - 60].min() > 0.5
    picture = render_focused(raw, method="depth", depth=depth)
    assert np.abs(depth.on(picture.grid) - 0.2).max() < 0.002


def test_what_went_astray_comes_back_and_an_edge_of_depth_stays(device: Device) -> None:
    rig, image, _ = exposed("square", 0.2)
    raw = raw_of(device, rig, image, m=0.2)
    matcher = Matcher(raw, FocusedGeometry.of(raw), 6.0)
    right = float(matcher.geometry.ratio(0.2))
    start = np.full(matcher.geometry.kinds.shape, right)
    start[4, 5], start[2, 3] = 0.48, 0.46
    assert np.abs(matcher.refined(start).ratio / right - 1)[[4, 2], [5, 3]].min() > 0.15
    found = refine_outliers(matcher, start)
    assert np.abs(found.ratio / right - 1).max() < 0.01
    # a lenslet between others that are wrong fits better by itself than from their median
    start = np.full(matcher.geometry.kinds.shape, right)
    bad = np.array([[3, 3, 5, 5], [4, 6, 4, 6]])
    start[bad[0], bad[1]] = 0.48
    assert abs(refine_outliers(matcher, start).ratio[4, 5] / right - 1) < 0.01


def test_noise_widens_the_uncertainty(device: Device) -> None:
    rig, image, _ = exposed("square", 0.2)
    clean = focused_depth(raw_of(device, rig, image, m=0.2))
    noisy = image + np.random.default_rng(6).normal(0, 0.02, image.shape)
    depth = focused_depth(raw_of(device, rig, noisy, m=0.2))
    sure = depth.confidence >= depth.sure
    assert sure.mean() > 0.8
    error, expected = np.std(depth.m[sure] - 0.2), np.median(depth.uncertainty[sure])
    assert expected > 3 * np.median(clean.uncertainty[sure])
    # Cubic weights mix pixels, and not all pairs are seen: within a factor of 2.
    assert expected / 2 < error < 2 * expected


@pytest.mark.parametrize(("m", "at"), [(0.2, 0.16), (-0.3, -0.3)])
def test_a_point_by_the_pitch_of_its_spots(device: Device, m: float, at: float) -> None:
    rig = square(m)
    width, place = 5.0, (21.0, -33.0)

    def spot(y, x):
        return np.exp(-((y - place[0]) ** 2 + (x - place[1]) ** 2) / (2 * width**2))

    image = rig.expose(spot, rig.b / at, rays=9, fine=3)
    raw = raw_of(device, rig, image, m=m)
    found = point_m(raw)
    # Measured .2 to 2.9 %: spots at the rim of their sub-image are dimmed on one side.
    assert found.m == pytest.approx(at, rel=0.035)
    scale = (rig.z2 + rig.b) / (rig.z2 - rig.b / at)
    expected = np.array(rig.axis) + np.array(place) * scale
    # A tenth of a pixel on the sensor is 1/ratio times as much here.
    assert found.position == pytest.approx(tuple(expected), abs=0.1 / abs(at))
    assert found.spots >= 4
    assert found.residual < 0.3
    assert found.z == pytest.approx(float(z_of_m(raw, at)), abs=0.005 * raw.camera.object_distance)


def raw_with(device: Device, m: float) -> RawImage:
    rig = square(0.3)
    image = np.full(rig.shape, 0.5)
    return replace(raw_of(device, rig, image), camera=camera_of(rig, m))


def test_bad_input_is_refused_in_a_sentence(device: Device) -> None:
    rig, image, _ = exposed("square", 0.2)
    raw = raw_of(device, rig, image, m=0.2)
    for words, message in (
        ({"ms": (0.2, 0.1)}, "lowest, highest"),
        ({"ms": (0.1, math.nan)}, "lowest, highest"),
        ({"ms": (-0.1, 0.2)}, "includes 0"),
        ({"ms": (0.2, 0.5)}, "only 2 lenslets a row see a point, too few"),
        ({"ms": (0.005, 0.2)}, "main lens' pupil"),
        ({"window": 9.0}, "quarter of a sub-image"),
        ({"window": 1.0}, "quarter of a sub-image"),
    ):
        with pytest.raises(ValueError, match=message):
            focused_depth(raw, **words)
    with pytest.raises(ValueError, match=r"camera's m = 0\.6 only 1\.7 lenslets"):
        focused_depth(raw_with(device, 0.6))
    image = image.copy()
    image[3, 5] = np.nan
    with pytest.raises(ValueError, match="1 pixels that are NaN"):
        focused_depth(raw_of(device, rig, image, m=0.2))


def test_what_has_no_texture_has_no_depth(device: Device) -> None:
    raw = raw_with(device, 0.2)
    depth = focused_depth(raw)
    assert depth.confidence.max() < 0.05
    assert np.isnan(depth.m[depth.confidence == 0]).all()
    with pytest.raises(ValueError, match="Pass m"):
        _ = depth.median
    with pytest.raises(ValueError, match="Pass m"):
        render_focused(replace(raw, camera=None))
    with pytest.raises(ValueError, match="At least 3"):
        point_m(replace(raw, data=device.zeros(raw.shape, np.float32)))
    assert "0 of 90" in repr(depth)


def test_lenslets_of_one_type_have_to_be_neighbours(device: Device) -> None:
    rig, image, _ = exposed("slanted")
    first, second = (np.array(v) * (1 + rig.t) for v in rig.base)
    steps = (tuple(2 * first), tuple(2 * second))
    types = tuple(
        LensType(tuple(i * first + j * second), (3.0, 5.0), steps) for i in (0, 1) for j in (0, 1)
    )
    raw = raw_of(device, rig, image, m=0.2, lens_types=types, count=(2, 2), start=(0, 0))
    with pytest.raises(ValueError, match="Depth needs lenslets of one type"):
        focused_depth(raw)
