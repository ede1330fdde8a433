"""Phases in float32: H, the field after one step."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fields import field_of, step
from setups import LAM
from tolerance import err_db

from clplen import Field, Grid, Propagator

pytestmark = pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")


ROUNDING = 6e-7  # of a product of float32 phasors


@lru_cache
def two_fields(n: int) -> np.ndarray:
    """Gaussian of waist S/16, and a square S/2 of random phases, shape (2, n, n)."""
    x = (np.arange(n) - n // 2) / n
    rng = np.random.default_rng(n)
    square = np.multiply.outer(*2 * (np.abs(x) < 0.25,))
    waves = np.exp(2j * np.pi * rng.random((n, n)))
    return np.stack([np.exp(-256 * np.add.outer(x**2, x**2)), square * waves])


@pytest.mark.parametrize("method", ["as", "blas", "cblas", "rs"])
def test_one_step_keeps_120_db(device, precise, method):
    """Where the method is valid, up to 1 m on samples of 6.6 um."""
    for z in (1e-3, 0.24):
        u, dx = two_fields(509), 6.6e-6
        with_warning = Propagator(
            field_of(u, dx, device).grid, z, wavelength=LAM, method=method, device=device
        ).report
        if not with_warning.fully_sampled_from <= z <= with_warning.fully_sampled_to:
            assert with_warning.warning
            continue
        exact, got = (step(u, dx, z, dev, method=method) for dev in (precise, device))
        for one, two in zip(exact, got, strict=True):
            assert err_db(one, two) >= 120


UNLIKE = [  # shape, pitch, z, wavelength, method, output
    ((1, 257), 7.2e-6, 8.5, 2e-6, "as", None),  # 200 turns beside the tables
    ((33, 256), 0.52e-6, 1.7e-5, 400e-9, "rs", None),  # 1050
    ((17, 509), 0.9e-6, 5e-4, 1.06e-6, "auto", Grid((19, 301), 1.3e-6, origin=(3e-6, -9e-5))),  # 17
    ((61, 47), 8e-6, -0.03, 10e-6, "blas", None),
    ((64, 64), 8.3e-6, -4.5e-3, 10e-6, "auto", Grid((50, 31), 6e-6, origin=(1e-5, 2e-5))),
    ((41, 60), 0.3e-6, 1e-5, 550e-9, "auto", Grid((30, 43), 0.4e-6, origin=(0, 1e-6))),
]


@pytest.mark.parametrize(("shape", "pitch", "z", "wavelength", "method", "out"), UNLIKE)
def test_every_route_of_the_phase_keeps_the_light(
    device, precise, monkeypatch, shape, pitch, z, wavelength, method, out
):
    """To rounding, 6e-7; and the one that is taken does not depend on the device."""
    grid = Grid(shape, pitch)
    rng = np.random.default_rng(5)
    u = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)

    def result(where, phase):
        plan = Propagator(
            grid, z, wavelength=wavelength, method=method, out_grid=out, device=where, phase=phase
        )
        return plan(Field.from_array(u, grid, wavelength=wavelength, device=where)).to_numpy()

    exact = result(precise, None)
    for phase in ("tables", "twofloat", *(["fp64"] if device.has_fp64 else [])):
        got = result(device, phase)
        assert np.linalg.norm(got - exact) <= ROUNDING * np.linalg.norm(exact), phase
    taken = result(device, None)
    monkeypatch.setattr(device, "has_fp64", not device.has_fp64)
    np.testing.assert_array_equal(result(device, None), taken)
