"""Pictures of focused cameras against the texture that rays saw: place, scale, sign, seams."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import setups_slanted
from reference_focused import Rig
from setups_focused import (
    PITCH,
    PIXEL,
    Z2,
    captured,
    exposed,
    lens_types,
    raw_of,
    slanted,
    square,
    whites,
)

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources
from clplen.compute.device import Device
from clplen.errors import DeviceError, ShapeError
from clplen.io import read_raw, write_picture, write_raytrix
from clplen.lightfield.focused.focused_depth import focused_depth
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_picture import FocusedImage, seam
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.raw.raw_image import RawImage
from clplen.lightfield.refocusing.focal_stacks import refocus

pytestmark = pytest.mark.thorough

BORDER = 8  # samples that lenslets beyond the array would have to help with


def wrong(got: np.ndarray, true: np.ndarray, border: int = BORDER) -> float:
    """rms difference over the contrast of the truth, without a border."""
    inside = np.s_[border:-border, border:-border]
    return float((got[inside] - true[inside]).std() / true[inside].std())


def truth_of(picture: FocusedImage, rig: Rig, texture, distance: float, slope=(0.0, 0.0)):
    return rig.picture(texture, *picture.grid.axes(), distance, slope)


@pytest.fixture
def raw(device: Device) -> RawImage:
    rig, image, _ = exposed("square", 0.2)
    return raw_of(device, rig, image, m=0.2)


@pytest.mark.parametrize(("method", "m"), [("basic", 0.3), ("blended", -0.3), ("depth", 0.2)])
def test_a_picture_in_focus_is_the_texture(device: Device, method: str, m: float) -> None:
    rig, image, texture = exposed("square", m)
    raw = raw_of(device, rig, image, m=m)
    picture = render_focused(raw, method=method, white=whites("square", m))
    values, true = picture.to_numpy(), truth_of(picture, rig, texture, rig.b / m)
    patch = round(picture.geometry.patch(m))
    assert picture.shape == (9 * patch, 10 * patch)
    # Measured .002 to .01; moved by one sample .1 to .3, a mirror image above 1.
    assert wrong(values, true) < 0.015
    y, x = picture.positions()
    plane = texture(y[:, None] / PIXEL, x[None, :] / PIXEL)
    assert wrong(values, plane) < 0.015
    main = (Z2 - rig.b / m) * PIXEL
    assert picture.pitch == pytest.approx(
        PITCH * PIXEL * main / (Z2 * PIXEL * patch), rel=1e-9 if method != "depth" else 1e-4
    )


def test_only_the_right_patch_joins(raw: RawImage) -> None:
    mu = FocusedGeometry.of(raw).patch(0.2)
    assert mu == pytest.approx(5.5814, abs=1e-4)
    right = seam(render_focused(raw, method="basic"))
    textbook = seam(render_focused(raw, method="basic", patch=0.2 * PITCH))
    small = seam(render_focused(raw, method="basic", patch=5.2))
    assert 0.7 < right < 1.4
    assert min(textbook, small) > 4


def test_another_viewpoint_moves_what_is_not_in_focus(device: Device) -> None:
    method = "blended"
    rig, image, texture = exposed("square", 0.2, 0.17)
    raw = raw_of(device, rig, image, m=0.2)
    geometry = FocusedGeometry.of(raw)
    slope = 1 / geometry.ratio(0.17) - 1 / geometry.ratio(0.2)
    still = render_focused(raw, method=method, aperture=0.2, step=2.0)
    y, x = still.grid.axes()
    for view in ((6.0, 0.0), (0.0, -7.0)):
        picture = render_focused(raw, method=method, view=view, aperture=0.2, step=2.0)
        moved = rig.picture(texture, y - view[0] * slope, x - view[1] * slope, rig.b / 0.17)
        place = rig.picture(texture, y, x, rig.b / 0.17)
        values = picture.to_numpy()
        assert wrong(values, moved, 24) < 0.5 * wrong(values, place, 24)
        assert wrong(values, moved, 24) < 1.5 * wrong(still.to_numpy(), place, 24) + 0.02


def test_a_stack_is_its_pictures_and_sharpest_where_it_should(device: Device) -> None:
    rig, image, texture = exposed("square", 0.2, 0.17)
    raw = raw_of(device, rig, image, m=0.2)
    ms = [0.13, 0.15, 0.17, 0.19, 0.22]
    stack = focused_stack(raw, ms=ms, white=whites("square"))
    assert stack.shape == (5, 9 * 6, 10 * 6)
    true = rig.picture(texture, *stack.grid.axes(), rig.b / 0.17)
    errors = [wrong(plane, true) for plane in stack.to_numpy()]
    assert np.argmin(errors) == 2
    assert errors[2] < 0.3 * min(errors[1], errors[3])
    camera = raw.camera
    F = camera.image_distance
    assert stack.alphas == pytest.approx(F / (F + camera.a - camera.b / np.array(ms)))
    one = render_focused(raw, m=0.19, step=stack.grid.step, white=whites("square"))
    assert np.array_equal(stack.to_numpy()[3], one.to_numpy())


# Several lens types


@pytest.fixture
def several(device: Device) -> RawImage:
    rig, image, _ = exposed("slanted")
    more = {"count": (20, 20), "start": (-8, -2), "lens_types": lens_types(rig)}
    return raw_of(device, rig, image, m=0.2, **more)


def test_depth_based_rendering_is_sharper_than_any_patch_size(several: RawImage) -> None:
    rig, _, texture = exposed("slanted")
    plane, white = slanted(rig), whites("hexagonal")
    depth = focused_depth(several)
    picture = render_focused(several, method="depth", depth=depth, white=white, step=5.0)
    true = truth_of(picture, rig, texture, *plane)
    best = wrong(picture.to_numpy(), true)
    assert best < 0.05  # measured .028; single sizes .11 and more
    for m in (0.16, 0.2):
        for method in ("basic", "blended"):
            single = render_focused(several, method=method, m=m, white=white, step=5.0)
            assert wrong(single.to_numpy(), true) > 2.5 * best


def test_a_captured_image_with_its_xml(device: Device, tmp_path: Path) -> None:
    """From a file as a Raytrix camera's: no camera, hexagonal, three types, turned."""
    made = captured()
    write_raytrix(tmp_path / "shot.xml", made.calibration)
    write_picture(tmp_path / "shot.tif", np.round(made.image * 65535).astype(np.uint16))
    raw = read_raw(tmp_path / "shot.xml", device=device)
    geometry = FocusedGeometry.of(raw)
    assert geometry.pitch == pytest.approx(34.9, rel=1e-9)
    there = geometry.kinds >= 0
    places = geometry.centres[there]
    assert np.array_equal(
        made.rig.kind(*made.rig.owner(*np.moveaxis(places, -1, 0))), geometry.kinds[there]
    )
    for white, most in ((None, 0.016), (made.white, 0.012)):  # measured .012 and .009
        depth = focused_depth(raw, white=white)
        sure = depth.confidence >= depth.sure
        wrong_by = depth.m[sure] / made.ratio(geometry.centres)[sure] - 1
        assert sure.sum() > 0.75 * geometry.count
        assert np.sqrt((wrong_by**2).mean()) < most
        assert np.isnan(depth.z).all()
    right = {}
    for method, m in (("depth", None), ("basic", 0.15), ("basic", 0.17), ("blended", 0.17)):
        words = {"depth": depth} if method == "depth" else {"m": m}
        picture = render_focused(raw, method=method, white=made.white, step=5.0, **words)
        true = truth_of(picture, made.rig, made.texture, *made.plane)
        right[method, m] = wrong(picture.to_numpy() / 65535, true, 10)
    assert right.pop(("depth", None)) < 0.4 * min(right.values())
    assert math.isnan(picture.pitch)


