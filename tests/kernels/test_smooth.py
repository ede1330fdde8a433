"""smooth.cl (with separated.cl and vectors.cl) against a float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from clplen.lightfield.arrays.smoothing import Smoother, box_taps, gaussian_taps

EPS = 2.0**-24


@pytest.mark.parametrize(
    ("shape", "taps"),
    [
        ((2, 13, 17), gaussian_taps(4.0)),  # the window is wider than the map
        ((3, 7, 75), box_taps(9)),  # more than one chunk of 64, a whole one and a part
        ((1, 3, 64), np.array([0.5, -0.25, 0.5])),
        ((2, 19, 37), gaussian_taps(1.5)),  # blocks of 8 rows on CPUs, the last one short
        ((2, 2, 1), gaussian_taps(4.0)),  # reflected more than once
        ((2, 2, 261), gaussian_taps(1.5)),  # two stretches of a GPU
        ((1, 2, 520), gaussian_taps(2.0)),  # two of a CPU, the second one short
    ],
)
def test_smoothed(device, shape, taps):
    maps = np.random.default_rng(1).random(shape).astype(np.float32)
    out = device.zeros((shape[0] + 1, *shape[1:]), np.float32)
    Smoother(taps, device=device)(out, device.upload(maps), start=1, count=shape[0])
    window = np.concatenate((taps[:0:-1], taps))
    want = maps.astype(np.float64)
    for axis in (1, 2):
        want = correlate1d(want, window, axis=axis, mode="reflect")
    got = device.download(out)
    # each axis: a rounding of each tap, of each product and of each partial sum
    allowed = 2 * (window.size + 2) * EPS * np.abs(window).sum() ** 2
    assert np.abs(got[1:] - want).max() <= allowed
    assert not got[0].any()


def test_windows_keep_the_mean():
    for taps in (gaussian_taps(1.5), gaussian_taps(4.0), box_taps(9), box_taps(1)):
        assert taps[0] + 2 * taps[1:].sum() == pytest.approx(1, abs=1e-14)
    assert box_taps(9).size == 5
    ratio = gaussian_taps(2.0)[3] / gaussian_taps(2.0)[0]
    assert ratio == pytest.approx(np.exp(-9 / 8), rel=1e-14)
