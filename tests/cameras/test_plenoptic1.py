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
    estimate_alpha,
    refocus,
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
    monkeypatch.setattr(wave_exposure, "BATCH_BYTES", 1)
    calls = []
    singles = camera.expose(
        PointSources(POINTS, diameter=10e-6), progress=lambda n, total: calls.append((n, total))
    ).to_numpy()
    assert calls == [(1, 3), (2, 3), (3, 3)]
    np.testing.assert_allclose(one_batch, singles, atol=1e-7 * singles.max())


def test_matched_aperture_small_camera(device):
    camera = small(device, mla=MicrolensArray(150e-6, 10e-3, count=(51, 57), fill="full"))
    got = camera.expose(PointSources(POINTS, diameter=10e-6)).to_numpy()
    expected = simulate_scene(POINTS, params=Camera(count=(51, 57), pixels_per_lenslet=10))
    assert relative_max(expected, got.astype(np.float64)) <= 3e-6


def test_double_precision(precise):
    camera = small(precise, mla=MicrolensArray(150e-6, 10e-3, count=(51, 57), fill="full"))
    got = camera.expose(PointSources(POINTS[:1], diameter=10e-6)).to_numpy()
    assert got.dtype == np.float32
    expected = simulate_scene(POINTS[:1], params=Camera(count=(51, 57), pixels_per_lenslet=10))
    # the rim of the aperture by 32 strips: 1.2e-4 of a rim sample, one sample in a thousand
    assert relative_max(expected, got.astype(np.float64)) <= 1e-6


def test_power_scales_each_source(device):
    camera = small(device, aperture_diameter=1.0e-3)
    one, two = (camera.expose(PointSources(p)).to_numpy() for p in POINTS[:2])
    both = camera.expose(PointSources(POINTS[:2], power=[2.0, 0.5])).to_numpy()
    np.testing.assert_allclose(both, 2 * one + 0.5 * two, atol=1e-6 * both.max())


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
def test_grid_covers_the_array(device, lattice):
    mla = MicrolensArray(150e-6, 10e-3, count=(12, 17), lattice=lattice)
    camera = small(device, mla=mla, pixels_per_lenslet=9.37, aperture_diameter=0.5e-3)
    pitch = 150e-6 / 9.37
    assert camera.pixel_pitch == pytest.approx(pitch)
    for n, length in zip(camera.grid.shape, mla.extent, strict=True):
        assert n * pitch >= length * (1 - 1e-9) > (n - 1) * pitch
    for n, o in zip(camera.grid.shape, camera.grid.origin, strict=True):
        assert o == (pitch / 2 if n % 2 == 0 else 0)


@pytest.mark.parametrize("rotation", [0, 0.1])
def test_sub_images_lie_on_chief_rays(device, rotation):
    mla = MicrolensArray(150e-6, 10e-3, count=(12, 17), rotation=rotation, offset=(20e-6, -9e-6))
    camera = small(device, mla=mla, aperture_diameter=0.5e-3)
    raw = camera.expose(PointSources((0, 0, 0)))
    grid = raw.sub_images
    i, k = 3, 11
    place = np.add(grid.first, np.multiply(i, grid.row_step)) + np.multiply(k, grid.column_step)
    expected = mla.centres()[i, k] * (1 + 10e-3 / 0.24)
    at = [
        np.interp(p, np.arange(n), axis)
        for p, n, axis in zip(place, camera.grid.shape, (camera.grid.y, camera.grid.x), strict=True)
    ]
    np.testing.assert_allclose(at, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, (0.24, 0.24)),
        ({"object_distance": 0.36}, (0.36, 0.18)),
        ({"image_distance": 0.18}, (0.36, 0.18)),
        ({"object_distance": 0.36, "image_distance": 0.18}, (0.36, 0.18)),
    ],
)
def test_distances(device, given, expected):
    camera = small(device, aperture_diameter=0.5e-3, **given)
    assert (camera.object_distance, camera.image_distance) == pytest.approx(expected)


def test_contradicting_distances(device):
    with pytest.raises(ValueError, match=r"contradict the lens law .* imaged at 0.18 m"):
        small(device, object_distance=0.36, image_distance=0.2)


