"""The maps along an axis against explicit float64 sums."""

from __future__ import annotations

import math

import numpy as np
from reference_lines import matrix

from clplen.compute.fft.lines import (
    Separable,
    chirp_z,
    convolution,
    cropped_inverse,
    identity,
    padded_spectrum,
    smooth_length,
)

ROUND_OFF = 1e-12  # sums of at most 100 unit terms in float64, phases reduced in turns
LENGTHS = [(1, 1), (1, 4), (4, 4), (5, 5), (7, 12), (8, 15), (13, 26), (6, 7)]


def centred(n: int) -> np.ndarray:
    return np.arange(n) - n // 2


def random_complex(shape: int | tuple[int, ...], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def test_padded_spectrum_counts_from_the_windows_centre() -> None:
    for n, length in LENGTHS:
        k = np.arange(length)
        # Sample n//2 lies on window sample length//2, so that the phase is that of length//2 + x.
        expected = np.exp(-2j * np.pi * np.outer(k, length // 2 + centred(n)) / length)
        np.testing.assert_allclose(matrix(padded_spectrum(n, length)), expected, atol=ROUND_OFF)


def test_cropped_inverse_is_what_brings_the_samples_back() -> None:
    for m, length in LENGTHS:
        both = matrix(cropped_inverse(length, m)) @ matrix(padded_spectrum(m, length))
        np.testing.assert_allclose(both, np.eye(m), atol=ROUND_OFF)


def test_convolution_is_a_sum_over_displacements() -> None:
    for length in [9, 14]:
        for n, m in [(5, 8), (8, 5), (7, 7), (6, 9), (1, 4), (4, 1)]:
            h = random_complex(length, 1)
            made = matrix(convolution(n, m, np.fft.fft(h)))
            expected = h[(centred(m)[:, None] - centred(n)) % length]
            np.testing.assert_allclose(made, expected, atol=1e-12 * length)


def test_chirp_z_is_the_sum_it_stands_for() -> None:
    for step in [1 / 8, -1 / 8, math.sqrt(2) / 31, -math.pi / 50, 0.0, 3.7]:
        for n, m in [(8, 8), (7, 12), (13, 5), (1, 6), (6, 1), (11, 16), (1, 1)]:
            pre, post = random_complex(n, 2), random_complex(m, 3)
            line = chirp_z(n, m, step, pre=pre, post=post)
            assert (line.n, line.m) == (n, m)
            assert line.length >= n + m - 1
            turns = step * np.outer(centred(m), centred(n))
            expected = post[:, None] * np.exp(2j * np.pi * (turns - np.rint(turns))) * pre
            # a chirp of |step| p^2/2 <= 120 turns, and three transforms of <= 27 samples
            np.testing.assert_allclose(matrix(line), expected, atol=1e-12)


def test_nothing_happens_to_one_sample() -> None:
    for line in (padded_spectrum(1, 1), cropped_inverse(1, 1), identity(1)):
        assert line.kind == "none"
        np.testing.assert_array_equal(matrix(line), [[1]])
    assert padded_spectrum(1, 2).kind == "forward"


def test_smooth_lengths() -> None:
    from_brute_force = [
        n for n in range(1, 400) if all(n % p or p <= 7 for p in range(2, n + 1) if is_prime(p))
    ]
    for n in range(1, 376):
        assert smooth_length(n) == next(m for m in from_brute_force if m >= n)
    assert smooth_length(2 * 3030) == 6075


def is_prime(p: int) -> bool:
    return p > 1 and all(p % q for q in range(2, math.isqrt(p) + 1))


def test_shape_and_window_of_maps() -> None:
    y = (padded_spectrum(5, 12), cropped_inverse(12, 7))
    both = Separable(y, (convolution(4, 3, np.ones(20, complex)),))
    assert both.shape_after((5, 4)) == (7, 3)
    assert both.widest((5, 4)) == (12, 20)
    assert Separable().shape_after((5, 4)) == (5, 4)
    assert Separable().widest((5, 4)) == (5, 4)
    assert Separable(y=y).shape_after((5, 4)) == (7, 4)


def test_tables_of_another_precision() -> None:
    line = chirp_z(5, 4, 0.3, pre=np.ones(5), post=np.ones(4))
    bare = padded_spectrum(3, 8)
    both = Separable((line, bare), (line,)).astype(np.dtype(np.complex64))
    for made in (both.y[0], both.x[0]):
        assert {t.dtype.str for t in (made.pre, made.kernel, made.post)} == {"<c8"}
        assert (made.n, made.m, made.length, made.kind) == (5, 4, line.length, "convolve")
        np.testing.assert_allclose(made.kernel, line.kernel, rtol=2e-7, atol=1e-6)
    assert (both.y[1].pre, both.y[1].kernel, both.y[1].post) == (None, None, None)
    assert line.kernel.dtype == np.complex128
