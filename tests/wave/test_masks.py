"""Random phase masks against the closed forms of their degree of coherence."""

import math

import numpy as np
import pytest

from clplen import Grid, SamplingError, SamplingWarning
from clplen.wave import RandomPhaseMask
from clplen.wave.coherence.phase_masks import hard_limited

LAM = 550e-9
N, DX, CELLS = 256, 2e-6, 32
CELL = N * DX / CELLS
GRID = Grid((N, N), DX)


def snapshots(mask, device, count, grid=GRID, seed=3):
    for index in range(count):
        field = mask.field(grid, wavelength=LAM, device=device, seed=seed, index=index)
        yield field.to_numpy().astype(complex)


def measured_degree(fields):
    """Mean autocorrelation over a periodic window, 1 at lag 0, FFT order."""
    power = sum(np.abs(np.fft.fft2(u)) ** 2 for u in fields)
    mu = np.fft.ifft2(power)
    return (mu / mu[0, 0]).real


def lags(grid):
    return [np.fft.fftfreq(n, 1 / (n * d)) for n, d in zip(grid.shape, grid.pitch, strict=True)]


def deviation(mask, device, grid=GRID, count=40):
    """rms of measured less stated degree over displacements up to two cells."""
    y, x = lags(grid)
    error = measured_degree(snapshots(mask, device, count, grid)) - mask.degree(y[:, None], x)
    py, px = mask.cells
    near = error[np.ix_(np.abs(y) <= 2 * py, np.abs(x) <= 2 * px)]
    return math.sqrt((near**2).mean())


@pytest.mark.thorough
def test_degree_of_coherence_does_not_depend_on_the_distance(device):
    for kernel in ["square", "gaussian"]:
        fields = {}
        for factor in (0, 0.25, 4):
            mask = RandomPhaseMask(CELL, kernel=kernel, distance=factor * CELL**2 / LAM)
            assert deviation(mask, device) <= 0.01
            fields[factor] = measured_degree(snapshots(mask, device, 4))
        assert np.abs(fields[0] - fields[4]).max() < 1e-4  # propagation is unitary
        assert np.abs(fields[0] - fields[0.25]).max() < 1e-4


def test_degree_on_a_rectangle_of_oblong_cells(device):
    # 25 x 36 cells of 5.04 x 5 samples: swapped axes would be off by .1
    grid = Grid((126, 180), (3e-6, 2e-6))
    mask = RandomPhaseMask((126 * 3e-6 / 25, 10e-6), distance=0)
    assert deviation(mask, device, grid, 80) <= 0.01


def test_degree_of_the_phase_alone(device):
    for factor in [2, 4]:
        mask = RandomPhaseMask(CELL, distance=factor * CELL**2 / LAM, kind="phase")
        assert deviation(mask, device, count=60) <= 0.01
        u = next(snapshots(mask, device, 1))
        assert np.abs(np.abs(u) - 1).max() < 1e-6


