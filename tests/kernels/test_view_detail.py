"""view_detail.cl (with separated.cl) against SciPy's Gaussian filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clplen import LightField
from clplen.compute.device import Device
from clplen.lightfield.matching.view_detail import view_detail


@pytest.mark.parametrize(
    ("size", "colours", "dtype"),
    [
        ((21, 34), (3,), np.uint8),
        ((7, 5), (), np.float32),
        ((9, 150), (), np.uint16),
        ((9, 50), (2,), np.float32),
    ],
)
def test_detail_is_what_a_gaussian_leaves(
    device: Device, size: tuple[int, int], colours: tuple[int, ...], dtype: type
) -> None:
    random = np.random.default_rng(3)
    samples = random.random((2, 3, *size, *colours))
    if dtype is not np.float32:
        samples = samples * np.iinfo(dtype).max
    samples = samples.astype(dtype)
    lf = LightField.from_array(samples, device=device)
    gain = 255 / float(samples.max())
    gains = np.array([[gain, gain, 0], [gain / 2, gain, gain]])
    found = (view_detail(lf, gains).to_numpy().astype(np.float64) - 2**15) / 64
    sd = (0, 0, 2, 2, *(0,) * len(colours))
    values = samples.astype(np.float64)
    detail = values - gaussian_filter(values, sd, mode="reflect")
    expected = gains.reshape(2, 3, *(1,) * (values.ndim - 2)) * detail
    assert found.shape == samples.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.5 / 64 + 1e-3)  # rounding, float32
