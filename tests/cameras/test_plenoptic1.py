"""Camera geometry, exposure in batches, messages."""

import numpy as np
import pytest
from reference_camera import Camera, simulate_scene
from tolerance import relative_max

from clplen import (
    DeviceError,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    SamplingError,
    Sensor,
)
from clplen.cameras import camera_base
from clplen.cameras.exposure import wave_exposure


def small(device, **change):
    values = {
        "focal_length": 0.12,
        "wavelength": 532e-9,
        "pixels_per_lenslet": 10,
        "device": device,
        "mla": MicrolensArray(150e-6, 10e-3, count=(27, 31), fill="full"),
    } | change
    return PlenopticCamera.type1(**values)


POINTS = [(0.3e-3, -0.2e-3, -0.03), (-0.5e-3, 0.4e-3, 0.02), (0.1e-3, 0.6e-3, 0.0)]


def test_batches_equal_single_sources(device, monkeypatch):
    camera = small(device, aperture_diameter=1.8e-3, object_distance=0.2)
    one_batch = camera.expose(PointSources(POINTS, diameter=10e-6)).to_numpy()
    monkeypatch.setattr(wave_exposure, "MAX_BATCH_BYTES", 1)
    calls = []
    singles = camera.expose(
        PointSources(POINTS, diameter=10e-6), progress=lambda n, total: calls.append((n, total))
    ).to_numpy()
    assert calls == [(1, 3), (2, 3), (3, 3)]
    np.testing.assert_allclose(one_batch, singles, atol=1e-7 * singles.max())


def test_a_raw_image_is_the_twins(device, precise):
    """The rim of the aperture by 32 strips: 1.2e-4 of a rim sample, one sample in a thousand."""
    params = Camera(count=(51, 57), pixels_per_lenslet=10)
    expected = simulate_scene(POINTS[:2], params=params)
    for where, tolerance in ((device, 3e-6), (precise, 1e-6)):
        camera = small(where, mla=MicrolensArray(150e-6, 10e-3, count=(51, 57), fill="full"))
        got = camera.expose(PointSources(POINTS[:2], diameter=10e-6)).to_numpy()
        assert got.dtype == np.float32
        assert relative_max(expected, got.astype(np.float64)) <= tolerance


def test_distances(device):
    for given, expected in [
        ({}, (0.24, 0.24)),
        ({"object_distance": 0.36}, (0.36, 0.18)),
        ({"image_distance": 0.18}, (0.36, 0.18)),
        ({"object_distance": 0.36, "image_distance": 0.18}, (0.36, 0.18)),
    ]:
        camera = small(device, aperture_diameter=0.5e-3, **given)
        assert (camera.object_distance, camera.image_distance) == pytest.approx(expected)


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
def test_the_grid_covers_the_array(device, lattice):
    mla = MicrolensArray(150e-6, 10e-3, count=(12, 17), lattice=lattice)
    camera = small(device, mla=mla, pixels_per_lenslet=9.37, aperture_diameter=0.5e-3)
    pitch = 150e-6 / 9.37
    assert camera.pixel_pitch == pytest.approx(pitch)
    for n, length, origin in zip(camera.grid.shape, mla.extent, camera.grid.origin, strict=True):
        assert n * pitch >= length * (1 - 1e-9) > (n - 1) * pitch
        assert origin == (pitch / 2 if n % 2 == 0 else 0)
    rows = 150e-6 * (1 if lattice == "square" else np.sqrt(3) / 2)
    step = camera.pixel_pitch * 24
    lf = LightField.from_raw(camera.expose(PointSources((0, 0, 0))))
    assert lf.spacing == pytest.approx((-step, -step, rows, 150e-6))


