"""What ``auto`` takes where, and what it says about it; no device is needed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fields import LAM
from reference_corrected import AxisPlan, corrected_plan
from reference_optics import smooth_length

from clplen import Grid
from clplen.wave.propagation.description import Description, Request
from clplen.wave.propagation.methods import describe

SET_UP_A = Grid((1, 1024), 2 * LAM)
GRIDS = [
    SET_UP_A,
    Grid((1024, 1), 2 * LAM),
    Grid((64, 64), 2e-6),
    Grid((61, 200), (6.6e-6, 5e-6)),
    Grid((200, 61), (1.5e-6, 9e-6)),
    Grid((128, 96), (0.4e-6, 0.3e-6)),
    Grid((40, 50), (0.2e-6, 0.25e-6)),
]


def auto(grid: Grid, z: float, **options: object) -> Description:
    return describe(Request(grid, z, LAM, **options))


def taken(made: Description) -> str:
    """The rule: the method, and how the corrected band is summed."""
    if made.method == "as" or (made.method == "rs" and made.kind == "fft"):
        return made.method
    return f"{made.method} {made.kind}"


def by_the_rules(grid: Grid, z: float, lit: float = 1) -> tuple[str, float, float]:
    """The design's section 5 with the twin's band: the rule, W/S and f_geo/f_nyq.

    lit: the part of the window that carries light.
    """
    support = [lit * e for e in grid.extent]
    plans: list[AxisPlan] = list(
        corrected_plan(grid.shape, grid.pitch, z, wavelength=LAM, support=support)
    )
    wide, share, clipped, sampled, grazing = 1.0, 0.0, True, True, False
    for plan, n, d in zip(plans, grid.shape, grid.pitch, strict=True):
        if n == 1:
            continue
        nyquist, reach = 1 / (2 * d), (1 + lit) / 2 * n * d
        wide = max(wide, smooth_length(max(n, round(plan.window / d))) / n)
        steepest = reach / (LAM * math.hypot(reach, z)) / nyquist
        share = max(share, steepest)
        # Waves of the Nyquist frequency are evanescent and lose exp(-18.4), 160 dB.
        beyond = (LAM * nyquist) ** 2 - 1
        decay = 2 * math.pi * abs(z) / LAM * math.sqrt(max(beyond, 0))
        sampled = sampled and (steepest <= 0.8 or decay >= 18.4)
        clipped = clipped and plan.f_lo == -nyquist and plan.f_hi == nyquist
        # The steepest ray of the band, and its alias, against the widest window that is taken.
        sine, spread = LAM * plan.f_hi, math.sqrt(LAM * abs(z))
        beside = abs(z) * sine / math.sqrt(1 - sine**2) if sine < 1 else math.inf
        guard = 8 if min((1 + lit) * m * p for m, p in live(grid)) ** 2 < 16 * LAM * z else 6
        grazing = grazing or beside + reach + 3 * spread > 8 * reach + 2 * (guard + 3) * spread
    # The kernel's peak, of width z, takes three samples: exp(-2 pi 3) is 160 dB.
    near = abs(z) < 3 * max(p for _, p in live(grid))
    kernel = sampled and not near
    if min(p for _, p in live(grid)) < LAM / 2 and abs(z) <= 3 * LAM and near:
        return "as", wide, share
    if grazing and not kernel and not near:
        return "rs chirp-z", wide, share
    if clipped and (wide <= 2.2 or not kernel):
        return "as", wide, share
    if wide <= 2.2 or (wide <= 2.5 and not kernel):
        return "cblas fft", wide, share
    return ("rs" if kernel else "cblas chirp-z"), wide, share


def live(grid: Grid) -> list[tuple[int, float]]:
    """(samples, pitch) of the axes along which something varies."""
    return [(n, d) for n, d in zip(grid.shape, grid.pitch, strict=True) if n > 1]


def distances(grid: Grid) -> np.ndarray:
    return np.geomspace(0.3, 3e5, 47) * max(grid.pitch)


def test_the_rules_everywhere() -> None:
    for grid in GRIDS:
        for lit in [1, 0.1]:
            support = tuple(lit * e for e in grid.extent)
            for z in distances(grid):
                expected, wide, share = by_the_rules(grid, z, lit)
                for sign in (1, -1):
                    made = auto(grid, sign * z, support=support)
                    assert taken(made) == expected, (z, wide, share, made.why)
                    assert made.warning == ""


def test_another_grid_is_summed_over_its_own_frequencies() -> None:
    grid = Grid((30, 40), 3e-6)
    for out in (
        Grid((30, 40), 3.1e-6),
        Grid((30, 40), 3e-6, origin=(0, 1e-6)),
        Grid((30, 41), (3e-6, 2e-6)),
    ):
        for z in (1e-5, 1e-3, 100.0):
            made = auto(grid, z, out_grid=out)
            # Far away one transform between the grids is exact, and less work.
            assert taken(made) == ("one-step series" if z == 100 else "cblas chirp-z")
            assert made.why.startswith("the output has another pitch or centre")
            assert ("% of the work of" in made.why) == (z == 100)
            assert made.out_grid == out


def test_an_aligned_grid_of_another_size_needs_no_convolution() -> None:
    for shape in [(61, 83), (12, 17), (30, 81), (15, 81)]:
        grid = Grid((30, 40), 3e-6, origin=(1e-5, 2e-5))
        out = Grid(shape, 3e-6, origin=grid.origin)
        methods = set()
        for z in np.geomspace(1e-6, 1, 40):
            made = auto(grid, z, out_grid=out)
            methods.add(taken(made))
            assert made.into.shape_after(grid.shape) == (made.back.y[0].n, made.back.x[0].n)
            assert made.back.shape_after(made.into.shape_after(grid.shape)) == shape
            if made.route.startswith("FFT"):
                assert all(
                    length >= max(n, m)
                    for length, n, m in zip(made.window, grid.shape, shape, strict=True)
                )
        assert "rs" not in methods
        assert {"as", "cblas chirp-z"} <= methods


def test_evanescent_waves_are_kept_within_three_wavelengths() -> None:
    fine, coarse = Grid((40, 50), (0.2e-6, 0.6e-6)), Grid((40, 50), 0.3e-6)
    for z in (0.1 * LAM, 3 * LAM):
        made = auto(fine, z)
        assert (made.method, made.band[0]) == ("as", (-2.5e6, 2.5e6))
        assert made.why.endswith("<= 3 lam: evanescent waves count")
        assert made.valid == (0, 3 * LAM)
        assert "evanescent" not in auto(coarse, z).why
    assert "evanescent" not in auto(fine, 3.01 * LAM).why
    # Both grids fit beside each other in the window, and grazing waves 64 z beside them: 26 um
    # and 35.2 um are 306 samples, 315 the next 7-smooth length. Nothing grazes along x.
    wide = auto(fine, LAM, out_grid=Grid((90, 50), fine.pitch))
    assert (wide.method, wide.window) == ("as", (315, 100))


def test_the_longer_axis_decides() -> None:
    """A square's short side alone would take a window of twice its size."""
    z = 0.02
    assert taken(auto(Grid((1, 800), 5e-6), z)) == "as"
    assert taken(auto(Grid((50, 1), 5e-6), z)) == "rs"
    both = auto(Grid((50, 800), 5e-6), z)
    assert taken(both) == by_the_rules(Grid((50, 800), 5e-6), z)[0]
    turned = auto(Grid((800, 50), 5e-6), z)
    assert (turned.method, turned.why) == (both.method, both.why)
    assert turned.window == both.window[::-1]


