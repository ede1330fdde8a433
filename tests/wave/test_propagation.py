"""Plans and propagations: batches, distances, wavelengths, what is kept and what is reported."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from fields import LAM, band_limited, field_of, go, staying
from reference_corrected import corrected
from tolerance import err_db

from clplen import Device, Grid, Propagator, SamplingWarning, propagate
from clplen.wave.propagation.free_space import plan, propagate_wavelengths

METHODS = (
    "auto", "as", "blas", "cblas", "rs", "one-step",
    "fresnel-tf", "fresnel-ir", "fresnel-1fft", "fresnel-multistep",
)  # fmt: skip
FAR = {"one-step": 1000}  # times the distance where a method is refused nearer
SAME = 130  # dB between two ways to the same sums in complex64


@pytest.fixture
def on_device(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device with a GPU's route: its arrays stay on it."""
    return staying(device, monkeypatch)


# Batches, distances, wavelengths ----------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_a_batch_is_its_fields(device):
    for method in METHODS:
        grid = Grid((12, 17), 3e-6)
        u = np.stack([[band_limited(grid.shape, s) for s in (1, 2, 3)] for _ in range(2)])
        u[1] *= 2j
        z = 3e-4 * FAR.get(method, 1)
        field = field_of(u, grid, device)
        batch = propagate(field, z, method=method)
        assert batch.shape == (2, 3, 12, 17)
        np.testing.assert_array_equal(field.to_numpy(), u.astype(device.complex))  # unchanged
        alone = propagate(field_of(u[1, 2], grid, device), z, method=method)
        assert alone.grid == batch.grid
        assert err_db(alone.to_numpy(), batch.to_numpy()[1, 2]) >= SAME


def test_an_empty_batch(device):
    grid, out = Grid((4, 5), 3e-6), Grid((6, 7), 2e-6)
    field = field_of(np.zeros((0, 4, 5)), grid, device)
    assert propagate(field, 1e-3).shape == (0, 4, 5)
    assert propagate(field, [1e-3, 2e-3], out_grid=out).shape == (2, 0, 6, 7)


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_several_distances(device):
    """Near and far, back, the same twice, and none: each as by itself, in its place."""
    for method in [m for m in METHODS if m != "fresnel-1fft"]:
        grid = Grid((21, 32), (3e-6, 2e-6))
        u = np.stack([band_limited(grid.shape, seed) for seed in (1, 2)])
        field = field_of(u, grid, device)
        z = [one * FAR.get(method, 1) for one in (3e-3, 2e-4, 0.0, -1e-4, 2e-4, 0.4)]
        together = propagate(field, z, method=method)
        assert together.shape == (6, 2, 21, 32)
        for one, got in zip(z, together.to_numpy(), strict=True):
            alone = propagate(field, one, method=method).to_numpy()
            assert err_db(alone, got) >= SAME, one
        assert propagate(field, np.array([1e-3])).shape == (1, 2, 21, 32)


def test_several_distances_to_another_grid(device):
    """Forth and back by as much: bands of one length that lie on two sides."""
    grid, out = Grid((21, 32), (3e-6, 2e-6)), Grid((20, 30), 2.5e-6, origin=(2e-4, -5e-4))
    field = field_of(band_limited(grid.shape), grid, device)
    z = [4e-3, -4e-3, 5e-3, 4e-3]
    together = propagate(field, z, out_grid=out)
    assert together.grid == out
    for one, got in zip(z, together.to_numpy(), strict=True):
        assert err_db(propagate(field, one, out_grid=out).to_numpy(), got) >= SAME


@pytest.mark.filterwarnings("ignore::clplen.errors.SamplingWarning")
def test_where_arrays_stay_on_the_device(device, on_device):
    for method in ["auto", "as", "rs", "fresnel-multistep"]:
        grid = Grid((21, 32), (3e-6, 2e-6))
        u = np.stack([band_limited(grid.shape, seed) for seed in (1, 2)])
        z = [3e-3, 2e-4, 0.0, -1e-4, 2e-4]
        expected, field = go(u, grid, z, device, method=method), field_of(u, grid, on_device)
        got = propagate(field, z, method=method).to_numpy()
        assert err_db(expected, got) >= SAME
        np.testing.assert_array_equal(field.to_numpy(), u.astype(device.complex))  # unchanged
        out = Grid((18, 40), (2.5e-6, 3e-6), origin=(1e-5, 0))
        if method == "auto":
            expected = go(u, grid, z, device, out_grid=out)
            assert err_db(expected, go(u, grid, z, on_device, out_grid=out)) >= SAME


