"""The combined cue on scenes of exact disparity, and what must not change its map."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import Bars, Plane
from clplen.cameras.scenes.textures import noise
from clplen.lightfield.depth import combined_cue
from clplen.lightfield.depth.combined_cue import combined_disparity
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.matching import view_matching
from clplen.lightfield.model.light_field import LightField

PLANES = np.linspace(-1.5, 1.5, 31)
VIEWS, SHAPE = (7, 9), (64, 96)


def texture(seed=1, **more):
    return noise(seed, 128, **more)


def front(d=0.37, **more):
    return SurfaceScene(Plane(d, texture=texture(**more)))


SLANTED = SurfaceScene(Plane(0.1, (0.012, -0.006), texture=texture(2)))
BAR = SurfaceScene(
    [
        Plane(-0.6, texture=texture(3)),
        Plane(1.1, texture=texture(4), outline=Bars((0, 3), 200, count=1, period=30, width=9)),
    ]
)


def errors(scene, device, views=VIEWS, shape=SHAPE, planes=PLANES, **more):
    """(absolute errors, confidence, truth)."""
    lf, truth = scene.light_field(views, shape, device=device, **more)
    found, sure = combined_disparity(lf, planes)
    return np.abs(found - truth.disparity), sure, truth


@pytest.mark.parametrize("d", [-1.13, 0.05])
def test_in_front(device, d):
    e, sure, _ = errors(front(d), device)
    assert np.median(e) < 0.01
    assert (e > 0.03).mean() < 0.05
    assert (e > 0.07).mean() < 0.002
    assert np.median(sure) > 0.5


def test_behind_a_bar(device, monkeypatch):
    """Half apertures see past the bar what the whole aperture does not."""
    scene = BAR
    e, sure, truth = errors(scene, device)
    surer = sure > np.median(sure)
    assert (e[surer] > 0.07).mean() < 0.5 * (e > 0.07).mean()
    far = truth.masks["far"] & ~truth.masks["near"]
    assert (e > 0.07).mean() < 0.06
    assert np.median(e[far]) < 0.03
    bad = (e[far] > 0.07).mean()
    monkeypatch.setattr(view_matching, "RATIO", 1e3)  # all views only
    whole = (errors(scene, device)[0][far] > 0.07).mean()
    assert bad < 0.5 * whole, (bad, whole)


def test_scale_and_offset_of_samples(device):
    lf, _ = BAR.light_field(VIEWS, SHAPE, device=device, noise=0.01)
    want, sure = combined_disparity(lf, PLANES)
    samples = lf.to_numpy()
    for scale, offset in ((37.0, 0.0), (-1.0, 1.0)):
        other = LightField.from_array(samples * np.float32(scale) + np.float32(offset),
                                      device=device)  # fmt: skip
        found, known = combined_disparity(other, PLANES)
        # Where two planes are equally good, a rounding decides.
        off = np.abs(found - want) > 1e-3
        assert off.mean() < 1e-3, (scale, offset)
        assert np.median(np.abs(known - sure)) < 1e-3


@pytest.mark.parametrize("views", [(6, 8), (9, 1), (2, 9)])
def test_other_counts_of_views(device, views):
    e, sure, _ = errors(SLANTED, device, views=views)
    assert np.median(e) < 0.02
    assert (e > 0.07).mean() < 0.01
    assert np.median(sure) > 0.3


def test_one_view_tells_nothing(device):
    scene = front()
    lf, _ = scene.light_field((1, 1), (20, 24), device=device)
    with pytest.raises(ValueError, match=r"at least two views with a weight, got 1\.$"):
        depth_map(lf)
    pair, _ = scene.light_field((1, 2), (20, 24), device=device)
    blind = LightField.from_array(pair.data, device=device, weights=[[0, 1]])
    with pytest.raises(ValueError, match="at least two views"):
        combined_disparity(blind, PLANES)


def test_nothing_to_see(device):
    for level in (0.0, 0.5):
        lf = LightField.from_array(np.full((3, 5, 20, 24), level, np.float32), device=device)
        found, sure = combined_disparity(lf, PLANES)
        assert np.isfinite(found).all()
        assert (found >= PLANES[0]).all()
        assert (found <= PLANES[-1]).all()
        assert not sure.any()


def test_views_on_no_grid(device):
    """Views of a finer grid, some of them left out: their positions say where they are."""
    lf, _ = SLANTED.light_field((9, 11), SHAPE, device=device)
    v, u = np.array([0, 1, 4, 6, 8]), np.array([0, 3, 4, 5, 9, 10])
    steps = np.stack(np.meshgrid((v - 4) / 2, (u - 5) / 2, indexing="ij"), axis=-1)
    part = LightField.from_array(
        np.ascontiguousarray(lf.to_numpy()[v[:, None], u]), device=device, positions=steps
    )
    y, x = np.indices(SHAPE)
    truth = 2 * (0.1 + 0.012 * (y - 31.5) - 0.006 * (x - 47.5))  # a step is two views
    found, _ = combined_disparity(part, 2 * PLANES)
    assert np.median(np.abs(found - truth)) < 0.02
    assert (np.abs(found - truth) > 0.07).mean() < 0.01


def test_noise(device):
    e, sure, _ = errors(front(), device, noise=0.05)
    assert np.median(e) < 0.02
    assert (e > 0.07).mean() < 0.03
    quiet = errors(front(), device)[1]
    assert np.median(sure) < np.median(quiet)
    e, _, _ = errors(front(), device, noise=0.3)  # nowhere do all views agree
    assert (e > 0.07).mean() < 0.1


def test_vignetted_views(device):
    """Views that get darker towards the rim leave the map as it is."""
    v, u = (np.linspace(-1, 1, n) for n in VIEWS)
    gain = 1 - 0.12 * (v[:, None] ** 2 + u**2) / 2
    e, sure, _ = errors(front(0.37, contrast=0.3), device, gain=gain)
    assert np.median(e) < 0.01
    assert (e > 0.07).mean() < 0.01
    assert np.median(sure) > 0.3


def test_planes_far_apart_get_others_between_them(device):
    e, _, _ = errors(BAR, device, planes=np.linspace(-1.5, 1.5, 4))
    assert (e > 0.07).mean() < 0.08
    np.testing.assert_allclose(
        combined_cue._dense(np.array([0.0, 0.1, 0.5])), [0, 0.1, 7 / 30, 11 / 30, 0.5]
    )
