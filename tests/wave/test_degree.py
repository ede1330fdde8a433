"""Degree of coherence and contrast, measured: against sums over pairs in float64."""

import numpy as np
import pytest

from clplen.errors import ShapeError
from clplen.wave.coherence.degree import DegreeEstimator, measured_degree, speckle_contrast
from clplen.wave.field.field import Field, Grid

GRID = Grid((7, 10), (3e-6, 2e-6), origin=(1e-3, 0))


def samples(count=3, grid=GRID, seed=1):
    random = np.random.default_rng(seed)
    u = random.standard_normal((count, *grid.shape)) + 1j * random.standard_normal(
        (count, *grid.shape)
    )
    return u * np.exp(0.7j * np.arange(grid.shape[1])) + 0.4j  # a slope, so that mu is complex


def to_field(u, device, grid=GRID):
    return Field.from_array(u, grid, wavelength=550e-9, device=device)


def twin(u, dy, dx, periodic):
    """Mean of u*(r) u(r + lag) over pairs and snapshots, over the mean intensity."""
    _, ny, nx = u.shape
    pairs = []
    for y in range(ny):
        for x in range(nx):
            if periodic or (0 <= y + dy < ny and 0 <= x + dx < nx):
                pairs.append(np.conj(u[:, y, x]) * u[:, (y + dy) % ny, (x + dx) % nx])
    return np.mean(pairs) / np.mean(np.abs(u) ** 2)


LAGS = [(0, 0), (0, 1), (2, 0), (-3, 4), (6, -9), (6, 9), (-1, -8)]


def test_mean_over_pairs(device, precise):
    for periodic in [False, True]:
        u = samples()
        expected = np.array([twin(u, dy, dx, periodic) for dy, dx in LAGS])
        got = measured_degree((to_field(one, precise) for one in u), LAGS, periodic=periodic)
        np.testing.assert_allclose(got, expected, atol=1e-13)
        # a field rounded to complex64
        got = measured_degree((to_field(one, device) for one in u), LAGS, periodic=periodic)
        np.testing.assert_allclose(got, expected, atol=1e-6)


def test_lags_along_an_axis(precise):
    for periodic in [False, True]:
        u = samples()
        for axis, most in (("y", 6), ("x", 9)):
            lags = np.arange(-most, most + 1)
            got = measured_degree([to_field(u, precise)], lags, axis=axis, periodic=periodic)
            pairs = [(n, 0) if axis == "y" else (0, n) for n in lags]
            expected = [twin(u, dy, dx, periodic) for dy, dx in pairs]
            np.testing.assert_allclose(got, expected, atol=1e-13)
            np.testing.assert_allclose(got, np.conj(got[::-1]), atol=1e-13)


def test_a_batch_counts_as_its_fields(precise):
    u = samples(6)
    one, many = (DegreeEstimator(GRID, reach=(2, 3)) for _ in range(2))
    one.add(to_field(u.reshape(2, 3, *GRID.shape), precise))
    for field in u:
        many.add(to_field(field, precise))
    assert one.count == many.count == 6
    np.testing.assert_allclose(one.map(), many.map(), rtol=0, atol=1e-14)


def test_whole_maps(precise):
    for shape in [(7, 10), (6, 9), (1, 8), (9, 1)]:
        grid = Grid(shape, 2e-6)
        u = samples(2, grid)
        ny, nx = shape
        plain, periodic = DegreeEstimator(grid), DegreeEstimator(grid, periodic=True)
        for estimator in (plain, periodic):
            estimator.add(to_field(u, precise, grid))
        got = plain.map()
        assert got.shape == (2 * ny - 1, 2 * nx - 1)
        for dy, dx in ((0, 0), (ny - 1, 0), (1 - ny, nx - 1), (ny // 2, 1 - nx)):
            assert got[ny - 1 + dy, nx - 1 + dx] == pytest.approx(twin(u, dy, dx, False), abs=1e-13)
        got = periodic.map()
        assert got.shape == shape
        for y in range(ny):
            for x in range(nx):
                expected = twin(u, y - ny // 2, x - nx // 2, True)
                assert got[y, x] == pytest.approx(expected, abs=1e-13)


def test_contrast(device):
    image = np.random.default_rng(4).gamma(4.0, size=(200, 300))
    # of a gamma distribution of shape 4, as 4 independent speckles have: 1/2
    assert speckle_contrast(image) == pytest.approx(0.5, rel=0.02)
    half = image.copy()
    half[:, 150:] = 3
    assert speckle_contrast(half, region=np.s_[:, 150:]) == 0
    mask = np.zeros(image.shape, bool)
    mask[3:90, 7:80] = True
    inside = image[3:90, 7:80]
    assert speckle_contrast(half, region=mask) == pytest.approx(inside.std() / inside.mean())
    field = to_field(np.sqrt(np.arange(70.0)).reshape(7, 10), device)
    expected = np.arange(70).std() / 34.5
    assert speckle_contrast(field.intensity()) == pytest.approx(expected, rel=1e-6)


# Bad input


def test_nothing_to_measure(device):
    with pytest.raises(ValueError, match="at least one snapshot"):
        measured_degree([], LAGS)
    with pytest.raises(ValueError, match="at least one snapshot"):
        DegreeEstimator(GRID).map()
    with pytest.raises(ValueError, match="dark"):
        measured_degree([to_field(np.zeros(GRID.shape), device)], LAGS)
    with pytest.raises(ValueError, match="must be positive"):
        speckle_contrast(np.zeros((3, 4)))
    with pytest.raises(ValueError, match="must contain samples"):
        speckle_contrast(np.ones((3, 4)), region=np.s_[5:, :])


def test_bad_lags(device):
    for periodic in [False, True]:
        for lags, axis, error, words in [
            ([(7, 0)], None, ValueError, r"\(6, 9\), got \(7, 0\)"),
            ([0, 10], "x", ValueError, r"\(6, 9\), got \(0, 10\)"),
            ([-7], "y", ValueError, r"\(6, 9\), got \(7, 0\)"),
            ([1.5], "x", ValueError, "must be integers"),
            ([np.inf], "x", ValueError, "must be integers"),
            ([], "x", ValueError, "must be integers"),
            (["1"], "x", ValueError, "must be integers"),
            ([1, 2, 3], None, ShapeError, r"shape \(..., 2\), got \(3,\)"),
            ([1], "z", ValueError, "'y' or 'x', got 'z'"),
        ]:
            field = to_field(samples(1)[0], device)
            with pytest.raises(error, match=words):
                measured_degree([field], lags, axis=axis, periodic=periodic)


def test_an_estimator_keeps_to_its_grid_and_reach(device):
    estimator = DegreeEstimator(GRID, reach=(1, 2))
    other = Grid(GRID.shape, GRID.pitch)
    with pytest.raises(ShapeError, match="field must have"):
        estimator.add(to_field(samples(1)[0], device, other))
    estimator.add(to_field(samples(1)[0], device))
    with pytest.raises(ValueError, match=r"along x must be at most 2 samples, got 3"):
        estimator.degree(0, [-3, 1])
    for reach in ((1,), (7, 0), (0, -1), (1, 2.5)):
        with pytest.raises(ValueError, match="reach"):
            DegreeEstimator(GRID, reach=reach)