def test_less_light_needs_less() -> None:
    grid, z = Grid((1, 1000), 1e-6), 0.01
    whole, some = (auto(grid, z, support=s) for s in (None, (1e-4, 1e-4)))
    assert some.band[1][1] < whole.band[1][1] or some.window[1] < whole.window[1]
    assert auto(grid, z, support=(1, 1)).window == whole.window


def test_fields_of_a_sample_or_two() -> None:
    for shape in [(1, 1), (1, 2), (2, 1)]:
        for z in [1e-7, 1e-3, -5.0]:
            made = auto(Grid(shape, 3e-6), z)
            assert made.method in ("as", "cblas", "rs")
            assert made.out_grid == Grid(shape, 3e-6)
            if shape == (1, 1):
                assert (made.method, made.window) == ("as", (1, 1))


def test_nothing_is_done_at_z_zero() -> None:
    grid = Grid((5, 6), 3e-6)
    for method in ("auto", "as", "blas", "cblas", "rs", "fresnel-tf", "fresnel-multistep"):
        made = describe(Request(grid, 0.0, LAM, method))
        assert (made.route, made.factor) == ("none", None)
        assert made.method == ("as" if method == "auto" else method)
    moved = auto(grid, 0.0, out_grid=Grid((5, 6), 2e-6))
    assert taken(moved) == "cblas chirp-z"


def test_what_is_asked_for_is_taken() -> None:
    grid = Grid((20, 30), 3e-6)
    for z in (1e-6, 1e-3, 1.0):
        for method in ("as", "blas", "cblas", "rs", "fresnel-tf", "fresnel-ir", "fresnel-1fft"):
            made = describe(Request(grid, z, LAM, method))
            assert (made.method, made.why) == (method, "asked for")


def test_cblas_takes_transforms_of_the_window_or_of_the_band() -> None:
    grid, s = Grid((1, 256), 2e-6), 512e-6
    routes = {}
    for z in (s / 10, s, 1e3 * s):
        made = describe(Request(grid, z, LAM, "cblas"))
        routes[z] = taken(made)
        assert made.band[1][1] <= 1 / 4e-6
    assert routes == {s / 10: "cblas fft", s: "cblas fft", 1e3 * s: "cblas chirp-z"}
    far = describe(Request(grid, 1e6 * s, LAM, "cblas"))
    assert far.into.x[0].m == pytest.approx(2 * 8 * (8 + 3), abs=2)  # tends to 2 g (g + t_w)
