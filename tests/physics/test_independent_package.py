"""An optional cross-check with an independent package, HCIPy (Por et al. 2018).

Its `AngularSpectrumPropagator` is the same theory on the same samples, in float64: H over a window
of twice the grid where a sample is at least lam z/L, else the transform of the sampled
Rayleigh-Sommerfeld kernel, both with the carrier exp(ikz). It has no band limit and no guard, so
that the two agree only on light that stays inside the window and below 90 % of Nyquist: to
220 dB and better. By default it averages H over 2 x 2 points of every frequency cell, which dims
what lies off the axis: 60-75 dB; here that is switched off. The carrier of z/lam waves in float64
leaves an angle of 2 pi z/lam eps, 2e-12 rad, or 230 dB.
"""

from __future__ import annotations

import numpy as np
import pytest
from fields import LAM, band_limited, go
from setups import gaussian_2d
from tolerance import err_db, snr_db

from clplen import Grid

GRIDS = [Grid((100, 128), (4e-6, 3e-6)), Grid((111, 96), (3e-6, 4e-6))]


def by_hcipy(u: np.ndarray, grid: Grid, z: float, oversampling: int = 1) -> np.ndarray:
    """u after z, its carrier taken off."""
    hcipy = pytest.importorskip("hcipy", reason="the cross-check needs hcipy: pip install hcipy")
    (ny, nx), (dy, dx) = grid.shape, grid.pitch
    first = np.array([grid.x[0], grid.y[0]])
    coordinates = hcipy.RegularCoords(np.array([dx, dy]), np.array([nx, ny]), first)
    plane = hcipy.CartesianGrid(coordinates)
    propagator = hcipy.AngularSpectrumPropagator(plane, z, num_oversampling=oversampling)
    wave = hcipy.Wavefront(hcipy.Field(u.ravel().astype(complex), plane), LAM)
    made = np.asarray(propagator.forward(wave).electric_field).reshape(ny, nx)
    return made * np.exp(-2j * np.pi * (z / LAM % 1))


def middle(grid: Grid) -> np.ndarray:
    """A random band-limited field under a Gaussian in the middle of the window."""
    y, x = (v / e for v, e in zip((grid.y, grid.x), grid.extent, strict=True))
    envelope = np.exp(-90 * ((y[:, None] - 0.03) ** 2 + (x + 0.05) ** 2))
    return band_limited(grid.shape, 3, share=0.3) * envelope


def test_random_field(device, precise):
    for grid in GRIDS:
        for z in [6e-4, 2e-3, 7e-3]:
            u = middle(grid)
            theirs = by_hcipy(u, grid, z)
            for method in ("auto", "cblas"):
                assert err_db(theirs, go(u, grid, z, precise, method=method)) >= 160, method
                assert err_db(theirs, go(u, grid, z, device, method=method)) >= 120, method


def test_gaussian(precise):
    for grid in GRIDS:
        z = 1.3e-3
        a = gaussian_2d(
            grid.shape, grid.pitch, z, waist=min(grid.extent) / 13, centre=(9e-6, -1.4e-5)
        )
        ours, theirs = go(a.u, grid, z, precise), by_hcipy(a.u, grid, z)
        assert err_db(a.exact, theirs) >= 200
        assert err_db(theirs, ours) >= 200
        assert err_db(theirs, ours.conj()) < 10
        averaged = by_hcipy(a.u, grid, z, oversampling=2)
        assert 50 <= err_db(ours, averaged) <= 100
        assert snr_db(ours, averaged) <= 130  # not a constant alone
