"""along_rays.cl against float64 twins: statistics, interpolations, maps, masks, sample types."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import along_rays as sampled
from reference_render import statistic, steps
from tolerance import relative_max

from clplen.lightfield.arrays.ray_samples import INTERPOLATIONS, STATISTICS, along_rays

TYPES = (
    np.float32,
    np.uint8,
    pytest.param(np.float16, marks=pytest.mark.thorough),
)
# Coordinates in float32 are right to 1e-6 of a pixel; neighbours differ by at most the maximum.
TOLERANCE = 1e-5


def light_field(shape, dtype=np.float32) -> np.ndarray:
    return np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)


def weights(views) -> np.ndarray:
    """Unlike, two views of weight 0."""
    w = np.random.default_rng(4).uniform(0.2, 1.7, views)
    w[0, 1] = w[-1, -1] = 0
    return w


def a_map(shape) -> np.ndarray:
    """Disparities of every pixel, of both signs, on both sides of whole pixels."""
    y, x = np.mgrid[: shape[2], : shape[3]]
    return (0.9 * np.sin(0.7 * y) + 0.07 * x - 0.4).astype(np.float32)


def judged(device, a, mode, d, *, w=None, **more) -> None:
    views = a.shape[:2]
    w = weights(views) if w is None else w
    step = steps(views, 1.3)
    got = along_rays(
        device.upload(a), mode, device=device, weights=w, steps=step, disparity=d, **more
    )
    values, used = sampled(a, np.asarray(d, float), weights=w, step=step, **more)
    want = statistic(mode, values, used)
    scale = a.astype(float).max() if mode == "variance" else 1.0  # of squares
    got = device.download(got).astype(float)
    assert relative_max(want, got) <= TOLERANCE * (4 if scale > 1 else 1)


@pytest.mark.parametrize("mode", STATISTICS)
@pytest.mark.parametrize(("shape", "d"), [((3, 4, 7, 37), -0.65), ((2, 5, 5, 11, 3), 1.0)])
def test_statistics(device, mode, shape, d):
    judged(device, light_field(shape), mode, d)


@pytest.mark.parametrize("mode", STATISTICS)
def test_on_a_surface(device, mode):
    shape = (2, 5, 5, 11, 3)
    judged(device, light_field(shape), mode, a_map(shape))


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("dtype", TYPES)
def test_interpolations(device, interpolation, dtype):
    a = light_field((3, 4, 8, 41), dtype)
    for d in (0.37, -1.0, *((a_map(a.shape),) if dtype == np.float32 else ())):
        judged(device, a, "mean", d, interpolation=interpolation)
    judged(device, light_field((2, 3, 5, 13, 3), dtype), "mean", 0.3, interpolation=interpolation)


@pytest.mark.parametrize(
    ("mode", "interpolation"), [("mean", "linear"), ("median", "linear"), ("mean", "nearest")]
)
def test_masks(device, mode, interpolation):
    a = light_field((3, 4, 7, 23, 3))
    mask = np.random.default_rng(6).random(a.shape[:4]) > 0.3
    mask[:, :, 2, 5:9] = False  # seen by no view at disparity 0
    judged(device, a, mode, 0.0, interpolation=interpolation, mask=mask)
    judged(device, a, mode, 0.45, interpolation=interpolation, mask=mask)


def test_medians_of_equal_weights(device):
    """Even and odd numbers, equal values, numbers of both signs: the same as NumPy's."""
    for count in [1, 2, 3, 16, 17]:
        a = np.random.default_rng(8).integers(-3, 4, (1, count, 5, 19)).astype(np.float32)
        w = np.full((1, count), 0.3)
        got = along_rays(
            device.upload(a), "median", device=device, weights=w, steps=np.zeros((1, count, 2))
        )
        np.testing.assert_array_equal(device.download(got), np.median(a, axis=(0, 1)))


def test_nothing_is_seen_beyond_the_views(device):
    a = light_field((2, 3, 5, 7))
    for mode in STATISTICS:
        got = along_rays(
            device.upload(a),
            mode,
            device=device,
            weights=np.ones((2, 3)),
            steps=np.full((2, 3, 2), 30.0),
            disparity=1.0,
        )
        assert not device.download(got).any()
