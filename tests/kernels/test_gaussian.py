"""gaussian.cl against scipy.ndimage in float64."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clplen.lightfield.gaussian import GaussianBlur, gaussian_taps


def tolerance(sigma: float) -> float:
    """Largest error over the largest value: for each axis, one rounding of a tap, one of its
    product, and one for each of the radius + 1 terms that are added, of weights that sum to 1."""
    return 2 * (gaussian_taps(sigma).size + 2) * 2.0**-24


def twin(pictures: np.ndarray, sigma: float) -> np.ndarray:
    spread = (0, sigma, sigma) + (0,) * (pictures.ndim - 3)
    return gaussian_filter(pictures.astype(np.float64), spread, mode="reflect", truncate=4.0)


@pytest.mark.parametrize("shape", [(37, 53), (29, 31, 3), (64, 16), (17, 97, 2), (101, 7), (1, 40)])
@pytest.mark.parametrize("sigma", [0.4, 1.5, 4.0])
def test_against_twin(device, shape, sigma):
    pictures = np.random.default_rng(2).random((3, *shape)).astype(np.float32)
    stack, out = device.upload(pictures), device.empty(shape, np.float32)
    want = twin(pictures, sigma)
    blur = GaussianBlur(sigma, shape, device=device)
    for index in (1, 2, 0):
        blur(out, stack, index=index)
        got = device.download(out)
        assert np.abs(got - want[index]).max() <= tolerance(sigma)


@pytest.mark.parametrize("shape", [(5, 3), (2, 1), (1, 1), (3, 4, 3)])
def test_picture_smaller_than_the_taps(device, shape):
    picture = np.random.default_rng(5).random((1, *shape)).astype(np.float32)
    out = device.empty(shape, np.float32)
    GaussianBlur(4.0, shape, device=device)(out, device.upload(picture))
    assert np.abs(device.download(out) - twin(picture, 4.0)[0]).max() <= tolerance(4.0)


def test_in_place(device):
    picture = np.random.default_rng(6).random((1, 23, 41)).astype(np.float32)
    array = device.upload(picture[0])
    GaussianBlur(2.0, (23, 41), device=device)(array, array)
    assert np.abs(device.download(array) - twin(picture, 2.0)[0]).max() <= tolerance(2.0)


def test_taps_sum_to_one():
    for sigma in (0.3, 1.5, 4.0):
        taps = gaussian_taps(sigma)
        assert 2 * taps.sum() - taps[0] == pytest.approx(1, abs=1e-15)
        assert taps.size == int(4 * sigma + 0.5) + 1
