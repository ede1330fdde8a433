"""estimate_alpha on raw images of an independent simulation, and on analytic light fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
import reference_camera
from reference_lightfield import thesis_alpha
from scipy.special import j1

from clplen.errors import SamplingWarning
from clplen.lightfield.depth.alpha_estimate import estimate_alpha
from clplen.lightfield.depth.camera_optics import LensletBlur, disc_ambiguity, interval_ambiguity
from clplen.lightfield.depth.spectral_sharpness import sharpness
from clplen.lightfield.depth.window_measures import read_window
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage

OPTICS = reference_camera.Camera(count=(31, 35))  # narrow: enough for one point near the axis
TOLERANCE = OPTICS.pitch / OPTICS.aperture_diameter  # p/D
KAPPA = 0.889
DEPTHS = (-0.05, 0.0, 0.05)


@dataclass(frozen=True)
class Model:
    """What estimate_alpha asks of a camera."""

    kind: str = "standard"
    image_distance: float = OPTICS.image_distance
    aperture_diameter: float = OPTICS.aperture_diameter
    pixel_pitch: float = OPTICS.pixel
    wavelength: float = OPTICS.wavelength
    lenslet_pitch: float = OPTICS.pitch
    lenslet_diameter: float = OPTICS.pitch
    lenslet_focal_length: float = OPTICS.f_mu
    lenslet_fill: str = "full"
    lenslet_lattice: str = "square"

    def alpha(self, dz: float) -> float:
        return OPTICS.alpha(dz)

    def dz(self, alpha: float) -> float:
        return 1 / (1 / OPTICS.focal_length - alpha / self.image_distance) - OPTICS.object_distance


def centres(count: tuple[int, int], shape: tuple[int, int], step: float) -> LensletGrid:
    first = tuple((n - 1) / 2 - (k - 1) / 2 * step for n, k in zip(shape, count, strict=True))
    n = OPTICS.pixels_per_lenslet
    return LensletGrid(count, (n, n), first, (step, 0.0), (0.0, step))


@pytest.fixture(scope="module")
def images() -> dict[float, np.ndarray]:
    """Raw images of points half a millimetre off the axis."""
    points = {dz: (0.3e-3, -0.5e-3, dz) for dz in DEPTHS}
    return {
        dz: reference_camera.simulate_raw(*point, params=OPTICS) for dz, point in points.items()
    }


@pytest.fixture
def fields(device, images) -> dict[float, LightField]:
    n, shape = OPTICS.pixels_per_lenslet, OPTICS.shape
    du = OPTICS.pixel * OPTICS.image_distance / OPTICS.f_mu
    spacing = (-du, -du, OPTICS.pitch, OPTICS.pitch)
    wide = centres(OPTICS.count, shape, n * (1 + OPTICS.f_mu / OPTICS.image_distance))
    cells = centres(OPTICS.count, shape, n)
    return {
        dz: LightField.from_raw(
            RawImage(
                device.upload(image.astype(np.float32)),
                device,
                OPTICS.pixel,
                wide,
                cells,
                spacing,
                Model(),
            )
        )
        for dz, image in images.items()
    }


@pytest.mark.parametrize("dz", [-0.05, 0.05])
def test_compensated(fields, dz):
    found = estimate_alpha(fields[dz])
    assert found.alpha == pytest.approx(OPTICS.alpha(dz), abs=0.010)
    assert found.z == pytest.approx(Model().dz(found.alpha))
    assert not found.in_focus
    # the standard deviation at 4 and at 6 lenslets of blur; test_uncertainty.py holds it true
    assert found.uncertainty == pytest.approx(0.06 * TOLERANCE, rel=0.1)
    assert found.bias == 0
    assert found.disparity == pytest.approx(0.8 * (1 - found.alpha))
    assert np.all(np.diff(found.curve[0]) > 0)
    assert abs(found.curve[0][np.argmax(found.curve[1])] - found.alpha) < 0.02
    np.testing.assert_allclose(found.disparities, 0.8 * (1 - found.curve[0]), atol=1e-12)


@pytest.mark.parametrize("dz", [-0.05, 0.05])
def test_energy_is_pulled_towards_focus(fields, dz):
    truth = OPTICS.alpha(dz)
    found = estimate_alpha(fields[dz], method="energy")
    assert found.alpha == pytest.approx(truth, abs=0.030)
    assert (found.alpha - 1) / (truth - 1) == pytest.approx(KAPPA, abs=0.04)
    assert (found.alpha - found.bias - 1) * KAPPA == pytest.approx(found.alpha - 1, rel=5e-4)
    assert found.alpha - found.bias == pytest.approx(truth, abs=0.010)
    assert found.uncertainty == pytest.approx(0.08 * TOLERANCE, rel=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize("dz", [-0.05, 0.05])
def test_thesis_equals_its_twin(fields, images, dz):
    found = estimate_alpha(fields[dz], method="thesis", at=(15, 17))
    expected = thesis_alpha(images[dz], OPTICS.pixels_per_lenslet, near=(17, 15))
    assert found.alpha == pytest.approx(expected, abs=1e-12)
    assert math.isnan(found.uncertainty)
    assert found.curve[0].shape == found.curve[1].shape == (121,)


def test_in_focus(fields):
    found = estimate_alpha(fields[0.0])
    energy = estimate_alpha(fields[0.0], method="energy")
    assert found.in_focus
    assert energy.in_focus
    assert found.alpha == pytest.approx(1, abs=TOLERANCE)
    assert found.alpha - 1 == pytest.approx((energy.alpha - 1) / KAPPA, rel=1e-3)
    assert found.uncertainty == pytest.approx(energy.uncertainty, rel=1e-6)
    # anywhere within a blur of one lenslet: p/(sqrt(3) D) = .58 p/D if all were alike
    assert found.uncertainty == pytest.approx(0.54 * TOLERANCE, rel=0.01)
    assert found.disparity == pytest.approx(0.8 * (1 - found.alpha))


def test_the_representation_names_the_depth(fields):
    estimate = estimate_alpha(fields[0.05])
    assert f"z={estimate.z:.6g}, " in repr(estimate)
    assert f"z_uncertainty={estimate.z_uncertainty:.6g}, " in repr(estimate)


def test_the_brightest_region_is_found(fields):
    for dz, lf in fields.items():
        # the image of (0.3, -0.5) mm, in lenslets
        x, y = (OPTICS.image_position(q, dz) / OPTICS.pitch for q in (0.3e-3, -0.5e-3))
        at = estimate_alpha(lf, method="energy").at
        assert at == pytest.approx((15 + y, 17 + x), abs=0.8)


@pytest.mark.parametrize(("colours", "at"), [((), (9, 1)), ((3,), (0, 12))])
def test_window(device, colours, at):
    rng = np.random.default_rng(6)
    values = rng.integers(1, 200, (2, 3, 11, 13, *colours)).astype(np.uint8)
    weights = rng.random((2, 3)).astype(np.float32)
    lf = LightField.from_array(values, device=device, weights=weights)
    framed = np.zeros((2, 3, 21, 23, *(colours or (1,))))
    framed[:, :, 5:16, 5:18] = values.reshape(2, 3, 11, 13, -1)
    framed *= weights[:, :, None, None, None]
    y, x = at
    want = np.moveaxis(framed[:, :, y : y + 11, x : x + 11], -1, 0)
    np.testing.assert_array_equal(read_window(lf, at, 11, fill=True), want)
    rows, columns = (np.flatnonzero(want.any(axis=axes)) for axes in ((0, 1, 2, 4), (0, 1, 2, 3)))
    clipped = want[..., rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    np.testing.assert_array_equal(read_window(lf, at, 11), clipped)


def test_search_that_misses_the_peak_says_so(fields):
    with pytest.warns(SamplingWarning, match=r"end of the search, disparity 0\.1 .*c_max=0\.2\."):
        found = estimate_alpha(fields[-0.05], c_max=0.1)
    assert found.disparity == pytest.approx(0.1)
    assert math.isnan(found.uncertainty)
    assert math.isnan(found.z_uncertainty)


def textured(shape: tuple[int, ...], dy: float, dx: float) -> np.ndarray:
    """Views of a plane whose points move by -dy and -dx pixels a view step; mean 3."""
    V, U, ny, nx = shape
    rng = np.random.default_rng(4)
    fy, fx = rng.uniform(-0.3, 0.3, (2, 40))
    phase = rng.uniform(0, 2 * np.pi, 40)
    y = np.arange(ny)[None, :] + dy * (np.arange(V)[:, None] - (V - 1) / 2)
    x = np.arange(nx)[None, :] + dx * (np.arange(U)[:, None] - (U - 1) / 2)
    wave_y = np.exp(2j * np.pi * fy * y[..., None] + 1j * phase)
    wave_x = np.exp(2j * np.pi * fx * x[..., None])
    return 3 + 0.1 * np.einsum("vyk,uxk->vuyx", wave_y, wave_x).real


def test_sharpness_by_the_sums_that_define_it():
    rng = np.random.default_rng(8)
    window, pad, d, aspect = rng.standard_normal((2, 3, 4, 7, 9)), 2, 0.37, 0.8
    blur = LensletBlur(q=8.1, fill=(0.9, 1.0), circular=False)
    _, V, U, ny, nx = window.shape
    expected = 0.0
    for j in range(-(ny + 4) // 2 + 1, (ny + 4) // 2 + 1):
        for i in range(-(nx + 4) // 2 + 1, (nx + 4) // 2 + 1):
            ky, kx = j / (ny + 2 * pad), i / (nx + 2 * pad)
            if not 0.1 <= math.hypot(ky, kx) <= 0.4:
                continue
            v, u = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
            y, x = np.arange(ny), np.arange(nx)
            phase = ky * (y[None, None, :, None] + aspect * d * v[:, None, None, None]) + kx * (
                x + d * u[None, :, None, None]
            )
            image = (window * np.exp(-2j * np.pi * phase)).sum(axis=(1, 2, 3, 4))
            h = 1.0
            for k, shear, fill in ((ky, aspect * d, 0.9), (kx, d, 1.0)):
                t = abs(8.1 * shear * k)
                h *= max(1 - t, 0) * np.sinc(k * fill * (1 - t))
            expected += np.sum(np.abs(image) ** 2) / max(abs(h), 0.05) ** 1.8
    measure = sharpness(window, pad=pad, band=(0.1, 0.4), aspect=aspect, blur=blur)
    assert measure(d) == pytest.approx(expected, rel=1e-11)


def test_ambiguity_functions():
    k, t = np.meshgrid(np.linspace(0.01, 2, 7), np.linspace(0, 1.2, 9))
    x = (np.arange(200000) + 0.5) / 200000 - 0.5
    for function, chord in (
        (interval_ambiguity, lambda s: (np.abs(s) < 0.5) * 1.0),
        (disc_ambiguity, lambda s: 8 / np.pi * np.sqrt(np.maximum(0.25 - s**2, 0))),
    ):
        expected = np.empty_like(k)
        for i in np.ndindex(k.shape):
            # the overlap of the aperture with itself moved by t is its narrower half at each x
            overlap = np.minimum(chord(x - t[i] / 2), chord(x + t[i] / 2))
            expected[i] = np.mean(overlap * np.cos(2 * np.pi * k[i] * x))
        np.testing.assert_allclose(function(k, t), expected, atol=2e-5)
    frequency = np.linspace(0.1, 3, 8)
    airy = 2 * j1(np.pi * frequency) / (np.pi * frequency)
    np.testing.assert_allclose(disc_ambiguity(frequency, 0 * frequency), airy, atol=1e-12)


def plain(device, **options) -> LightField:
    values = textured((5, 6, 23, 27), 0.2, 0.2).astype(np.float32)
    return LightField.from_array(values, device=device, **options)


def test_bad_input(device):
    for options, words in (
        ({"method": "sharpest"}, r"'compensated', 'energy', 'slope', 'thesis'.*'sharpest'"),
        ({"method": "compensated"}, r"spacing.*camera"),
        ({"method": "thesis"}, r"raw image"),
        ({"at": (3, 27)}, r"x < 27.*\(3, 27\)"),
        ({"at": (-1, 3)}, r"y < 23"),
        ({"at": (4, 3.5)}, r"at must be \(y, x\)"),
        ({"window": 20}, r"odd.*20"),
        ({"window": 7}, r"at least 9 lenslets, got 7"),
        ({"c_max": 0.0}, r"c_max must be between 0 and"),
        ({"c_max": 40.0}, r"c_max.*40"),
        ({"c_max": math.nan}, r"c_max.*nan"),
    ):
        with pytest.raises(ValueError, match=words):
            estimate_alpha(plain(device), **({"method": "energy"} | options))


def test_c_max_keeps_alpha_positive_and_the_band_open(device, fields):
    near_one = plain(device, spacing=(-1e-4, -1e-4, 1e-3, 1e-3))
    with pytest.raises(ValueError, match=r"between 0 and 0\.1 "):
        estimate_alpha(near_one, method="energy")
    with pytest.raises(ValueError, match=r"c_max must be between 0 and"):
        estimate_alpha(fields[0.05], c_max=0.95)