def test_object_within_the_focal_length(device):
    with pytest.raises(ValueError, match="within the focal length"):
        small(device, object_distance=0.1)


def test_sampling_rule_says_what_would_do(device):
    camera = small(device, mla=MicrolensArray(150e-6, 2e-3, count=(27, 31), fill="full"))
    assert camera.pixels is not None  # they integrate: single points do not meet the rule
    with pytest.raises(SamplingError, match=r"cycles/m .*pixels_per_lenslet = .*method='local'"):
        camera.expose(PointSources((0, 0, 0)), method="points")


def test_sampling_rule_counts_the_image_position(device):
    camera = small(device, mla=MicrolensArray(150e-6, 10e-3, count=101, fill="full"))
    with pytest.raises(SamplingError, match=r"\|X\| = 0.007"):
        camera.expose(PointSources((7e-3, 0, 0)))


def test_less_than_two_pixels(device):
    with pytest.raises(SamplingError, match="at least 2"):
        small(device, pixels_per_lenslet=1.5)


def test_window_smaller_than_the_aperture(device):
    camera = small(device, mla=MicrolensArray(150e-6, 10e-3, count=9, fill="full"))
    with pytest.raises(SamplingError, match="does not hold the main lens' aperture"):
        camera.expose(PointSources((0, 0, 0)), method="points")


def test_point_beyond_the_array(device):
    camera = small(device, aperture_diameter=0.5e-3)
    with pytest.raises(SamplingError, match=r"imaged at .* beyond the array"):
        camera.expose(PointSources((3e-3, 0, 0)))


def test_point_behind_the_lens(device):
    with pytest.raises(ValueError, match="behind the main lens"):
        small(device, aperture_diameter=0.5e-3).expose(PointSources((0, 0, -0.25)))


def test_too_large_for_the_device(device, monkeypatch):
    camera = small(device, aperture_diameter=0.5e-3)
    monkeypatch.setattr(device, "memory_bytes", 10_000)
    with pytest.raises(DeviceError, match=r"needs [\d,]+ bytes"):
        camera.expose(PointSources((0, 0, 0)))


@pytest.mark.parametrize("name", ["focal_length", "wavelength", "aperture_diameter"])
def test_lengths_are_positive(device, name):
    with pytest.raises(ValueError, match=f"{name} is positive"):
        small(device, **{name: -1.0})


@pytest.mark.parametrize(
    ("args", "kwargs", "message"),
    [
        (([(0, 0)],), {}, r"\(x, y, dz\)"),
        (([],), {}, r"\(x, y, dz\)"),
        (([(0, 0, np.nan)],), {}, "finite"),
        (([(0, 0, 0)],), {"diameter": -1}, "not negative"),
        (([(0, 0, 0)],), {"power": [1, 2]}, "give one or each"),
        (([(0, 0, 0)],), {"power": -1}, "not negative"),
    ],
)
def test_bad_sources(args, kwargs, message):
    with pytest.raises(ValueError, match=message):
        PointSources(*args, **kwargs)


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
    assert camera.padding(PointSources((0, 0, 0))) == (1, 1)
    far = PointSources((1.2e-3, 0, 0.25))
    assert camera.padding(far)[0] == 2
    _, at_array, _ = camera_base.scene_energy(camera, far)[0]
    assert at_array > 0.998


def test_sampling_rule_counts_the_defocus(device):
    """A point near the lens sends light at (X - alpha u)/F: abs(alpha) grows without limit."""
    camera = small(device, aperture_diameter=1.8e-3)
    with pytest.raises(SamplingError, match="cycles/m"):
        camera.expose(PointSources((0, 0, -0.235)))


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
@pytest.mark.parametrize(
    "degrees", [30, *(pytest.param(d, marks=pytest.mark.thorough) for d in (0, 45))]
)
def test_turned_arrays_obey_the_shear_law(device, lattice, degrees):
    """Refocused on its true alpha a point is sharp, however the array is turned."""
    mla = MicrolensArray(
        150e-6, 10e-3, count=41, fill="full", lattice=lattice, rotation=np.deg2rad(degrees)
    )
    camera = small(device, mla=mla, pixels_per_lenslet=20)
    lf = LightField.from_raw(camera.expose(PointSources((0.1e-3, -0.2e-3, -0.05))))
    alpha = camera.alpha(-0.05)
    gain = refocus(lf, alpha=alpha).to_numpy().max() / lf.render().to_numpy().max()
    assert gain > (4.5 if lattice == "square" else 3.5)
    wrong = refocus(lf, alpha=2 - alpha).to_numpy().max()
    assert wrong < lf.render().to_numpy().max()
    assert estimate_alpha(lf, c_max=0.4).alpha == pytest.approx(alpha, abs=0.03)  # d = .316


