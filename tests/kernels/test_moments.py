"""moments.cl (with sheared.cl) and colours.cl against float64 twins."""

from __future__ import annotations

import numpy as np
import pytest
from reference_cues import grid_steps, moments
from reference_lightfield import refocus

from clplen.lightfield.depth.correspondence_cue import shear_moments
from clplen.lightfield.depth.sheared_views import add_colours
from clplen.lightfield.model.light_field import LightField

EPS = 2.0**-24
PLANES = np.array([0.3, -1.0, 2.75, 0.0])


def field(shape, dtype, seed=1):
    """Samples far from 0 beside their spread, a gradient and noise."""
    random = np.random.default_rng(seed)
    values = (
        100 + 20 * random.random(shape) + np.arange(shape[3]).reshape(-1, *(1,) * len(shape[4:]))
    )
    return values.astype(dtype)


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [
        ((3, 2, 5, 37), np.float32),
        ((1, 4, 6, 19, 3), np.uint8),
        ((4, 1, 7, 5), np.uint16),
        ((2, 3, 2, 40, 2), np.float16),
    ],
)
def test_moments(device, shape, dtype):
    L = field(shape, dtype)
    weights = np.random.default_rng(2).random(shape[:2]).astype(np.float32) + 0.1
    if weights.size > 4:
        weights[0, -1] = 0
    lf = LightField.from_array(L, device=device, weights=weights)
    mean_map, variance_map = shear_moments(lf, PLANES)
    colours = L.reshape(*shape[:4], -1).astype(np.float64)
    for p, d in enumerate(PLANES):
        mean, variance = moments(colours, d, weights.astype(float), grid_steps(shape[:2]))
        got = device.download(mean_map)[p].reshape(mean.shape)
        # values, less the pivot, up to 60: a rounding in each of 4 mixes and each sum over views
        wrong = (8 + L.shape[0] * L.shape[1]) * EPS * 60 + EPS * 160
        assert np.abs(got - mean).max() <= wrong
        got = device.download(variance_map)[p].reshape(mean.shape)
        assert np.abs(got - variance).max() <= 2 * 60 * wrong + 1e-10 * 160**2
        plain = refocus(colours, d, weights=weights)
        assert np.abs(mean - plain).max() <= 1e-9  # the twin's mean is the refocused picture


def test_views_on_no_grid(device):
    L = field((2, 3, 9, 21), np.float32)
    positions = np.random.default_rng(3).normal(0, 1.5, (2, 3, 2))
    lf = LightField.from_array(
        L, device=device, positions=positions, spacing=(2e-3, -1e-3, 5e-4, 1e-3)
    )
    mean_map, variance_map = shear_moments(lf, np.array([0.8]))
    # (dv/dy)/(du/dx) = 4/-1 of the disparity along y
    steps = -positions * [-4, 1]
    mean, variance = moments(L[..., None].astype(float), 0.8, np.ones((2, 3)), steps)
    assert np.abs(device.download(mean_map)[0] - mean[..., 0]).max() <= 1e-5 * 140
    assert np.abs(device.download(variance_map)[0] - variance[..., 0]).max() <= 1e-5 * 60**2


def test_a_small_spread_on_a_large_value(device):
    """S2 - S1^2 of float32 would be off by 1e-7 of the squared value: 500 times this variance."""
    random = np.random.default_rng(4)
    L = (60000 + random.integers(-1, 2, (3, 3, 6, 20))).astype(np.uint16)
    _, variance_map = shear_moments(LightField.from_array(L, device=device), np.array([0.0]))
    variance = L.reshape(9, 6, 20).astype(float).var(axis=0)
    wanted = np.where(variance > 1e-10 * 60000**2, variance, 0)
    assert np.abs(device.download(variance_map)[0] - wanted).max() <= 1e-5


def test_equal_views_have_no_variance(device):
    L = np.full((3, 3, 6, 20), 0.3, np.float32)
    for d in (0.0, 0.37):
        _, variance_map = shear_moments(LightField.from_array(L, device=device), np.array([d]))
        assert not device.download(variance_map).any()


def test_colours_are_added(device):
    maps = np.random.default_rng(5).random((2, 3, 37, 3)).astype(np.float32)
    got = device.download(add_colours(device.upload(maps), device))
    np.testing.assert_allclose(got, maps.astype(float).sum(axis=-1), rtol=3 * EPS)
    one = device.upload(maps[..., :1].copy())
    np.testing.assert_array_equal(device.download(add_colours(one, device)), maps[..., 0])
