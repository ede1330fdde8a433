"""Flattening: statistics over views, weights, masks, what lies in front."""

from __future__ import annotations

import numpy as np
import pytest
from reference_lightfield import refocus as twin_refocus
from reference_render import along_rays as sampled
from reference_render import statistic, steps
from tolerance import relative_max

from clplen.errors import ShapeError
from clplen.lightfield.model.apertures import disc, gaussian
from clplen.lightfield.model.light_field import LightField


def light_field(device, shape=(5, 4, 7, 13), dtype=np.float32):
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    w = np.random.default_rng(4).uniform(0.3, 1.5, shape[:2]).astype(np.float32)
    w[2, 3] = 0
    return a, w.astype(float), LightField.from_array(a, device=device, weights=w)


def test_the_mean_is_the_refocused_picture(device):
    a, w, lf = light_field(device)
    want = twin_refocus(a.astype(float), 1.3, weights=w)
    assert relative_max(want, lf.flatten(disparity=1.3).to_numpy().astype(float)) <= 1e-5
    everything = np.ones(a.shape, bool)
    masked = lf.flatten(disparity=1.3, mask=everything).to_numpy().astype(float)
    assert relative_max(want, masked) <= 1e-5


def test_an_aperture_weighs_the_views(device):
    a, w, lf = light_field(device)
    shape = disc(lf.shape, 1.4) * gaussian(lf.shape, 1.0)
    got = lf.flatten("median", aperture=shape).to_numpy().astype(float)
    want = statistic("median", *sampled(a, 0.0, weights=w * shape, step=steps(a.shape[:2])))
    assert relative_max(want, got) <= 1e-5


def test_the_median_sees_around_a_wire(device):
    """A bright wire 1 pixel wide at d = 2.4 before a ground at 0: the median shows the ground."""
    y, x = np.mgrid[:12, :29]
    ground = 50 + 3.0 * y + np.zeros_like(x)
    a = np.repeat(ground[None], 9, axis=0)[None]
    for u in range(9):
        a[0, u, :, round(14 - 2.4 * (u - 4))] = 250
    lf = LightField.from_array(a.astype(np.float32), device=device)
    median, mean, largest = (lf.flatten(mode).to_numpy() for mode in ("median", "mean", "max"))
    np.testing.assert_array_equal(median, ground)
    assert np.abs(mean - ground).max() > 15
    assert (largest == 250).any()
    spread = lf.flatten("variance").to_numpy()
    assert spread[:, 14].min() > 100 > spread[:, 13].max()


def test_bad_words_are_refused(device):
    a, _, lf = light_field(device)
    with pytest.raises(ValueError, match="'mean', 'variance', 'median', 'max', 'min', got 'mode'"):
        lf.flatten("mode")
    with pytest.raises(ShapeError, match=r"one value per ray, shape \(5, 4, 7, 13\), got \(5, 4\)"):
        lf.flatten("median", mask=np.ones((5, 4)))
    with pytest.raises(ValueError, match="'linear' or 'nearest', got 'cubic'"):
        lf.flatten("mean", mask=np.ones(a.shape), interpolation="cubic")
    many = LightField.from_array(np.ones((33, 32, 1, 1), np.uint8), device=device)
    with pytest.raises(ValueError, match="A median takes at most 1024 views, got 1056"):
        many.flatten("median")
