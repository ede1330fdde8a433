"""warp.cl against a float64 twin: views of a picture, and gradients of a loss through them."""

from __future__ import annotations

import numpy as np
import pytest
from tolerance import relative_max

from clplen.lightfield.refocusing import view_warp
from clplen.lightfield.refocusing.view_warp import ViewWarp

SHAPES = [(3, 4, 7, 11), (2, 3, 7, 5, 3), (1, 5, 9, 2), (2, 3, 1, 19), (3, 2, 37, 3)]
STEP = 1e-7  # of central differences


def samples(shape, seed=3):
    """(picture, disparity, gradient of the views) of a light field."""
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(-2.3, 1.9, shape[2:4])
    given = rng.normal(size=shape[2:]), disparity, rng.normal(size=shape)
    return [np.float32(values) for values in given]


def twin(picture, disparity, steps):
    """Every view by linear interpolation at positions within the picture."""
    (ny, nx), views = disparity.shape, []
    picture = picture.astype(np.float64).reshape(ny, nx, -1)
    y, x = np.mgrid[:ny, :nx]
    for step in steps.reshape(-1, 2):
        py, px = np.clip(y + disparity * step[0], 0, ny - 1), np.clip(
            x + disparity * step[1], 0, nx - 1
        )  # fmt: skip
        i, j = np.floor(py).astype(int), np.floor(px).astype(int)
        b, a = (py - i)[..., None], (px - j)[..., None]
        below, beside = np.minimum(i + 1, ny - 1), np.minimum(j + 1, nx - 1)
        views.append(
            (1 - b) * ((1 - a) * picture[i, j] + a * picture[i, beside])
            + b * ((1 - a) * picture[below, j] + a * picture[below, beside])
        )
    return np.array(views)


@pytest.mark.parametrize("shape", SHAPES)
def test_views(device, shape):
    """Positions are off by the rounding of a shift of at most 5 pixels."""
    picture, disparity, _ = samples(shape)
    model = ViewWarp(shape, device=device)
    got = model.forward(picture, disparity).to_numpy()
    want = twin(picture, disparity.astype(float), model.steps).reshape(shape)
    assert relative_max(want, got) <= (5 + 2 * 5 + 8) * 2.0**-24


@pytest.mark.parametrize(
    ("shape", "band"), [((3, 4, 7, 11), 3), ((2, 3, 7, 5, 3), 32), ((3, 2, 37, 3), 3)]
)
def test_gradient_of_the_picture_is_the_transpose(device, shape, band, monkeypatch):
    monkeypatch.setattr(view_warp, "_BAND", band)
    picture, disparity, g = samples(shape)
    model = ViewWarp(shape, device=device)
    got = model.vjp(picture, disparity, g)[0]
    want, y = np.zeros(picture.size), np.eye(picture.size)
    d = disparity.astype(float)
    for k in range(picture.size):
        views = twin(y[k].reshape(picture.shape), d, model.steps)
        want[k] = np.vdot(views.reshape(shape), g.astype(float))
    assert got.shape == picture.shape
    assert relative_max(want.reshape(got.shape), got.astype(float)) <= 2e-6


@pytest.mark.parametrize("shape", SHAPES[:3])
def test_gradient_of_the_disparity(device, shape):
    picture, disparity, g = samples(shape)
    model = ViewWarp(shape, device=device)
    got = model.vjp(picture, disparity, g)[1]
    d = disparity.astype(float)
    change = [twin(picture, d + step, model.steps) for step in (STEP, -STEP)]
    slope = ((change[0] - change[1]) / (2 * STEP)).reshape(*shape[:4], -1)
    want = (slope * g.reshape(slope.shape)).sum(axis=(0, 1, 4))
    assert relative_max(want, got.astype(float)) <= 1e-5


def test_disparities_that_leave_the_picture(device):
    """All views see the corners, and no disparity changes anything."""
    shape, disparity = (2, 2, 5, 7), np.full((5, 7), 1e9)
    picture, _, g = samples(shape)
    model = ViewWarp(shape, device=device)
    got = model.forward(picture, disparity).to_numpy()
    np.testing.assert_array_equal(got[0, 1], np.full((5, 7), picture[0, -1]))
    of_picture, of_disparity = model.vjp(picture, disparity, g)
    assert not of_disparity.any()
    want = np.zeros((5, 7))
    want[[0, 0, -1, -1], [0, -1, 0, -1]] = g.sum(axis=(2, 3)).ravel()
    np.testing.assert_allclose(of_picture, want, rtol=1e-5, atol=1e-5)


def test_whole_positions_have_the_slope_towards_the_next_pixel(device):
    picture = np.arange(12.0).reshape(1, 12) ** 2
    model = ViewWarp((1, 3, 1, 12), device=device)
    g = np.zeros((1, 3, 1, 12))
    g[0, 2] = 1
    of_disparity = model.vjp(picture, np.full((1, 12), 2.0), g)[1]
    want = [2 * (x + 2) + 1 if x + 2 < 11 else 0 for x in range(12)]
    np.testing.assert_array_equal(of_disparity[0], want)