# Bad input


def test_bad_input_is_refused_in_a_sentence(raw: RawImage) -> None:
    for words, message in (
        ({"m": 0.0}, "other than 0, got 0.0"),
        ({"m": math.nan}, "finite number"),
        ({"m": 1.0}, "only 1 lenslets on average see"),
        ({"m": -1.4}, "abs\\(m\\) must be below 1"),
        ({"m": 0.01396}, "main lens' pupil"),
        ({"method": "patches"}, "method must be 'basic', 'blended', 'depth'"),
        ({"interpolation": "nearest"}, "interpolation must be"),
        ({"patch": 31.0}, "at most a sub-image"),
        ({"patch": -2.0}, "positive number of pixels"),
        ({"method": "depth", "patch": 5.0}, "omit patch"),
        ({"depth": object()}, "requires method='depth'"),
        ({"step": 0.0}, "step must be a positive number of sensor pixels"),
        ({"step": 1e-12}, "pass a larger step"),
        ({"view": (14.0, 0.0)}, "leaves the sub-image"),
        ({"view": (math.nan, 0.0)}, "two finite numbers"),
        ({"aperture": 0.0}, "share of the sub-image's diameter"),
        ({"white": np.zeros(raw.shape)}, "finite and not black"),
    ):
        with pytest.raises(ValueError, match=message):
            render_focused(raw, **words)
    with pytest.raises(ShapeError, match="white image of this camera"):
        render_focused(raw, white=np.ones((3, 4)))
    with pytest.raises(DeviceError, match="Pictures of shape"):
        render_focused(raw, step=2e-4)
    for ms in ([], 0.2, [[0.2]]):
        with pytest.raises(ValueError, match="ms must be a list of ratios"):
            focused_stack(raw, ms=ms)
    with pytest.raises(ValueError, match="other than 0"):
        focused_stack(raw, ms=[0.2, 0])


