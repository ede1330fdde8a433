"""intensity.cl: intensity, its accumulation over a batch, sums of rows."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.wave.field.field import Field, Grid, row_powers
from clplen.wave.field.intensity import add_scaled

SHAPES = [(1, 13), (13, 1), (5, 67), (16, 64)]


def random_field(device, shape, grid_shape):
    rng = np.random.default_rng(sum(shape))
    u = rng.normal(size=shape) + 1j * rng.normal(size=shape) + (0.3 - 0.1j)
    grid = Grid(grid_shape, (3e-6, 2e-6))
    return u, Field.from_array(u, grid, wavelength=5e-7, device=device)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_intensity(wave):
    for shape in SHAPES:
        u, field = random_field(wave, (3, *shape), shape)
        eps = np.finfo(wave.real).eps
        # rounding of the samples (twice eps/2), two squares and a sum
        assert relative_max(np.abs(u) ** 2, field.intensity().to_numpy()) <= 4 * eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_accumulate_adds_weighted_intensities(wave):
    for shape in SHAPES:
        u, field = random_field(wave, (3, *shape), shape)
        start = np.arange(np.prod(shape), dtype=np.float64).reshape(shape)
        weights = np.array([0.5, 2.0, 0.25])
        total = wave.upload(start.astype(wave.real))
        kernel = wave.kernel("intensity.cl", "accumulate", **wave.wave_defines())
        wave.launch_rows(
            kernel,
            shape,
            total,
            field.data,
            wave.upload(weights.astype(wave.real)),
            np.int32(3),
            np.int32(shape[0]),
            np.int32(shape[1]),
        )
        expected = start + np.tensordot(weights, np.abs(u) ** 2, axes=1)
        assert relative_max(expected, wave.download(total)) <= 8 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_add_scaled(wave):
    for shape in SHAPES:
        rng = np.random.default_rng(sum(shape))
        start, picture = rng.normal(size=(2, *shape)).astype(wave.real)
        total = wave.upload(start)
        add_scaled(total, wave.upload(picture), -0.375, wave)
        expected = start.astype(np.float64) - 0.375 * picture.astype(np.float64)
        # the product and the sum are rounded once each
        assert relative_max(expected, wave.download(total)) <= 2 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_row_powers_are_compensated(wave):
    # 4096 equal terms: a plain float32 sum would be off by about 1e-5.
    values = np.full((2, 3, 4096), 0.1 + 0.2j)
    values[:, 1] *= 3
    field = Field.from_array(values, Grid((3, 4096), 1e-6), wavelength=5e-7, device=wave)
    expected = (np.abs(values) ** 2).sum(axis=-1)
    assert relative_max(expected, row_powers(field)) <= 4 * np.finfo(wave.real).eps
