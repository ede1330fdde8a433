"""finite.cl: counting NaN and infinity."""

import numpy as np
import pytest

from clplen.compute.finite import count_bad


@pytest.mark.parametrize("dtype", [np.float32, np.complex64, np.float64, np.complex128])
def test_counts_each_bad_part(device, dtype):
    if np.dtype(dtype).itemsize > 8 or dtype == np.float64:
        if not device.has_fp64:
            pytest.skip(f"{device.name} has no double precision")
    values = np.ones((3, 5, 7), dtype)
    assert count_bad(device.upload(values), device) == 0
    values[0, 0, 0] = np.nan
    values[2, 4, 6] = -np.inf
    values[1, 2, 3] = np.inf
    expected = 3 if np.dtype(dtype).kind == "f" else np.count_nonzero(
        ~np.isfinite(values.view(values.real.dtype))
    )
    assert count_bad(device.upload(values), device) == expected


def test_integers_are_finite(device):
    assert count_bad(device.upload(np.full((3, 4), 65535, np.uint16)), device) == 0
