"""upsample.cl: every sample near its true place, against a float64 twin with dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import steps
from reference_render import upsampled as twin
from tolerance import relative_max

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import UPSAMPLE_BASE, upsampled


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        (np.uint8, (3, 4, 7, 11)),
        (np.uint16, (2, 5, 5, 18, 3)),
        (np.float16, (2, 5, 5, 18, 3)),
        (np.float32, (2, 5, 6, 5, 3)),
        (np.float32, (1, 3, 4, 35)),
    ],
)
def test_places(device, dtype, shape):
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    w = np.random.default_rng(4).uniform(0.2, 1.7, shape[:2]).astype(np.float32)
    w[0, 1] = 0
    lf = LightField.from_array(a, device=device, weights=w)
    for n, d in ((1, -0.65), (2, 2.25), (3, 0.0), (3, -0.65)):
        got = device.download(upsampled(lf, d, n, lf.weights)).astype(float)
        want = twin(a, d, n, weights=w.astype(float), step=steps(shape[:2]), base=UPSAMPLE_BASE)
        assert relative_max(want, got) <= 1e-5
    assert not device.download(upsampled(lf, 300.0, 2, lf.weights)).any()
