"""The focused camera: geometry, matched apertures, refusals, a float64 twin of its raw image."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import reference_camera as reference
from reference_optics import propagate
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera, PointSources, SamplingError
from clplen.cameras.focused_camera import Plenoptic2
from clplen.compute.device import Device

LAM = 532e-9


def focused(device: Device, m: float | None = 0.25, **change: Any) -> Plenoptic2:
    """f = 120 mm in 2f-2f, lenslets of 150 um and 10 mm with 15 pixels."""
    values: dict[str, Any] = {
        "focal_length": 0.12,
        "mla": MicrolensArray(150e-6, change.pop("f", 10e-3), count=(41, 43), fill="full"),
        "wavelength": LAM,
        "pixels_per_lenslet": 15,
        "device": device,
        "m": m,
    }
    return PlenopticCamera.type2(**(values | change))


class Twin(reference.Camera):
    """The reference camera with another distance to its array and to its sensor."""

    def __init__(self, m: float, count: tuple[int, int]) -> None:
        super().__init__(count=count, pixels_per_lenslet=15)
        object.__setattr__(self, "m", m)

    @property
    def b(self) -> float:
        return self.f_mu * (1 + self.m)

    @property
    def array(self) -> float:
        return self.image_distance + self.f_mu * (1 + 1 / self.m)

    @property
    def aperture_diameter(self) -> float:
        return self.pitch * self.array / self.b

    def raw(self, x0: float, y0: float, dz: float) -> Any:
        step = (self.pixel, LAM)
        u = reference.field_behind_lens(self, x0, y0, dz)
        u = propagate(u, step[0], self.array, step[1], method="blas", pad=1, workers=2)
        u *= reference.array_phase(self)
        u = propagate(u, step[0], self.b, step[1], method="as", pad=1, workers=2)
        return u.real**2 + u.imag**2


def test_raw_image_against_the_twin(device: Device, precise: Device) -> None:
    point, mla = (0.3e-3, -0.2e-3, 4e-3), MicrolensArray(150e-6, 10e-3, count=(57, 61), fill="full")
    # complex64, type1 has 3e-6; float32 and the rim's strips
    for where, m, tolerance in ((device, 0.25, 5e-6), (precise, -0.3, 1e-6)):
        camera = focused(where, m, mla=mla)
        assert camera.optics.padding(np.array([point])) == (1, 1)
        got = camera.expose(PointSources(point, diameter=10e-6)).to_numpy()
        expected = Twin(m, (57, 61)).raw(*point)
        assert relative_max(expected, got.astype(np.float64)) <= tolerance


def test_distances_and_apertures(device: Device) -> None:
    for m, a, b, pupil, cone in [
        (1, 20e-3, 20e-3, 1.95e-3, 1.8e-3),
        (0.25, 50e-3, 12.5e-3, 3.48e-3, 2.88e-3),
        (-0.3, -23.33333e-3, 7e-3, 4.642857e-3, 5.142857e-3),
    ]:
        camera = focused(device, m)
        assert (camera.a, camera.b) == pytest.approx((a, b), rel=1e-6)
        assert (camera.array_distance, camera.sensor_distance) == pytest.approx((0.24 + a, b))
        assert camera.aperture_diameter == pytest.approx(pupil, rel=1e-6)
        assert focused(device, m, match="cone").aperture_diameter == pytest.approx(cone, rel=1e-6)
        assert focused(device, m, aperture_diameter=2e-3).aperture_diameter == 2e-3
        by_a = focused(device, None, a=camera.a)
        assert by_a.m == pytest.approx(m, rel=1e-12)
        assert camera.patch_size == pytest.approx(abs(m) * 15 * 0.24 / (0.24 + a), rel=1e-6)
        assert focused(device, m, match="cone").views == pytest.approx(1 / abs(m), rel=1e-9)
        assert camera.views == pytest.approx(abs((1 + a / 0.24) / m), rel=1e-6)


def test_the_patch_of_a_strong_lenslet(device: Device) -> None:
    camera = focused(
        device, 0.2, mla=MicrolensArray(150e-6, 3e-3, count=101, fill="full"), match="cone",
        pixels_per_lenslet=30,
    )  # fmt: skip
    assert camera.patch_size == pytest.approx(5.58, abs=0.005)
    assert camera.aperture_diameter == pytest.approx(10e-3)
    table = camera.describe()
    assert "Keplerian" in str(table)
    assert table["array distance"] == pytest.approx(0.258)
    assert table["patch size"] == camera.patch_size
    assert table["views"] == pytest.approx(5)
    assert table["cut-off"] == pytest.approx(15.66e3, rel=1e-3)
    text = str(focused(device, -0.3, f=(10e-3, 12e-3)).describe())
    assert "Galilean" in text
    assert "before the image" in text
    assert "lenslet focal length 1          12 mm" in text


def test_ray_matrix_in_focus(device: Device) -> None:
    for m in [0.25, -0.3]:
        found = focused(device, m).ray_matrix()
        np.testing.assert_allclose(found, [[-m, 0], [-1 / 10e-3, -1 / m]], rtol=1e-12, atol=1e-12)


def test_ray_matrix_out_of_focus(device: Device) -> None:
    """Free space, lens, free space, one after the other."""
    for dz in [-0.01, 0.03]:
        camera = focused(device, 0.4, f=(10e-3, 12e-3))
        image = 1 / (1 / 0.12 - 1 / (0.24 + dz))
        for number, f in enumerate((10e-3, 12e-3)):
            way = [[1, 0.24 + camera.a - image], [0, 1]]
            lens, on = [[1, 0], [-1 / f, 1]], [[1, camera.b], [0, 1]]
            found = camera.ray_matrix(dz, lens_type=number)
            np.testing.assert_allclose(found, np.linalg.multi_dot([on, lens, way]), rtol=1e-9)
            assert np.linalg.det(found) == pytest.approx(1, abs=1e-9)
        with pytest.raises(ValueError, match="lens_type must be 0 to 1, got 2"):
            camera.ray_matrix(lens_type=2)
        with pytest.raises(ValueError, match="imaged at infinity"):
            camera.ray_matrix(-0.12)


def test_ray_matrix_of_a_standard_camera(device: Device) -> None:
    mla = MicrolensArray(150e-6, 10e-3, count=27, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=10, device=device
    )
    np.testing.assert_allclose(camera.ray_matrix(), [[0, 10e-3], [-100, 1]], atol=1e-12)
    assert np.linalg.det(camera.ray_matrix(0.05)) == pytest.approx(1)
    place = [(3e-4, -1e-4, 0.02)]
    np.testing.assert_array_equal(camera.image_of(place), camera.on_array(place))


def test_chief_rays(device: Device) -> None:
    camera = focused(device, 0.25)
    place = (4e-4, -1e-4, 0.02)
    x, y = camera.image_of([place])[0]
    assert (x, y) == pytest.approx((-4e-4 * 0.24 / 0.26, 1e-4 * 0.24 / 0.26))
    assert camera.on_array([place])[0] == pytest.approx(np.array([x, y]) * 0.29 / 0.24)
    image = 1 / (1 / 0.12 - 1 / 0.26)
    assert camera.alpha(0.02) == pytest.approx(0.24 / image)
    assert camera.array_alpha(0.02) == pytest.approx(0.29 / image)
    assert camera.dz(0.24 / image) == pytest.approx(0.02)
    raw = camera.expose(PointSources((0, 0, 0)))
    step = raw.sub_images.column_step[1]
    assert step == pytest.approx(15 * (1 + 12.5e-3 / 0.29))
    assert raw.cells.column_step[1] == pytest.approx(15)
    assert raw.spacing is None  # alpha is not the light field's
    assert raw.camera is camera


@pytest.mark.parametrize("field_lens", [None, True])
def test_the_spread_of_light_on_the_sensor(field_lens: bool | None, device: Device) -> None:
    """Rays from both rims of the main lens through both edges of a lenslet, one after the other."""
    for dz in [-4e-3, 0.03]:
        camera: Any = focused(device, 0.25, f=(10e-3, 9e-3))
        if field_lens is not None:
            camera = PlenopticCamera.type1(
                focal_length=0.12, mla=MicrolensArray(150e-6, 9e-3, count=31), wavelength=LAM,
                pixels_per_lenslet=15, device=device, aperture_diameter=2e-3, field_lens=field_lens,
            )  # fmt: skip
        z2, z3, X = camera.array_distance, camera.sensor_distance, 7e-4
        image = 1 / (1 / 0.12 - 1 / (0.24 + dz))
        reached = []
        for u in (-camera.aperture_diameter / 2, camera.aperture_diameter / 2):
            slope = (X * image / z2 - u) / image
            x = u + slope * z2
            for edge in (-75e-6, 75e-6):
                behind = slope - edge / 9e-3 - (x / z2 if field_lens else 0)
                chief = X if field_lens else X * (1 + z3 / z2)
                reached.append(abs(x + z3 * behind - chief))
        assert max(reached) == pytest.approx(camera.spread(dz), rel=1e-9)


def test_bad_cameras(device: Device) -> None:
    for change, message in [
        ({"m": None}, "exactly one of m and a"),
        ({"m": 0.2, "a": 60e-3}, "exactly one of m and a"),
        ({"m": 0}, "and finite, got 0"),
        ({"m": np.nan}, "and finite"),
        ({"m": -1}, r"m must be > -1"),
        ({"m": -1.5}, "before the array"),
        ({"m": None, "a": 7e-3}, "focal length 0.01 m, got 0.007 m"),
        ({"m": None, "a": 10e-3}, "a must be > f"),
        ({"m": None, "a": 0.0}, "a must be > f"),
        ({"m": None, "a": np.inf}, "a must be > f"),
        ({"m": -0.03}, "before the main lens, whose image is at 0.24 m"),
        ({"match": "both"}, "match must be 'pupil' or 'cone', got 'both'"),
        ({"object_distance": 0.1}, "larger than the focal length"),
        ({"f": -10e-3}, "must be > 0"),
        ({"f": (10e-3, -12e-3)}, "must be > 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            focused(device, **change)
    for m in (True, "0.2", np.array([0.1, 0.2])):
        with pytest.raises(TypeError, match="m must be a real number, got"):
            focused(device, m)
    mla = MicrolensArray(150e-6, (10e-3, 11e-3), count=27, fill="full")
    with pytest.raises(ValueError, match=r"one focal length.* got 2: use one, or .*type2"):
        PlenopticCamera.type1(
            focal_length=0.12, mla=mla, wavelength=LAM, pixels_per_lenslet=10, device=device
        )
    assert focused(device, f=(10e-3, 20e-3)).pixels is None
    for f in (3e-3, (10e-3, 3.5e-3)):  # the steepest lenslet counts
        with pytest.raises(SamplingError, match=r"cycles/m .*pixels_per_lenslet = "):
            focused(device, f=f).expose(PointSources((0, 0, 0)), method="points")
