"""Scenes of surfaces: the light field's law, truth, occlusion, highlights, noise, bad input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference_scene import texture as texture_at
from scipy.ndimage import map_coordinates

from clplen import SurfaceScene
from clplen.cameras import Plane, Sphere, Texture, sample_scenes
from clplen.cameras.scenes.gallery import SCENES
from clplen.cameras.scenes.surfaces import Bars, Ellipse, Polygon, Spot, rectangle
from clplen.cameras.scenes.textures import bricks, checker, noise, picture, stripes, uniform
from clplen.compute.device import Device
from clplen.errors import ShapeError

SHAPE = (37, 50)


def middles(shape: tuple[int, int] = SHAPE) -> tuple[Any, Any]:
    """(Y, X) of all pixels from the middle of the picture."""
    ny, nx = shape
    return np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx)[None, :] - (nx - 1) / 2


def test_a_plane_is_the_law_of_the_light_field(device: Device) -> None:
    views = (4, 3)
    d, texture = 0.73, noise(3, 64, colour=True)
    lf, truth = SurfaceScene(Plane(d, texture=texture)).light_field(views, SHAPE, device=device)
    Y, X = middles()
    for v in range(views[0]):
        for u in range(views[1]):
            a, b = v - (views[0] - 1) / 2, u - (views[1] - 1) / 2
            expected = texture_at(texture, *np.broadcast_arrays(Y + d * a, X + d * b))
            # a coordinate of 30 pixels rounds by 2e-6, the texture's slope is below 1 a pixel
            np.testing.assert_allclose(lf.to_numpy()[v, u], expected, atol=2e-5)
    assert (truth.disparity == np.float32(d)).all()


def test_coordinates_keep_1e_4_pixel_at_the_rim_of_a_wide_view(device: Device) -> None:
    d, period, shape = 1.37, 8.0, (1, 2001)
    wave = stripes(period, contrast=0.3)
    lf, _ = SurfaceScene(Plane(d, texture=wave)).light_field((1, 9), shape, device=device)
    _, X = middles(shape)
    for u in (0, 8):
        expected = texture_at(wave, *np.broadcast_arrays(0 * X, X + d * (u - 4)))[..., 0]
        steepest = 0.3 * np.sqrt(2) * 2 * np.pi / period
        assert np.abs(lf.to_numpy()[0, u] - expected).max() < 1e-4 * steepest


def test_truth_of_slants_spheres_and_nothing(device: Device) -> None:
    Y, X = middles()
    slant = Plane(0.2, (0.013, -0.021))
    _, truth = SurfaceScene(slant).light_field((2, 2), SHAPE, device=device)
    np.testing.assert_allclose(truth.disparity, 0.2 + 0.013 * Y - 0.021 * X, atol=1e-6)
    ball = Sphere((3, -5), 11, disparity=-0.4, height=1.3)
    _, truth = SurfaceScene(ball).light_field((2, 2), SHAPE, device=device)
    r2 = ((Y - 3) ** 2 + (X + 5) ** 2) / 11**2
    expected = np.where(r2 <= 1, -0.4 + 1.3 * np.sqrt(np.maximum(1 - r2, 0)), np.nan)
    # a root of 1 - r^2 near the rim: 1e-7 becomes 1e-7/(2 sqrt(1 - r^2))
    np.testing.assert_allclose(truth.disparity, expected, atol=1e-5)
    assert truth.surface[18, 19] == 0
    assert truth.surface[0, 0] == -1
    assert np.isnan(truth.z).all()


def consistency(scene: SurfaceScene, device: Device, sign: float = 1.0) -> float:
    """Median over pixels of the variance of views along the true disparity."""
    lf, truth = scene.light_field((5, 5), (64, 80), device=device)
    L, d = lf.to_numpy().astype(np.float64), sign * truth.disparity.astype(np.float64)
    y, x = np.indices(d.shape)
    seen = [
        map_coordinates(L[v, u], [y - d * (v - 2), x - d * (u - 2)], order=3)
        for v in range(5)
        for u in range(5)
    ]
    inner = (slice(8, -8), slice(8, -8))
    keep = (truth.masks["planes"] | truth.masks["smooth"])[inner]
    return float(np.median(np.var(seen, axis=0)[inner][keep]))


def test_views_agree_along_the_true_disparity(device: Device) -> None:
    smooth = noise(1, 128, finest=0.12, coarsest=0.02)
    ground = Plane(-0.7, (0.01, 0.005), texture=smooth)
    scene = SurfaceScene([ground, Sphere((4, -6), 22, disparity=-0.2, height=1.2, texture=smooth)])
    assert consistency(scene, device) < 1e-7  # cubic interpolation of a band below 0.12
    assert consistency(scene, device, sign=-1.0) > 1e-3


def test_the_nearer_surface_hides(device: Device) -> None:
    near = Plane(1.0, texture=uniform(0.9), outline=rectangle((0, 5), (60, 10)))
    scene = SurfaceScene([near, Plane(-1.0, texture=uniform(0.1))])
    lf, truth = scene.light_field((1, 5), SHAPE, device=device)
    _, X = middles()
    for u in range(5):  # a near thing moves by -d a view
        edge = np.clip(np.minimum(X - (-0.5 - (u - 2)), (9.5 + 1 - (u - 2)) - X), 0, 1)
        expected = np.broadcast_to(0.1 + 0.8 * edge, SHAPE)
        np.testing.assert_allclose(lf.to_numpy()[0, u], expected, atol=1e-6)
    row = {name: mask[5] for name, mask in truth.masks.items()}
    assert np.flatnonzero(row["near"]).tolist() == [25, 26, 27, 28, 31, 32, 33, 34]
    assert np.flatnonzero(row["far"]).tolist() == [21, 22, 23, 24, 35, 36, 37, 38]
    assert (row["edges"] == (row["near"] | row["far"])).all()
    assert (row["planes"] == ~row["edges"]).all()
    assert not truth.masks["smooth"].any()


def test_surfaces_far_from_focus_are_found_in_every_view(device: Device) -> None:
    white = uniform(1.0)
    Y, X = middles()
    for one in (
        Plane(2.7, texture=white, outline=Ellipse((1, -2), 3)),
        Sphere((1, -2), 3, disparity=2.6, height=0.1, texture=white),
    ):
        lf, _ = SurfaceScene(one).light_field((5, 4), SHAPE, device=device)
        for v, u in np.ndindex(5, 4):
            light = lf.to_numpy()[v, u]
            centre = (light * Y).sum() / light.sum(), (light * X).sum() / light.sum()
            assert centre == pytest.approx((1 - 2.7 * (v - 2), -2 - 2.7 * (u - 1.5)), abs=0.25)


def test_bars_with_gaps_of_one_pixel(device: Device) -> None:
    bars = Bars((0.3, 0.15), 20, count=6, period=4, width=3)
    scene = SurfaceScene(Plane(0.5, texture=uniform(1.0), outline=bars))
    lf, _ = scene.light_field((1, 3), SHAPE, device=device)
    line = lf.to_numpy()[0, :, 18]
    assert abs(line.sum(axis=1) - 18).max() < 1e-5
    assert line[:, 19:30].min() < 0.7  # a gap between two bars
    # bars that taper to nothing have half the area
    taper = Bars((0.3, 0.15), 20, count=6, period=4, width=(0, 3), angle=0.5)
    lf, _ = SurfaceScene(Plane(0, texture=uniform(1.0), outline=taper)).light_field(
        (1, 1), SHAPE, device=device
    )
    assert lf.to_numpy().sum() == pytest.approx(6 * 20 * 1.5, rel=0.02)


def test_area_of_discs_and_of_polygons_with_holes(device: Device) -> None:
    hole = Polygon([(-9, -8), (-9, 12), (11, 12), (11, -8)], [(-2, -3), (-2, 4), (5, 4)])
    for outline, area in ((Ellipse((1.2, 3.1), (9, 5), angle=0.3), np.pi * 45), (hole, 375.5)):
        scene = SurfaceScene(Plane(0, texture=uniform(1.0), outline=outline))
        lf, _ = scene.light_field((1, 1), SHAPE, device=device)
        assert lf.to_numpy().sum() == pytest.approx(area, rel=2e-3)


def test_a_highlight_moves_with_its_own_disparity(device: Device) -> None:
    spot = Spot((2.0, -3.0), 2.5, strength=0.5, disparity=-1.1)
    scene = SurfaceScene(Plane(0.8, texture=uniform(0.0), spots=[spot]))
    lf, _ = scene.light_field((3, 3), SHAPE, device=device)
    Y, X = middles()
    for v, u in ((0, 0), (0, 2), (2, 1)):
        light = lf.to_numpy()[v, u]
        centre = (light * Y).sum() / light.sum(), (light * X).sum() / light.sum()
        assert centre == pytest.approx((2 + 1.1 * (v - 1), -3 + 1.1 * (u - 1)), abs=1e-4)


def test_noise_types_and_colour(device: Device) -> None:
    scene = SurfaceScene(Plane(0, texture=uniform((0.2, 0.4, 0.6))))
    rising = np.linspace(0, 0.1, 40)[:, None]
    lf, _ = scene.light_field((2, 3), (40, 60), device=device, noise=rising, seed=4)
    spread = (lf.to_numpy() - [0.2, 0.4, 0.6]).std(axis=(0, 1, 3, 4))
    np.testing.assert_allclose(spread[1:], rising[1:, 0], rtol=0.15)  # 360 x 3 samples a row
    again, _ = scene.light_field((2, 3), (40, 60), device=device, noise=rising, seed=4)
    other, _ = scene.light_field((2, 3), (40, 60), device=device, noise=rising, seed=5)
    assert (again.to_numpy() == lf.to_numpy()).all()
    assert not (other.to_numpy() == lf.to_numpy()).all()
    for dtype, top in ((np.uint8, 255), (np.uint16, 65535)):
        whole, _ = scene.light_field((2, 2), (3, 4), device=device, dtype=dtype)
        assert whole.dtype == dtype
        assert (whole.to_numpy()[0, 0, 0, 0] == np.rint(np.array([0.2, 0.4, 0.6]) * top)).all()
    bright = SurfaceScene(Plane(0, texture=uniform(1.3)))
    assert (
        bright.light_field((1, 1), (2, 2), device=device, dtype="u1")[0].to_numpy() == 255
    ).all()


def test_textures_pass_through_their_samples() -> None:
    for one in (noise(1, 32), bricks(2), checker(12), picture(np.eye(9)), stripes(7)):
        ny, nx = one.samples.shape[:2]
        Y, X = np.meshgrid(*(one.scale * (np.arange(n) - n // 2) for n in (ny, nx)), indexing="ij")
        np.testing.assert_allclose(texture_at(one, Y, X), one.samples, atol=1e-6)
        padded = np.pad(one.coefficients(1)[..., 0], 1, mode="wrap").astype(np.float64)
        kernel = np.outer([1, 4, 1], [1, 4, 1]) / 36
        found = sum(
            kernel[j, k] * padded[j : j + ny, k : k + nx] for j in range(3) for k in range(3)
        )
        np.testing.assert_allclose(found, one.samples[..., 0], atol=1e-6)


def test_noise_keeps_its_band_and_contrast() -> None:
    values = noise(7, 128, contrast=0.1, exponent=0.0, finest=0.25, coarsest=0.1).samples[..., 0]
    assert values.std() == pytest.approx(0.1, rel=1e-4)
    f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(128))
    power = np.abs(np.fft.fft2(values - values.mean())) ** 2
    assert power[(f > 0.2501) | (f < 0.0999)].sum() < 1e-9 * power.sum()
    assert (noise(7, 32).samples == noise(7, 32).samples).all()
    assert not (noise(8, 32).samples == noise(7, 32).samples).all()


def test_a_mirrored_picture_has_no_seam() -> None:
    ramp = np.tile(np.arange(20) / 20, (6, 1))
    assert np.abs(np.diff(picture(ramp).samples[0, :, 0])).max() < 0.06
    assert picture(np.full((3, 4), 255, np.uint8)).samples.max() == pytest.approx(1)


@pytest.mark.thorough
def test_sample_scenes_are_varied_repeatable_and_within_range(device: Device) -> None:
    shape = (48, 64)
    names = []
    for one, again in zip(sample_scenes(3, shape), sample_scenes(3, shape), strict=True):
        lf, truth = one.scene.light_field((3, 3), shape, device=device, noise=one.noise)
        names.append(one.name)
        assert np.nanmin(truth.disparity) >= -2, one.name
        assert np.nanmax(truth.disparity) <= 2, one.name
        assert np.isfinite(truth.disparity).mean() > 0.95, one.name
        one.scene.check_views(4, 4)
        if one.name == "clutter":
            same, _ = again.scene.light_field((3, 3), shape, device=device, noise=one.noise)
            assert (same.to_numpy() == lf.to_numpy()).all()
    assert names == list(SCENES)


def test_sample_scenes_take_pictures() -> None:
    chosen = np.full((8, 8), 7, np.uint8)
    scenes = [one.scene for one in sample_scenes(0, (32, 32), pictures=[chosen])]
    shapes = {surface.texture.samples.shape for scene in scenes for surface in scene.surfaces}
    assert (16, 16, 1) in shapes


PLANE = Plane(0.0)


def test_bad_input_gets_one_sentence(device: Device) -> None:
    def lit(device: Any, scene: Any = PLANE, **words: Any) -> Any:
        return SurfaceScene(scene).light_field(device=device, **words)

    for call, error, words in [
        (lambda d: Plane(np.nan), ValueError, "finite"),
        (lambda d: Sphere((0, 0), -1, disparity=0, height=1), ValueError, "radius|Radius"),
        (lambda d: Sphere((0, 0), 1, disparity=0, height=0), ValueError, "height"),
        (lambda d: Spot((0, 0), 0), ValueError, "width"),
        (lambda d: Bars((0, 0), 5, count=2, period=3, width=4), ValueError, "0 to 3 pixels"),
        (lambda d: Bars((0, 0), 5, count=0, period=3, width=2), ValueError, "count must be"),
        (lambda d: Ellipse((0, 0), (1, 0)), ValueError, "positive"),
        (lambda d: Polygon([(0, 0), (1, 1)]), ValueError, "three points"),
        (lambda d: SurfaceScene([PLANE] * 65), ValueError, "1 to 64 surfaces, got 65"),
        (lambda d: SurfaceScene(["wall"]), TypeError, "Plane or a Sphere, got str"),
        (lambda d: Texture(np.zeros((2, 2, 2))), ShapeError, r"\(2, 2, 2\)"),
        (lambda d: Texture([[1.0]], 0), ValueError, "scale"),
        (lambda d: noise(1, 32, finest=0.6), ValueError, "0.5 cycles"),
        (lambda d: noise(1, 8, finest=0.1, coarsest=0.05), ValueError, "use a larger"),
        (lambda d: checker(0), ValueError, "period of a chessboard"),
        (lambda d: checker(8, smoothing=-1), ValueError, "smoothing must be a number >= 0"),
        (lambda d: stripes(0), ValueError, "period of stripes"),
        (lambda d: picture(np.ones((4, 4)), scale=0), ValueError, "scale of a picture"),
        (lambda d: bricks(1, size=(2, 20)), ValueError, "Bricks must be at least 4"),
        (lambda d: picture(np.ones((0, 4))), ShapeError, r"got \(0, 4\)"),
        (lambda d: lit(d, views=(0, 3)), ShapeError, "views"),
        (lambda d: lit(d, shape=(4,)), ShapeError, "shape"),
        (lambda d: lit(d, dtype="f8"), ValueError, "float64"),
        (lambda d: lit(d, noise=-1), ValueError, "finite and >= 0"),
        (lambda d: lit(d, shape=(3, 4), noise=[1, 2, 3]), ShapeError, "must broadcast"),
        (lambda d: lit(d, gain=[1]), ShapeError, r"\(9, 9\)"),
        (lambda d: lit(0), TypeError, "Device"),
        (lambda d: lit(d, [PLANE, Plane(0, (0.2, -0.1))]), ValueError, "Surface 1.*edge-on"),
    ]:
        with pytest.raises(error, match=words):
            call(device)