def test_the_law_of_the_phase_alone():
    found = hard_limited([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
    expected = [0, 0.07864, 0.23836, 0.40630, 0.59194, 0.82044, 1]
    assert np.abs(found - expected).max() < 6e-6  # as printed


@pytest.mark.thorough
def test_contrast_of_speckle_grows_with_the_distance(device):
    row = {0: 0.0, 0.1: 0.62, 0.25: 0.81, 0.5: 1.03, 1: 0.79, 2: 0.944, 4: 0.985, 8: 0.998}
    for factor, expected in row.items():
        mask = RandomPhaseMask(CELL, distance=factor * CELL**2 / LAM)
        intensities = [np.abs(u) ** 2 for u in snapshots(mask, device, 12)]
        contrast = np.mean([i.std() / i.mean() for i in intensities])
        assert contrast == pytest.approx(expected, abs=0.03)


@pytest.mark.thorough
def test_jitter_removes_the_lattice_from_the_mean(device):
    grid, count = Grid((64, 64), 4e-6), 400
    residual = {}
    for jitter in (True, False):
        # at p^2/(2 lam) the mean over unmoved blocks has the period of the lattice; at 4 p^2/lam
        # its harmonics are those of the blocks' own intensity, which is even
        mask = RandomPhaseMask(32e-6, distance=0.5 * 32e-6**2 / LAM, jitter=jitter)
        mean = sum(np.abs(u) ** 2 for u in snapshots(mask, device, count, grid)) / count
        residual[jitter] = mean.std() / mean.mean()
    assert residual[True] <= 1.2 / math.sqrt(count)
    assert residual[False] > 3 * residual[True]


def test_mean_intensity_is_one(device):
    for kernel in ["square", "gaussian"]:
        mask = RandomPhaseMask(CELL, kernel=kernel)
        means = [np.mean(np.abs(u) ** 2) for u in snapshots(mask, device, 30)]
        assert np.mean(means) == pytest.approx(1, abs=3 * np.std(means) / math.sqrt(30) + 1e-6)


def test_snapshots_are_the_same_in_any_order_and_precision(device, precise):
    mask = RandomPhaseMask(CELL, kernel="gaussian")
    forward = [u.copy() for u in snapshots(mask, device, 3)]
    again = mask.field(GRID, wavelength=LAM, device=device, seed=3, index=1).to_numpy()
    assert np.array_equal(forward[1], again.astype(complex))
    exact = mask.field(GRID, wavelength=LAM, device=precise, seed=3, index=1).to_numpy()
    assert np.linalg.norm(exact - again) / np.linalg.norm(exact) < 2e-6
    assert np.abs(forward[0] - forward[1]).max() > 0.5
    other = mask.field(GRID, wavelength=LAM, device=device, seed=4, index=1).to_numpy()
    assert np.abs(other - again).max() > 0.5


def test_one_axis(device):
    for shape in [(1, 1536), (1536, 1)]:
        grid = Grid(shape, 2e-6)
        mask = RandomPhaseMask(12e-6, distance=0)
        y, x = lags(grid)
        mu = measured_degree(snapshots(mask, device, 25, grid))
        assert np.abs(mu - mask.degree(y[:, None], x)).max() < 0.06  # 3/sqrt(25 x 256 cells) x 1.6
        spectrum = mask.power_spectrum(grid)
        assert spectrum.shape == shape
        assert spectrum.sum() == pytest.approx(1)


@pytest.mark.thorough
def test_power_spectrum_is_that_of_the_snapshots(device):
    grid = Grid((48, 40), (3e-6, 2e-6))
    mask = RandomPhaseMask((12e-6, 10e-6))
    power = sum(np.abs(np.fft.fft2(u)) ** 2 for u in snapshots(mask, device, 600, grid))
    expected = mask.power_spectrum(grid)
    error = power / power.sum() - expected
    # each of 600 values of |U|^2 scatters by its mean
    assert np.abs(error).max() < 5 * expected.max() / math.sqrt(600)
    assert np.linalg.norm(error) < 2 * np.linalg.norm(expected) / math.sqrt(600)


def test_cells_that_do_not_fit_name_the_nearest_that_does(device):
    for cell, words in [
        (1.5 * DX, r"fewer than 2 samples.*4 um, 128 cells along y"),
        (15.3e-6, r"window of 512 um must hold an integer number.*15.5152 um, 33 cells along y"),
        (N * DX, r"must hold .*256 um, 2 cells"),
        ((16e-6, 15e-6), r"15.0588 um, 34 cells along x"),
    ]:
        mask = RandomPhaseMask(cell)
        with pytest.raises(SamplingError, match=words):
            mask.field(GRID, wavelength=LAM, device=device, seed=0, index=0)


def test_a_short_distance_warns_with_the_one_needed():
    mask = RandomPhaseMask(CELL, distance=1e-3)
    with pytest.warns(SamplingWarning, match=r"at least 4 p\^2/lam = 1.86182 mm"):
        mask.check(GRID, wavelength=LAM)
    RandomPhaseMask(CELL).check(GRID, wavelength=LAM)


def test_bad_values():
    for make in [
        lambda: RandomPhaseMask(0),
        lambda: RandomPhaseMask((1e-6, -1e-6)),
        lambda: RandomPhaseMask(math.nan),
        lambda: RandomPhaseMask(1e-6, kernel="disc"),
        lambda: RandomPhaseMask(1e-6, kind="amplitude"),
        lambda: RandomPhaseMask(1e-6, distance=-1),
        lambda: RandomPhaseMask(1e-6, distance=math.inf),
    ]:
        with pytest.raises(ValueError, match=r"."):
            make()
