"""Cameras that people own: decoding, what their description says, and what is refused."""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from accuracy_real_cameras import line

from clplen import (
    DeviceError,
    LightField,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SamplingError,
    SamplingWarning,
    estimate_alpha,
    read_camera,
)
from clplen.cameras import PixelArray
from clplen.cameras.optics.ray_optics import pupil_image
from clplen.compute.device import Device
from clplen.lightfield import point_m

CAMERAS = Path(__file__).parents[2] / "examples" / "cameras"


def camera_of(device: Device, **change: Any) -> Any:
    """A camera of f/7 with 9 x 9 lenslets of 150 um."""
    values: dict[str, Any] = {
        "focal_length": 0.05, "object_distance": 1.0, "aperture_diameter": 7e-3,
        "mla": MicrolensArray(150e-6, 1e-3, count=9), "wavelength": 550e-9,
        "pixels": PixelArray(pitch=5e-6), "device": device,
    }  # fmt: skip
    return PlenopticCamera.type1(**(values | change))


def focused_of(device: Device, **change: Any) -> Any:
    """The same as a focused camera."""
    values: dict[str, Any] = {
        "focal_length": 0.05, "object_distance": 1.0, "aperture_diameter": 7e-3,
        "mla": MicrolensArray(150e-6, 1e-3, count=9), "wavelength": 550e-9, "a": 5e-3,
        "pixels": PixelArray(pitch=5e-6), "device": device,
    }  # fmt: skip
    return PlenopticCamera.type2(**(values | change))


@pytest.mark.parametrize(
    ("lattice", "turned", "pixels"),
    [
        ("hexagonal", 0.02, PixelArray(pitch=1.4e-6, rotation=-0.013, offset=(2.1e-6, -5e-6))),
        ("square", 0.0, PixelArray(pitch=1.37e-6, rotation=0.011, offset=(-7e-6, 3.3e-6))),
    ],
)
def test_light_fields_keep_slopes_of_rays(
    device: Device, lattice: Any, turned: float, pixels: PixelArray
) -> None:
    """dx/du = 1 - alpha about X in the light field of a point by rays; 14.3 pixels a lenslet."""
    mla = MicrolensArray(
        20e-6, 40e-6, count=(25, 27), lattice=lattice, fill="full", rotation=turned,
        offset=(3e-6, -4e-6),
    )  # fmt: skip
    camera = camera_of(device, focal_length=0.03, aperture_diameter=0.015, mla=mla, pixels=pixels)
    for point in ((1e-3, -2e-3, -0.2), (-1e-3, 5e-4, 0.3)):
        raw = camera.expose(PointSources(point), model="rays")
        lf = LightField.from_raw(raw)
        slope, place = line(lf, 0.45 * camera.aperture_diameter)
        assert slope == pytest.approx(1 - camera.alpha(point[2]), rel=0.02)
        assert np.isfinite(place).all()


@pytest.mark.thorough
def test_steep_lenslets_magnify_the_image_of_the_pupil(device: Device) -> None:
    """1 + d^2 (1/f - 1/z2)^2/8 to first order, for a small pupil."""
    for f_number in [5.0, 20.0]:
        mla = MicrolensArray(50e-6, 50e-6 * f_number, count=5)
        camera = camera_of(device, mla=mla, aperture_diameter=0.5e-3)
        slope = mla.diameter * (1 / mla.focal_length - 1 / camera.image_distance)
        size, variance = pupil_image(camera)
        assert size - 1 == pytest.approx(slope**2 / 8, rel=0.005 + slope**2 / 2)
        assert variance < (0.1 * slope * camera.pixel_pitch) ** 2
        assert camera.spot_variance == pytest.approx(1 / 12, rel=0.05)
        by_waves, by_rays = (
            camera.expose(PointSources((0, 0, 0)), model=model).spacing
            for model in ("waves", "rays")
        )
        expected = size if size > 1.001 else 1
        assert by_rays[1] / by_waves[1] == pytest.approx(expected, rel=1e-12)


def test_the_description_of_the_focus_tolerance(device: Device) -> None:
    """In metres on the object, and up to infinity for a camera focused far away."""
    for focused, limits in ((0.5, "dz from -24 mm to 26.5 mm"), (20.0, "to infinity")):
        camera = PlenopticCamera.type1(
            focal_length=0.05, mla=MicrolensArray(100e-6, 311e-6, count=9, fill="full"),
            wavelength=550e-9, object_distance=focused, aperture_diameter=0.05 / 2.8,
            pixels_per_lenslet=9, device=device,
        )  # fmt: skip
        assert limits in str(camera.describe())


