"""Pictures as scenes: where their samples lie, and their patterns against one field a sample."""

from dataclasses import replace

import numpy as np
import pytest
from tolerance import relative_max

from clplen import (
    DeviceError,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SamplingError,
    SamplingWarning,
    Sensor,
    ShapeError,
)
from clplen.cameras.exposure import pattern_lattice, wave_exposure
from clplen.cameras.scenes.scene_sources import PicturePlane

RANDOM = np.random.default_rng(3)


def camera_of(device, *, pixels=26, field_lens=False, focal_length=0.12, **array):
    """Lenslets of 26 pixels and twice what a matched camera resolves: 3 x 3 places a cell."""
    values = {"pitch": 150e-6, "f": 10e-3, "count": (17, 21), "fill": "full"} | array
    return PlenopticCamera.type1(
        focal_length=focal_length,
        mla=MicrolensArray(**values),
        wavelength=532e-9,
        pixels_per_lenslet=pixels,
        aperture_diameter=focal_length / 100,
        device=device,
        field_lens=field_lens,
    )


def picture(shape=(3, 5), width=0.7e-3, dz=0.0):
    """Samples without symmetry, some of them dark."""
    values = RANDOM.random(shape) * (RANDOM.random(shape) < 0.8)
    values[0, 0] = 0.7
    return PicturePlane(values, width, dz)


def both(camera, plane):
    points = camera.expose(plane, method="points").to_numpy().astype(np.float64)
    raw = camera.expose(plane, method="isoplanatic")
    return points, raw.to_numpy().astype(np.float64), raw.exposure


# Pictures


def test_samples_lie_about_the_central_one():
    values = np.array([[0, 1, 2, 0], [3, 0, 0, 0], [0, 0, 0, 4]])
    plane = PicturePlane(values, 8e-4, 0.01)
    values[:] = 5  # a picture keeps its own samples
    points = plane.points()
    order = np.argsort(points.power)
    expected = [(-2e-4, -2e-4), (0, -2e-4), (-4e-4, 0), (2e-4, 2e-4)]
    np.testing.assert_allclose(points.positions[order][:, :2], expected, atol=1e-18)
    assert points.power[order].tolist() == [1, 2, 3, 4]
    assert (points.positions[:, 2] == 0.01).all()
    assert points.diameter == 0
    assert plane.positions().shape == (12, 3)
    np.testing.assert_array_equal(plane.positions()[5], (-2e-4, 0, 0.01))


def test_bad_pictures():
    for image, width, more, error, words in [
        (np.ones(3), 1e-3, {}, ShapeError, r"\(ny, nx\)"),
        (np.ones((2, 2, 3)), 1e-3, {}, ShapeError, r"\(2, 2, 3\)"),
        (np.ones((0, 2)), 1e-3, {}, ShapeError, r"\(0, 2\)"),
        ([[1, -1]], 1e-3, {}, ValueError, "finite and >= 0"),
        ([[1, np.nan]], 1e-3, {}, ValueError, "finite"),
        ([[0, 0]], 1e-3, {}, ValueError, "sends no light"),
        ([[1, 0]], 0, {}, ValueError, "width"),
        ([[1, 0]], np.inf, {}, ValueError, "width"),
        ([[1, 0]], 1e-3, {"z": np.nan}, ValueError, "z of a picture"),
        ([[1, 0]], 1e-3, {"mode": "slide"}, ValueError, "'transmission'"),
        ([[1.5, 0]], 1e-3, {"mode": "transmission"}, ValueError, "at most 1"),
    ]:
        with pytest.raises(error, match=words):
            PicturePlane(image, width, **more)


# Routes


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("array", "more"),
    [
        ({"offset": (40e-6, -30e-6)}, {}),
        ({}, {"shape": (4, 3), "dz": -0.02, "width": 0.4e-3}),
        ({"fill": "circular"}, {"shape": (5, 5)}),
        ({"field_lens": True}, {}),
    ],
)
def test_patterns_equal_one_field_a_sample(device, array, more):
    camera, plane = camera_of(device, **array), picture(**more)
    points, patterns, exposure = both(camera, plane)
    # measured 4e-4 to 9e-4: pixels sample the same lenslet otherwise where the phase is steeper
    assert relative_max(points, patterns) <= 1e-3
    assert relative_max(points, patterns[::-1]) > 0.1
    assert relative_max(points, patterns[:, ::-1]) > 0.1
    assert exposure.route == "isoplanatic"
    assert 1e-5 < exposure.error <= 1.5e-3


