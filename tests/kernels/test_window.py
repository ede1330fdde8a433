"""window.cl: zero padding and cropping about the central sample."""

import numpy as np
import pytest

from clplen.compute.fft.blocks import window

SHAPES = [
    ((5, 7), (8, 9)),
    ((8, 9), (5, 7)),
    ((4, 6), (4, 6)),
    ((1, 7), (1, 16)),
    ((3, 11), (7, 5)),
]


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_sample_n_half_stays_central(wave):
    for small, large in SHAPES:
        rng = np.random.default_rng(1)
        u = (rng.normal(size=(2, *small)) + 1j * rng.normal(size=(2, *small))).astype(wave.complex)
        got = wave.download(window(wave.upload(u), (2, *large), wave))
        expected = np.zeros((2, *large), wave.complex)
        for y in range(large[0]):
            for x in range(large[1]):
                from_y = y - large[0] // 2 + small[0] // 2
                from_x = x - large[1] // 2 + small[1] // 2
                if 0 <= from_y < small[0] and 0 <= from_x < small[1]:
                    expected[:, y, x] = u[:, from_y, from_x]
        np.testing.assert_array_equal(got, expected)