def test_several_wavelengths(device):
    grid = Grid((14, 19), (3e-6, 2e-6))
    u = band_limited(grid.shape, 3)
    field = field_of(u, grid, device)
    wavelengths = (450e-9, 633e-9)
    results = propagate_wavelengths(field, 4e-4, wavelengths, method="blas", pad=1.5)
    for wavelength, result in zip(wavelengths, results, strict=True):
        assert result.wavelength == wavelength
        alone = field_of(u, grid, device, wavelength)
        expected = propagate(alone, 4e-4, method="blas", pad=1.5).to_numpy()
        np.testing.assert_array_equal(result.to_numpy(), expected)
    both = propagate_wavelengths(field, [1e-4, 2e-4], wavelengths)
    assert [result.shape for result in both] == [(2, 14, 19)] * 2
    assert err_db(both[0].to_numpy(), both[1].to_numpy()) < 40  # the colours differ
    (alone,) = propagate_wavelengths(field, 4e-4, 633e-9, method="blas", pad=1.5)
    np.testing.assert_array_equal(alone.to_numpy(), results[1].to_numpy())


# Plans ------------------------------------------------------------------------------------------


def test_plans_are_kept(device):
    grid = Grid((12, 18), 3e-6)
    field = field_of(band_limited(grid.shape, 1), grid, device)
    propagate(field, 3.21e-4)
    hits, misses = device.plans.hits, device.plans.misses
    propagate(field, 3.21e-4)
    assert (device.plans.hits, device.plans.misses) == (hits + 1, misses)
    changes = [
        {"z": 3.22e-4}, {"method": "as"}, {"pad": 3}, {"guard": 5.0}, {"support": 2e-5},
        {"out_grid": Grid((12, 18), 2e-6)}, {"border": 0.3},
    ]  # fmt: skip
    for change in changes:
        propagate(field, **{"z": 3.21e-4, **change})
    propagate(replace(field, wavelength=551e-9), 3.21e-4)
    assert device.plans.misses == misses + len(changes) + 1
    assert device.plans.hits == hits + 1
    one = plan(grid, 3.21e-4, wavelength=LAM, device=device)
    assert plan(grid, 3.21e-4, wavelength=LAM, device=device) is one
    assert one.nbytes > 0


def test_a_plan_is_the_propagation(device):
    grid, out = Grid((13, 18), (3e-6, 2e-6)), Grid((11, 20), (2e-6, 3e-6), origin=(4e-6, -5e-6))
    u = band_limited(grid.shape, 2)
    field = field_of(u, grid, device)
    made = Propagator(grid, 7e-4, wavelength=LAM, device=device, out_grid=out, support=4e-5)
    got = made(field)
    assert (got.grid, made.out_grid, got.wavelength) == (out, out, LAM)
    expected = propagate(field, 7e-4, out_grid=out, support=(4e-5, 4e-5)).to_numpy()
    np.testing.assert_array_equal(got.to_numpy(), expected)
    np.testing.assert_array_equal(made(field).to_numpy(), expected)  # and again


def test_the_origin_goes_along(device):
    """Moved together, field and output give the same numbers; an output alone moves the field."""
    u = band_limited((20, 31), 8)
    here = Grid((20, 31), (3e-6, 2e-6))
    there = Grid((20, 31), (3e-6, 2e-6), origin=(7e-4, -3e-4))
    for method in METHODS:
        z = 3e-4 * FAR.get(method, 1)
        a = go(u, here, z, device, method=method)
        np.testing.assert_array_equal(go(u, there, z, device, method=method), a)
    moved = propagate(field_of(u, there, device), 3e-4)
    assert moved.grid == there


def test_a_plan_without_a_transfer_function_has_tables_alone(device):
    for method, z in (("fresnel-tf", 1e-5), ("as", 0.0)):
        made = Propagator(
            Grid((6, 7), 3e-6), z, wavelength=LAM, method=method, device=device, phase="twofloat"
        )
        assert (made.phase, made.report.phase) == ("tables", "tables")


# Output grids -----------------------------------------------------------------------------------


def test_an_output_beyond_the_band_is_dark_and_said_to_be(device):
    grid = Grid((16, 24), (4e-6, 5e-6))
    beside = Grid((16, 24), (4e-6, 5e-6), origin=(0, 1e-3))
    field = field_of(band_limited(grid.shape), grid, device)
    with pytest.warns(SamplingWarning, match="No light .* along x: .* of 1e.05;"):
        dark = propagate(field, 1e-3, out_grid=beside)
    assert dark.grid == beside
    np.testing.assert_array_equal(dark.to_numpy(), 0)


def test_more_samples_to_one(device):
    """A sum over an axis of the output that has one sample: the field there."""
    grid, out = Grid((40, 47), (2e-6, 3e-6)), Grid((1, 30), (1e-6, 3e-6), origin=(5e-6, 0))
    r2 = grid.y[:, None] ** 2 + (grid.x - 9e-6) ** 2
    u = np.exp(-r2 / 1.1e-5**2) + 0j
    expected = corrected(
        u, grid.pitch, 5e-4, wavelength=LAM, out_shape=(1, 30), out_pitch=out.pitch,
        out_centre=out.origin,
    )  # fmt: skip
    assert err_db(expected, go(u, grid, 5e-4, device, out_grid=out)) >= 115


# Reports and warnings ----------------------------------------------------------------------


