"""Depth of views whose brightness differs, by the default cue."""

from __future__ import annotations

import hard_scenes
import numpy as np
import pytest

from clplen import LightField, depth_map
from clplen.compute.device import Device
from clplen.lightfield.depth.combined_cue import LevelSurvey
from clplen.lightfield.matching.view_detail import Surroundings, is_even
from clplen.lightfield.matching.view_matching import group_views

BORDER = (slice(15, -15), slice(15, -15))
# BadPix(.07) in per cent that the default may have, twice what it has.
MOST = {
    "brightness of views": 3.6,
    "flat checkerboard, shading": 0.1,
    "thin bars": 24.0,
    "vignetting": 3.6,
}


def test_where_samples_are_believed():
    """Near outlines where costs agree, or lie between the outline's sides; nowhere else."""
    shape = (40, 60)
    costs = np.full(shape, 2.0, np.float32), np.full(shape, 2.0, np.float32)
    sides = np.zeros(shape, np.float32)
    sides[:, 30:] = 1.0
    around = Surroundings.of(sides)
    near = around.near
    inside = np.flatnonzero(near[20, 6:-6]) + 6
    np.testing.assert_array_equal(inside, np.arange(24, 36))
    for edge in (near[:6], near[-6:], near[:, :6], near[:, -6:]):
        assert edge.all()
    assert (is_even(costs, sides, around, 1) == near).all()
    brighter = costs[0] + 0.5
    assert (is_even((brighter, costs[1]), sides, around, 1) == near).all()
    outside = np.full(shape, 2.0, np.float32)
    assert not is_even((brighter, costs[1]), outside, around, 1).any()
    assert not is_even((brighter + 2, costs[1]), sides, around, 1).any()
    # what samples cost elsewhere is not known, and does not count
    unknown = np.where(near, costs[0], np.float32(1e6))
    assert (is_even((unknown, costs[1]), sides, around, 1) == near).all()


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


def exposures(name: str) -> np.ndarray:
    """Views 30 % darker than their neighbours, shape (9, 9)."""
    gains = np.ones((9, 9), np.float32)
    if name == "rows by turns":
        gains[::2] = 0.7
    else:
        gains[4, 4] = 0.7
    return gains


def even_of(samples: np.ndarray, device: Device) -> np.ndarray:
    """What undoes the exposure of each view, those that are not compared 0."""
    lf = LightField.from_array(samples, device=device)
    survey = LevelSurvey(lf)
    survey.add(slice(0, samples.shape[2]), lf)
    found = np.zeros(81)
    found[group_views(lf).view] = survey.finish().even
    return found.reshape(9, 9)


@pytest.mark.parametrize("name", ["the middle", "rows by turns"])
def test_exposures_of_views_are_evened(device: Device, name: str):
    """As they are, 35 % of the pixels are bad with a dark middle, 18 % with rows by turns."""
    scene = next(hard_scenes.hard_scenes((60, 72), device=device, only="faint walls"))
    gains = exposures(name)
    uneven = scene.samples * gains[..., None, None]
    found = even_of(uneven, device)
    wanted = gains[4, 4] / gains
    np.testing.assert_allclose(found, np.where(found == 0, 0, wanted), rtol=0.03)
    bad = [
        100 * np.mean(np.abs(depth_map(a, disparities=scene.planes, device=device).disparity
                             - scene.disparity)[BORDER] > 0.07)
        for a in (scene.samples, uneven)
    ]  # fmt: skip
    assert bad[1] <= bad[0] + 1.0


def test_content_that_crosses_the_edges_is_no_exposure(device: Device):
    """A bright thing that half of the views do not see changes their brightness smoothly."""
    u = np.arange(9) - 4
    samples = np.full((9, 9, 40, 50), 0.3, np.float32)
    for i, k in np.ndindex(9, 9):
        samples[i, k, :, : 8 + 2 * int(u[k])] += 0.6
    ratio = samples.mean(axis=(2, 3))
    assert ratio.max() > 1.3 * ratio.min()
    assert set(even_of(samples, device).ravel()) <= {0.0, 1.0}
