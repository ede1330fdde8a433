"""support.cl against float64 twins."""

from __future__ import annotations

import numpy as np
import pytest
from reference_matching import gather, valley
from tolerance import relative_max

EPS = 2.0**-24


def gathered(device, cost, picture, near, alike, radius, block):
    out = device.empty(cost.shape, np.float32)
    planes, ny, nx = cost.shape
    length = block if device.rows else 1
    device.launch(
        device.kernel(
            "support.cl", "gather", CHANNELS=picture.shape[2], RADIUS=radius, BLOCK=length
        ),
        (-(-nx // length), ny),
        out,
        *(device.upload(a) for a in (cost, picture, near, alike)),
        *(np.int32(n) for n in (planes, ny, nx)),
    )
    return device.download(out)


@pytest.mark.parametrize("block", [5, 64])
@pytest.mark.parametrize(
    ("planes", "ny", "nx", "channels", "radius"),
    [
        (3, 7, 13, 1, 2),
        (2, 11, 6, 3, 3),
        (1, 4, 17, 2, 8),  # the window is larger than the picture
        (4, 1, 9, 3, 2),
        (2, 13, 1, 1, 3),
        (2, 5, 10, 1, 0),
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


def test_only_what_is_alike_is_gathered(device):
    """A step of the picture: no cost passes it."""
    picture = np.zeros((6, 11, 1), np.float32)
    picture[:, 4:] = 100
    cost = np.where(picture[None, ..., 0] > 0, 3, 7).astype(np.float32)
    flat = np.full((6, 11), 1e-3, np.float32)
    got = gathered(device, cost, picture, flat, flat, 3, 4)
    np.testing.assert_allclose(got, cost, rtol=1e-6)


def lowest(device, cost, planes, file="support.cl", **defines):
    count, ny, nx = cost.shape
    kinds = (np.float32, np.int32, np.float32, np.float32, np.float32)
    maps = [device.empty((ny, nx), kind) for kind in kinds]
    device.launch_rows(
        device.kernel(file, "valley", CHANNELS=1, **defines),
        (ny, nx),
        *maps,
        device.upload(cost),
        device.upload(planes.astype(np.float32)),
        *(np.int32(n) for n in (count, ny, nx)),
    )
    return [device.download(one) for one in maps]


UNEVEN = np.array([-1.5, -1.25, -0.5, 0.0, 0.125, 1.0, 1.5, 3.0])


@pytest.mark.parametrize("planes", [UNEVEN, UNEVEN[:3], np.linspace(-2, 2, 17)])
def test_valley(device, planes):
    cost = np.random.default_rng(4).uniform(1, 9, (len(planes), 11, 13)).astype(np.float32)
    place, number, least, second, mean = lowest(device, cost, planes)
    want = valley(cost.astype(float), planes)
    # the parabola lies within half a step; its rises are exact to a rounding, and so is their ratio
    assert np.abs(place - want[0]).max() <= 16 * EPS * np.abs(planes).max()
    np.testing.assert_array_equal(number, want[1])
    assert np.abs(least - want[2]).max() <= 4 * EPS * cost.max()  # two differences
    np.testing.assert_array_equal(second, want[3])
    assert len(planes) > 3 or np.isinf(second).any()
    assert relative_max(want[4], mean) <= (len(planes) + 1) * EPS


def test_valley_in_the_program_of_its_cue(device):
    cost = np.random.default_rng(4).uniform(1, 9, (len(UNEVEN), 3, 19)).astype(np.float32)
    sizes = {"SAMPLE": "float", "RADIUS": 1, "BLOCK": 1, "MATCH_BLOCK": 1}
    together = lowest(device, cost, UNEVEN, "combined.cl", **sizes)
    np.testing.assert_array_equal(together, lowest(device, cost, UNEVEN))


def test_valley_of_a_parabola(device):
    """Its bottom is found, wherever it lies between planes that are not evenly spaced."""
    bottoms = np.linspace(-1.2, 2.2, 40).reshape(5, 8)
    cost = 2 + (UNEVEN[:, None, None] - bottoms) ** 2
    place = lowest(device, cost.astype(np.float32), UNEVEN)[0]
    middle = np.searchsorted((UNEVEN[1:] + UNEVEN[:-1]) / 2, bottoms)
    half = np.diff(UNEVEN) / 2
    off = np.abs(bottoms - UNEVEN[middle])
    assert (off <= np.maximum(half[middle - 1], half[middle])).all()
    # costs up to 20 rounded, over the bend of the narrowest pair of steps, 1/8
    np.testing.assert_allclose(place, bottoms, atol=20 * EPS / 0.125)


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
