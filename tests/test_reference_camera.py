"""The independent camera against the printed energies and first-order optics."""

from __future__ import annotations

import numpy as np
import pytest
from reference import decode_calibrated, decode_naive, microlens_array, thesis_alpha
from reference_camera import (
    Camera,
    array_phase,
    field_at_array,
    field_behind_lens,
    highest_frequency,
    simulate_raw,
    simulate_scene,
)

pytestmark = pytest.mark.nightly

SMALL = Camera(count=(51, 57), pixels_per_lenslet=10)
A = (-3e-3, -3e-3, -0.050)


def test_derived_numbers_of_the_thesis_system():
    camera = Camera()
    assert camera.object_distance == pytest.approx(0.240, rel=1e-12)
    assert camera.aperture_diameter == pytest.approx(3.6e-3, rel=1e-12)
    assert camera.pixel == pytest.approx(5e-6, rel=1e-12)
    assert camera.shape == (3030, 3030)
    assert camera.axes()[1][[0, -1]] == pytest.approx([-7.5725e-3, 7.5725e-3], rel=1e-12)
    for dz, alpha in ((-0.1, 0.285714), (-0.05, 0.736842), (0.05, 1.172414), (0.25, 1.510204)):
        assert camera.alpha(dz) == pytest.approx(alpha, abs=5e-7)
    assert camera.image_position(A[0], A[2]) == pytest.approx(3.79e-3, abs=5e-6)
    assert highest_frequency(camera, *A) == pytest.approx(58e3, rel=5e-3)


def test_array_phase_is_the_microlens_array():
    array = microlens_array(
        SMALL.shape, SMALL.pixel, pitch=SMALL.pitch, f=SMALL.f_mu, count=SMALL.count,
        wavelength=SMALL.wavelength, fill="full", origin=SMALL.origin,
    )  # fmt: skip
    assert np.abs(array - array_phase(SMALL)).max() < 1e-11


def test_energy_and_maximum_of_point_a():
    """Point A of the thesis system at full size: .99931 reaches the array, maximum 8.9e-4."""
    raw = simulate_raw(*A)
    assert raw.sum() == pytest.approx(0.99931, abs=5e-6)
    assert raw.max() / raw.sum() == pytest.approx(8.9e-4, abs=5e-6)


def test_energy_is_one_behind_the_lens_and_kept_from_array_to_sensor():
    point = (0.3e-3, -0.5e-3, 0.02)
    assert np.sum(np.abs(field_behind_lens(SMALL, *point)) ** 2) == pytest.approx(1, rel=1e-12)
    at_array = np.sum(np.abs(field_at_array(SMALL, *point)) ** 2)
    assert 0.997 < at_array < 1
    assert simulate_raw(*point, params=SMALL).sum() == pytest.approx(at_array, rel=1e-12)


@pytest.mark.parametrize("dz", [-0.05, 0.0, 0.05])
def test_light_lands_on_the_inverted_image_point(dz):
    point = (0.6e-3, -0.4e-3, dz)
    intensity = np.abs(field_at_array(SMALL, *point)) ** 2
    weight = intensity**2 / np.sum(intensity**2)
    y, x = SMALL.axes()
    assert weight.sum(axis=0) @ x == pytest.approx(SMALL.image_position(point[0], dz), abs=1.5e-5)
    assert weight.sum(axis=1) @ y == pytest.approx(SMALL.image_position(point[1], dz), abs=1.5e-5)


@pytest.mark.parametrize("dz", [-0.05, 0.05])
def test_shear_of_the_decoded_light_field(dz):
    """The line x = X - d (j - j_c) of (x, view), d = kappa (1 - alpha), nearer is larger.

    The blur of the sub-images attenuates the slope by up to a tenth, with weights I^2 and the
    middle of the sub-images only.
    """
    raw = simulate_raw(0.0, 0.0, dz, params=SMALL)
    lf = decode_calibrated(raw, 10, magnification=1 + SMALL.f_mu / SMALL.image_distance)
    lines = lf.sum(axis=(0, 2)) ** 2
    j, k = np.arange(10) - 4.5, np.arange(57) - 28
    used = np.abs(j) <= 2.5
    w = lines[used]
    jj, kk = np.meshgrid(j[used], k, indexing="ij")
    slope = np.sum(w * jj * kk) / np.sum(w * jj**2)
    kappa = SMALL.image_distance / (SMALL.f_mu * 10)
    assert -slope == pytest.approx(kappa * (1 - SMALL.alpha(dz)), rel=0.10)


def test_crosstalk_of_a_point_in_focus():
    """Energy outside the own cell, point on a lenslet centre: .106 with 51 lenslets."""
    raw = simulate_raw(0.0, 0.0, 0.0, params=SMALL)
    cells = decode_naive(raw, 10).sum(axis=(0, 1))
    assert 1 - cells[25, 28] / cells.sum() == pytest.approx(0.106, abs=0.004)


def test_a_scene_is_the_sum_of_its_points():
    camera = Camera(count=(25, 25), pixels_per_lenslet=10)
    points = [(0, 0, 0), (0.3e-3, 0, -0.01)]
    scene = simulate_scene(points, params=camera)
    parts = [simulate_raw(*point, params=camera) for point in points]
    assert np.array_equal(scene, parts[0] + parts[1])


def test_image_is_symmetric_and_transposes_with_the_point():
    camera = Camera(count=(31, 31), pixels_per_lenslet=10)
    raw = simulate_raw(0.0, 0.0, 0.02, params=camera)
    assert np.abs(raw - raw[::-1, ::-1]).max() < 1e-12 * raw.max()
    assert np.abs(raw - raw.T).max() < 1e-12 * raw.max()
    off = simulate_raw(0.4e-3, 0.0, 0.02, params=camera)
    turned = simulate_raw(0.0, 0.4e-3, 0.02, params=camera)
    assert np.abs(off - turned.T).max() < 1e-12 * off.max()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("dz", "printed"), [(-0.050, 0.820), (-0.025, 0.920), (0.025, 1.080), (0.050, 1.120)]
)
def test_thesis_alphas(dz, printed):
    raw = simulate_raw(0.0, 0.0, dz)
    assert thesis_alpha(raw, 30, near=(50, 50)) == pytest.approx(printed, abs=1e-9)
