"""Where methods end: their intervals, hard edges, guards, steps and groups, and what they say."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np
import pytest
from fields import LAM, band_limited, field_of, go
from tolerance import err_db

from clplen import Grid, Propagator, SamplingError, propagate
from clplen.wave.propagation import propagator
from clplen.wave.propagation.band import guarded_band
from clplen.wave.propagation.description import Request
from clplen.wave.propagation.methods import describe
from clplen.wave.propagation.plan_report import PlanReport, report
from clplen.wave.propagation.transfer_function import Transfer


def report_of(grid: Grid, z: float, method: str = "auto", **options: object) -> PlanReport:
    return report(describe(Request(grid, z, LAM, method, **options)), "tables")


def warns(grid: Grid, z: float, method: str, **options: object) -> list[bool]:
    """Whether it warns a little before z and a little after it."""
    around = (z * (1 - 1e-6), z * (1 + 1e-6))
    return [bool(report_of(grid, one, method, **options).warning) for one in around]


# Hard edges: guard = 0 --------------------------------------------------------------------------


def test_evanescent_waves_do_not_return_in_a_window_without_padding(device):
    """Within 3 lam the window holds both grids whatever pad and guard are.

    In one of the larger grid alone, what comes back leaves 22 and 15 dB or less.
    """
    for waves, floor in [(0.3, 38), (1, 26)]:
        for shape in [(40, 50), (90, 50)]:
            grid = Grid((40, 50), (0.2e-6, 0.25e-6))
            out, u = Grid(shape, grid.pitch), band_limited(grid.shape)
            expected = go(u, grid, waves * LAM, device, out_grid=out)
            assert (
                err_db(expected, go(u, grid, waves * LAM, device, guard=0, pad=1, out_grid=out))
                >= floor
            )


# Guards and windows -----------------------------------------------------------------------------


def test_the_guard_is_wider_where_the_windows_are_narrow():
    """S^2 < 4 lam z along any axis that varies, S the mean of the lit and the wanted width."""
    grid = Grid((40, 50), (3e-6, 2e-6))
    cases = [
        ({}, 100e-6),  # along x, the shorter one
        ({"support": (1.0, 40e-6)}, 70e-6),
        ({"out_grid": Grid((40, 75), grid.pitch)}, 120e-6),  # 125 um along x, 120 um along y
    ]
    for options, s in cases:
        far = s**2 / (4 * LAM)
        for sign in (1, -1):
            near, beyond = (
                Request(grid, sign * f * far, LAM, **options).widths for f in (0.99, 1.01)
            )
            assert (near, beyond) == (6, 8)
            for guard in (0, 3.5):
                assert Request(grid, sign * 2 * far, LAM, guard=guard, **options).widths == guard
    # An axis of one sample has no window: what is narrow is not along it.
    far = (100e-6) ** 2 / (4 * LAM)
    assert Request(Grid((1, 50), (1e-9, 2e-6)), 0.99 * far, LAM).widths == 6
    # It is this guard that makes the band.
    for z, widths in ((0.99 * far, 6), (1.01 * far, 8)):
        band = Request(Grid((1, 50), 2e-6), z, LAM).bands[1]
        d = math.hypot(100e-6, z)
        geometric, width = 100e-6 / (LAM * d), z / (d * math.sqrt(LAM * d))
        assert band.guard == widths
        assert band.high == pytest.approx(geometric + widths * width, rel=1e-12)


def test_grazing_waves_get_64_z_of_window():
    """Beside both grids, but no more than the widest window of any distance."""
    for guard in [6.0, 0.0]:
        own, other = Grid((1, 50), 0.2e-6), Grid((1, 400), 0.1e-6, origin=(0, 3e-6))
        for z, capped in ((0.2 * LAM, False), (3 * LAM, True), (-3 * LAM, True)):
            way = Request(own, z, LAM, out_grid=other).span(1)
            window = guarded_band(way, guard).window
            beside = 10e-6 + 40e-6 + 2 * 3e-6 + 64 * abs(z)
            assert window == pytest.approx(beside, rel=1e-12)
            small = Request(Grid((1, 6), 0.2e-6), z, LAM).span(1)
            most = 4 * 2.4e-6 + 2 * (guard + 3) * math.sqrt(LAM * abs(z))
            beside = 2.4e-6 + 64 * abs(z)
            assert (most < beside) == capped
            assert guarded_band(small, guard).window == pytest.approx(min(most, beside), rel=1e-12)


def test_a_ray_straight_ahead_at_the_smallest_distance():
    """The output ends where the input begins: 0 sideways, and z^3 is 0 in floating point."""
    for z in [1e-120, -1e-120]:
        grid = Grid((1, 8), 2**-18)
        out = Grid((1, 8), 2**-18, origin=(0, 8 * 2**-18))
        band = Request(grid, z, LAM, out_grid=out).bands[1]
        assert math.isfinite(band.window)
        assert (band.low, band.high) == ((-(2.0**17), 2.0**17))


# Intervals and errors of a report ---------------------------------------------------------------


def test_a_kernel_is_sampled_from_two_samples_on():
    """On samples below lam/2 no ray is too steep, but near by the peak of width z is missed."""
    fine = Grid((20, 60), (0.25e-6, 0.2e-6))
    assert warns(fine, 2 * 0.25e-6, "rs") == [True, False]
    assert warns(Grid((1, 60), 0.2e-6), -2 * 0.2e-6, "rs") == [True, False]
    for z in (0.3e-6, 0.9e-6):
        made = report_of(fine, z, "rs")
        assert (made.fully_sampled_from, made.fully_sampled_to) == (2 * 0.25e-6, math.inf)
    assert "aliased below 5e-07 m" in report_of(fine, 0.3e-6, "rs").warning
    # On coarser samples the steepest ray decides: f_geo = f_nyq.
    grid = Grid((1, 100), 2e-6)
    nearest = 200e-6 * math.sqrt((4e-6 / LAM) ** 2 - 1)
    assert warns(grid, nearest, "rs") == [True, False]
    assert report_of(grid, 0.1, "rs").fully_sampled_from == pytest.approx(nearest, rel=1e-12)


def test_the_paraxial_error_is_that_of_the_corner():
    """Of both axes: against the difference of the two phases at the highest frequencies."""
    for z in [0.02, -0.5]:
        grid = Grid((60, 90), (5e-6, 7e-6))
        s = sum(
            (LAM * min(e / (LAM * math.hypot(e, z)), 1 / (2 * d))) ** 2
            for e, d in zip(grid.extent, grid.pitch, strict=True)
        )
        exact = 2 * math.pi * abs(z) / LAM * (1 - s / 2 - math.sqrt(1 - s))
        # Next term of the series: s/2 of it, below 3e-3.
        for method in ("fresnel-tf", "fresnel-ir", "fresnel-1fft", "fresnel-multistep"):
            error = report_of(grid, z, method).paraxial_error
            assert error == pytest.approx(exact, rel=3e-3, abs=0)
        assert report_of(grid, z, "as").paraxial_error == 0


# Many steps -------------------------------------------------------------------------------------

STEPS = Grid((20, 50), (3e-6, 2e-6))  # padded twice, 40 x 100: dz = 655 um along y, 727 um along x
DZ = 40 * (3e-6) ** 2 / LAM


def test_many_steps_warn_where_light_comes_back():
    for pad, border, reach in [
        (2, 0.4, 33 * DZ),
        (2, 0.01, 33 * DZ),
        (2, 0, 2 * DZ),
        (1, 0.4, 33 * DZ / 2),
        (1, 0, None),
    ]:
        options = {"pad": pad, "border": border}
        made = report_of(STEPS, 5.5 * DZ, "fresnel-multistep", **options)
        assert made.fully_sampled_to == pytest.approx(reach or math.inf, rel=1e-12)
        if reach is None:  # the periodic window is what was asked for
            for z in (0.1 * DZ, 5.5 * DZ, -900 * DZ):
                assert not report_of(STEPS, z, "fresnel-multistep", **options).warning
            continue
        for z in (reach, -reach):
            assert warns(STEPS, z, "fresnel-multistep", **options) == [False, True]
        said = report_of(STEPS, 1.01 * reach, "fresnel-multistep", **options).warning
        assert said.startswith(f"fresnel-multistep takes {33 if border else 2} steps to z = ")
        assert "light that left the window returns. Use method=" in said


def test_more_steps_than_anyone_waits_for(device):
    grid = Grid((7, 7), 2e-6)
    dz = 8 * (2e-6) ** 2 / LAM  # the window's length is even
    options = {"pad": 1, "border": 0}
    made = describe(Request(grid, 100_000.5 * dz, LAM, "fresnel-multistep", **options))
    assert len(made.into.x) == 100_001
    for z in (100_001.5 * dz, -(10**11) * dz):
        with pytest.raises(SamplingError, match=r"limited to 100,000 steps"):
            propagate(
                field_of(np.ones((7, 7)), grid, device), z, method="fresnel-multistep", **options
            )
    with pytest.raises(SamplingError, match="requires 100,001;"):
        describe(Request(grid, 100_001.5 * dz, LAM, "fresnel-multistep", **options))


# Groups of distances ----------------------------------------------------------------------------


def test_many_distances_run_eight_at_a_time(device, monkeypatch):
    """The same results in their places, and no more memory asked for than for eight."""
    grid = Grid((12, 15), 3e-6)
    field = field_of(band_limited(grid.shape, 2), grid, device)
    z = list(np.linspace(1e-4, 2e-4, 19))
    z[5], z[9] = z[9], z[5]
    expected = [propagate(field, one, method="as").to_numpy() for one in z]
    counts, asked, run, require = [], [], propagator.run, device.require_memory

    def counted(data, into, spectra, *rest):
        counts.append(len(spectra))
        return run(data, into, spectra, *rest)

    def remembered(nbytes, what):
        asked.append(nbytes)
        require(nbytes, what)

    monkeypatch.setattr(propagator, "run", counted)
    monkeypatch.setattr(device, "require_memory", remembered)
    propagate(field, z[:8], method="as")
    assert counts == [8]
    most = max(asked)
    counts.clear()
    asked.clear()
    got = propagate(field, z, method="as").to_numpy()
    assert counts == [8, 8, 3]
    assert max(asked) == most
    for one, other in zip(expected, got, strict=True):
        np.testing.assert_array_equal(one, other)


# One plan, two threads --------------------------------------------------------------------------


def test_two_threads_on_one_plan_make_its_factor_once(device, monkeypatch):
    grid = Grid((12, 15), 3e-6)
    field = field_of(band_limited(grid.shape, 2), grid, device)
    expected = propagate(field, 2.5e-4, method="as").to_numpy()
    plan = Propagator(grid, 2.5e-4, wavelength=LAM, method="as", device=device)
    first, second, made = Event(), Event(), Transfer.on_device

    def slow(*arguments):
        (second if first.is_set() else first).set()
        second.wait(0.2)  # time enough for another thread to come here, too
        return made(*arguments)

    monkeypatch.setattr(Transfer, "on_device", slow)
    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(plan, field)
        assert first.wait(10)
        results = [pool.submit(plan, field), one]
        for result in results:
            np.testing.assert_array_equal(result.result().to_numpy(), expected)
    assert not second.is_set()
