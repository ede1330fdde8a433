"""hyperfan.cl against a float64 filter of the whole 4-D spectrum."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import hyperfan as twin
from tolerance import relative_max

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.hyperfan_filter import hyperfan

SPACING = (-3e-4, -2e-4, 1e-4, 1.5e-4)


@pytest.mark.parametrize(
    ("dtype", "shape", "ends"),
    [
        (np.uint8, (3, 4, 7, 10), (-0.7, -0.5)),
        (np.uint16, (2, 3, 8, 5, 3), (0.0, 1.3)),
        (np.float16, (3, 4, 7, 10), (1.0, 1.0)),
        (np.float32, (2, 3, 8, 5, 3), (0.0, 1.3)),
    ],
)
def test_gains(device, dtype, shape, ends):
    spacing = SPACING if dtype == np.uint16 else None
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    w = np.ones(shape[:2])
    w[0, 1] = 0
    lf = LightField.from_array(a, device=device, weights=w, spacing=spacing)
    got = hyperfan(lf, *ends, bandwidth=0.2)
    ratio = 1.0 if spacing is None else 2.25
    want = twin(a, *ends, bandwidth=0.2, lit=w, ratio=ratio)
    assert got.shape == shape
    assert got.dtype == np.float32
    assert got.weights.all()
    # 4-D transforms in float32: about 20 units of rounding (tolerance.fft_tolerance) a transform.
    assert relative_max(want, got.to_numpy().astype(float)) <= 1e-5
