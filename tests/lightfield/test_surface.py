"""Focus on tilted and curved surfaces, and other interpolations of one plane."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import along_rays as sampled
from reference_render import phase_ramps, statistic, steps
from tolerance import relative_max

from clplen.errors import ShapeError
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import plane_through
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

SPACING = (-3e-4, -2e-4, 1e-4, 1.5e-4)  # d along y is 2.25 times d along x


def light_field(device, shape=(5, 4, 9, 14), dtype=np.float32, **more):
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    w = np.random.default_rng(4).uniform(0.3, 1.5, shape[:2]).astype(np.float32)
    w[2, 3 % shape[1]] = 0
    return a, w.astype(float), LightField.from_array(a, device=device, weights=w, **more)


def test_a_plane_meets_its_points():
    points = [(3, 4, 0.5), (11, 2, -0.25), (7, 15, 1.0)]
    plane = plane_through(points, (13, 17, 3))
    assert plane.shape == (13, 17)
    for y, x, d in points:
        assert plane[y, x] == pytest.approx(d, abs=1e-12)
    np.testing.assert_allclose(np.diff(plane, 2, axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.diff(plane, 2, axis=1), 0, atol=1e-12)


def test_more_points_by_least_squares():
    y, x = np.mgrid[:3, :4] * 5
    d = 0.3 - 0.02 * y + 0.01 * x
    noisy = d + np.array([[1, -1, -1, 1], [-2, 2, 2, -2], [1, -1, -1, 1]]) * 0.01  # orthogonal
    plane = plane_through(np.stack((y, x, noisy), axis=-1).reshape(-1, 3), (12, 18))
    np.testing.assert_allclose(plane[y, x], d, atol=1e-12)


def test_no_plane():
    for points, error, words in (
        ([(0, 0, 1), (1, 1, 2)], ShapeError, "n >= 3"),
        ([(0, 0, 1), (1, 1, 2), (2, 2, 3)], ValueError, "lie on one line"),
        ([(2, 2, 1)] * 3, ValueError, "lie on one line"),
        ([(0, 0, 1), (1, 1, 2), (2, 1, np.nan)], ValueError, "must be finite"),
    ):
        with pytest.raises(error, match=words):
            plane_through(points, (9, 9))


def test_a_surface_in_alphas(device):
    _, _, lf = light_field(device, spacing=SPACING)
    d = np.linspace(-0.5, 0.5, 9 * 14).reshape(9, 14)
    got = refocus(lf, alpha=lf.alpha(d)).to_numpy()
    np.testing.assert_allclose(got, refocus(lf, disparity=d).to_numpy(), rtol=1e-5)


@pytest.mark.parametrize(
    ("interpolation", "shape"),
    [("nearest", (5, 4, 9, 14)), ("cubic", (3, 4, 5, 7, 3)), ("fourier", (5, 4, 9, 14))],
)
def test_interpolations(device, interpolation, shape):
    a, w, lf = light_field(device, shape)
    for d in (0.0, -0.65, 1.5):
        got = refocus(lf, disparity=d, interpolation=interpolation).to_numpy().astype(float)
        if interpolation == "fourier":
            want = phase_ramps(a, d, weights=w, step=steps(shape[:2]))
        else:
            parts = sampled(a, d, weights=w, step=steps(shape[:2]), interpolation=interpolation)
            want = statistic("mean", *parts)
        assert relative_max(want, got) <= 1e-5
    stack = focal_stack(lf, disparities=[0.2, d], interpolation=interpolation)
    np.testing.assert_allclose(stack.to_numpy()[1], got, rtol=1e-6, atol=1e-4)
    assert stack.weights is None


def test_options_that_do_not_go_together(device):
    _, _, lf = light_field(device, spacing=SPACING)
    surface = np.zeros((9, 14))
    for more in ({"rescale": True}, {"upsample": 2}, {"interpolation": "fourier"}):
        with pytest.raises(ValueError, match="A per-pixel disparity cannot be combined"):
            refocus(lf, disparity=surface, **more)
    for more in ({"rescale": True}, {"interpolation": "cubic"}):
        with pytest.raises(ValueError, match="upsample cannot be combined"):
            refocus(lf, disparity=0.5, upsample=2, **more)
    with pytest.raises(ValueError, match="'cubic' or 'fourier', got 'sinc'"):
        focal_stack(lf, disparities=[0.5], interpolation="sinc")
    with pytest.raises(ShapeError, match=r"shape \(9, 14\), got shape \(14, 9\)"):
        refocus(lf, disparity=surface.T)
    with pytest.raises(ValueError, match="refocus needs a single plane"):
        refocus(lf, disparity=[0.0, 1.0])