def test_a_report_in_numbers(device):
    grid = Grid((60, 80), (5e-6, 4e-6))
    made = Propagator(grid, 0.01, wavelength=LAM, method="blas", device=device)
    report = made.report
    assert (report.method, report.why, report.z) == ("blas", "asked for", 0.01)
    assert (made.method, made.why) == (report.method, report.why)
    assert report.padded_shape == (120, 160)
    assert (report.out_grid, report.sampled) == (grid, "transfer function")
    limits = [1 / (LAM * math.hypot(2 * 0.01 / w, 1)) for w in (600e-6, 640e-6)]
    limits = [min(limit, 1 / (2 * d)) for limit, d in zip(limits, grid.pitch, strict=True)]
    assert report.band == pytest.approx(limits, rel=1e-12, abs=0)
    assert report.nyquist == pytest.approx((1e5, 1.25e5))
    kept = limits[0] * limits[1] / (1e5 * 1.25e5)
    assert report.lost_band == pytest.approx(1 - kept, abs=1e-12)
    # Matsushima's limit is where the phase of H turns by pi from sample to sample.
    assert 0.8 < report.phase_step <= 1
    s = (LAM * limits[0]) ** 2 + (LAM * limits[1]) ** 2
    q = 1 - math.sqrt(1 - s)
    assert report.residual_turns == pytest.approx(0.01 / LAM * q * q / 2, rel=0.1, abs=0)
    assert (report.phase, report.paraxial_error, report.warning) == ("tables", 0, "")
    assert "blas: asked for" in str(report)


def test_a_report_of_an_aliased_plan(device):
    grid = Grid((1, 256), 2e-6)
    with pytest.warns(SamplingWarning, match="aliased") as said:
        made = Propagator(grid, 0.05, wavelength=LAM, method="fresnel-tf", device=device)
    report = made.report
    critical = 512 * (2e-6) ** 2 / LAM
    assert (report.fully_sampled_from, report.fully_sampled_to) == pytest.approx((0, critical))
    assert report.phase_step == pytest.approx(0.05 / critical)
    assert report.warning == str(said[0].message)
    assert report.warning in str(report)
    frequency = 512e-6 / (LAM * math.hypot(512e-6, 0.05))
    error = math.pi * 0.05 * LAM**3 * frequency**4 / 4
    assert report.paraxial_error == pytest.approx(error, rel=1e-9, abs=0)


def check_warnings_begin_at_the_end_of_the_valid_interval(device, method, near, far):
    grid = Grid((1, 200), 2e-6)

    def says(z: float) -> list[str]:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            Propagator(grid, z, wavelength=LAM, method=method, device=device)
        return [str(one.message) for one in said]

    for z in (near, far):
        assert z is None or re.search("aliased|returns|is not exact", says(z)[0])
    report = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        z = 0.02 if method == "one-step" else 1e-3
        report = Propagator(grid, z, wavelength=LAM, method=method, device=device).report
    low, high = report.fully_sampled_from, report.fully_sampled_to
    assert (near is None) == (low == 0)
    assert (far is None) == math.isinf(high)
    if low:
        assert says(low * 0.999)
        assert not says(low * 1.001)
    if math.isfinite(high):
        assert says(high * 1.001)
        assert not says(high * 0.999)
    if near is far is None:
        assert not any(says(z) for z in (1e-5, 1e-3, 0.5, -0.5))


def test_warnings_begin_at_the_end_of_the_valid_interval(device):
    for method, near, far in [
        ("as", None, 0.5),
        ("rs", 1e-5, None),
        ("fresnel-tf", None, 0.5),
        ("fresnel-ir", 1e-5, None),
        ("fresnel-1fft", 1e-5, None),
        ("one-step", 0.02, None),
        ("blas", None, None),
        ("cblas", None, None),
        ("auto", None, None),
        ("fresnel-multistep", None, 2.0),
    ]:
        check_warnings_begin_at_the_end_of_the_valid_interval(device, method, near, far)


def test_a_warning_is_said_once_a_plan_and_where_it_was_asked(device):
    grid = Grid((9, 11), 3e-6)
    field = field_of(band_limited(grid.shape), grid, device)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(2):
            propagate(field, 0.51234, method="as")
        Propagator(grid, 0.5, wavelength=LAM, method="as", device=device)
        plan(grid, 0.512345, wavelength=LAM, method="as", device=device)
    assert [one.category for one in said] == [SamplingWarning] * 3
    assert {one.filename for one in said} == {__file__}


def test_columns_outside_the_band_are_known_to_be_zero(device):
    """The band limits kx in the first grid, ky in both."""
    for shape, z, narrow in (((64, 40), 0.02, True), ((40, 512), 8e-3, False)):
        made = Propagator(Grid(shape, 5e-6), z, wavelength=LAM, method="blas", device=device)
        spectrum = made.spectrum
        found = device.download(spectrum.values)
        lit = (found if spectrum.turned else found.T).any(axis=1)
        known = made.description.factor.lit
        assert (known is not None) == narrow
        assert np.array_equal(lit, known if narrow else np.ones(shape[1] + 1, bool))


def test_a_periodic_window_is_not_called_aliased(device):
    for method in ("as", "fresnel-tf", "fresnel-ir"):
        Propagator(Grid((9, 12), 3e-6), 0.5, wavelength=LAM, method=method, pad=1, device=device)
