"""devignette.cl against float64 twins."""

from __future__ import annotations

import numpy as np
import pytest

EPS = 2.0**-24
NEAR, WITHIN = 1 / 32, 1 / 512  # weights of neighbouring lenslets and of the colour's own pixels


def drawn(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).random(shape).astype(np.float32)


@pytest.mark.parametrize(
    ("shape", "channels", "channel"), [((2, 3, 5, 7), 3, 1), ((1, 1, 1, 37), 1, 0)]
)
def test_divide(device, shape, channels, channel):
    V, U, ny, nx = shape
    raw, white = drawn(1, *shape) - np.float32(0.25), drawn(2, *shape) - np.float32(0.25)
    before = drawn(3, *shape, channels)
    out = device.upload(before)
    device.launch_rows(
        device.kernel("devignette.cl", "divide"),
        (V * U, ny, nx),
        *(out, device.upload(raw), device.upload(white)),
        np.float32(0.125),
        *(np.int32(n) for n in (ny, nx, channels, channel)),
    )
    got = device.download(out)
    want = raw.astype(np.float64) / np.maximum(white, 0.125)
    # OpenCL's division of floats is within 2.5 units of 2^-23
    assert (np.abs(got[..., channel] - want) <= 5 * EPS * np.abs(want)).all()
    others = [c for c in range(channels) if c != channel]
    np.testing.assert_array_equal(got[..., others], before[..., others])


def around(views: np.ndarray) -> np.ndarray:
    """Every lenslet with its eight neighbours, those beyond the edge 0."""
    ny, nx = views.shape[-2:]
    padded = np.pad(views.astype(np.float64), [(0, 0), (0, 0), (1, 1), (1, 1)])
    weights = (NEAR, 1, NEAR)
    return sum(
        weights[b] * weights[a] * padded[..., b : b + ny, a : a + nx]
        for b in range(3)
        for a in range(3)
    )


@pytest.mark.parametrize("shape", [(2, 3, 5, 7), (1, 2, 1, 6)])
def test_colours(device, shape):
    V, U, ny, nx = shape
    raw, white, first, second, *flat = (drawn(seed, *shape) for seed in range(6))
    raw[drawn(7, *shape) < 0.7] = 0
    white[drawn(8, *shape) < 0.7] = 0
    if min(ny, nx) > 1:  # nothing anywhere near: dark
        for empty in (white, *flat):
            empty[0, 0, :2, :2] = 0
            empty[0, 0, :, :3] = 0
    out = device.zeros((*shape, 3), np.float32)
    arrays = [device.upload(a) for a in (raw, white, first, second, *flat)]
    device.launch_rows(
        device.kernel("devignette.cl", "colours"),
        (V * U, ny, nx),
        *(out, *arrays),
        np.float32(0.0625),
        *(np.int32(n) for n in (ny, nx, 1)),
    )
    got = device.download(out)
    light = around(raw) + WITHIN * (first.astype(np.float64) + second)
    level = around(white) + WITHIN * (flat[0].astype(np.float64) + flat[1])
    want = light / np.maximum(level, 0.0625)
    # sums of 11 positive terms above and below, then a division
    assert (np.abs(got[..., 1] - want) <= (2 * 12 + 5) * EPS * want).all()
    assert not got[..., [0, 2]].any()
