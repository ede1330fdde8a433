"""sharpness.cl against float64 twins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter

from clplen.lightfield.focus import HighPass, PeakTracker
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


def peak_twin(curve: np.ndarray, values: np.ndarray, start: float) -> tuple[float, float]:
    """(place, confidence) of one pixel."""
    n = len(curve)
    padded = np.concatenate([[-1.0], curve, [-1.0]])
    tops = [i for i in range(n) if padded[i] <= curve[i] > padded[i + 2] and curve[i] > 0]
    if not tops:
        return start, 0.0
    best = max(tops, key=lambda i: curve[i])
    second = max((curve[i] for i in tops if i != best), default=0.0)
    if best in (0, n - 1):
        return values[best], 0.0
    a, b, _ = np.polyfit(values[best - 1 : best + 2] - values[best], curve[best - 1 : best + 2], 2)
    k = -2 * a / curve[best]
    return values[best] - b / (2 * a), (1 - second / curve[best]) * k / (1 + k)


@pytest.mark.parametrize("shape", [(13, 17), (5, 64), (31, 3)])
@pytest.mark.parametrize(
    "values",
    [
        np.linspace(-2, 2, 9),
        np.array([-1.7, -1.6, -0.9, 0.0, 0.05, 0.8, 2.3]),
        np.array([0.1, 0.2, 0.5]),
    ],
)
def test_peak(device, shape, values):
    planes = np.random.default_rng(7).random((len(values), *shape)).astype(np.float32)
    planes[:, 2, :2] = 0  # no energy at all
    tracker = PeakTracker(shape, device=device, start=0.125)
    for value, plane in zip(values, planes, strict=True):
        with device.on_host(tracker.next_plane(float(value))) as target:
            target[...] = plane
    place, confidence = tracker.finish()
    curves = planes.reshape(len(values), -1).T.astype(np.float64)
    want = np.array([peak_twin(curve, values, 0.125) for curve in curves]).reshape(*shape, 2)
    # the vertex lies within half a step, from quotients of 6 roundings each
    step = np.diff(values).max()
    assert np.abs(place - want[..., 0]).max() <= EPS * (np.abs(values).max() + 12 * step)
    assert np.abs(confidence - want[..., 1]).max() <= 16 * EPS
    assert not confidence[2, :2].any()
    assert (confidence.min(), confidence.max()) >= (0, 0)
    assert confidence.max() <= 1