@pytest.mark.thorough
def test_hexagonal_lattice(device):
    camera = camera_of(device, lattice="hexagonal", count=(18, 17))
    points, patterns, exposure = both(camera, picture(shape=(5, 4)))
    # rows of 22.5 pixels: pixels sample the lenslets' edges otherwise in every second row
    assert relative_max(points, patterns) <= 2.5e-3
    assert relative_max(points, patterns[::-1]) > 0.1
    assert exposure.error <= 6e-3


def test_off_the_axis(device):
    """Samples to one side only, a third of the array away from its middle."""
    camera = camera_of(device, count=(17, 31))
    values = np.zeros((5, 9))
    values[1:4, 0:2] = RANDOM.random((3, 2)) + 0.1
    points, patterns, _ = both(camera, PicturePlane(values, 3e-3, 0.01))
    assert relative_max(points, patterns) <= 1.5e-3


def short_camera(device):
    """At f-number 50 and with object and image close by, astigmatism counts: .012 rad."""
    return PlenopticCamera.type1(
        focal_length=0.03,
        mla=MicrolensArray(150e-6, 10e-3, count=21, fill="full"),
        wavelength=532e-9,
        pixels_per_lenslet=30,
        aperture_diameter=0.6e-3,
        device=device,
    )


def test_patches_interpolate_their_monomials(device):
    for monomials in ["CONSTANT", "LINEAR", "EVEN", "QUADRATIC"]:
        camera, exponents = short_camera(device), getattr(pattern_lattice, monomials)
        plane = PicturePlane(RANDOM.random((5, 9)) + 0.1, 2.2e-3, 1e-3)
        found = pattern_lattice.patches(
            camera, plane, pattern_lattice.pattern_grid(camera), exponents
        )
        assert len(found) == len(exponents)
        scale = -camera.image_distance / (camera.object_distance + 1e-3)
        y, x = plane.y[:, None] * scale, plane.x * scale
        for i, k in exponents:
            values = sum(p.share * p.centre[0] ** i * p.centre[1] ** k for p in found)
            # linear algebra in float64, of nodes within the picture
            np.testing.assert_allclose(
                values, y**i * x**k + 0 * values, atol=1e-10 * 1e-3 ** (i + k)
            )


def test_one_row_of_samples_needs_fewer_patches(device):
    camera = short_camera(device)
    plane = PicturePlane(np.ones((1, 9)), 2.2e-3)
    found = pattern_lattice.patches(
        camera, plane, pattern_lattice.pattern_grid(camera), pattern_lattice.QUADRATIC
    )
    assert len(found) == 3
    np.testing.assert_allclose(sum(p.share for p in found), np.ones((1, 9)), rtol=1e-10)


def test_monomials_follow_from_the_aberrations(device):
    camera = short_camera(device)
    uneven = replace(camera, object_distance=0.045, image_distance=0.09)
    corner = np.zeros((21, 21))
    corner[:3, :3] = 1
    assert pattern_lattice.powers(camera, PicturePlane([[1, 1]], 1e-4)) == pattern_lattice.CONSTANT
    assert (
        pattern_lattice.powers(camera, PicturePlane(np.ones((5, 5)), 2e-3)) == pattern_lattice.EVEN
    )
    assert (
        pattern_lattice.powers(uneven, PicturePlane(np.ones((5, 5)), 2e-3))
        == pattern_lattice.QUADRATIC
    )
    assert pattern_lattice.powers(camera, PicturePlane(corner, 2e-3)) == pattern_lattice.LINEAR


