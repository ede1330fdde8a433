"""Depth of views whose brightness differs, and what their detail is."""

from __future__ import annotations

import hard_scenes
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clplen import LightField, depth_map
from clplen.compute.device import Device
from clplen.lightfield.depth.combined_cue import LevelSurvey
from clplen.lightfield.depth.view_detail import is_even, view_detail
from clplen.lightfield.depth.view_matching import group_views

BORDER = (slice(15, -15), slice(15, -15))
# BadPix(.07) in per cent that the default may have, twice what it has.
MOST = {
    "brightness of views": 3.6,
    "faint walls, shading": 16.0,
    "flat checkerboard, shading": 0.1,
    "repeated texture": 3.4,
    "thin bars": 24.0,
    "vignetting": 3.6,
}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("colours", [(), (3,)])
def test_detail_is_what_a_gaussian_leaves(device: Device, dtype: type, colours: tuple[int, ...]):
    random = np.random.default_rng(3)
    samples = random.random((2, 3, 21, 34, *colours))
    if dtype is not np.float32:
        samples = samples * np.iinfo(dtype).max
    samples = samples.astype(dtype)
    lf = LightField.from_array(samples, device=device)
    gain = 255 / float(samples.max())
    gains = np.array([[gain, gain, 0], [gain / 2, gain, gain]])
    found = (view_detail(lf, gains).to_numpy().astype(np.float64) - 2**15) / 64
    sd = (0, 0, 2, 2, *(0,) * len(colours))
    values = samples.astype(np.float64)
    detail = values - gaussian_filter(values, sd, mode="nearest")
    expected = gains.reshape(2, 3, *(1,) * (values.ndim - 2)) * detail
    assert found.shape == samples.shape
    np.testing.assert_allclose(found, expected, atol=0.5 / 64 + 1e-3)  # rounding, float32


def test_where_samples_are_believed():
    """Where costs agree; beside an outline if they lie between its sides."""
    shape = (40, 60)
    costs = np.full(shape, 2.0, np.float32), np.full(shape, 2.0, np.float32)
    disparities = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    assert is_even(costs, disparities, 1).all()
    brighter = costs[0] + 0.5
    assert not is_even((brighter, costs[1]), disparities, 1).any()
    sides = np.zeros(shape, np.float32)
    sides[:, 30:] = 1.0
    even = is_even((brighter, costs[1]), (sides, sides), 1)
    assert even[:, 25:35].all()
    assert not even[:, :20].any()
    outside = np.full(shape, 2.0, np.float32)
    assert not is_even((brighter, costs[1]), (outside, sides), 1).any()
    assert not is_even((brighter + 2, costs[1]), (sides, sides), 1).any()


@pytest.mark.thorough
@pytest.mark.parametrize("name", MOST)
def test_the_default_is_not_worse_than_the_sharpest_plane(device: Device, name: str):
    scene = next(hard_scenes.hard_scenes((96, 120), device=device, only=name))
    lf = LightField.from_array(scene.samples, device=device)

    def bad(cue: str | None) -> float:
        error = np.abs(depth_map(lf, disparities=scene.planes, cue=cue).disparity - scene.disparity)
        return 100 * float((error[BORDER] > 0.07).mean())

    found = bad(None)
    assert found <= 1.02 * bad("energy") + 0.3  # 17 pixels of 66 x 90
    assert found <= MOST[name]


def test_one_black_view_leaves_vignetting_to_be_evened(device: Device):
    scene = next(hard_scenes.hard_scenes((40, 50), device=device, only="vignetting"))
    samples = scene.samples.copy()
    lf = LightField.from_array(samples, device=device)
    survey = LevelSurvey(lf)
    survey.add(slice(0, 40), lf)
    whole = survey.finish().even
    samples[0, 0] *= 0.01
    lf = LightField.from_array(samples, device=device)
    survey = LevelSurvey(lf)
    survey.add(slice(0, 40), lf)
    found = survey.finish().even
    dark = np.flatnonzero(group_views(lf).view == 0)[0]
    assert whole.max() > 1.1
    assert found[dark] == 1
    np.testing.assert_allclose(np.delete(found, dark), np.delete(whole, dark), rtol=0.02)
