"""Two points: Airy's and square apertures, incoherent and coherent, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_closed import airy
from scipy.optimize import brentq

from clplen.analysis.point.psf import PSF
from clplen.analysis.point.twopoint import SLIT, TwoPoints
from clplen.errors import ShapeError
from clplen.wave.field.field import Grid

UNIT = 40e-6  # lam F/D = lam/(2 NA)
CENTRE = (33e-6, -21e-6)
GRIDS = [
    Grid((161, 120), (0.31 * UNIT, 0.42 * UNIT), origin=(8e-6, -3e-6)),
    Grid((126, 163), (0.44 * UNIT, 0.27 * UNIT), origin=(0.0, 19e-6)),
]


def circular(grid: Grid) -> np.ndarray:
    return airy(np.pi * np.hypot.outer(grid.y - CENTRE[0], grid.x - CENTRE[1]) / UNIT)


def square(grid: Grid) -> np.ndarray:
    lines = [np.sinc((c - m) / UNIT) for c, m in zip((grid.y, grid.x), CENTRE, strict=True)]
    return np.multiply.outer(*lines)


def two(amplitude: np.ndarray, grid: Grid, axis: int) -> TwoPoints:
    return TwoPoints.incoherent(PSF(amplitude**2, grid.pitch, grid.origin), axis=axis)


@pytest.mark.parametrize(("grid", "axis"), [(GRIDS[0], 0), (GRIDS[1], 1)])
class TestEveryGrid:
    """Tolerances: windows of 50 units cut the tails, 1e-4 near the middle."""

    def test_the_image_is_the_sum_of_two(self, grid: Grid, axis: int) -> None:
        s = 1.37 * UNIT
        t = np.linspace(-3, 3, 41) * UNIT
        a, b = (airy(np.pi * (t + sign * s / 2) / UNIT) for sign in (1, -1))
        got = two(circular(grid), grid, axis).image(s, t)
        np.testing.assert_allclose(got, a**2 + b**2, atol=1e-4)
        for phase in (0.0, 0.6, np.pi):
            pair = TwoPoints.coherent(circular(grid), pitch=grid.pitch, axis=axis, phase=phase)
            expected = np.abs(a + np.exp(1j * phase) * b) ** 2
            np.testing.assert_allclose(pair.image(s, t), expected, atol=3e-4)

    def test_airy_at_rayleigh_s_distance_and_sparrow_s(self, grid: Grid, axis: int) -> None:
        pair = two(circular(grid), grid, axis)
        assert pair.contrast(1.219670 * UNIT) == pytest.approx(0.735, abs=1e-4)
        assert pair.rayleigh() == pytest.approx(1.219670 * UNIT, rel=3e-4)
        assert pair.sparrow() == pytest.approx(0.9472 * UNIT, rel=1e-3)  # 0.474 lam/NA

    def test_a_square_aperture(self, grid: Grid, axis: int) -> None:
        pair = two(square(grid), grid, axis)
        s = np.array([[0.5, 0.7], [1.0, 1.5]])
        middle = 2 * np.sinc(s / 2) ** 2
        t = np.linspace(0, 2, 4001)
        peak = [
            [(np.sinc(t + one / 2) ** 2 + np.sinc(t - one / 2) ** 2).max() for one in row]
            for row in s
        ]
        np.testing.assert_allclose(pair.contrast(s * UNIT), middle / peak, atol=2e-4)
        assert pair.contrast(UNIT) == pytest.approx(8 / np.pi**2, abs=2e-4)
        assert pair.rayleigh(SLIT) == pytest.approx(UNIT, rel=3e-4)

        def curvature(u: float) -> float:  # of sinc^2, with v = pi u
            v = np.pi * u
            sin, cos = np.sin(v), np.cos(v)
            return float(2 * np.cos(2 * v) / v**2 - 8 * sin * cos / v**3 + 6 * sin**2 / v**4)

        inflection = brentq(curvature, 0.2, 0.6)
        assert pair.sparrow() == pytest.approx(2 * inflection * UNIT, rel=1e-3)

    def test_coherent_points(self, grid: Grid, axis: int) -> None:
        # In quadrature two coherent points look like incoherent ones (Goodman 2005, 6.5.2); in
        # phase Sparrow's distance is 1.4640 lam F/D (0.732 lam/NA); opposed the middle is dark.
        def pair(phase: float) -> TwoPoints:
            return TwoPoints.coherent(circular(grid), pitch=grid.pitch, axis=axis, phase=phase)

        assert pair(np.pi / 2).contrast(1.22 * UNIT) == pytest.approx(0.735, abs=1e-3)
        assert pair(0.0).sparrow() == pytest.approx(1.4640 * UNIT, rel=2e-3)
        assert pair(0.0).contrast(1.22 * UNIT) == 1
        assert pair(np.pi).contrast(0.4 * UNIT) == pytest.approx(0, abs=1e-6)
        with pytest.raises(ValueError, match="part into two"):
            pair(np.pi).sparrow()


def test_a_gaussian_has_sparrow_s_limit_at_two_sigma() -> None:
    grid, sigma = GRIDS[0], (2.2 * UNIT, 1.4 * UNIT)
    lines = [
        np.exp(-((c - m) ** 2) / (2 * s**2))
        for c, m, s in zip((grid.y, grid.x), CENTRE, sigma, strict=True)
    ]
    psf = PSF(np.multiply.outer(*lines), grid.pitch, grid.origin)
    for axis in (0, 1):
        pair = TwoPoints.incoherent(psf, axis=axis)
        assert pair.sparrow() == pytest.approx(2 * sigma[axis], rel=1e-3)
        assert pair.contrast(1.9 * sigma[axis]) == 1
        assert pair.contrast(2.2 * sigma[axis]) < 0.9999


def test_the_weaker_of_two_maxima_counts() -> None:
    # The lobe beside the first point's image falls on the second's.
    x = np.arange(-60, 61) * 0.1
    line = np.exp(-(x**2)) + 0.35 * np.exp(-((x - 2.6) ** 2))
    psf = PSF(np.multiply.outer(np.exp(-(x**2)), line), 0.1e-6)
    pair, s = TwoPoints.incoherent(psf, axis=1), 3.1e-6
    t = np.linspace(-s, s, 2001)
    image = pair.image(s, t)
    left, right = image[t < 0].max(), image[t > 0].max()
    assert abs(left - right) > 0.1
    assert pair.contrast(s) == pytest.approx(pair.image(s, 0.0) / min(left, right), rel=1e-4)


def test_bad_input_is_told() -> None:
    grid = GRIDS[0]
    pair = two(square(grid), grid, 1)
    with pytest.raises(ValueError, match="positive"):
        pair.contrast([UNIT, 0.0])
    with pytest.raises(ValueError, match="take a wider window"):
        pair.contrast(25 * UNIT)
    with pytest.raises(ValueError, match="between 0 and 1"):
        pair.rayleigh(1.0)
    with pytest.raises(ValueError, match="phase must be finite"):
        TwoPoints.coherent(square(grid), pitch=1e-6, axis=0, phase=math.inf)
    with pytest.raises(ValueError, match="axis must be 0"):
        two(square(grid), grid, 2)
    with pytest.raises(ShapeError, match="at least 4 samples"):
        TwoPoints.coherent(np.ones((3, 3)), pitch=1e-6, axis=0)