def test_a_picture_of_points_is_point_sources(device):
    camera, plane = camera_of(device), picture(shape=(2, 3))
    raw = camera.expose(plane.points()).to_numpy()
    np.testing.assert_array_equal(camera.expose(plane, method="points").to_numpy(), raw)
    exposure = camera.expose(PointSources((0, 0, 0))).exposure
    assert (exposure.route, exposure.error) == ("points", 0)
    assert sum(n for n, _ in exposure.transforms) == 4


@pytest.mark.thorough
def test_auto_takes_what_transforms_less(device, monkeypatch):
    camera = camera_of(device, count=(11, 13))
    full = PicturePlane(RANDOM.random((12, 11)), 4e-4)
    assert camera.expose(full).exposure.route == "points"  # affordable, so exact
    monkeypatch.setattr(wave_exposure, "MAX_EXACT_OPERATIONS", 0.0)
    one = camera.expose(PicturePlane([[0, 1], [0, 0]], 1e-4))
    many = camera.expose(full)
    assert (one.exposure.route, many.exposure.route) == ("points", "isoplanatic")
    cost = [sum(n * y * x for n, (y, x) in r.exposure.transforms) for r in (one, many)]
    assert cost[1] < 132 * cost[0]
    text = str(many.exposure)
    assert "Fourier transforms" in text
    assert f"error {many.exposure.error:.2g}" in text


def test_turned_array_falls_back(device):
    camera = camera_of(device, count=(9, 9), rotation=0.02)
    plane = PicturePlane(np.ones((4, 5)), 2e-4)
    assert camera.expose(plane).exposure.route == "points"
    with pytest.raises(ValueError, match=r"rotated by 0\.02 rad"):
        camera.expose(plane, method="isoplanatic")


def test_units_of_brightness_and_a_sensor(device):
    camera, plane = camera_of(device, count=(13, 13)), picture(width=0.4e-3)
    raw = camera.expose(plane, method="isoplanatic").to_numpy()
    faint = PicturePlane(plane.image * 1e-25, plane.width)
    ratio = camera.expose(faint, method="isoplanatic").to_numpy() / raw.max()
    np.testing.assert_allclose(ratio * 1e25, raw / raw.max(), atol=1e-6)
    electrons = camera.expose(plane, method="isoplanatic", sensor=Sensor(exposure=1e4))
    np.testing.assert_allclose(electrons.to_numpy(), 1e4 * np.maximum(raw, 0), rtol=1e-6)
    assert electrons.exposure.route == "isoplanatic"


# Bad scenes


def test_bad_scenes(device):
    camera = camera_of(device, count=(9, 9))
    plane = PicturePlane(np.ones((2, 2)), 1e-4)
    with pytest.raises(TypeError, match="got str"):
        camera.expose([plane, "usaf"])
    with pytest.raises(ValueError, match="empty"):
        camera.expose([])
    with pytest.raises(ValueError, match="'fast'"):
        camera.expose(plane, method="fast")
    with pytest.raises(SamplingError, match="beyond the array"):
        camera.expose([plane, PicturePlane(np.ones((2, 2)), 4e-3)])
    with pytest.raises(ValueError, match="behind the main lens"):
        camera.expose(PicturePlane(np.ones((2, 2)), 1e-4, -0.3))
    with pytest.raises(ValueError, match="mode='emission'"):
        camera.expose(PicturePlane(np.ones((2, 2)), 1e-4, mode="transmission"))


def test_memory_is_asked_for_first(device, monkeypatch):
    monkeypatch.setattr(device, "memory_bytes", 10**6)
    camera = camera_of(device, count=(9, 9))
    with pytest.raises(DeviceError, match="This exposure needs"):
        camera.expose(PicturePlane(np.ones((2, 2)), 1e-4), method="isoplanatic")


def test_patterns_that_depart_are_said_aloud(device, monkeypatch):
    monkeypatch.setattr(wave_exposure, "MAX_PATTERN_ERROR", 0.0)
    with pytest.warns(SamplingWarning, match=r"method='points', exact by \d+ fields"):
        camera_of(device, count=(9, 9)).expose(picture(width=0.4e-3), method="isoplanatic")
