"""coherence.cl against a float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
from reference_cues import coherence

EPS = 2.0**-24


def twin(tensors, shears, reach, start):
    """(best, second, place) of every pixel, shear after shear; tensors (n, 6, pixels)."""
    best, second = np.zeros((2, tensors.shape[2]))
    place = np.full(tensors.shape[2], start)
    for J, d0 in zip(tensors, shears, strict=True):
        both = coherence(J[:3]) * J[:3] + coherence(J[3:]) * J[3:]
        off = np.divide(both[1], both[0], out=np.zeros_like(both[0]), where=both[0] > 0)
        c = np.where(np.abs(off) <= reach, coherence(both), 0)
        far = np.abs(d0 + off - place) > reach
        second = np.where(far, np.maximum(second, np.minimum(best, c)), second)
        place = np.where(c > best, d0 + off, place)
        best = np.maximum(best, c)
    return best, second, place


@pytest.mark.parametrize("shape", [(5, 37), (31, 3)])
def test_most_coherent(device, shape):
    random = np.random.default_rng(1)
    shears, reach, start = np.array([-0.5, -0.25, 0.0, 0.25]), 0.1875, 0.25
    g, e = random.normal(0, 1, (2, 4, 2, 4, shape[0] * shape[1]))
    u = 0.15 * g + 0.3 * e  # the disparity left is about 0.15
    parts = [np.sum(a * b, axis=2) for a, b in ((g, g), (g, u), (u, u))]
    tensors = np.stack(parts, axis=2).reshape(4, 6, -1).astype(np.float32)
    tensors[:, :, 0] = 0  # no texture
    tensors[:, 3:, 1] = 0  # one direction only
    state = [device.upload(np.full(shape, v, np.float32)) for v in (0, 0, start)]
    kernel = device.kernel("coherence.cl", "most_coherent")
    for J, d0 in zip(tensors, shears, strict=True):
        args = (*state, device.upload(J), np.float32(d0), np.float32(reach))
        device.launch_rows(kernel, shape, *args, *(np.int32(n) for n in shape))
    best, second, place = (device.download(a).ravel() for a in state)
    want = twin(tensors.astype(np.float64), shears, reach, start)
    # a coherence and the ratio of two sums, from a dozen roundings each
    assert np.abs(best - want[0]).max() <= 32 * EPS
    assert np.abs(second - want[1]).max() <= 32 * EPS
    assert np.abs(place - want[2]).max() <= 32 * EPS
    assert (best[0], second[0], place[0]) == (0, 0, start)
    assert best[1] > 0
    assert (second > 0).mean() > 0.1
