"""A sensor that is tilted against the array: every pixel at a distance of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tolerance import relative_max

from clplen import (
    Grid,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SurfaceScene,
)
from clplen.cameras import Aberrations, PixelArray, Plane, Plenoptic1, noise
from clplen.cameras.optics.tilted_sensor import plane_count, sensor_planes, tilt_reach
from clplen.compute.device import Device
from clplen.wave.field.field import Field

LAM = 532e-9
POINTS = PointSources(np.array([(1e-4, -2e-4, -0.02), (-3e-5, 1e-4, 0.01)]))


def camera_of(device: Device, tilt: tuple[float, float], **change: float) -> Plenoptic1:
    given = {"sensor_shift": 1e-4} | change
    array = MicrolensArray(150e-6, 10e-3, count=(5, 7), fill="full")
    return PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=LAM, pixels_per_lenslet=9, device=device,
        aperture_diameter=0.6e-3, aberrations=Aberrations(sensor_tilt=tilt, **given),
    )  # fmt: skip


def by_sums(field: np.ndarray, grid: Grid, distance: np.ndarray) -> np.ndarray:
    """Every pixel's sum over the plane waves of a periodic window, at a distance of its own."""
    fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(grid.shape, grid.pitch, strict=True))
    turns = (np.sqrt(1 - LAM**2 * (fy[:, None] ** 2 + fx**2)) - 1) / LAM
    spectrum = np.fft.fft2(field) / field.size
    down, right = (
        np.exp(2j * np.pi * np.outer(f * d, np.arange(f.size)))
        for f, d in zip((fy, fx), grid.pitch, strict=True)
    )
    found = np.zeros(grid.shape, complex)
    for y, x in np.ndindex(grid.shape):
        onward = spectrum * np.exp(2j * np.pi * distance[y, x] * turns)
        found[y, x] = down[:, y] @ onward @ right[:, x]
    return found


def test_each_pixel_has_its_own_distance(device: Device, precise: Device) -> None:
    tilt = (0.03, -0.02)
    grid, random = camera_of(precise, tilt).grid, np.random.default_rng(1)
    values = random.normal(size=grid.shape) + 1j * random.normal(size=grid.shape)
    distance = 10.1e-3 + tilt[0] * grid.y[:, None] + tilt[1] * grid.x
    expected = by_sums(values, grid, distance)
    ends = [by_sums(values, grid, distance + h) for h in (1e-7, -1e-7)]
    slope = (ends[0] - ends[1]) / 2e-7
    for where, tolerance in ((precise, 1e-9), (device, 1e-5)):
        optics = camera_of(where, tilt).optics
        field = Field.from_array(values, grid, wavelength=LAM, device=where)
        assert relative_max(expected, optics.to_sensor(field).to_numpy()) <= tolerance
        found = optics.sensor_slope(field).to_numpy()
        assert relative_max(slope, found) <= max(tolerance, 1e-7)  # differences, in double
        # the transpose, without conjugation
        other = Field.from_array(values[::-1] + 1, grid, wavelength=LAM, device=where)
        left = (other.to_numpy() * optics.to_sensor(field, pad=2).to_numpy()).sum()
        right = (optics.from_sensor(other, pad=2).to_numpy() * values).sum()
        assert abs(left - right) <= tolerance * abs(left)


def test_planes_are_as_many_as_the_light_turns(precise: Device) -> None:
    assert [plane_count(p, 1e-10) for p in (0.1, 0.35, 2.0)] == [8, 10, 16]
    grid = Grid((21, 17), 8e-6)
    planes = [sensor_planes(grid, 0.01, t, LAM, precise) for t in ((0.0, 0.0), (0.3, 0.1))]
    assert len(planes[0].distances) < len(planes[1].distances)
    assert tilt_reach(grid, (0.3, -0.1)) == pytest.approx(0.3 * 80e-6 + 0.1 * 64e-6)
    assert max(planes[1].distances) - 0.01 < tilt_reach(grid, (0.3, 0.1))
    total = sum(precise.download(one) for one in planes[1].weights)
    assert abs(np.abs(total) - 1).max() < 0.2  # one plane wave, of half the largest turn


def test_a_flat_sensor_is_as_before(device: Device) -> None:
    flat, hardly = (camera_of(device, t).expose(POINTS).to_numpy() for t in ((0, 0), (0, 1e-12)))
    assert relative_max(flat, hardly) <= 1e-5


def test_rays_meet_the_tilted_plane(device: Device) -> None:
    """Spots of a point far out of focus move by their slope times the way to their pixels."""
    array = MicrolensArray(150e-6, 10e-3, count=(5, 15), fill="full")
    flat = PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=LAM, pixels_per_lenslet=45, device=device,
        pixels=PixelArray(), aperture_diameter=4e-3,
    )  # fmt: skip
    point = PointSources((0, 0, 1.0))
    tilted = flat.with_aberrations(Aberrations(sensor_tilt=(0.0, 0.1)))
    spots = []
    for camera in (flat, tilted):
        raw = camera.expose(point, model="rays").to_numpy()[90:135].sum(axis=0)
        cells = raw.reshape(15, 45)
        lit = cells.sum(axis=1)
        spots.append(cells @ np.arange(45) / np.where(lit > 0, lit, 1))
    moved = (spots[1] - spots[0]) * flat.pixel_pitch
    x = (np.arange(15) - 7) * 150e-6
    beta = flat.optics.array_alpha(1.0)
    slope = (x - x / (1 - beta)) / flat.array_distance  # the ray from u meets x = u (1 - beta)
    expected = slope * 0.1 * x
    seen = np.abs(x) < 0.8e-3  # whose sub-images lie in their own cells
    assert np.abs(expected[seen]).max() > 4e-7
    ratio = (moved * expected)[seen].sum() / (expected[seen] ** 2).sum()
    assert ratio == pytest.approx(1, abs=0.05)


def test_arguments(device: Device) -> None:
    with pytest.raises(ValueError, match=r"two finite slopes \(y, x\)"):
        Aberrations(sensor_tilt=(0.0, np.nan))
    with pytest.raises(ValueError, match=r"sensor_tilt must be at most 0\.1 along y and x"):
        Aberrations(sensor_tilt=(0.0, 0.2))
    bent = Aberrations(sensor_tilt=(0.01, -0.02))
    assert Aberrations.from_json(bent.to_json()) == bent
    camera = camera_of(device, (0.01, -0.02))
    assert camera.describe()["sensor tilt"] == pytest.approx(np.hypot(0.01, 0.02))
    with pytest.raises(ValueError, match="does not support a tilted sensor"):
        replace(camera, pixels=PixelArray()).expose(POINTS)
    scene = SurfaceScene([Plane(0.0, texture=noise(1))])
    with pytest.raises(ValueError, match="SurfaceScene does not support a tilted sensor"):
        camera.expose(scene, model="rays")
    picture = PicturePlane(np.ones((3, 3)), 3e-4)
    with pytest.raises(ValueError, match="method='isoplanatic' does not support a tilted sensor"):
        camera.expose(picture, method="isoplanatic")
    short = MicrolensArray(150e-6, 20e-6, count=5)
    with pytest.raises(ValueError, match=r"moves pixels .* towards the array"):
        PlenopticCamera.type1(
            focal_length=0.12, mla=short, wavelength=LAM, pixels_per_lenslet=9, device=device,
            aperture_diameter=0.6e-3, aberrations=Aberrations(sensor_tilt=(0.0, 0.1)),
        )  # fmt: skip