def test_what_is_refused(device, monkeypatch):
    """Cameras, points and what is said of them."""
    array = {"count": (27, 31), "fill": "full"}
    narrow, middle = {"aperture_diameter": 0.5e-3}, (0, 0, 0)
    short = {"mla": MicrolensArray(150e-6, 2e-3, **array)}
    wide = {"mla": MicrolensArray(150e-6, 10e-3, count=101, fill="full")}
    few = {"mla": MicrolensArray(150e-6, 10e-3, count=9, fill="full")}
    far = {"object_distance": 0.36, "image_distance": 0.2}
    assert small(device, **short).pixels is not None  # they integrate: the rule is not for them
    for change, point, method, error, words in (
        (far, None, "", ValueError, r"contradict the lens law .* is at 0.18 m"),
        ({"object_distance": 0.1}, None, "", ValueError, "larger than the focal length"),
        ({"pixels_per_lenslet": 1.5}, None, "", SamplingError, "at least 2"),
        ({"wavelength": -1.0}, None, "", ValueError, "wavelength must be > 0"),
        ({"aperture_diameter": -1.0}, None, "", ValueError, "aperture_diameter must be > 0"),
        (short, middle, "points", SamplingError, r"cycles/m .*lenslet = .*method='local'"),
        (wide, (7e-3, 0, 0), "auto", SamplingError, r"\|X\| = 0.007"),
        (few, middle, "points", SamplingError, "must hold the main lens' aperture"),
        # a point near the lens sends light at (X - alpha u)/F: abs(alpha) grows without limit
        ({"aperture_diameter": 1.8e-3}, (0, 0, -0.235), "auto", SamplingError, "cycles/m"),
        (narrow, (3e-3, 0, 0), "auto", SamplingError, r"imaged at .* beyond the array"),
        (narrow, (0, 0, -0.25), "auto", ValueError, "behind the main lens"),
    ):
        with pytest.raises(error, match=words):
            small(device, **change).expose(PointSources(point), method=method)
    for args, kwargs, words in (
        (([(0, 0)],), {}, r"\(x, y, dz\)"),
        (([],), {}, r"\(x, y, dz\)"),
        (([(0, 0, np.nan)],), {}, "finite"),
        (([(0, 0, 0)],), {"diameter": -1}, "diameter must be >= 0"),
        (([(0, 0, 0)],), {"power": [1, 2]}, "must be one value or 1"),
        (([(0, 0, 0)],), {"power": -1}, "finite and >= 0"),
    ):
        with pytest.raises(ValueError, match=words):
            PointSources(*args, **kwargs)
    camera = small(device, **narrow)
    monkeypatch.setattr(device, "memory_bytes", 10_000)
    with pytest.raises(DeviceError, match=r"needs [\d,]+ bytes"):
        camera.expose(PointSources(middle))


def test_light_beyond_the_sensor_is_lost_not_wrapped(device):
    """Chief rays of a point near the border land at X (1 + f_mu/F), off the sensor."""
    camera = small(device, aperture_diameter=0.8e-3, pixels_per_lenslet=20)
    x = -0.98 * camera.grid.extent[1] / 2  # imaged at +.98 of the half width, lands at 1.02
    raw = camera.expose(PointSources((x, 0, 0))).to_numpy().astype(np.float64)
    assert raw[:, : raw.shape[1] // 2].sum() < 0.01
    assert raw.sum() < 0.9


def test_padding_follows_the_marginal_ray(device):
    camera = small(
        device, mla=MicrolensArray(150e-6, 10e-3, count=51, fill="full"), pixels_per_lenslet=15
    )
    assert camera.optics.padding(np.zeros((1, 3))) == (1, 1)
    far = PointSources((1.2e-3, 0, 0.25))
    assert camera.optics.padding(far.positions)[0] == 2
    _, at_array, _ = camera_base.scene_energy(camera, far)[0]
    assert at_array > 0.998


def test_field_lens_centres_the_sub_images(device):
    """Without it the sub-image of a lenslet at x lies at x (1 + f_mu/F), with it at x."""
    shifts = {}
    for field_lens in (False, True):
        camera = small(device, aperture_diameter=1.5e-3, field_lens=field_lens)
        X = 10 * 150e-6
        raw = camera.expose(PointSources((-X, 0, 0))).to_numpy().astype(np.float64) ** 2
        shifts[field_lens] = (raw.sum(axis=0) @ camera.grid.x) / raw.sum() - X
    assert abs(shifts[True]) < 2e-6
    assert shifts[False] == pytest.approx(10 * 150e-6 * 10e-3 / 0.24, rel=0.05)


def test_a_sensor_is_off_by_default_and_refuses_what_none_has(device):
    raw = small(device, aperture_diameter=0.5e-3).expose(PointSources((0, 0, 0)))
    assert Sensor().record(raw) is raw
    for change, words in (
        ({"exposure": 1e6, "full_well": 9, "bit_depth": 8.5}, "from 1 to 24"),
        ({"seed": -1}, "seed must be a non-negative integer"),
        ({"exposure": -1}, "exposure must be a positive"),
        ({"shot_noise": True}, "require exposure"),
        ({"exposure": 1e6, "bit_depth": 8}, "bit_depth requires full_well"),
        ({"exposure": 1e6, "bit_depth": 40, "full_well": 1}, "from 1 to 24"),
        ({"exposure": 1e6, "read_noise": -1}, "read_noise must not be negative"),
    ):
        with pytest.raises(ValueError, match=words):
            Sensor(**change)


def test_every_camera_is_a_plenoptic_camera_and_says_its_kind(device):
    lenslets = MicrolensArray(150e-6, 10e-3, count=25)
    shared = {"mla": lenslets, "wavelength": 532e-9, "pixels_per_lenslet": 30, "device": device}
    for camera, kind in (
        (PlenopticCamera.type1(focal_length=0.12, **shared), "standard"),
        (PlenopticCamera.type2(focal_length=0.12, m=0.3, **shared), "focused"),
        (PlenopticCamera.microscope(magnification=20, na=0.15, **shared), "microscope"),
    ):
        assert isinstance(camera, PlenopticCamera)
        assert camera.kind == kind
    assert not isinstance(lenslets, PlenopticCamera)
    with pytest.raises(TypeError, match="type1"):
        PlenopticCamera()
