"""The comparison functions must fail on broken results: this is their only safeguard."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.fft
from tolerance import err_db, fft_tolerance, relative_max, snr_db

RNG = np.random.default_rng(7)
FIELD = RNG.normal(size=(5, 7)) + 1j * RNG.normal(size=(5, 7))


@pytest.mark.parametrize("compare", [relative_max, err_db, snr_db])
def test_what_cannot_be_compared_is_refused(compare):
    for value in (np.nan, -np.inf, 1j * np.nan):
        broken = FIELD.copy()
        broken[2, 3] = value
        with pytest.raises(AssertionError, match="result holds 1 values"):
            compare(FIELD, broken)
        with pytest.raises(AssertionError, match="reference holds 1 values"):
            compare(broken, FIELD)
    for other in (FIELD.T, FIELD[:1], FIELD[0, 0], FIELD[None]):  # some would broadcast
        with pytest.raises(AssertionError, match="shape"):
            compare(FIELD, other)
    for other in (FIELD.real, FIELD.real.astype(int), FIELD.astype(object)):
        with pytest.raises(AssertionError, match="dtype"):
            compare(FIELD, other)
    for shape in ((3, 4), (0, 4)):
        with pytest.raises(AssertionError, match="nothing to compare"):
            compare(np.zeros(shape), np.zeros(shape))


def test_wrong_values_are_measured():
    assert 1e-9 < relative_max(FIELD, FIELD.astype(np.complex64)) < 6e-8
    assert (relative_max(FIELD, FIELD.copy()), err_db(FIELD, FIELD.copy())) == (0, math.inf)
    wrong = FIELD.copy()
    wrong[1, 2] += 0.25j
    assert relative_max(FIELD, wrong) == pytest.approx(0.25 / np.abs(FIELD).max(), rel=1e-12)
    expected = -20 * np.log10(0.25 / np.linalg.norm(FIELD))
    assert err_db(FIELD, wrong) == pytest.approx(expected, rel=1e-12)


def test_err_db_sees_scale_and_phase_and_snr_db_does_not():
    turned = 1.1 * np.exp(0.3j) * FIELD
    expected = -20 * np.log10(abs(1.1 * np.exp(0.3j) - 1))
    assert err_db(FIELD, turned) == pytest.approx(expected, rel=1e-9)
    assert snr_db(FIELD, turned) > 290
    assert snr_db(FIELD, FIELD.conj()) < 5
    other = FIELD + 0.2 * RNG.normal(size=FIELD.shape)
    gamma = np.vdot(FIELD, other) / np.linalg.norm(FIELD) / np.linalg.norm(other)
    expected = -10 * np.log10(1 - abs(gamma) ** 2)
    assert snr_db(FIELD, other) == snr_db(other, FIELD) == pytest.approx(expected, rel=1e-9)


def test_fft_tolerance_holds_for_scipy_and_is_not_vacuous():
    """Transforms pass with at most a factor 100 to spare; a wrong factor would not pass."""
    assert fft_tolerance(1000, np.complex64) == pytest.approx(3.5e-6)
    assert fft_tolerance(3030, "F") == pytest.approx(2 * (2e-6 + 5e-7 * np.log10(3030)))
    for shape, dtype in (((64, 60), np.complex64), ((127, 35), np.complex128)):
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
