"""Scenes before a focused camera: pictures, slides, rays, and arrays of several focal lengths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from clplen import (
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
)
from clplen.cameras.focused_camera import Plenoptic2
from clplen.compute.device import Device

LAM = 532e-9
PICTURE = np.array([[0.0, 1, 0.5], [2, 0, 1], [0.3, 0, 0]])
THREE = (10e-3, 12.5e-3, 8.5e-3)


def camera_of(device: Device, m: float, f: Any = 10e-3, **words: Any) -> Plenoptic2:
    """f = 120 mm in 2f-2f, lenslets of 150 um with 15 pixels, D = 2.4 mm."""
    pixels = words.pop("pixels", 15)
    diameter = words.pop("aperture_diameter", 2.4e-3)
    mla = MicrolensArray(150e-6, f, **({"fill": "full", "count": (31, 33)} | words))
    return PlenopticCamera.type2(
        focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=pixels, device=device, m=m,
        aperture_diameter=diameter,
    )  # fmt: skip


def test_pictures_from_patterns_are_those_of_points(device: Device) -> None:
    small = {"count": (17, 19), "aperture_diameter": 1.8e-3, "pixels": 22}  # 15 leave 1e-2
    camera = camera_of(device, -0.3, lattice="hexagonal", offset=(20e-6, -30e-6), **small)
    plane = PicturePlane(PICTURE, 0.6e-3, 2e-3)
    points, patterns = (camera.expose(plane, method=method) for method in ("points", "isoplanatic"))
    exact = points.to_numpy().astype(np.float64)
    error = np.abs(patterns.to_numpy() - exact).max() / exact.max()
    assert error < 2e-3
    assert patterns.exposure is not None
    assert patterns.exposure.route == "isoplanatic"
    assert patterns.exposure.error < 3e-3
    assert exact.sum() == pytest.approx(PICTURE.sum(), rel=2e-2)  # a window of 3 mm


def test_patterns_need_lenslets_of_one_kind(device: Device) -> None:
    camera = camera_of(device, 0.3, (10e-3, 11e-3))
    plane = PicturePlane([[1.0, 2]], 3e-4)
    with pytest.raises(ValueError, match=r"lenslets of one focal length: use method='points'"):
        camera.expose(plane, method="isoplanatic")
    assert camera.expose(plane).exposure.route == "points"  # type: ignore[union-attr]


def correlation(a: Any, b: Any) -> float:
    return float((a * b).sum() / math.sqrt((a**2).sum() * (b**2).sum()))


@pytest.mark.parametrize(
    ("m", "f", "words"),
    [
        (-0.3, (10e-3, 9e-3), {"offset": (30e-6, -20e-6), "rotation": 0.1}),
        (0.4, THREE, {"lattice": "hexagonal", "fill": "circular"}),
    ],
)
def test_waves_and_rays_put_the_light_in_the_same_place(
    m: float, f: Any, words: Any, device: Device
) -> None:
    camera = camera_of(device, m, f, **words)
    scene = PointSources([(2e-4, 3e-4, -3e-3)], diameter=1e-5)
    waves, rays = (
        camera.expose(scene, model=model).to_numpy().astype(np.float64)
        for model in ("waves", "rays")
    )
    # of round lenslets the gaps meet darker or brighter parts of the rings than the mean
    assert rays.sum() == pytest.approx(waves.sum(), rel=0.06 if "fill" in words else 0.02)
    assert correlation(smooth(waves), smooth(rays)) > 0.95
    assert correlation(smooth(waves), smooth(rays[::-1])) < 0.7


def smooth(image: Any) -> Any:
    """Over the width of a diffraction spot, lam b/d, so that rays have it too."""
    y, x = (np.fft.fftfreq(n) for n in image.shape)
    gauss = np.exp(-2 * (math.pi * 4) ** 2 * (y[:, None] ** 2 + x[None] ** 2))
    return np.fft.ifft2(np.fft.fft2(image) * gauss).real


class TestSeveralFocalLengths:
    """A hexagonal array of three types in one exposure."""

    def camera(self, device: Device) -> Plenoptic2:
        mla = MicrolensArray(300e-6, THREE, count=25, lattice="hexagonal", fill="full")
        return PlenopticCamera.type2(
            focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=40, device=device,
            m=0.4, aperture_diameter=5e-3,
        )  # fmt: skip

    @pytest.mark.parametrize(("model", "gain"), [("waves", 1.2), ("rays", 2.5)])
    def test_each_type_is_sharp_at_its_own_distance(
        self, model: Any, gain: float, device: Device
    ) -> None:
        """One point on the axis of a lenslet of each type."""
        camera, kind = self.camera(device), 1
        a = 1 / (1 / THREE[kind] - 1 / camera.b)
        dz = camera.dz(camera.image_distance / (camera.array_distance - a))
        assert camera.ray_matrix(dz, lens_type=kind)[0, 1] == pytest.approx(0, abs=1e-12)
        found = []
        for number in range(3):
            row, column = np.argwhere(camera.mla.types()[10:15, 10:15] == number)[2] + 10
            y, x = camera.mla.centres()[row, column]
            scale = camera.array_scale(dz)
            raw = camera.expose(PointSources((x / scale, y / scale, dz)), model=model)
            centre = np.array([y, x]) * camera.sub_image_scale
            found.append(sharpness(raw.to_numpy().astype(np.float64), camera, centre))
        assert found[kind] > gain * np.delete(found, kind).max(), found

    def test_the_raw_image_tells_where_they_are(self, device: Device) -> None:
        camera = self.camera(device)
        raw = camera.expose(PointSources((0, 0, 0)), model="rays")
        grid = raw.sub_images
        assert len(raw.lens_types) == 3
        i, k = np.indices(grid.count)
        column = k + grid.odd_row_shift * (i % 2)
        place = (
            np.asarray(grid.first)
            + i[..., None] * np.asarray(grid.row_step)
            + column[..., None] * np.asarray(grid.column_step)
        )
        for number, one in enumerate(raw.lens_types):
            mine = place[camera.mla.types() == number]
            step = np.linalg.inv(np.array(one.steps))
            index = (mine - np.asarray(grid.first) - one.offset) @ step
            np.testing.assert_allclose(index, np.rint(index), atol=1e-9)
            other = place[camera.mla.types() != number]
            index = (other - np.asarray(grid.first) - one.offset) @ step
            assert (np.abs(index - np.rint(index)).max(axis=-1) > 0.3).all()

    def test_their_ranges_meet_and_hold_their_focus(self, device: Device) -> None:
        camera = self.camera(device)
        types = camera.expose(PointSources((0, 0, 0)), model="rays").lens_types
        for one, f in zip(types, THREE, strict=True):
            low, high = one.depth_range
            assert low < 1 / (camera.b / f - 1) < high
        ends = sorted(one.depth_range for one in types)
        assert ends[0][1] == pytest.approx(ends[1][0])
        assert ends[1][1] == pytest.approx(ends[2][0])
        assert camera_of(device, 0.2).expose(PointSources((0, 0, 0))).lens_types == ()


def sharpness(image: Any, camera: Plenoptic2, place: Any) -> float:
    """Sum of squares over the square of the sum, about a place on the sensor."""
    rows, columns = (
        np.abs(axis - at) <= 100e-6
        for axis, at in zip((camera.grid.y, camera.grid.x), place, strict=True)
    )
    part = image[np.ix_(rows, columns)]
    return float((part**2).sum() / part.sum() ** 2) if part.size and part.sum() > 0 else 0.0