def test_the_description_of_windows(device: Device) -> None:
    camera = read_camera(CAMERAS / "canon_50mm.toml", device=device, count=(11, 13))
    table = camera.describe()
    raw = camera.expose(PointSources((0, 0, 0)))
    samples = raw.exposure.transforms[0][1][0]
    assert table["window"] == pytest.approx(samples * camera.pixel_pitch / 11)
    assert f"{samples} x {samples} samples" in str(table)
    assert table["samples a pixel"] == 11
    assert table["active share"] == 1
    assert table["sensor offset x"] == pytest.approx(-17e-6)
    assert table["sensor rotation"] == pytest.approx(math.radians(0.05))
    # (6.25 mm)^4/8 (1/.5^3 + 1/.0556^3)
    assert table["spherical aberration"] == pytest.approx(1.1139e-6, rel=1e-3)
    # what the image lacks: light beyond the window, and the little that pixels beyond it get
    lost = 1 - float(raw.to_numpy().sum(dtype=np.float64))
    assert 0.6 < lost / table["light beyond it"] < 1.2
    leaky = PixelArray(pitch=5e-6, fill_factor=0.5, crosstalk=((0.02, 0.9, 0.03),))
    table = camera_of(device, pixels=leaky).describe()
    assert (table["active share"], leaky.active) == (0.5, math.sqrt(0.5))
    assert table["pixel crosstalk"] == pytest.approx(0.1)
    slow = camera_of(
        device, mla=MicrolensArray(150e-6, 10e-3, count=25), pixels=None,
        pixels_per_lenslet=30, aperture_diameter=8e-4,
    )  # fmt: skip
    table = slow.describe()
    assert slow.pixels is None
    assert (table["samples a pixel"], table["active share"]) == (1, 0)
    assert table["window"] == pytest.approx(750 * slow.pixel_pitch)


LENGTHS = {
    "focal_length": (0.05, 1e3),
    "image_distance": (0.0526, 1e3),
    "aperture_diameter": (7e-3, 1e3),
    "wavelength": (550e-9, 1e6),
}


def test_lengths_of_cameras_in_other_units(device: Device) -> None:
    for key, (value, factor) in LENGTHS.items():
        other = {"object_distance": None} if key == "image_distance" else {}
        with pytest.raises(ValueError, match=r"in metres|a lens has") as caught:
            camera_of(device, **{key: value * factor}, **other)
        hint = float(re.search(r"did you mean (\S+)\?", str(caught.value))[1])
        assert hint == pytest.approx(value, rel=1e-4)


def did_you_mean(number: str) -> str:
    return re.escape(f"did you mean {number}?")


