"""Phases in float32: H, the field after one step."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from fields import field_of, step
from reference_optics import blas_limit
from setups import LAM
from tolerance import err_db

from clplen import Device, Field, Grid, Propagator
from clplen.wave.propagation.transfer_function import Transfer

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


GRIDS = [  # N, dx, z
    (3030, 6.6e-6, 0.010),
    (3030, 6.6e-6, 0.240),
    (3030, 5e-6, 0.240),
    (3030, 6.6e-6, 1.0),
    (8192, 6.6e-6, 0.6),
    (2048, 0.5e-6, 1e-3),
    (2048, 0.2e-6, 1e-3),
]


ROWS = 24


def sampled(n: int, dx: float, z: float) -> tuple[Transfer, np.ndarray]:
    """Some rows and every column of H in the band of the window 2 N, and H in double.

    The highest frequencies of the band are among the rows: the error grows with them.
    """
    f = np.arange(n + 1) / (2 * n * dx)
    f = f[(f < blas_limit(2 * n * dx, z, LAM)) & (LAM * f < 1)]
    some = np.unique(np.linspace(0, f.size - 1, ROWS).astype(int))
    rows = np.unique(np.append(f[some], f[-4:]))
    s = (LAM * rows[:, None]) ** 2 + (LAM * f) ** 2
    inside = np.minimum(s, 1)
    exact = np.exp(-2j * np.pi * (z / LAM) * inside / (1 + np.sqrt(1 - inside)))
    exact[s > 1] = np.nan  # evanescent
    ones = (np.ones(rows.size), np.ones(f.size))
    return Transfer((rows.size, f.size), (rows, f), ones, z, LAM), exact


def transposed(h: Transfer) -> Transfer:
    """The same with the rows in the place of the columns."""
    return Transfer(h.shape[::-1], h.frequencies[::-1], h.weights[::-1], h.z, h.wavelength)


def worst(h: Transfer, exact: np.ndarray, device: Device, phase: str) -> float:
    """Largest error of rows and of columns."""
    rows = device.download(h.on_device(device, phase).values)
    columns = device.download(transposed(h).on_device(device, phase).values)
    assert rows.shape == exact.shape
    return float(max(np.nanmax(np.abs(got - exact)) for got in (rows, columns.T)))


@pytest.mark.parametrize(("n", "dx", "z"), GRIDS)
def test_errors_of_the_transfer_function(device, n, dx, z):
    """Not more than rounding, whatever the residual."""
    h, exact = sampled(n, dx, z)
    for phase in ("tables", "twofloat", *(["fp64"] if device.has_fp64 else [])):
        assert worst(h, exact, device, phase) <= ROUNDING, phase
