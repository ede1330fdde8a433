"""statistics.cl: running mean and variance, standard errors, sums over a region."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import Statistics, Window

SHAPE = (5, 37)


def some_fields(device, shape, count=7):
    rng = np.random.default_rng(count)
    u = rng.normal(size=(count, *shape)) + 1j * rng.normal(size=(count, *shape)) + 2
    grid = Grid(shape, 1e-6)
    return u, [Field.from_array(one, grid, wavelength=5e-7, device=device) for one in u]


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
@pytest.mark.parametrize("images", [False, True])
def test_mean_and_standard_error(wave, images):
    u, fields = some_fields(wave, SHAPE)
    statistics = Statistics(SHAPE, wave)
    for field in fields:
        statistics.add(field.intensity().data if images else field)
    intensity = np.abs(u) ** 2
    eps = np.finfo(wave.real).eps
    # each of 7 updates rounds a few times
    assert relative_max(intensity.mean(0), statistics.image().to_numpy()) <= 16 * eps
    expected = intensity.std(0, ddof=1) / np.sqrt(len(u))
    assert relative_max(expected, statistics.standard_error().to_numpy()) <= 32 * eps


def test_one_snapshot_has_no_error(device):
    _, fields = some_fields(device, SHAPE)
    statistics = Statistics((5, 37), device)
    statistics.add(fields[0])
    assert np.isnan(statistics.standard_error().to_numpy()).all()
    assert np.isnan(statistics.relative_error(Window.of(None, SHAPE)))


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_relative_error_of_a_region(wave):
    u, fields = some_fields(wave, SHAPE)
    statistics = Statistics(SHAPE, wave)
    for field in fields:
        statistics.add(field)
    for region in (None, (slice(1, 4), slice(3, 21)), (slice(-1, None), slice(2))):
        rows, columns = region or (slice(None), slice(None))
        chosen = (np.abs(u) ** 2)[:, rows, columns]
        error = chosen.std(0, ddof=1) / np.sqrt(len(u))
        expected = np.sqrt((error**2).mean()) / chosen.mean()
        found = statistics.relative_error(Window.of(region, SHAPE))
        assert found == pytest.approx(expected, rel=32 * float(np.finfo(wave.real).eps))


def test_a_region_without_pixels_is_refused():
    for region in ((slice(3), slice(40, 50)), (slice(0, 5, 2), slice(3)), (1, slice(3)), "all"):
        with pytest.raises(ValueError, match=r"region"):
            Window.of(region, SHAPE)
