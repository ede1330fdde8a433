"""transmission_gradient.cl: sums over a batch, and moments along the rows, against NumPy."""

import numpy as np
import pytest

from clplen.wave.field.field import Field, Grid
from clplen.wave.field.field_gradients import log_moments, transmission_gradient

GRID = Grid((23, 37), (0.9e-6, 1.3e-6), origin=(4e-6, -2e-6))


def waves(seed, shape):
    random = np.random.default_rng(seed)
    return random.normal(size=shape) + 1j * random.normal(size=shape) + (0.3 + 0.1j)


def fields(where, batch):
    return [
        Field.from_array(waves(seed, (*batch, *GRID.shape)), GRID, wavelength=5e-7, device=where)
        for seed in (1, 2)
    ]


def product(batch):
    u, g = (waves(seed, (*batch, *GRID.shape)) for seed in (1, 2))
    return (u.conj() * g).reshape(-1, *GRID.shape).sum(axis=0)


@pytest.mark.parametrize(
    ("wave", "tolerance", "batch"),
    [("single", 1e-6, (2, 5)), ("double", 1e-14, ())],
    indirect=["wave"],
)
def test_sums_over_a_batch(wave, tolerance, batch):
    expected = product(batch)
    got = wave.download(transmission_gradient(*fields(wave, batch)))
    assert got.dtype == wave.complex
    assert np.abs(got - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize(
    ("wave", "tolerance", "order"), [("single", 3e-6, 3), ("double", 1e-13, 1)], indirect=["wave"]
)
def test_moments(wave, tolerance, order):
    powers = np.arange(order + 1)[:, None]
    y, x = GRID.y**powers, GRID.x**powers
    expected = y @ product((2,)) @ x.T
    got = log_moments(*fields(wave, (2,)), GRID.y, GRID.x, order=order)
    scale = np.abs(GRID.y).max() ** powers * np.abs(GRID.x).max() ** powers.T
    assert (np.abs(got - expected) / scale).max() <= tolerance * (np.abs(expected) / scale).max()
