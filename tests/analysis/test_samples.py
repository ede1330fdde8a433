"""Fourier interpolation of pictures and lines, and crossings of lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clplen.analysis.point.samples import between, finer, first_fall, line_of

RANDOM = np.random.default_rng(8)


def wave(y: np.ndarray, x: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A few frequencies below half a cycle a sample, none of them alike, and a constant."""
    v, u = 2 * np.pi * np.asarray(y) / shape[0], 2 * np.pi * np.asarray(x) / shape[1]
    down = 0.3 + np.cos(v + 0.4) + 0.5 * np.sin(3 * v)
    return np.multiply.outer(down, 1.1 + np.sin(u - 0.2) + 0.7 * np.cos(2 * u))


@pytest.mark.parametrize("shape", [(8, 11), (11, 8), (7, 9), (10, 6)])
def test_a_picture_between_its_samples(shape: tuple[int, int]) -> None:
    values = wave(np.arange(shape[0]), np.arange(shape[1]), shape)
    rows, columns = RANDOM.uniform(-3, 15, 5), RANDOM.uniform(-3, 15, 4)
    np.testing.assert_allclose(between(values, rows, columns), wave(rows, columns, shape))
    turned = between(values * np.exp(0.7j), rows, columns)
    np.testing.assert_allclose(turned, wave(rows, columns, shape) * np.exp(0.7j))
    np.testing.assert_allclose(line_of(values, 1, 2.3), between(values, [2.3], range(shape[1]))[0])
    along_y = between(values, range(shape[0]), [4.1])[:, 0]
    np.testing.assert_allclose(line_of(values, 0, 4.1), along_y)
    again = between(values, np.arange(shape[0]), np.arange(shape[1]))
    np.testing.assert_allclose(again, values, atol=1e-14)


def test_half_a_cycle_a_sample_is_shared_between_both_signs() -> None:
    line = np.array([[1.0, -1, 1, -1, 1, -1]])
    at = np.linspace(0, 5, 11)
    np.testing.assert_allclose(between(line, [0], at)[0], np.cos(np.pi * at), atol=1e-12)


@pytest.mark.parametrize("n", [8, 9])
def test_a_finer_line_keeps_its_samples(n: int) -> None:
    line = RANDOM.standard_normal(n) + 1j * RANDOM.standard_normal(n)
    fine = finer(line, 5)
    assert fine.shape == (5 * (n - 1) + 1,)
    np.testing.assert_allclose(fine[::5], line, atol=1e-12)
    expected = between(line[None], [0], np.arange(fine.size) / 5)[0]
    np.testing.assert_allclose(fine, expected, atol=1e-12)


def test_the_first_fall() -> None:
    x, y = np.array([0.0, 1, 2, 4, 5]), np.array([3.0, 4, 1, 5, 0])
    assert first_fall(x, y, 2) == pytest.approx(1 + 2 / 3)
    assert first_fall(x[3::-1], y[3::-1], 2) == pytest.approx(2.5)  # 5 at 4, 1 at 2
    assert math.isnan(first_fall(x, y, -1))
    assert math.isnan(first_fall(x, y, 3.5))
