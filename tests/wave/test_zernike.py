"""Zernike polynomials against exact values, phase plates against their formulae."""

from fractions import Fraction
from math import factorial

import numpy as np
import pytest

from clplen import Field, Grid, SamplingError, SamplingWarning
from clplen.wave import wavefront
from clplen.wave.elements.zernike import (
    noll,
    osa,
    phase_plate,
    zernike,
    zernike_gradient,
    zernike_monomials,
)

LAM = 532e-9
R2, R3, R5, R6, R8, R10 = (np.sqrt(n) for n in (2, 3, 5, 6, 8, 10))
# Noll (1976), table I, in Cartesian form: name, Noll's j, OSA's j, polynomial of x and y.
NAMED = [
    ("piston", 1, 0, lambda x, y: 0 * x + 1),
    ("tilt in x", 2, 2, lambda x, y: 2 * x),
    ("tilt in y", 3, 1, lambda x, y: 2 * y),
    ("defocus", 4, 4, lambda x, y: R3 * (2 * (x**2 + y**2) - 1)),
    ("oblique astigmatism", 5, 3, lambda x, y: R6 * 2 * x * y),
    ("astigmatism", 6, 5, lambda x, y: R6 * (x**2 - y**2)),
    ("coma in y", 7, 7, lambda x, y: R8 * (3 * (x**2 + y**2) - 2) * y),
    ("coma in x", 8, 8, lambda x, y: R8 * (3 * (x**2 + y**2) - 2) * x),
    ("trefoil in y", 9, 6, lambda x, y: R8 * (3 * x**2 - y**2) * y),
    ("trefoil in x", 10, 9, lambda x, y: R8 * (x**2 - 3 * y**2) * x),
    ("spherical", 11, 12, lambda x, y: R5 * (6 * ((r := x**2 + y**2) ** 2 - r) + 1)),
    ("second astigmatism", 12, 13, lambda x, y: R10 * (4 * (x**2 + y**2) - 3) * (x**2 - y**2)),
    ("second oblique", 13, 11, lambda x, y: R10 * (4 * (x**2 + y**2) - 3) * 2 * x * y),
    ("tetrafoil", 14, 14, lambda x, y: R10 * (x**4 - 6 * x**2 * y**2 + y**4)),
    ("oblique tetrafoil", 15, 10, lambda x, y: R10 * 4 * x * y * (x**2 - y**2)),
]


def ones(grid, device, wavelength=LAM):
    return Field.from_array(np.ones(grid.shape), grid, wavelength=wavelength, device=device)


def test_named_terms():
    x, y = np.random.default_rng(1).uniform(-0.7, 0.7, (2, 50))
    polar = np.hypot(x, y), np.arctan2(y, x)
    for name, j, osa_j, polynomial in NAMED:
        got, expected = zernike(*noll(j), *polar), polynomial(x, y)
        np.testing.assert_allclose(got, expected, atol=1e-14, rtol=0, err_msg=name)
        assert osa(osa_j) == noll(j)


def test_indices_are_complete():
    pairs = [(n, m) for n in range(12) for m in range(-n, n + 1, 2)]
    assert [osa(j) for j in range(len(pairs))] == pairs
    assert sorted(noll(j) for j in range(1, len(pairs) + 1)) == pairs
    assert all((m > 0) == (j % 2 == 0) for j in range(1, 79) if (m := noll(j)[1]))


