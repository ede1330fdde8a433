"""plane_waves.cl: sums of plane waves against complex128."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.errors import ShapeError
from clplen.wave.coherence import extended_source as module
from clplen.wave.coherence.extended_source import plane_waves
from clplen.wave.field.field import Grid


def waves(points, seed=3):
    random = np.random.default_rng(seed)
    amplitudes = random.standard_normal(points) + 1j * random.standard_normal(points)
    return random.uniform(-4e4, 7e4, (points, 2)), amplitudes


def twin(frequencies, amplitudes, grid):
    turns = [
        np.multiply.outer(f, s if len(s) > 1 else 0 * s)
        for f, s in zip(frequencies.T, (grid.y, grid.x), strict=True)
    ]
    ey, ex = (np.exp(2j * np.pi * (t - np.rint(t))) for t in turns)
    return np.einsum("p,py,px->yx", amplitudes, ey, ex)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_sum_of_waves(wave):
    for points in [1, 13]:
        for shape in [(7, 11), (8, 12), (1, 33), (40, 1), (5, 38), (1, 1)]:
            # thousands of turns at the origin of the window
            grid = Grid(shape, (5e-6, 4e-6), origin=(3e-2, -7e-2))
            frequencies, amplitudes = waves(points)
            got = plane_waves(frequencies, amplitudes, grid=grid, wavelength=5e-7, device=wave)
            assert got.grid == grid
            assert got.wavelength == 5e-7
            # tables and sums rounded to eps each; turns of 5e3 keep 1e-12 in float64
            limit = 8 * np.finfo(np.float32).eps if wave.precision == "single" else 2e-11
            expected = twin(frequencies, amplitudes, grid)
            assert relative_max(expected, got.to_numpy().astype(np.complex128)) <= limit


def check_blocks_that_do_not_fit_the_window(device, monkeypatch, blocks):
    monkeypatch.setattr(module, "_blocks", lambda device: module._Blocks(*blocks))
    frequencies, amplitudes = waves(5)
    for shape in ((5, 37), (6, 40)):
        grid = Grid(shape, (5e-6, 4e-6))
        got = plane_waves(frequencies, amplitudes, grid=grid, wavelength=5e-7, device=device)
        limit = 8 * np.finfo(np.float32).eps
        assert relative_max(twin(frequencies, amplitudes, grid), got.to_numpy()) <= limit


def test_blocks_that_do_not_fit_the_window(device, monkeypatch):
    for blocks in [(1, 1, 4), (4, 1, 3), (4, 2, 2), (8, 1, 1)]:
        check_blocks_that_do_not_fit_the_window(device, monkeypatch, blocks)


def test_shapes_must_fit(device):
    frequencies, amplitudes = waves(5)
    grid = Grid((4, 4), 1e-6)
    for f, a in ((frequencies[:4], amplitudes), (frequencies.T, amplitudes), (frequencies[:0], [])):
        with pytest.raises(ShapeError, match="plane waves must have shape"):
            plane_waves(f, a, grid=grid, wavelength=5e-7, device=device)
