"""views.cl: black views and slices, on every storage type."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.lightfield.arrays.stored_samples import lit_views, plane

TYPES = (np.uint8, np.uint16, np.float16, np.float32)


def light_field(dtype, *shape: int) -> np.ndarray:
    values = np.random.default_rng(5).integers(1, 250, shape)
    return (values / 3 if dtype is np.float32 else values).astype(dtype)


@pytest.mark.parametrize("dtype", TYPES)
def test_lit_views(device, dtype):
    values = light_field(dtype, 3, 5, 7, 11)
    values[0, 1] = 0
    values[2, 4] = 0
    values[1, 3] = 0
    values[1, 3, -1, -1] = 1  # its last sample
    lit = lit_views(device.upload(values), device)
    want = np.ones((3, 5), bool)
    want[[0, 2], [1, 4]] = False
    np.testing.assert_array_equal(lit, want)


@pytest.mark.parametrize("dtype", TYPES)
def test_planes(device, dtype):
    shape = (2, 4, 5, 13, 3) if dtype in (np.uint8, np.float16) else (3, 5, 7, 11)
    values = light_field(dtype, *shape)
    data = device.upload(values)
    rows = device.download(plane(data, {2: 4, 0: 1}, (1, 3), device))
    np.testing.assert_array_equal(rows, values[1, :, 4].astype(np.float32))
    columns = device.download(plane(data, {3: 9, 1: 2}, (0, 2), device))
    np.testing.assert_array_equal(columns, values[:, 2, :, 9].astype(np.float32))
    assert rows.dtype == np.float32
