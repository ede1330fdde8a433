"""magnify.cl against a float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
from reference_lightfield import magnify as twin

from clplen.lightfield.refocusing.magnification import magnify, magnify_adjoint

# Units of 2^-24 of the largest value: three roundings in each of the two linear steps, one for
# the gain, and positions whose fractions are off by half a unit at a slope of at most 2 per axis.
TOLERANCE = (3 + 3 + 1 + 2) * 2.0**-24


@pytest.mark.parametrize(
    ("shape", "alpha"), [((13, 17), 0.31), ((31, 18), 2.5), ((7, 12, 3), 1.1724), ((1, 5), 0.7368)]
)
def test_against_twin(device, shape, alpha):
    image = np.random.default_rng(3).random(shape).astype(np.float32)
    got = device.download(magnify(device.upload(image), alpha, device=device))
    want = twin(image.astype(np.float64), alpha)
    assert got.shape == shape
    assert np.abs(got - want).max() <= TOLERANCE * alpha**2


@pytest.mark.parametrize(
    ("shape", "alpha"), [((13, 17), 0.31), ((13, 17), 1.0), ((7, 12, 3), 1.1724), ((1, 5), 2.5)]
)
def test_spread_is_the_transpose(device, shape, alpha):
    """Of the twin: a pixel is shown by at most 1/alpha + 2 pixels along each axis."""
    values = np.random.default_rng(5).random(shape).astype(np.float32)
    got = device.download(magnify_adjoint(device.upload(values), alpha, device=device))
    units = np.eye(values.size).reshape(-1, *shape)
    want = [np.vdot(twin(unit, alpha), values.astype(np.float64)) for unit in units]
    largest = np.abs(want).max()
    tolerance = (3 + 2 * (1 / alpha + 2)) * TOLERANCE * largest
    assert np.abs(got - np.reshape(want, shape)).max() <= tolerance


def test_one_is_a_copy(device):
    image = np.random.default_rng(4).random((11, 6)).astype(np.float32)
    got = device.download(magnify(device.upload(image), 1.0, device=device))
    np.testing.assert_array_equal(got, image)


def test_outside_is_zero(device):
    image = np.ones((9, 9), np.float32)
    got = device.download(magnify(device.upload(image), 1e9, device=device))
    want = np.zeros((9, 9))
    want[4, 4] = 1e18
    np.testing.assert_allclose(got, want, rtol=1e-6)
