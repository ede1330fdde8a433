"""sharpness.cl against float64 twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter

from clplen.lightfield.focus import HighPass
from clplen.lightfield.interpolation import EvenBlur, evening_taps
from clplen.lightfield.refocus import FocalStack

EPS = 2.0**-24
LUMA = np.array([0.2126, 0.7152, 0.0722])


def high_passed(picture: np.ndarray, sigma: float) -> np.ndarray:
    a = picture.astype(np.float64)
    spread = (sigma, sigma) + (0,) * (a.ndim - 2)
    return a - gaussian_filter(a, spread, mode="reflect", truncate=4.0)


@pytest.mark.parametrize(
    "shape", [(37, 53), (29, 71, 3), (16, 64, 2), (1, 101, 3), (41, 1), (2, 3)]
)
def test_blurred_evenly(device, shape):
    pictures = np.random.default_rng(5).random((3, *shape)).astype(np.float32)
    weights = np.random.default_rng(6).random((3, 4)).astype(np.float32)
    planes, spacing = np.array([0.0, -1.3, 0.7]), (1e-3, -2e-3, 3e-4, 5e-4)
    stack = FocalStack(device.upload(pictures), device, planes, planes, spacing, None, weights)
    even = EvenBlur(shape, device=device)
    for index, d in enumerate(planes):
        # a plane of disparity d along x has d (dv/dy)/(du/dx) along y
        moves = np.outer([d * (1 / 0.3) / (-2 / 0.5), d], 1.0)
        want = pictures[index].astype(np.float64)
        for axis, (move, n) in enumerate(zip(moves, (3, 4), strict=True)):
            taps = evening_taps(move * -(np.arange(n) - (n - 1) / 2), weights.sum(axis=1 - axis))
            want = correlate1d(want, taps[[2, 1, 0, 1, 2]], axis=axis, mode="nearest")
        got = device.download(even(stack, index))
        # a rounding of each tap, of its product and of each of 3 sums, an axis; |taps| sum to < 1.1
        assert np.abs(got - want).max() <= 2 * 5 * EPS * 1.1**2
    plain = replace(stack, weights=None)
    np.testing.assert_array_equal(device.download(even(plain, 1)), pictures[1])


@pytest.mark.parametrize("shape", [(37, 53), (29, 31, 3), (16, 64, 2), (7, 101, 3)])
@pytest.mark.parametrize("luma", [False, True])
def test_local_energy(device, shape, luma):
    picture = (1 + np.random.default_rng(2).random(shape)).astype(np.float32)
    out = device.empty(shape[:2], np.float32)
    high_pass = HighPass(1.5, shape, device=device, luma=luma)
    high_pass(out, device.upload(picture))
    detail = high_passed(picture, 1.5)
    if luma and shape[2:] == (3,):
        want = (detail @ LUMA) ** 2
    else:
        want = (detail**2).reshape(*shape[:2], -1).sum(axis=-1)
    # the blur: 9 terms an axis of values up to 2; then its double in the square, and 6 roundings
    blur = 2 * 9 * EPS * 2
    count = 1 if len(shape) == 2 else shape[2]
    error = count * (2 * np.abs(detail).max() * blur + blur**2) + 6 * EPS * want.max()
    assert np.abs(device.download(out) - want).max() <= error


def test_flat_picture_has_no_energy(device):
    shape = (33, 47)
    rounding = 1 + 4 * EPS * np.random.default_rng(3).integers(-2, 3, shape)
    out = device.empty(shape, np.float32)
    for value in (0.0, 1e-3, 12345.0):
        picture = device.upload((value * rounding).astype(np.float32))
        HighPass(1.5, shape, device=device)(out, picture)
        assert not device.download(out).any()