def test_numbers_of_parts_that_are_refused() -> None:
    """Lengths in other units, and what is no number."""
    for make, words in (
        (lambda: MicrolensArray(0.15, 1e-3, count=9), did_you_mean("0.00015")),
        (lambda: MicrolensArray(150e-6, 10.0, count=9), did_you_mean("0.01")),
        (lambda: MicrolensArray(150e-6, 1e-3, count=9, offset=(0.0, 3.0)), did_you_mean("3e-06")),
        (lambda: PixelArray(pitch=1.4e-3), did_you_mean("1.4e-06")),
        (lambda: PixelArray(offset=(11.0, -2.0)), did_you_mean("1.1e-05")),
        (lambda: PointSources((0, 0, 0), diameter=10.0), did_you_mean("1e-05")),
        (lambda: MicrolensArray("150", 1e-3, count=9), "pitch of lenslets must be positive"),
        (lambda: PixelArray(shape=("a", "b")), r"shape must be pixels \(ny, nx\)"),
        (lambda: PixelArray(offset=("a", 0)), r"offset must be \(y, x\) in metres"),
        (lambda: PixelArray(crosstalk=[[1, 2], [1]]), "crosstalk must be numbers in rows"),
        (lambda: PointSources("abc"), "Positions of sources must be real numbers"),
        (lambda: PointSources((0, 0, 0), power="a"), "Powers of sources must be real numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


def test_numbers_that_contradict_each_other(device: Device) -> None:
    with pytest.raises(ValueError, match=r"below 0\.105263 m .* NA 1\.9\.$"):
        camera_of(device, aperture_diameter=0.2)
    with pytest.raises(ValueError, match=r"did you mean 0\.001\?"):
        camera_of(device, mla=MicrolensArray(150e-6, 1.0, count=9))
    with pytest.raises(ValueError, match=r"2 wavelengths wide, .* below 7\.5e-05 m"):
        camera_of(device, wavelength=550e-6)
    with pytest.raises(ValueError, match=r"by 0\.011 m along x.*than 0\.00135 m"):
        camera_of(device, pixels=PixelArray(pitch=5e-6, offset=(0, 11e-3)))
    with pytest.raises(SamplingError, match=r"got 1\.5: use pixels of 7\.5e-05 m or less"):
        camera_of(device, pixels=PixelArray(pitch=100e-6))
    with pytest.raises(ValueError, match=r"\(a = 5 m\).*abs\(m\) >= ([\d.e-]+\d)") as caught:
        focused_of(device, a=5.0)
    least = float(re.search(r"abs\(m\) >= ([\d.e-]+\d)", str(caught.value))[1])
    assert focused_of(device, a=None, m=1.05 * least).patch_size == pytest.approx(0.105, rel=0.05)
    for wrong in ("x", math.nan, -3):
        with pytest.raises(SamplingError, match="pixels_per_lenslet must be a number >= 2"):
            camera_of(device, pixels=None, pixels_per_lenslet=wrong)
    with pytest.raises(TypeError, match="mla must be a MicrolensArray, got None"):
        camera_of(device, mla=None)


def test_a_fast_main_lens_is_said_once(device: Device) -> None:
    with pytest.warns(SamplingWarning, match=r"NA 0\.475 .* D <= 0\.0421 m") as caught:
        camera = camera_of(device, aperture_diameter=0.05)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera.check_scene(PointSources((0, 0, 0)))
        camera_of(device, aperture_diameter=0.042)


def test_points_outside_the_field_of_view(device: Device) -> None:
    camera = camera_of(device, pixels=PixelArray(pitch=5e-6, shape=(201, 101), offset=(0, 1e-4)))
    with pytest.raises(SamplingError, match="At this dz the field of view") as caught:
        camera.expose(PointSources((0.02, 0, -0.2)))
    number = r"(-?[0-9.e-]+)"
    view = rf"x from {number} to {number} m, y from {number} to {number} m"
    found = re.search(view, str(caught.value))
    left, right, top, bottom = map(float, found.groups())
    step = (right - left) * 1e-3
    camera.check_scene(PointSources([(left + step, 0, -0.2), (right - step, 0, -0.2)]))
    camera.check_scene(PointSources([(0, 0.999 * top, -0.2), (0, 0.999 * bottom, -0.2)]))
    for outside in ((left - step, 0), (right + step, 0), (0, 1.002 * top), (0, 1.002 * bottom)):
        with pytest.raises(SamplingError, match="field of view"):
            camera.check_scene(PointSources((*outside, -0.2)))
    with pytest.raises(SamplingError, match=r"did you mean \(0, 0\.003\)\?"):
        camera.check_scene(PointSources((0, 3.0, 0)))
    with pytest.raises(ValueError, match=r"did you mean dz = -0\.05\?"):
        camera.check_scene(PointSources((0, 0, -50.0)))
    with pytest.raises(SamplingError, match="field of view"):
        camera.expose(PicturePlane(np.ones((2, 3)), 1.0))


def test_windows_that_do_not_fit_are_refused_before_memory_is_taken(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = camera_of(device, aperture_diameter=0.02)
    points = PointSources([(0, 0, 0), (0, 0, -0.999), (1e-3, 0, 0.1)])

    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("memory was taken")

    monkeypatch.setattr(Device, "empty", refuse)
    monkeypatch.setattr(Device, "zeros", refuse)
    with pytest.raises(DeviceError, match=r"blurred over 7011 lenslets: its window .* nearer"):
        camera.expose(points)


@pytest.mark.parametrize("name", ["lytro_illum", "canon_50mm"])
def test_alpha_of_cameras_that_people_own(device: Device, name: str) -> None:
    """Points on both sides of the focus: blurs to a fifth of a lenslet."""
    camera = read_camera(CAMERAS / f"{name}.toml", device=device, count=(29, 31))
    p, tolerance = camera.mla.pitch, camera.mla.pitch / camera.aperture_diameter
    for blur, place in ((4.7, (1.3, -0.6)), (-3.6, (-0.8, 1.9))):
        dz = float(camera.dz(1 + blur * tolerance))
        x, y = np.multiply(place, p / camera.array_scale(dz))
        lf = LightField.from_raw(camera.expose(PointSources((x, y, dz))))
        for method, least in (("compensated", 0.2), ("slope", 0.35)):
            found = estimate_alpha(lf, method=method, c_max=0.5)
            error = found.alpha - camera.alpha(dz)
            assert abs(error) < least * tolerance, (method, error / tolerance)
            assert abs(error) < 2.5 * found.uncertainty, (method, error / tolerance)


@pytest.mark.thorough
def test_m_of_three_kinds_of_lenslets(device: Device) -> None:
    """A virtual depth of 5 b, at which no kind is in focus."""
    camera = read_camera(CAMERAS / "raytrix_r12.toml", device=device, count=(15, 17))
    m = -0.2
    dz = camera.dz(camera.image_distance / (camera.array_distance - camera.b / m))
    found = point_m(camera.expose(PointSources((2e-3, -1e-3, dz))))
    assert found.m == pytest.approx(m, rel=0.02)
