"""Screens that stop the light of what lies behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from clplen import MicrolensArray, PicturePlane, PlenopticCamera, PointSources
from clplen.cameras import Occluder, PixelArray
from clplen.cameras.optics.local_window import LocalWindows, window_shape
from clplen.cameras.scenes.occluders import shadows
from clplen.compute.device import Device
from clplen.errors import ShapeError

LAM = 532e-9
AXIS = np.linspace(-3e-3, 3e-3, 301)


def shadow(screen: Occluder, place, distance: float = 0.5):
    (found,) = shadows(
        [screen], np.array([place]), object_distance=distance, wavelength=LAM, axis=AXIS
    )
    return found


def test_an_edge() -> None:
    """A half plane: (1 + (1 - i) (C + i S)(w))/2, Born and Wolf 1999, section 8.7.3."""
    for x, z, dz in [(3e-4, -0.1, 0.05), (-2e-4, 0.1, 1.0)]:
        screen = Occluder(np.full((3, 3), [0.0, 1.0, 1.0]), 3.0, z)  # opaque from x = -.5 m on
        moved = x + 0.5 * (0.5 + dz) / (0.5 + z)
        found = shadow(screen, (x - moved, 0.0, dz))
        share, nearer = (dz - z) / (0.5 + dz), 0.5 + z
        crossing = (x - moved) + (AXIS - (x - moved)) * share
        w = -(crossing + 0.5) * np.sqrt(2 / (LAM * nearer * share))
        s, c = special.fresnel(w)
        expected = (1 + (1 - 1j) * (c + 1j * s)) / 2
        row = found[150]
        assert np.abs(row - expected).max() < 0.02  # means over cells
        assert np.abs(np.abs(row) ** 2 - np.abs(expected) ** 2)[np.abs(w) < 2].max() < 5e-3


@pytest.mark.thorough
def test_a_screen_against_its_angular_spectrum() -> None:
    """Squares of any opacity, off the axis, beside a numerical propagation in float64."""
    random = np.random.default_rng(5)
    opacity = random.random((5, 7)) * (random.random((5, 7)) > 0.3)
    screen = Occluder(opacity, 2.1e-3, 0.02)
    x, y, dz, distance = 1.3e-3, -0.7e-3, 0.3, 0.5
    found = shadow(screen, (x, y, dz), distance)
    n, h = 2048, 7.5e-6
    axis = (np.arange(n) - n // 2 + 0.5) * h  # sides of the squares lie between samples
    row, column = (np.searchsorted(e, axis) - 1 for e in screen.edges())
    inside = ((row >= 0) & (row < 5))[:, None] & ((column >= 0) & (column < 7))[None]
    t = np.where(inside, opacity[np.clip(row, 0, 4)[:, None], np.clip(column, 0, 6)[None]], 0)
    t = np.sqrt(1 - t)
    share = (dz - screen.z) / (distance + dz)
    way = (distance + screen.z) * share
    f = np.fft.fftfreq(n, h)
    transfer = np.exp(-1j * np.pi * LAM * way * (f[:, None] ** 2 + f[None] ** 2))
    field = 1 + np.fft.ifft2(np.fft.fft2(t - 1) * transfer)
    from scipy.ndimage import map_coordinates

    at = [(p + (AXIS - p) * share) / h + n // 2 - 0.5 for p in (y, x)]
    grid = np.meshgrid(*at, indexing="ij")
    expected = sum(
        unit * map_coordinates(part, grid, order=3)
        for unit, part in ((1, field.real), (1j, field.imag))
    )
    error = np.abs(found - expected)
    assert np.sqrt((error**2).mean()) < 3e-3
    assert np.abs(1 - expected).max() > 0.5


def test_what_lies_before_a_screen_is_not_in_its_shadow() -> None:
    screen = Occluder(np.ones((2, 2)), 1.0, 0.01)
    for dz in (0.01, 0.0, -0.1):
        assert (shadow(screen, (0, 0, dz)) == 1).all()
    assert np.abs(shadow(screen, (0, 0, 0.02))).max() < 0.1


def test_fields_on_the_array_know_shadows(device: Device) -> None:
    """Half of the pupil in the shadow of an edge: the light comes from the other side."""
    camera = PlenopticCamera.type1(
        focal_length=0.02, object_distance=0.5, aperture_diameter=2e-3, wavelength=LAM,
        mla=MicrolensArray(60e-6, 0.6e-3, count=15), pixels_per_lenslet=10, device=device,
    )  # fmt: skip
    optics, place = camera.optics, np.array([(0.5e-3 * 0.6 / 0.2, -1.5e-3, 0.1)])
    shape = window_shape(optics, place[0])
    screen = Occluder(np.full((3, 3), [0.0, 0.0, 1.0]), 3e-3, -0.3)  # opaque from x = .5 mm on
    images = []
    for screens in ((), (screen,)):
        windows = LocalWindows.of(replace(optics, occluders=screens), shape, place)
        images.append(np.abs(device.download(windows.array_fields())[0]) ** 2)
    free, half = images
    axis = np.linspace(-1e-3, 1e-3, 201)
    (factor,) = shadows([screen], place, object_distance=0.5, wavelength=LAM, axis=axis)
    lit = np.abs(factor[np.hypot(axis[:, None], axis) < 1e-3]) ** 2
    assert lit.mean() == pytest.approx(0.47, abs=0.03)
    assert half.sum() / free.sum() == pytest.approx(lit.mean(), rel=0.01)
    # the light falls at x = X + (1 - alpha) u
    disc = np.hypot(axis[:, None], axis) < 1e-3
    light = np.abs(factor) ** 2 * disc
    u = (light.sum(0) * axis).sum() / light.sum()
    x = (np.arange(shape.samples) - shape.samples // 2) * shape.pitch
    near = np.abs(x) < 40e-6
    seen = (half.sum(0) * x * near).sum() / (half.sum(0) * near).sum()
    even = (free.sum(0) * x * near).sum() / (free.sum(0) * near).sum()
    assert seen - even == pytest.approx((1 - camera.alpha(0.1)) * u, rel=0.1)
    assert abs(u) > 0.3e-3


def bench(device: Device, **options) -> PlenopticCamera:
    values = {
        "focal_length": 0.02, "object_distance": 0.5, "aperture_diameter": 4e-3, "wavelength": LAM,
        "mla": MicrolensArray(60e-6, 0.3e-3, count=(13, 15), fill="full"), "device": device,
        "pixels": PixelArray(pitch=5e-6),
    }  # fmt: skip
    return PlenopticCamera.type1(**(values | options))


def test_cameras_whose_pixels_sample_the_light_know_screens(device: Device) -> None:
    """The share of the light that passes, by the shadow on the pupil."""
    mla = MicrolensArray(60e-6, 1.2e-3, count=41)
    camera = bench(device, pixels=None, pixels_per_lenslet=12, aperture_diameter=1e-3, mla=mla)
    assert camera.pixels is None
    place = np.array([[2e-4, -3e-4, 0.05]])
    screen = Occluder(np.arange(12).reshape(3, 4) / 12, 1e-3, -0.2)
    axis = np.linspace(-5e-4, 5e-4, 201)
    (factor,) = shadows([screen], place, object_distance=0.5, wavelength=LAM, axis=axis)
    lit = np.abs(factor[np.hypot(axis[:, None], axis) < 5e-4]) ** 2
    point = PointSources(place)
    sums = [camera.expose(scene).to_numpy().sum() for scene in ([point, screen], point)]
    assert 0.2 < lit.mean() < 0.8
    assert sums[0] / sums[1] == pytest.approx(lit.mean(), rel=0.02)


def test_pictures_hide_what_is_behind_them(device: Device) -> None:
    """A list in any order; what lies in front of a picture is as it was."""
    camera = bench(device)
    front = PicturePlane(np.eye(3), 6e-3, -0.1, opacity=1.0)
    near, far = PointSources((1e-3, 0, -0.15)), PointSources((1e-3, 0, 0.1))
    alone, both = (camera.expose(s).to_numpy() for s in (near, [front, near]))
    without = camera.expose(PicturePlane(np.eye(3), 6e-3, -0.1)).to_numpy()
    np.testing.assert_allclose(both, alone + without, atol=1e-6 * both.max())
    hidden = camera.expose([far, front]).to_numpy()
    assert np.abs(hidden - without).sum() < 0.01 * camera.expose(far).to_numpy().sum()
    half = PicturePlane(np.eye(3), 6e-3, -0.1, opacity=np.full((3, 3), 0.5))
    through = camera.expose([far, half]).to_numpy() - without
    assert through.sum() == pytest.approx(0.5 * camera.expose(far).to_numpy().sum(), rel=0.03)


def test_what_is_said_of_occluders(device: Device) -> None:
    camera, point = bench(device), PointSources((0, 0, 0))
    screen = Occluder(np.eye(3), 1e-3, -0.1)
    for scene, how, words in (
        ([point, Occluder(np.eye(3), 1e-3, -0.5)], {}, "behind the main lens"),
        ([screen], {}, "must contain a source"),
        ([point, screen], {"model": "rays"}, "SurfaceScene"),
        ([point, screen], {"method": "points"}, "method='points'"),
    ):
        with pytest.raises(ValueError, match=words):
            camera.expose(scene, **how)
    for change, error, words in (
        ({"opacity": np.eye(2)}, ShapeError, r"shape \(3, 3\), got \(2, 2\)"),
        ({"opacity": 1.5}, ValueError, "from 0 to 1"),
        ({"mode": "transmission", "opacity": 0.5}, ValueError, "opacity must be None"),
    ):
        with pytest.raises(error, match=words):
            PicturePlane(np.eye(3), 1e-3, **change)
    for wrong, kind in (([[np.nan]], ValueError), ([1.0], ShapeError), ("ab", TypeError)):
        with pytest.raises(kind):
            Occluder(wrong, 1e-3)
    for width, z in ((0, 0), ("1", 0), (1e-3, np.nan)):
        with pytest.raises(ValueError, match=r"width|z of"):
            Occluder(np.eye(2), width, z)
