"""support.cl, gather_rows.cl and valley_rows.cl against float64 twins."""

from __future__ import annotations

import numpy as np
import pytest
from reference_matching import gather, valley
from tolerance import relative_max

from clplen.lightfield.matching.view_detail import all_planes

EPS = 2.0**-24


VECTORS = (-8, pytest.param(-4, marks=pytest.mark.thorough))  # blocks: lanes of gather_rows.cl
OTHER_LANES = [pytest.param(4, marks=pytest.mark.thorough)]


def skip_without_rows(device):
    if not device.rows:
        pytest.skip("kernels in vectors are for devices on which an item takes a row")


def gathered(device, cost, picture, near, alike, radius, block, spans=None):
    out = device.zeros(cost.shape, np.float32)
    planes, ny, nx = cost.shape
    length = block if device.rows else 1
    channels = picture.shape[2]
    sizes = {"CHANNELS": channels, "RADIUS": radius}
    if block < 0:
        skip_without_rows(device)
        kernel = device.kernel("gather_rows.cl", "gather_rows", LANES=-block, **sizes)
        size = (ny, -(-nx // 16))
    else:
        kernel = device.kernel("support.cl", "gather", BLOCK=length, **sizes)
        size = (-(-nx // length), ny)
    spans = all_planes((ny, nx), planes) if spans is None else spans
    device.launch(
        kernel,
        size,
        out,
        *(device.upload(a) for a in (cost, spans, np.moveaxis(picture, 2, 0).copy(), near, alike)),
        *(np.int32(n) for n in (planes, ny, nx)),
    )
    return device.download(out)


@pytest.mark.parametrize("block", [5, *VECTORS])
@pytest.mark.parametrize(
    ("planes", "ny", "nx", "channels", "radius"),
    [
        (2, 11, 6, 3, 3),
        (1, 4, 17, 2, 8),  # the window is larger than the picture
        (4, 1, 9, 3, 0),
        (19, 9, 37, 1, 3),
    ],
)
def test_gather(device, planes, ny, nx, channels, radius, block):
    random = np.random.default_rng(ny)
    cost = random.uniform(1, 30, (planes, ny, nx)).astype(np.float32)
    picture = random.uniform(0, 40, (ny, nx, channels)).astype(np.float32)
    near = random.uniform(0.02, 0.5, (ny, nx)).astype(np.float32)
    alike = (random.uniform(0.5, 8, (ny, nx)) / 40**2).astype(np.float32)
    got = gathered(device, cost, picture, near, alike, radius, block)
    want = gather(*(a.astype(float) for a in (cost, picture, near, alike)), radius)
    # Weights: q <= 8 to a few roundings, 8 times that in the bell where r is not small; sums of
    # positive terms, one rounding a term at most.
    terms = (2 * radius + 1) ** 2
    assert relative_max(want, got) <= (8 * (4 + channels) + 2 * terms) * EPS


@pytest.mark.parametrize("block", [8, *VECTORS])
def test_gather_of_spans(device, block):
    """Planes of a span are gathered, the same as all; nothing where no plane is wanted."""
    random = np.random.default_rng(7)
    cost = random.uniform(1, 30, (21, 6, 45)).astype(np.float32)
    picture = random.uniform(0, 40, (6, 45, 1)).astype(np.float32)
    flat = np.full((6, 45), 0.01, np.float32)
    spans = np.sort(random.integers(0, 21, (6, 3, 2)), axis=-1).astype(np.int32)
    spans[1, 1] = spans[4, 2] = (1, 0)
    every = gathered(device, cost, picture, flat, flat, 3, block)
    found = gathered(device, cost, picture, flat, flat, 3, block, spans)
    first, last = np.repeat(spans, 16, axis=1)[:, :45].transpose(2, 0, 1)
    p = np.arange(21)[:, None, None]
    there = (p >= first) & (p <= last)
    np.testing.assert_array_equal(found[there], every[there])
    assert not found[~there].any()


def lowest(device, cost, planes, file="support.cl", spans=None, lanes=0, **defines):
    count, ny, nx = cost.shape
    if lanes:
        skip_without_rows(device)
    every = np.tile(np.array((0, count - 1), np.int32), (ny, nx, 1))
    kinds = (np.float32, np.int32, np.float32, np.float32, np.float32)
    maps = [device.zeros((ny, nx), kind) for kind in kinds]
    args = (
        *maps,
        device.upload(cost),
        device.upload(every if spans is None else spans),
        device.upload(planes.astype(np.float32)),
        *(np.int32(n) for n in (count, ny, nx)),
    )
    if lanes:
        kernel = device.kernel("valley_rows.cl", "valley_rows", LANES=lanes)
        device.launch(kernel, (-(-nx // lanes), ny), *args)
    else:
        device.launch_rows(device.kernel(file, "valley", CHANNELS=1, **defines), (ny, nx), *args)
    return [device.download(one) for one in maps]


UNEVEN = np.array([-1.5, -1.25, -0.5, 0.0, 0.125, 1.0, 1.5, 3.0])


@pytest.mark.parametrize("lanes", [0, 8, *OTHER_LANES])
@pytest.mark.parametrize("planes", [UNEVEN[:3], np.linspace(-2, 2, 17)])
def test_valley(device, planes, lanes):
    cost = np.random.default_rng(4).uniform(1, 9, (len(planes), 11, 13)).astype(np.float32)
    place, number, least, second, mean = lowest(device, cost, planes, lanes=lanes)
    want = valley(cost.astype(float), planes)
    # the parabola lies within half a step; its rises are exact to a rounding, and so is their ratio
    assert np.abs(place - want[0]).max() <= 16 * EPS * np.abs(planes).max()
    np.testing.assert_array_equal(number, want[1])
    assert np.abs(least - want[2]).max() <= 4 * EPS * cost.max()  # two differences
    np.testing.assert_array_equal(second, want[3])
    assert len(planes) > 3 or np.isinf(second).any()
    assert relative_max(want[4], mean) <= (len(planes) + 1) * EPS


@pytest.mark.parametrize("lanes", [0, 8])
def test_valley_among_the_planes_of_a_span(device, lanes):
    cost = np.random.default_rng(4).uniform(1, 9, (8, 3, 35)).astype(np.float32)
    spans = np.array([[(0, 7)] * 16 + [(2, 6)] * 16 + [(1, 0)] * 3] * 3, np.int32)
    found = lowest(device, cost, UNEVEN, spans=spans, lanes=lanes)
    whole = lowest(device, cost, UNEVEN, lanes=lanes)
    part = lowest(device, cost[2:7], UNEVEN[2:7], lanes=lanes)
    for k, (map_, every, some) in enumerate(zip(found, whole, part, strict=True)):
        np.testing.assert_array_equal(map_[:, :16], every[:, :16])
        np.testing.assert_array_equal(map_[:, 16:32], some[:, 16:32] + (2 if k == 1 else 0))
        assert not map_[:, 32:].any()


@pytest.mark.parametrize("lanes", [8])
def test_valleys_of_neighbours_with_their_own_spans(device, lanes):
    """A span for each pixel, many of one plane; the same as pixel by pixel, by the plain kernel."""
    random = np.random.default_rng(9)
    cost = random.integers(1, 5, (8, 6, 45)).astype(np.float32)  # plateaus, too
    spans = np.sort(random.integers(0, 8, (6, 45, 2)), axis=-1).astype(np.int32)
    spans[random.random((6, 45)) < 0.2] = (1, 0)
    got = lowest(device, cost, UNEVEN, spans=spans, lanes=lanes)
    want = lowest(device, cost, UNEVEN, spans=spans)
    np.testing.assert_array_equal(got[1], want[1])
    for one, other in zip(got, want, strict=True):
        np.testing.assert_allclose(one, other, rtol=8 * EPS, atol=8 * EPS * 8)


def test_valley_in_the_program_of_its_cue(device):
    cost = np.random.default_rng(4).uniform(1, 9, (len(UNEVEN), 3, 19)).astype(np.float32)
    sizes = {"SAMPLE": "float", "RADIUS": 1, "BLOCK": 1, "MATCH_BLOCK": 1}
    together = lowest(device, cost, UNEVEN, "combined.cl", **sizes)
    np.testing.assert_array_equal(together, lowest(device, cost, UNEVEN))


def test_valley_without_one(device):
    cost = np.stack([np.full((2, 3), 4.0), np.full((2, 3), 4.0), np.full((2, 3), 4.0)])
    place, number, least, second, mean = lowest(
        device, cost.astype(np.float32), np.array([-1.0, 0, 2])
    )
    assert np.isfinite(place).all()
    assert ((number >= 0) & (number < 3)).all()
    np.testing.assert_array_equal(least, 4)
    np.testing.assert_array_equal(mean, 4)
    assert np.isinf(second).all()
