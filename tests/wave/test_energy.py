"""Where the energy of a propagated field goes."""

from __future__ import annotations

import numpy as np
import pytest
from fields import LAM, band_limited, field_of

from clplen import Field, Grid, Propagator
from clplen.errors import DeviceError, SamplingError
from clplen.wave.propagation import methods
from clplen.wave.propagation.transfer_function import Transfer


def test_energy_of_a_batch_and_of_nothing(device):
    grid = Grid((12, 15), 3e-6)
    u = np.stack([band_limited(grid.shape, 1), 2 * band_limited(grid.shape, 2)])
    field = field_of(u, grid, device)
    still = Propagator(grid, 0, wavelength=LAM, device=device).energy(field)
    assert (still.into, still.window) == pytest.approx([np.sum(field.power())] * 2)
    assert (still.outside, still.cut) == (0, 0)
    made = Propagator(grid, 1e-4, wavelength=LAM, method="as", device=device)
    parts = [made.energy(field_of(one, grid, device)) for one in u]
    whole = made.energy(field)
    for name in ("into", "window", "outside"):
        assert getattr(whole, name) == pytest.approx(sum(getattr(p, name) for p in parts), rel=1e-5)


def test_no_energy_budget_without_a_window(device):
    for method in ["rs", "fresnel-tf", "fresnel-1fft"]:
        grid = Grid((8, 9), 3e-6)
        made = Propagator(grid, 4e-3, wavelength=LAM, method=method, pad=1, device=device)
        with pytest.raises(SamplingError, match=r"energy\(\) requires as, blas or cblas"):
            made.energy(Field.from_array(np.ones((8, 9)), grid, wavelength=LAM, device=device))


def test_energy_of_the_few_frequencies_that_auto_takes_far_away(precise, monkeypatch):
    """By FFTs of a window, where the plan itself takes chirp-z transforms."""
    few_are_less = {"chirp-z": 0.5, "fft": 1.0}  # as on grids of thousands of samples
    monkeypatch.setattr(methods, "flops", lambda made: few_are_less[made.kind])
    grid = Grid((20, 150), 2e-6)
    u = np.exp(-((grid.y[:, None] / 1e-5) ** 2) - ((grid.x - 1.2e-5) / 1e-5) ** 2)
    field = field_of(u, grid, precise)
    made = Propagator(grid, 0.02, wavelength=LAM, device=precise)
    assert (made.method, made.description.kind) == ("cblas", "chirp-z")
    energy = made.energy(field)
    # Two ways to the same sums in float64; a guard of 6 for one of them would show.
    assert energy.window == pytest.approx(made(field).power(), rel=1e-11, abs=0)
    parts = energy.window + energy.outside + energy.cut
    assert parts == pytest.approx(energy.into, rel=1e-11, abs=0)


def test_energy_asks_for_memory_before_it_takes_any(device, monkeypatch):
    grid = Grid((20, 30), 3e-6)
    made = Propagator(grid, 1e-4, wavelength=LAM, method="as", device=device)
    field = field_of(band_limited(grid.shape), grid, device)
    monkeypatch.setattr(Transfer, "on_device", lambda *_: pytest.fail("made H"))
    monkeypatch.setattr(device, "memory_bytes", 4 * 40 * 60 * 8 - 1)
    with pytest.raises(DeviceError, match="This energy budget needs 76,800 bytes"):
        made.energy(field)
