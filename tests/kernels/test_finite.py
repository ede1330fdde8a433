"""finite.cl: counting NaN and infinity."""

import numpy as np
import pytest

from clplen.compute import arrays
from clplen.compute.arrays import count_bad


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.complex64, np.float64, np.complex128])
def test_counts_each_bad_part(device, dtype):
    if dtype in (np.float64, np.complex128) and not device.has_fp64:
        pytest.skip(f"{device.name} has no double precision")
    values = np.ones((3, 5, 7), dtype)
    assert count_bad(device.upload(values), device) == 0
    values[0, 0, 0] = np.nan
    values[2, 4, 6] = -np.inf
    values[1, 2, 3] = np.inf
    expected = (
        3
        if np.dtype(dtype).kind == "f"
        else np.count_nonzero(~np.isfinite(values.view(values.real.dtype)))
    )
    assert count_bad(device.upload(values), device) == expected


def test_every_stretch_counts(device, monkeypatch):
    monkeypatch.setattr(arrays, "LENGTH", 16)
    values = np.ones(16 * 3 + 5, np.float32)
    values[[0, 15, 16, 47, 52]] = np.nan
    assert count_bad(device.upload(values), device) == 5


@pytest.mark.parametrize("size", [1, 63, 64, 65, 4095, 4097, 3 * 2**14 + 77])
def test_any_size(device, size):
    values = np.ones(size, np.float32)
    assert count_bad(device.upload(values), device) == 0
    bad = np.unique([0, size // 3, size // 2, size - 1])
    values[bad] = np.inf
    assert count_bad(device.upload(values), device) == bad.size


def test_integers_are_finite(device):
    assert count_bad(device.upload(np.full((3, 4), 65535, np.uint16)), device) == 0
