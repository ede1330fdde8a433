"""finite.cl: counting NaN and infinity."""

import numpy as np

from clplen.compute import arrays
from clplen.compute.arrays import count_bad


def test_counts_each_bad_part(device):
    for dtype in (np.float16, np.float32, np.complex64, np.float64, np.complex128):
        if dtype in (np.float64, np.complex128) and not device.has_fp64:
            continue
        values = np.full((3, 5, 7), np.finfo(dtype).max, dtype)
        assert count_bad(device.upload(values), device) == 0
        values[0, 0, 0], values[2, 4, 6], values[1, 2, 3] = np.nan, -np.inf, np.inf
        expected = np.count_nonzero(~np.isfinite(values.view(values.real.dtype)))
        assert count_bad(device.upload(values), device) == expected
    assert count_bad(device.upload(np.full((3, 4), 65535, np.uint16)), device) == 0


def test_every_stretch_counts(device, monkeypatch):
    monkeypatch.setattr(arrays, "LENGTH", 16)
    values = np.ones(16 * 3 + 5, np.float32)
    values[[0, 15, 16, 47, 52]] = np.nan
    assert count_bad(device.upload(values), device) == 5


def test_any_size(device):
    for size in (1, 63, 65, 4097, 3 * 2**14 + 77):
        values = np.ones(size, np.float32)
        assert count_bad(device.upload(values), device) == 0
        bad = np.unique([0, size // 3, size // 2, size - 1])
        values[bad] = np.inf
        assert count_bad(device.upload(values), device) == bad.size