def test_raw_images_that_cannot_be_rendered(device: Device, raw: RawImage) -> None:
    values = raw.to_numpy()
    values[7, 8] = np.inf
    with pytest.raises(ValueError, match="1 pixels that are NaN or infinite"):
        render_focused(replace(raw, data=device.upload(values)))
    alone = replace(raw, sub_images=replace(raw.sub_images, count=(1, 10)))
    with pytest.raises(ShapeError, match="pass a raw image with its lattice"):
        render_focused(alone)
    types = lens_types(square(0.2))
    with pytest.raises(ValueError, match="do not cover the lattice"):
        render_focused(replace(raw, lens_types=types[:2]))
    off = replace(types[0], offset=(14.0, 3.0))
    with pytest.raises(ValueError, match="does not match the lattice"):
        render_focused(replace(raw, lens_types=(off, *types[1:])))
    camera = PlenopticCamera.type1(
        focal_length=0.03,
        mla=MicrolensArray(150e-6, 10e-3, count=9),
        wavelength=532e-9,
        pixels_per_lenslet=12,
        device=device,
    )
    other = camera.expose(PointSources([(0, 0, 0)]))
    with pytest.raises(ValueError, match=r"plenoptic 1\.0 camera"):
        render_focused(other, m=0.2)
    with pytest.raises(ValueError, match=r"plenoptic 1\.0 camera"):
        focused_depth(other)
    assert LightField.from_raw(other).shape[2:] == (9, 9)
    with pytest.raises(TypeError, match=r"raw image, not a light field; decode it"):
        refocus(other, disparity=1.0)


def test_a_focused_camera_has_no_light_field(device: Device) -> None:
    camera = PlenopticCamera.type2(
        focal_length=0.03, mla=MicrolensArray(150e-6, 10e-3, count=11, fill="full"),
        wavelength=532e-9, pixels_per_lenslet=20, device=device, m=0.2,
    )  # fmt: skip
    shot = camera.expose(PointSources([(0, 0, 0)]))
    with pytest.raises(ValueError, match=r"focused .* camera.* render_focused"):
        LightField.from_raw(shot)
    assert LightField.from_raw(shot, decode="naive").shape == (20, 20, 11, 11)
    values = shot.to_numpy()
    values[3, 4:6] = np.nan
    with pytest.raises(ValueError, match="2 pixels that are NaN or infinite"):
        point_m(replace(shot, data=device.upload(values)))


def test_edges_from_near_to_far_are_sharper_than_by_one_m(device: Device) -> None:
    """A camera of three types before a slanted plane, its own rays; m from .15 to .27."""
    scene = setups_slanted.slanted(device, (0.15, 0.27), count=(24, 21))
    raw = scene.by_rays()
    depth = focused_depth(raw)
    m, z, count = scene.rms(depth)
    assert count > 350
    assert m < 0.03
    assert z < 0.015  # of the object's distance
    step = depth.geometry.pitch / 8
    best = scene.mtf50(render_focused(raw, method="depth", depth=depth, step=step))
    assert best.min() > 1  # cycles a lenslet
    for method in ("basic", "blended"):
        for one in (0.17, 0.2, 0.23):
            found = scene.mtf50(render_focused(raw, method=method, m=one, step=step))
            assert found.mean() < 0.75 * best.mean()
            assert found.min() < 0.75 * best.min()
