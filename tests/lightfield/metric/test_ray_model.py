"""Rays and pixels of a light-field camera: beside a general solver, and differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import fsolve

from clplen.errors import ShapeError
from clplen.lightfield import Intrinsics, metric_depth
from clplen.lightfield.metric.bundle_adjustment import placed
from clplen.lightfield.metric.ray_model import (
    PARAMETERS,
    distorted,
    matrix_of,
    parameters_of,
    pixels_and_slopes,
    pixels_of,
    undistorted,
)

SHAPE = (5, 4, 48, 65)
KNOWN = np.array(
    [
        *(2e-3, 2.1e-3, -2e-3, -1.9e-3, 3.6e-3, 3.5e-3, 0.01, -0.02, 0.01, -0.02),
        *(0.003, -0.002, -0.2, 0.05, 0.01),
    ]
)


@pytest.fixture
def camera() -> Intrinsics:
    return Intrinsics(matrix_of(KNOWN, SHAPE), KNOWN[10:], SHAPE)


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(7, 3)) * 0.05 + (0.01, -0.02, 0.5)


def test_pixels_are_those_whose_rays_meet_the_points(camera: Intrinsics, points: np.ndarray):
    pixels = camera.project(points)
    assert pixels.shape == (5, 4, 7, 2)
    for v, u, n in ((0, 0, 0), (4, 1, 3), (2, 3, 6)):

        def missed(at: np.ndarray, v: int = v, u: int = u, n: int = n) -> np.ndarray:
            s, t, a, b, _ = camera.matrix @ (u, v, at[1], at[0], 1.0)
            straight = fsolve(lambda d: distorted(d, camera.distortion)[0] - (a, b), (a, b))
            return points[n, :2] - (s, t) - points[n, 2] * straight

        wanted = fsolve(missed, (24.0, 32.0), xtol=1e-12)
        np.testing.assert_allclose(pixels[v, u, n], wanted, atol=1e-7)


def test_rays_are_the_inverse_of_pixels(camera: Intrinsics, points: np.ndarray):
    j, i = np.mgrid[:5, :4][:, :, :, None]
    y, x = np.moveaxis(camera.project(points), -1, 0)
    rays = camera.rays(i, j, x, y)
    met = rays[..., :2] + points[:, 2:] * rays[..., 2:]
    np.testing.assert_allclose(met, np.broadcast_to(points[:, :2], met.shape), atol=1e-13)


def test_derivatives_are_those_of_differences(points: np.ndarray):
    views = np.array([[-1.5, 2.0], [0.5, -1.0], [1.5, 0.0]])
    _, by_parameters, by_points = pixels_and_slopes(KNOWN, views, points)
    for n, name in enumerate(PARAMETERS):
        step = np.zeros(15)
        step[n] = 1e-5 * max(abs(KNOWN[n]), 1e-2)
        up, down = (pixels_of(KNOWN + way * step, views, points) for way in (1, -1))
        found = (up - down) / (2 * step[n])
        scale = np.abs(found).max()
        np.testing.assert_allclose(by_parameters[..., n], found, atol=2e-4 * scale, err_msg=name)
    for n in range(3):
        step = 1e-6 * np.eye(3)[n]
        up, down = (pixels_of(KNOWN, views, points + way * step) for way in (1, -1))
        np.testing.assert_allclose(by_points[..., n], (up - down) / 2e-6, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("turn", [(0.3, -0.5, 0.2), (1e-12, 0.0, 0.0)])
def test_derivatives_of_poses(turn: tuple[float, float, float], points: np.ndarray):
    pose = np.array([*turn, 0.1, -0.2, 0.5])
    slope = placed(points, pose)[1]
    for n in range(6):
        step = 1e-6 * np.eye(6)[n]
        up, down = (placed(points, pose + way * step)[0] for way in (1, -1))
        np.testing.assert_allclose(slope[..., n], (up - down) / 2e-6, atol=1e-8)


def test_distortion_is_taken_away():
    direction = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    there = distorted(direction, KNOWN[10:])[0]
    assert np.abs(there - direction).max() > 0.01
    np.testing.assert_allclose(undistorted(there, KNOWN[10:]), direction, atol=1e-12)
    folded = undistorted(np.array([[3.0, 0.0]]), np.array([0, 0, -0.2, 0, 0.0]))
    assert np.isnan(folded).all()


def test_matrix_and_parameters_are_inverse(camera: Intrinsics):
    found = parameters_of(camera.matrix, camera.distortion, SHAPE)
    np.testing.assert_allclose(found, KNOWN, atol=1e-15)
    middle = camera.matrix @ (1.5, 2, 32, 23.5, 1)
    np.testing.assert_allclose(middle, (0, 0, 0.01, -0.02, 1), atol=1e-15)


def test_disparity_and_depth(camera: Intrinsics):
    z = np.array([0.2, 0.5, 3.0, np.inf])
    d = camera.disparity(z)
    assert (np.diff(d) < 0).all()
    np.testing.assert_allclose(camera.depth(d), z, rtol=1e-12)
    assert np.isnan(camera.depth([d[-1] - 0.1, np.nan])).all()
    straight = Intrinsics(camera.matrix, np.zeros(5), SHAPE)
    row = straight.project([(0, 0, 0.5)])[2, :, 0, 1]
    np.testing.assert_allclose(np.diff(row), -straight.disparity(0.5), rtol=1e-9)
    with pytest.raises(ValueError, match="z must be positive"):
        camera.disparity([0.3, -1.0])


def test_rectified_intrinsics_and_lengths_say_the_same(camera: Intrinsics):
    flat = camera.rectified
    H = flat.matrix
    assert H[2, 2] == H[3, 3] == pytest.approx(np.sqrt(3.6e-3 * 3.5e-3))
    assert H[0, 2] == H[1, 3] == 0
    z = np.array([0.2, 0.7, 4.0])
    np.testing.assert_allclose(metric_depth(flat.disparity(z), **camera.lengths), z, rtol=1e-12)
    down = flat.project([(0, 0, 0.7)])
    assert np.ptp(down[2, :, 0, 0]) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(  # steps of 2.1 and 2.0 mm
        np.diff(down[:, 0, 0, 0])[0] / np.diff(down[0, :, 0, 1])[0], 2.1 / 2.0, rtol=1e-9
    )


def test_what_is_no_camera_is_refused(camera: Intrinsics):
    for name, at, value, message in (
        ("matrix", (0, 1), 1.0, "H12 must be 0, got 1"),
        ("matrix", (0, 4), 1.0, "H15 must be .* got 1"),
        ("matrix", (2, 2), -1.0, "H33 and H44, directions a pixel, must be positive"),
        ("matrix", (1, 1), 0.0, "H11 and H22, metres between views, must be other than 0"),
        ("matrix", (3, 3), np.nan, "matrix must be finite"),
        ("distortion", (2,), np.inf, "distortion must be finite"),
    ):
        values = {"matrix": camera.matrix.copy(), "distortion": camera.distortion.copy()}
        values[name][at] = value
        with pytest.raises(ValueError, match=message):
            Intrinsics(values["matrix"], values["distortion"], SHAPE)
    with pytest.raises(ShapeError, match=r"matrix must have shape \(5, 5\), got \(4, 5\)"):
        Intrinsics(camera.matrix[:4], camera.distortion, SHAPE)
    with pytest.raises(ShapeError, match=r"shape \(n, 3\), got \(3,\)"):
        camera.project((0.0, 0.0, 1.0))
    assert np.isnan(camera.project([(0, 0, -1.0)])).all()