def test_hexagonal_spacing_and_extent(device):
    mla = MicrolensArray(150e-6, 10e-3, count=(12, 17), lattice="hexagonal")
    camera = small(device, mla=mla, aperture_diameter=0.5e-3)
    lf = LightField.from_raw(camera.expose(PointSources((0, 0, 0))))
    rows = 150e-6 * np.sqrt(3) / 2
    step = camera.pixel_pitch * 24
    assert lf.spacing == pytest.approx((-step, -step, rows, 150e-6))
    assert mla.extent == pytest.approx((11 * rows + 2 * 150e-6 / np.sqrt(3), 17.5 * 150e-6))


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


class TestSensor:
    def raw(self, device):
        return small(device, aperture_diameter=1.8e-3).expose(PointSources((0, 0, 0)))

    def test_off_by_default(self, device):
        raw = self.raw(device)
        assert Sensor().record(raw) is raw

    def test_shot_noise_has_poisson_variance_and_a_seed(self, device):
        raw = self.raw(device)
        clean = raw.to_numpy().astype(np.float64) * 1e7
        noisy = Sensor(exposure=1e7, shot_noise=True, seed=3).record(raw).to_numpy()
        lit = clean > 50
        z = (noisy[lit] - clean[lit]) / np.sqrt(clean[lit])
        assert lit.sum() > 500
        assert z.std() == pytest.approx(1, abs=5 / np.sqrt(2 * lit.sum()))
        again = Sensor(exposure=1e7, shot_noise=True, seed=3).record(raw).to_numpy()
        np.testing.assert_array_equal(noisy, again)
        other = Sensor(exposure=1e7, shot_noise=True, seed=4).record(raw).to_numpy()
        assert (noisy != other).any()

    def test_read_noise_saturation_and_bits(self, device):
        raw = self.raw(device)
        out = Sensor(exposure=1e6, read_noise=2.0, full_well=1000, bit_depth=8).record(raw)
        values = out.to_numpy()
        np.testing.assert_array_equal(values, np.rint(values))
        assert values.min() == 0
        assert values.max() == 255

    def test_saturation_in_electrons(self, device):
        raw = self.raw(device)
        clean = raw.to_numpy().astype(np.float64) * 1e6
        full = Sensor(exposure=1e6, full_well=500).record(raw).to_numpy()
        assert clean.max() > 1000
        np.testing.assert_allclose(full, np.minimum(clean, 500), rtol=1e-6)

    def test_read_noise_has_its_deviation(self, device):
        raw = self.raw(device)
        clean = raw.to_numpy().astype(np.float64) * 1e6
        noise = Sensor(exposure=1e6, read_noise=3.0).record(raw).to_numpy() - clean
        assert noise.std() == pytest.approx(3.0, rel=5 / np.sqrt(2 * noise.size))

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"exposure": 1e6, "full_well": 9, "bit_depth": 8.5}, "whole number"),
            ({"seed": -1}, "seed is a whole number"),
            ({"exposure": -1}, "exposure is a positive"),
            ({"shot_noise": True}, "need exposure"),
            ({"exposure": 1e6, "bit_depth": 8}, "bit_depth needs full_well"),
            ({"exposure": 1e6, "bit_depth": 40, "full_well": 1}, "between 1 and 24"),
            ({"exposure": 1e6, "read_noise": -1}, "read_noise is not negative"),
        ],
    )
    def test_bad_values(self, change, message):
        with pytest.raises(ValueError, match=message):
            Sensor(**change)