def exact_radial(n, m, rho):
    """Noll (1976), eq. 2, in rational numbers."""
    total = sum(
        Fraction(
            (-1) ** s * factorial(n - s),
            factorial(s) * factorial((n + m) // 2 - s) * factorial((n - m) // 2 - s),
        )
        * rho ** (n - 2 * s)
        for s in range((n - m) // 2 + 1)
    )
    return float(total)


def test_high_orders_keep_their_digits():
    """Naive sums lose all of them: terms of 1e14 cancel at n = 40."""
    for n in [7, 20, 33, 40]:
        points = [Fraction(i, 16) for i in range(17)]
        for m in range(n % 2, n + 1, 2):
            norm = np.sqrt((n + 1) * (1 if m == 0 else 2))
            got = zernike(n, m, [float(p) for p in points], 0.0) / norm
            np.testing.assert_allclose(
                got, [exact_radial(n, m, p) for p in points], atol=1e-14, rtol=0
            )


def test_slopes_of_named_terms():
    """Central differences of the closed forms, whose third derivatives are below 600."""
    x, y = np.random.default_rng(2).uniform(-0.7, 0.7, (2, 50))
    x[0] = y[0] = 0
    h = 1e-4
    for name, j, _, polynomial in NAMED:
        down, right = zernike_gradient(*noll(j), y, x)
        by_y = (polynomial(x, y + h) - polynomial(x, y - h)) / (2 * h)
        by_x = (polynomial(x + h, y) - polynomial(x - h, y)) / (2 * h)
        np.testing.assert_allclose(down, by_y, atol=1e-6, rtol=0, err_msg=name)
        np.testing.assert_allclose(right, by_x, atol=1e-6, rtol=0, err_msg=name)


def test_monomials():
    x, y = np.random.default_rng(3).uniform(-0.7, 0.7, (2, 50))
    for j in range(1, 67):  # n up to 10
        got = np.polynomial.polynomial.polyval2d(y, x, zernike_monomials(*noll(j)))
        exact = zernike(*noll(j), np.hypot(x, y), np.arctan2(y, x))
        np.testing.assert_allclose(got, exact, atol=1e-11, rtol=0)


def plate_twin(grid, coefficients, diameter, centre, wavelength):
    y, x = np.meshgrid(grid.y - centre[0], grid.x - centre[1], indexing="ij")
    polynomials = {j: p for _, j, _, p in NAMED}
    w = sum(c * polynomials[j](2 * x / diameter, 2 * y / diameter) for j, c in coefficients.items())
    return np.exp(2j * np.pi * w / wavelength), np.hypot(y, x) < diameter / 2


def test_plate_off_centre(device, precise):
    for wavelength in [532e-9, 1064e-9]:
        grid = Grid((41, 52), (5e-6, 4e-6), origin=(7e-6, -3e-6))
        coefficients = {2: 30e-9, 5: -20e-9, 7: 25e-9, 10: 40e-9}
        centre = (-11e-6, 23e-6)
        expected, inside = plate_twin(grid, coefficients, 130e-6, centre, wavelength)
        for where, tolerance in ((device, 2e-7), (precise, 1e-13)):  # rounding of the transmission
            plate = phase_plate(
                ones(grid, where, wavelength), coefficients, diameter=130e-6, centre=centre
            )
            assert np.abs(plate.to_numpy() - expected)[inside].max() <= tolerance


def test_osa_coefficients(device):
    grid = Grid((21, 20), 5e-6)
    a = phase_plate(ones(grid, device), {7: 50e-9, 9: 20e-9}, diameter=90e-6, indexing="osa")
    b = phase_plate(ones(grid, device), {7: 50e-9, 10: 20e-9}, diameter=90e-6, indexing="noll")
    np.testing.assert_array_equal(a.to_numpy(), b.to_numpy())


def test_plate_is_phase_only_and_ends_at_its_rim(precise):
    """Cells that reach into the disc carry its phase, so that a weighted aperture is lit right."""
    grid = Grid((30, 33), (5e-6, 6e-6))
    got = phase_plate(ones(grid, precise), {4: 60e-9}, diameter=101e-6).to_numpy()
    y, x = np.abs(np.meshgrid(grid.y, grid.x, indexing="ij"))
    outside = np.hypot(np.maximum(y - 2.5e-6, 0), np.maximum(x - 3e-6, 0)) >= 50.5e-6
    rim = (np.hypot(y, x) > 50.5e-6) & ~outside
    assert rim.sum() > 10
    np.testing.assert_allclose(np.abs(got), 1, rtol=1e-14)
    np.testing.assert_array_equal(got[outside], 1)
    np.testing.assert_allclose(got[rim], np.exp(2j * np.pi * R3 * 60e-9 / LAM), rtol=1e-12)


def test_a_section_on_an_axis_of_one_sample(precise):
    grid = Grid((1, 41), (7e-6, 5e-6), origin=(3e-6, 0))
    got = phase_plate(ones(grid, precise), {8: 50e-9}, diameter=150e-6, centre=(50e-6, 10e-6))
    u = (grid.x - 10e-6) / 75e-6
    expected = np.exp(2j * np.pi * 50e-9 / LAM * R8 * (3 * u**3 - 2 * u))
    inside = np.abs(u) < 1
    np.testing.assert_allclose(got.to_numpy()[0, inside], expected[inside], rtol=1e-12)


def test_aliased_plate_says_what_would_do(device):
    """Z_2 = 2 rho cos theta: one step is 4 pi c dx/(lam D/2)."""
    grid = Grid((40, 44), (4e-6, 5e-6))
    limit = LAM * 80e-6 / (4 * 5e-6)
    phase_plate(ones(grid, device), {2: 0.999 * limit}, diameter=160e-6)
    message = (
        r"steps by 6\.283 rad, more than pi, .* 5e-06 m apart; use a pitch of at most 2\.5e-06 m"
    )
    with pytest.raises(SamplingError, match=message):
        phase_plate(ones(grid, device), {2: 2 * limit}, diameter=160e-6)
    with pytest.warns(SamplingWarning, match="4e-06 m apart"):
        phase_plate(ones(grid, device), {3: 2 * limit}, diameter=160e-6, aliasing="warn")
    phase_plate(ones(grid, device), {2: 2 * limit}, diameter=160e-6, aliasing="allow")


def test_bad_plates(device):
    for change, error, message in [
        ({"coefficients": {0: 1e-9}}, ValueError, "Noll's index must be an integer of at least 1"),
        ({"coefficients": {1.5: 1e-9}}, ValueError, "Noll's index"),
        ({"coefficients": {-1: 1e-9}, "indexing": "osa"}, ValueError, "OSA index .* at least 0"),
        ({"coefficients": {4: np.nan}}, ValueError, "Coefficient 4 of the plate must be finite"),
        ({"coefficients": [0, 1e-9]}, TypeError, "index: metres"),
        ({"indexing": "fringe"}, ValueError, "'noll' or 'osa', got 'fringe'"),
        ({"diameter": 0}, ValueError, "diameter of a plate must be positive"),
        ({"diameter": np.inf}, ValueError, "diameter of a plate must be positive"),
        ({"centre": (0, np.nan)}, ValueError, "centre of a plate must be finite"),
        ({"aliasing": "ignore"}, ValueError, "'raise', 'warn' or 'allow'"),
    ]:
        values = {"coefficients": {4: 1e-9}, "diameter": 1e-5} | change
        coefficients = values.pop("coefficients")
        with pytest.raises(error, match=message):
            phase_plate(ones(Grid((5, 6), 1e-6), device), coefficients, **values)
    for orders in [(2, 1), (1, 3), (2.5, 0.5)]:
        with pytest.raises(ValueError, match="orders must be integers n >= abs"):
            zernike(*orders, 0.5, 0.0)
    for diameter in [0, np.nan]:
        with pytest.raises(ValueError, match="diameter must be a positive number of metres"):
            wavefront(Grid((8, 8), 1e-4), {(2, 0): 1e-7}, diameter=diameter)
