"""total_variation.cl, time_variation.cl and sieve.cl against NumPy in float64."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from setups_microscope import divergence
from tolerance import relative_max

RNG = np.random.default_rng(1)
FRAMES, PLANES, NY, NX = 2, 4, 6, 9


def uploaded(device, arrays):
    return [device.upload(np.ascontiguousarray(one)) for one in arrays]


def test_restrain(device):
    z = np.array([0.0, 1.5, 2.0, 5.0])
    order = np.array([2, 0, 3, 1])  # plane order[i] is the i-th along z
    V, B = RNG.random((2, FRAMES, PLANES, NY, NX), np.float32)
    a, e = np.array([0.05, 0.11], np.float32), np.array([0.3, 0.01], np.float32)
    thick, gap = np.ones((2, PLANES), np.float32)
    above, below = np.tile(np.arange(PLANES, dtype=np.int32), (2, 1))
    thick[order], gap[order[:-1]] = np.gradient(z), np.diff(z)
    above[order[:-1]], below[order[1:]] = order[1:], order[:-1]
    expected = B.astype(float)
    for f in range(FRAMES):
        expected[f, order] /= 1 - a[f] * divergence(V[f, order].astype(float), z, e[f])
    tables = uploaded(device, (a, e, thick, gap, above, below))
    target, volumes = uploaded(device, (B, V))
    a, e, *places, below = tables
    steep = device.empty(V.shape, np.float32)
    for name, args in (
        ("steepness", (steep, volumes, e, *places)),
        ("restrain", (target, volumes, steep, a, *places, below)),
    ):
        kernel = device.kernel("total_variation.cl", name)
        sizes = (np.int32(n) for n in (PLANES, NY, NX))
        device.launch_rows(kernel, (FRAMES * PLANES, NY, NX), *args, *sizes)
    # a difference of two voxels over e = .01 loses two digits
    assert relative_max(expected, device.download(target)) < 5e-6


@pytest.mark.parametrize("begun", [False, True])
def test_restrain_in_time(device, begun):
    frames = 5
    V, B = RNG.random((2, frames, PLANES, NY, NX), np.float32)
    V[3] = V[2]  # nothing changes there
    before = RNG.random((PLANES, NY, NX), np.float32)
    a, e = RNG.uniform(0.05, 0.25, (2, frames)).astype(np.float32)
    first = before if begun else V[0]
    change = np.diff(np.concatenate([first[None], V, V[-1:]]).astype(float), axis=0)
    p = change / np.sqrt(change**2 + np.append(e[0], e)[:, None, None, None].astype(float) ** 2)
    expected = B / (1 - a[:, None, None, None].astype(float) * np.diff(p, axis=0))
    target, volumes, start, a, e = uploaded(device, (B, V, before, a, e))
    kernel = device.kernel("time_variation.cl", "restrain_time")
    sizes = (np.int32(n) for n in (begun, frames, PLANES, NY, NX))
    device.launch_rows(kernel, (PLANES, NY, NX), target, volumes, start, a, e, *sizes)
    assert relative_max(expected, device.download(target)) < 1e-6


def test_sieve(device):
    values = RNG.random((FRAMES, PLANES, NY, NX), np.float32)
    radii, margin = np.array([0, 3, 5, 1], np.int32), 5
    taps = RNG.random((PLANES, margin + 1), np.float32)
    expected = np.empty(values.shape)
    for z, radius in enumerate(radii):
        whole = np.concatenate((taps[z, radius:0:-1], taps[z, : radius + 1])).astype(float)
        for f in range(FRAMES):
            down = correlate1d(values[f, z].astype(float), whole, axis=0, mode="reflect")
            expected[f, z] = correlate1d(down, whole, axis=1, mode="reflect")
    given, w, r = uploaded(device, (values, taps, radii))
    padded = device.empty((FRAMES, PLANES, NY, NX + 2 * margin), np.float32)
    out = device.empty(values.shape, np.float32)
    sizes = [np.int32(n) for n in (margin, PLANES, NY, NX)]
    for name, to, of in (("down", padded, given), ("across", out, padded)):
        kernel = device.kernel("sieve.cl", name)
        device.launch_rows(kernel, (FRAMES * PLANES, NY, NX), to, of, w, r, *sizes)
    assert relative_max(expected, device.download(out)) < 1e-6
