"""The comparison functions must fail on broken results: this is their only safeguard."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tolerance import err_db, fft_tolerance, largest_prime_factor, relative_max, snr_db

COMPARISONS = (relative_max, err_db, snr_db)
RNG = np.random.default_rng(7)
FIELD = RNG.normal(size=(5, 7)) + 1j * RNG.normal(size=(5, 7))


def test_values_that_are_not_finite_are_refused():
    for value in [np.nan, np.inf, -np.inf, 1j * np.nan]:
        for compare in COMPARISONS:
            broken = FIELD.copy()
            broken[2, 3] = value
            with pytest.raises(AssertionError, match="result holds 1 values"):
                compare(FIELD, broken)
            with pytest.raises(AssertionError, match="reference holds 1 values"):
                compare(broken, FIELD)
            with pytest.raises(AssertionError, match="reference holds 1 values"):
                compare(broken, broken)


def test_another_shape_is_refused_even_if_it_broadcasts():
    for other in [FIELD.T, FIELD[:1], FIELD[0, 0], FIELD[None], FIELD.ravel()]:
        for compare in COMPARISONS:
            with pytest.raises(AssertionError, match="shape"):
                compare(FIELD, other)


def test_another_kind_of_number_is_refused():
    for compare in COMPARISONS:
        for other in (FIELD.real, FIELD.real.astype(int), FIELD.real > 0, FIELD.astype(object)):
            with pytest.raises(AssertionError, match="dtype"):
                compare(FIELD, other)
            with pytest.raises(AssertionError, match="dtype"):
                compare(other, FIELD)
        with pytest.raises(AssertionError, match="dtype"):
            compare(np.arange(5), np.arange(5))


def test_a_zero_or_empty_reference_is_refused():
    for compare in COMPARISONS:
        with pytest.raises(AssertionError, match="nothing to compare"):
            compare(np.zeros((3, 4)), np.zeros((3, 4)))
        with pytest.raises(AssertionError, match="nothing to compare"):
            compare(np.zeros((0, 4)), np.zeros((0, 4)))


def test_precision_may_differ_within_a_kind():
    assert 1e-9 < relative_max(FIELD, FIELD.astype(np.complex64)) < 6e-8
    assert 140 < err_db(FIELD, FIELD.astype(np.complex64)) < 170


def test_equal_arrays():
    assert relative_max(FIELD, FIELD.copy()) == 0
    assert err_db(FIELD, FIELD.copy()) == math.inf
    assert snr_db(FIELD, FIELD.copy()) > 300


def test_wrong_values_are_measured():
    wrong = FIELD.copy()
    wrong[1, 2] += 0.25j
    assert relative_max(FIELD, wrong) == pytest.approx(0.25 / np.abs(FIELD).max(), rel=1e-12)
    expected = -20 * np.log10(0.25 / np.linalg.norm(FIELD))
    assert err_db(FIELD, wrong) == pytest.approx(expected, rel=1e-12)
    assert relative_max(FIELD, np.zeros_like(FIELD)) == 1
    assert err_db(FIELD, np.zeros_like(FIELD)) == 0
    assert snr_db(FIELD, np.zeros_like(FIELD)) == 0


def test_err_db_sees_scale_and_phase_and_snr_db_does_not():
    turned = 1.1 * np.exp(0.3j) * FIELD
    assert err_db(FIELD, turned) == pytest.approx(
        -20 * np.log10(abs(1.1 * np.exp(0.3j) - 1)), rel=1e-9
    )
    assert snr_db(FIELD, turned) > 290
    assert err_db(FIELD, FIELD.conj()) < 5
    assert snr_db(FIELD, FIELD.conj()) < 5


def test_snr_db_is_one_over_one_minus_gamma_squared_and_symmetric():
    other = FIELD + 0.2 * RNG.normal(size=FIELD.shape)
    gamma = np.vdot(FIELD, other) / np.linalg.norm(FIELD) / np.linalg.norm(other)
    expected = -10 * np.log10(1 - abs(gamma) ** 2)
    assert snr_db(FIELD, other) == pytest.approx(expected, rel=1e-9)
    assert snr_db(other, FIELD) == pytest.approx(expected, rel=1e-9)


def test_fft_tolerance_values():
    assert fft_tolerance(1000, np.complex64) == pytest.approx(3.5e-6)
    assert fft_tolerance((100, 10), np.float32) == pytest.approx(3.5e-6)
    assert fft_tolerance(1000, np.complex128) == pytest.approx(6.5e-15)
    assert fft_tolerance(1000, np.complex64, bluestein=True) == pytest.approx(7e-6)
    assert fft_tolerance((4, 17), "d") == pytest.approx(2 * (5e-15 + 5e-16 * np.log10(68)))
    assert fft_tolerance(3030, "F") == pytest.approx(2 * (2e-6 + 5e-7 * np.log10(3030)))
    assert fft_tolerance(13 * 11 * 7, "F") == pytest.approx(2e-6 + 5e-7 * np.log10(1001))


def test_fft_tolerance_refuses_other_dtypes_and_lengths():
    with pytest.raises(KeyError):
        fft_tolerance(8, np.int32)
    with pytest.raises(ValueError, match="at least 1"):
        fft_tolerance((8, 0), np.float32)


def test_largest_prime_factor():
    for n, prime in [(1, 1), (2, 2), (3030, 101), (169, 13), (97, 97)]:
        assert largest_prime_factor(n) == prime


def test_fft_tolerance_holds_for_scipy_and_is_not_vacuous():
    """scipy's transforms pass with at most a factor 100 to spare; a wrong factor would not pass."""
    for dtype in [np.complex64, np.complex128]:
        for shape in [(64, 60), (127, 35)]:
            import scipy.fft

            u = (RNG.normal(size=shape) + 1j * RNG.normal(size=shape)).astype(dtype)
            exact = naive_dft2(u)
            error = relative_max(exact, scipy.fft.fft2(u))
            tolerance = fft_tolerance(shape, dtype)
            assert tolerance / 100 < error < tolerance
            assert relative_max(exact, scipy.fft.fft2(u) * (1 + 3 * tolerance)) > tolerance


def naive_dft2(u: np.ndarray) -> np.ndarray:
    """2-D DFT by matrices in extended precision, phases reduced as integers."""
    u = u.astype(np.clongdouble)
    for axis, n in enumerate(u.shape):
        k = np.arange(n)
        turns = (np.outer(k, k) % n).astype(np.longdouble) / n
        pi = np.longdouble("3.14159265358979323846264338327950288")
        matrix = np.cos(2 * pi * turns) - 1j * np.sin(2 * pi * turns)
        u = np.moveaxis(np.tensordot(matrix, u, axes=(1, axis)), 0, axis)
    return u
