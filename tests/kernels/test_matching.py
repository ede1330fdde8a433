"""matching.cl, match_rows.cl, and brightness of views.cl, against float64 twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_matching import bell_taps, centre_shares, costs, membership

from clplen.lightfield.matching import view_matching
from clplen.lightfield.matching.view_detail import all_planes
from clplen.lightfield.matching.view_matching import (
    group_views,
    match_costs,
    row_sums,
    shift_tables,
    thresholds,
)
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField

PLANES = np.array([-3.3, -0.9, -0.25, 0.0, 0.4, 1.0, 2.7, 50.0])  # the last leaves the views


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch):
    """Several blocks a row, the last one not whole."""
    monkeypatch.setattr(view_matching, "_BLOCK", 8)
    monkeypatch.setattr(view_matching, "_VECTORS", 1)


def samples(shape, dtype=np.float32, seed=3):
    """Values from 20 to 230, with neighbours that are alike."""
    random = np.random.default_rng(seed).uniform(20, 230, shape)
    for axis in (2, 3):
        random = (random + np.roll(random, 1, axis)) / 2
    return random.astype(dtype)


def light_field(device, shape, **more):
    weights = np.ones(shape[:2])
    if weights.size > 5:
        weights[0, 1] = 0
    return LightField.from_array(samples(shape), device=device, weights=weights, **more)


def wanted(lf, planes, channels, gain=1.0):
    """The costs of a light field by the twin, its views in their own order."""
    lit = lf.weights.ravel() > 0
    S = gain * lf.to_numpy().reshape(-1, *lf.shape[2:4], channels)[lit].astype(float)
    every = unit_steps(lf).reshape(-1, 2)
    steps = every[lit]
    down = 1 if lf.spacing is None else lf.spacing[0] / lf.spacing[1]
    centre = centre_shares(steps / (down, 1))
    return costs(S, steps, membership(steps, every), centre, planes, thresholds(channels))


def found_costs(lf, planes, gain=1.0):
    views = group_views(lf)
    moved = shift_tables(views, planes, gain, device=lf.device)
    return lf.device.download(match_costs(lf, views, moved, all_planes(lf.shape[2:4], planes.size)))


@pytest.mark.parametrize("part", [0, 0.1, 1 - 1e-9])
def test_taps(part):
    taps = view_matching.bell_taps(np.array(part))
    np.testing.assert_allclose(taps, bell_taps(part), rtol=0, atol=1e-15)
    np.testing.assert_allclose(taps @ np.ones(4), 1, atol=1e-15)
    np.testing.assert_allclose(taps @ np.arange(-1, 3), part, atol=1e-15)
    # the same from the other side: no picture is better than its mirror image
    np.testing.assert_allclose(view_matching.bell_taps(1 - np.array(part))[::-1], taps, atol=1e-9)
    # blurred, and noise passed, alike for all fractions
    assert 0.449 < (taps**2).sum() < 0.458


# Differences of values up to 230 after two sums of four positive taps, 8 roundings each, and of the
# centre; the mean over K views adds K roundings of e <= tau.
def tolerance(lf, channels):
    top, tau = 230.0, thresholds(channels)[0]
    views = lf.weights.size
    return (2 * 16 * channels * top + (views + 4) * tau) * 2.0**-24


@pytest.mark.parametrize(
    "shape",
    [
        (3, 5, 7, 17, 3),  # V != U, no multiple of the block
        (2, 4, 11, 8),  # even counts: four views make the centre
        (3, 2, 1, 19),
    ],
)
def test_match(device, shape):
    lf = light_field(device, shape)
    channels = (*shape, 1)[4]
    planes = PLANES[::3] if device.platform == "Oclgrind" else PLANES
    got = found_costs(lf, planes)
    want = wanted(lf, planes, channels)
    assert got.dtype == np.float32
    assert got.shape == (planes.size, *shape[2:4])
    assert np.abs(got - want).max() <= tolerance(lf, channels) < 2e-3 * thresholds(channels)[0]


@pytest.mark.thorough
@pytest.mark.parametrize(("shape", "lanes"), [((3, 5, 7, 37, 3), 4), ((5, 5, 6, 19), 16)])
def test_vectors_of_other_lengths(device, monkeypatch, shape, lanes):
    monkeypatch.setattr(view_matching, "vector_lanes", lambda device: (lanes, 8))
    lf = light_field(device, shape)
    channels, planes = (*shape, 1)[4], PLANES[:6]
    got = found_costs(lf, planes)
    want = wanted(lf, planes, channels)
    assert np.abs(got - want).max() <= tolerance(lf, channels)
    # the same where every view has its pattern, more than are added at a time
    views = group_views(lf)
    counts = np.diff(views.first)
    apart = replace(
        views,
        first=np.arange(len(views.view) + 1, dtype=np.int32),
        pattern=np.repeat(views.pattern, counts, axis=0),
    )
    moved = shift_tables(apart, planes, 1.0, device=device)
    spans = all_planes(lf.shape[2:4], planes.size)
    got = device.download(match_costs(lf, apart, moved, spans))
    assert np.abs(got - want).max() <= tolerance(lf, channels)


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [
        ((3, 3, 7, 13), np.uint8),
        ((2, 3, 9, 11, 3), np.uint16),
    ],
)
def test_integers_and_gain(device, shape, dtype):
    lf = LightField.from_array(samples(shape, dtype), device=device)
    planes = np.array([-0.6, 0.0, 1.25])
    channels = (*shape, 1)[4]
    got = found_costs(lf, planes, gain=0.37)
    assert np.abs(got - wanted(lf, planes, channels, gain=0.37)).max() <= tolerance(lf, channels)


@pytest.mark.parametrize("shape", [(3, 4, 7, 53), (2, 3, 6, 40, 3), (2, 2, 5, 37, 2)])
def test_only_planes_of_a_span(device, shape):
    lf = light_field(device, shape)
    channels, count = (*shape, 1)[4], PLANES.size
    rng = np.random.default_rng(4)
    spans = np.sort(rng.integers(0, count, (shape[2], -(-shape[3] // 16), 2)), axis=-1)
    spans[rng.random(spans.shape[:2]) < 0.3] = (1, 0)
    spans = spans.astype(np.int32)
    views = group_views(lf)
    moved = shift_tables(views, PLANES, 1.0, device=device)
    got = device.download(match_costs(lf, views, moved, spans))
    first, last = np.repeat(spans, 16, axis=1)[:, : shape[3]].transpose(2, 0, 1)
    p = np.arange(count)[:, None, None]
    there = (p >= first) & (p <= last)
    assert 0.1 < there.mean() < 0.9
    off = np.abs(got - wanted(lf, PLANES, channels))
    assert off[there].max() <= tolerance(lf, channels)
    assert np.isfinite(got).all()


def test_views_are_evened_one_by_one(device):
    lf = light_field(device, (3, 4, 9, 13))
    views, planes = group_views(lf), np.array([-0.8, 0.3, 1.4])
    gain = np.random.default_rng(8).uniform(0.5, 2, 12)
    moved = shift_tables(views, planes, gain[views.view], device=device)
    got = device.download(match_costs(lf, views, moved, all_planes(lf.shape[2:4], planes.size)))
    want = wanted(lf, planes, 1, gain=gain[lf.weights.ravel() > 0][:, None, None, None])
    assert np.abs(got - want).max() <= 2 * tolerance(lf, 1)  # samples twice as large


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_sums_of_rows(device, dtype):
    values = samples((3, 4, 7, 11, 3), dtype)
    want = values.reshape(12, 7, -1).sum(axis=2, dtype=float)
    # a row is a sum of 33 positive terms
    found = row_sums(LightField.from_array(values, device=device))
    np.testing.assert_allclose(found, want, rtol=33 * 2.0**-24)


@pytest.mark.parametrize("counts", [(3, 3), (4, 3)])
def test_rows_twice_as_far_apart(device, counts):
    """Steps along y are twice as long; who makes the centre is a matter of views, not of pixels."""
    lf = light_field(device, (*counts, 9, 11), spacing=(-2e-3, -1e-3, 5e-4, 5e-4))
    planes = np.array([-0.7, 0.35, 1.3])
    got = found_costs(lf, planes)
    assert np.abs(got - wanted(lf, planes, 1)).max() <= tolerance(lf, 1)


@pytest.mark.parametrize("counts", [(9, 9), (4, 6), (1, 5), (3, 1)])
def test_views_are_sorted_into_halves(device, counts):
    lf = LightField.from_array(np.ones((*counts, 2, 2), np.float32), device=device)
    views = group_views(lf)
    steps = unit_steps(lf).reshape(-1, 2)
    np.testing.assert_array_equal(np.sort(views.view), np.arange(len(steps)))
    np.testing.assert_array_equal(views.step, steps[views.view])
    share = np.repeat(views.pattern, np.diff(views.first), axis=0)
    np.testing.assert_array_equal(share, membership(steps)[views.view])
    # every view but the middle one counts once in two opposite halves together
    inner = np.abs(views.step).max(axis=1) > 0
    np.testing.assert_array_equal((share[:, 1:5] + share[:, 5:])[inner], 1)
    centre = np.zeros(len(steps))
    centre[views.view[views.reference]] = views.share
    np.testing.assert_allclose(centre, centre_shares(steps), atol=1e-7)
