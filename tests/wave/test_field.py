"""Grids and fields."""

import numpy as np
import pytest

from clplen import Field, Grid, ShapeError, propagate


def test_grid_axes():
    for shape in [(4, 5), (5, 4), (1, 7)]:
        grid = Grid(shape, (2e-6, 3e-6), origin=(1e-6, -0.5e-6))
        assert grid.y[shape[0] // 2] == 1e-6
        assert grid.x[shape[1] // 2] == -0.5e-6
        np.testing.assert_allclose(np.diff(grid.x), 3e-6, rtol=1e-9)
        np.testing.assert_array_equal(grid.fx, np.fft.fftfreq(shape[1], 3e-6))
        assert grid.y.dtype == np.float64


def test_samples_of_light_that_has_gone_far_may_be_wider(device):
    field = Field.from_array(np.ones((3, 4)), Grid((3, 4), 1e-3), wavelength=5e-7, device=device)
    far = propagate(field, 1e9, method="fresnel-1fft", pad=1)
    assert far.grid.pitch == pytest.approx((5e-7 * 1e9 / 3e-3, 5e-7 * 1e9 / 4e-3))
    assert Field.from_array(far.to_numpy(), far.grid, wavelength=5e-7, device=device).power() > 0


def test_round_trip_keeps_batch_and_dtype(device):
    u = np.arange(24).reshape(2, 3, 4) * (1 + 2j)
    field = Field.from_array(u, Grid((3, 4), 1e-6), wavelength=5e-7, device=device)
    assert field.to_numpy().dtype == np.complex64
    np.testing.assert_array_equal(field.to_numpy(), u.astype(np.complex64))
    assert field.power().shape == (2,)


def test_bad_grids():
    for shape in [(3,), 5, (0, 4), (2.5, 4), (2, 3, 4), (np.nan, 4), (10**400, 4), "ab"]:
        with pytest.raises(ShapeError, match=r"two positive integers \(ny, nx\)"):
            Grid(shape, 1e-6)
    for pitch in [0, -1e-6, np.nan, (1e-6, np.inf)]:
        with pytest.raises(ValueError, match="pitch must be positive and finite"):
            Grid((3, 4), pitch)
    for pitch, hint in [(10, "1e-05"), ((5e-6, 6.6), "6.6e-06"), (650.0, "0.00065")]:
        with pytest.raises(ValueError, match=f"must be in metres, at most 1, got .*mean {hint}"):
            Grid((3, 4), pitch)
    for origin in [(np.nan, 0.0), (1e300, 0.0), (0, -2e12), (10**400, 0)]:
        with pytest.raises(ValueError, match=r"origin must be (finite|in metres)"):
            Grid((3, 4), 5e-6, origin=origin)


def test_bad_fields(device):
    grid, ones = Grid((3, 4), 1e-6), np.ones((3, 4), complex)
    with pytest.raises(ShapeError, match=r"grid's shape \(3, 4\), got \(4, 3\)"):
        Field.from_array(ones.T, grid, wavelength=5e-7, device=device)
    for bad in [np.nan, np.inf, 1j * np.nan]:
        u = ones.copy()
        u[1, 2] = bad
        with pytest.raises(ValueError, match="NaN or infinite, which a propagation would"):
            Field.from_array(u, grid, wavelength=5e-7, device=device)
    for wavelength in [0, -5e-7, np.nan]:
        with pytest.raises(ValueError, match="wavelength must be positive"):
            Field.from_array(ones, grid, wavelength=wavelength, device=device)
