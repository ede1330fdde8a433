"""tensor.cl against a float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
from reference_cues import epi_tensor, grid_steps

from clplen.lightfield.depth.structure_tensor_cue import epi_tensors
from clplen.lightfield.model.light_field import LightField


def compare(lf, L, d, weights, steps):
    colours = L.reshape(*L.shape[:4], -1).astype(np.float64)
    found = lf.device.download(epi_tensors(lf, d))
    for k, axis in enumerate((1, 0)):  # along rows of views first
        want = epi_tensor(colours, d, weights, steps, axis)
        # gradients are differences of values of rounding 1e-7, so 1e-5 of the largest product
        np.testing.assert_allclose(found[3 * k : 3 * k + 3], want, atol=1e-5 * want.max() + 1e-30)


@pytest.mark.parametrize(
    ("shape", "dtype", "d"),
    [
        ((3, 2, 5, 37), np.float32, 0.35),
        ((1, 5, 6, 19, 3), np.uint8, -1.8),
        ((5, 4, 2, 40, 2), np.float16, -1.8),
    ],
)
def test_tensors(device, shape, dtype, d):
    random = np.random.default_rng(1)
    L = (200 * random.random(shape)).astype(dtype)
    weights = random.random(shape[:2]).astype(np.float32) + 0.1
    if weights.size > 6:
        weights[1, -1] = 0
    lf = LightField.from_array(L, device=device, weights=weights)
    compare(lf, L, d, weights.astype(float), grid_steps(shape[:2]))
