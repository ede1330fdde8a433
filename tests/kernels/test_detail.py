"""detail.cl against a float64 twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter

from clplen.lightfield.depth.energy_cue import LocalEnergy, evening_taps
from clplen.lightfield.refocusing.focal_stacks import FocalStack

EPS = 2.0**-24
LUMA = np.array([0.2126, 0.7152, 0.0722])
PLANES = np.array([0.0, -1.3, 0.7])
SPACING = (1e-3, -2e-3, 3e-4, 5e-4)


def stack_of(pictures, device, weights):
    data = device.upload(pictures.astype(np.float32))
    return FocalStack(data, device, PLANES, PLANES, SPACING, None, weights)


def evened(picture, d, weights):
    """A picture blurred to what half a pixel loses; (dv/dy)/(du/dx) d along y."""
    shifts = np.array([d * (1 / 0.3) / (-2 / 0.5), d])
    for axis, n in enumerate(weights.shape):
        taps = evening_taps(shifts[axis] * ((n - 1) / 2 - np.arange(n)), weights.sum(1 - axis))
        picture = correlate1d(picture, taps[[2, 1, 0, 1, 2]], axis=axis, mode="reflect")
    return picture


def energy(picture, luma):
    detail = picture - gaussian_filter(picture, (1.5, 1.5, 0), mode="reflect", truncate=4.0)
    if luma and picture.shape[2] == 3:
        return (detail @ LUMA) ** 2
    return (detail**2).sum(axis=-1)


@pytest.mark.parametrize(
    ("shape", "luma"),
    [((19, 37), False), ((9, 31, 3), True), ((1, 40, 3), False), ((37, 1), True), ((4, 35, 2), 1)],
)
def test_energy_of_detail(device, shape, luma):
    random = np.random.default_rng(2)
    pictures = random.random((3, *shape)) + 1
    weights = random.random((3, 4)).astype(np.float32)
    stack = stack_of(pictures, device, weights)
    measure = LocalEnergy(1.5, shape, device=device, luma=luma)
    out = device.empty((2, *shape[:2]), np.float32)
    measure(out, stack, start=1, count=2)
    colours = pictures.astype(np.float32).astype(np.float64).reshape(3, *shape[:2], -1)
    for got, d, picture in zip(device.download(out), PLANES[1:], colours[1:], strict=True):
        want = energy(evened(picture, d, weights), luma)
        # both filters: 17 terms an axis at most, values up to 2; then a double in the square
        wrong = 2 * 2 * 19 * EPS * 2
        error = shape[-1] if len(shape) == 3 else 1
        error *= 2 * np.sqrt(want.max()) * wrong + wrong**2 + 6 * EPS * want.max()
        assert np.abs(got - want).max() <= error
    measure(out, replace(stack, weights=None), start=0, count=1)
    plain = energy(colours[0], luma)
    np.testing.assert_allclose(device.download(out)[0], plain, atol=1e-5 * plain.max() + 1e-7)


def test_flat_picture_has_no_energy(device):
    shape = (9, 37)
    rounding = 1 + 4 * EPS * np.random.default_rng(3).integers(-2, 3, shape)
    out = device.empty((3, *shape), np.float32)
    values = np.array([0.0, 1e-3, 12345.0])
    stack = stack_of(values[:, None, None] * rounding, device, None)
    LocalEnergy(1.5, shape, device=device)(out, stack, start=0, count=3)
    assert not device.download(out).any()
