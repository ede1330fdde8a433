"""allinfocus.cl: between planes by a depth map, and blended by energy."""

from __future__ import annotations

import numpy as np
import pytest
from reference_render import between_planes, blended
from tolerance import relative_max

from clplen.lightfield.depth.all_in_focus import _launch
from clplen.lightfield.focus_and_depth import all_in_focus
from clplen.lightfield.refocusing.focal_stacks import FocalStack

ORDER = np.array([0.5, -1.0, 2.0, 0.0])


def stack(device, shape) -> FocalStack:
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(np.float32)
    return FocalStack(device.upload(a), device, ORDER[: shape[0]], ORDER[: shape[0]] * np.nan)


@pytest.mark.parametrize("shape", [(4, 7, 11), (3, 5, 6, 3), (2, 3, 1)])
def test_between_planes(device, shape):
    planes = stack(device, shape)
    d = np.random.default_rng(5).uniform(-1.3, 2.4, shape[1:3])
    d.flat[:3] = 0.5, -1.0, 2.0
    got = all_in_focus(planes, depth=d).to_numpy().astype(float)
    want = between_planes(planes.to_numpy(), planes.disparities, d)
    assert relative_max(want, got) <= 1e-6


def test_one_plane_is_itself(device):
    planes = stack(device, (1, 5, 7))
    got = all_in_focus(planes, depth=np.zeros((5, 7))).to_numpy()
    np.testing.assert_array_equal(got, planes.to_numpy()[0])


@pytest.mark.parametrize("shape", [(4, 7, 11), (3, 5, 6, 3)])
def test_blending(device, shape):
    planes = stack(device, shape)
    energy = np.random.default_rng(6).uniform(0.2, 1, shape[:3]) * 1e-3
    energy[:, 2, 3:5] = 0
    energy = energy.astype(np.float32)
    out = _launch("blend", planes, planes.data, device.upload(energy), np.int32(3))
    want = blended(planes.to_numpy().astype(float), energy.astype(float), 8)
    # (E/max)^8: eight roundings of the quotient, and those of the sum.
    assert relative_max(want, device.download(out).astype(float)) <= 2e-6
