"""masks.cl: random phases of cells, their spread over samples, the phase alone."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.wave.coherence.spatial_models import key_of, philox

SEED = 0x123456789ABCDEF0


def phasors(device, shape, index, seed=SEED):
    out = device.empty(shape, device.complex)
    kernel = device.kernel("masks.cl", "cell_phasors", **device.wave_defines())
    sizes = (np.int32(n) for n in shape)
    device.launch_rows(kernel, shape, out, np.uint32(index), key_of(seed), *sizes)
    return device.download(out)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_phases_are_those_of_the_counter(wave):
    for index in [0, 7, 2**32 - 1]:
        shape = (5, 13)
        y, x = np.indices(shape)
        counters = np.stack([x // 4, y, np.full(shape, index), np.zeros(shape)], axis=-1)
        words = philox(counters.astype(np.uint32), key_of(SEED))
        turns = np.take_along_axis(words, x[..., None] % 4, axis=-1)[..., 0] / 2.0**32
        # single: the phase in steps of 2^-24 turns (3.7e-7 rad) and the polynomials, 2e-7
        limit = 6e-7 if wave.precision == "single" else 1e-14
        assert relative_max(np.exp(2j * np.pi * turns), phasors(wave, shape, index)) <= limit


def test_both_halves_of_the_seed_count(device):
    first, low, high = (phasors(device, (4, 4), 0, seed) for seed in (5, 6, 5 + 2**32))
    assert np.abs(first - low).max() > 0.5
    assert np.abs(first - high).max() > 0.5


def check_cells_are_spread_over_samples(wave, taps):
    rng = np.random.default_rng(3)
    my, mx, ny, nx = 4, 7, 11, 19
    cells = rng.normal(size=(my, mx)) + 1j * rng.normal(size=(my, mx))
    rows_at, columns_at = rng.integers(0, my, (ny, taps)), rng.integers(0, mx, (nx, taps))
    rows_w, columns_w = rng.random((ny, taps)), rng.random((nx, taps))
    defines = wave.wave_defines() | {"TAPS": taps}

    def up(values):
        kind = np.int32 if values.dtype.kind == "i" else wave.real
        return wave.upload(values.astype(wave.complex if values.dtype.kind == "c" else kind))

    rows, out = wave.empty((ny, mx), wave.complex), wave.empty((ny, nx), wave.complex)
    wave.launch_rows(
        wave.kernel("masks.cl", "spread_rows", **defines),
        rows.shape, rows, up(cells), up(rows_at), up(rows_w), np.int32(ny), np.int32(mx),
    )  # fmt: skip
    wave.launch_rows(
        wave.kernel("masks.cl", "spread", **defines),
        out.shape, out, rows, up(columns_at), up(columns_w), np.int32(mx), np.int32(ny),
        np.int32(nx),
    )  # fmt: skip
    expected = np.einsum("ya,xb,yaxb->yx", rows_w, columns_w, cells[rows_at][:, :, columns_at])
    # sums of up to 25 products of magnitudes near the result
    assert relative_max(expected, wave.download(out)) <= 32 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_cells_are_spread_over_samples(wave):
    for taps in [1, 5]:
        check_cells_are_spread_over_samples(wave, taps)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_the_phase_alone(wave):
    rng = np.random.default_rng(4)
    u = rng.normal(size=(2, 3, 17)) + 1j * rng.normal(size=(2, 3, 17))
    u[0, 1, 3] = 0
    data = wave.upload(u.astype(wave.complex))
    kernel = wave.kernel("masks.cl", "unit_phase", **wave.wave_defines())
    wave.launch_rows(kernel, u.shape, data, np.int32(3), np.int32(17))
    expected = np.where(u == 0, 1, u / np.where(u == 0, 1, np.abs(u)))
    assert relative_max(expected, wave.download(data)) <= 4 * np.finfo(wave.real).eps
