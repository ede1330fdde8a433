"""What ``auto`` takes where, and what it says about it; no device is needed."""

from __future__ import annotations

import numpy as np
import pytest
from fields import LAM

from clplen import Grid
from clplen.wave.propagation.description import Description, Request
from clplen.wave.propagation.methods import describe

WHOLE = Grid((1, 1024), 2 * LAM)
CHANGES = [  # grid, part that carries light, first rule, (distance, rule) where another one begins
    (WHOLE, 1, "as", [(5.51821e-3, "rs")]),
    (Grid((61, 200), (6.6e-6, 5e-6)), 1, "as", [(0.0227053, "rs")]),
    (
        Grid((200, 61), (1.5e-6, 9e-6)),
        0.1,
        "as",
        [(1.96791e-3, "cblas fft"), (3.91551e-3, "cblas chirp-z"), (0.0123488, "rs")],
    ),
    (Grid((40, 50), (0.2e-6, 0.25e-6)), 1, "as", [(7.5e-7, "rs chirp-z"), (3.51472e-6, "rs")]),
    (Grid((128, 96), (0.4e-6, 0.3e-6)), 0.1, "as", [(4.27604e-5, "rs")]),
]


def auto(grid: Grid, z: float, **options: object) -> Description:
    return describe(Request(grid, z, LAM, **options))


def taken(made: Description) -> str:
    """The rule: the method, and how the corrected band is summed."""
    if made.method == "as" or (made.method == "rs" and made.kind == "fft"):
        return made.method
    return f"{made.method} {made.kind}"


def test_rules_change_where_their_inequalities_turn() -> None:
    """Distances by bisection; at the sixth digit on either side the rules are those named."""
    for grid, lit, first, changes in CHANGES:
        support, before = tuple(lit * e for e in grid.extent), first
        for z, after in changes:
            for at, rule in ((z * (1 - 1e-5), before), (z * (1 + 1e-5), after)):
                for sign in (1, -1):
                    made = auto(grid, sign * at, support=support)
                    assert (taken(made), made.warning) == (rule, ""), (grid, at)
            before = after
        assert taken(auto(grid, 1e3 * changes[-1][0], support=support)) == before


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
