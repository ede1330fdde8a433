"""Resolution targets: geometry, frequencies, area weights."""

import numpy as np
import pytest

from clplen import Grid, SamplingError, SamplingWarning, ShapeError
from clplen.wave.elements.transparency import siemens_star, usaf1951, usaf1951_elements


def block_mean(a, by, bx):
    ny, nx = a.shape
    return a.reshape(ny // by, by, nx // bx, bx).mean(axis=(1, 3))


def test_frequencies_of_the_standard():
    """MIL-STD-150A, line pairs a millimetre to three digits."""
    at = {(e.group, e.element): e.frequency / 1000 for e in usaf1951_elements((-2, 0, 3, 7))}
    known = {(-2, 1): 0.25, (-2, 6): 0.445, (0, 1): 1, (0, 2): 1.12, (3, 4): 11.3, (7, 6): 228}
    assert len(at) == 24
    assert all(float(f"{at[key]:.3g}") == value for key, value in known.items())


def test_bars_are_one_by_five_widths_apart_by_one():
    for element in usaf1951_elements((2,), centre=(1e-3, -2e-3)):
        w = element.width
        assert w == pytest.approx(0.5 / element.frequency)
        upright, level = element.bars[:3], element.bars[3:]
        np.testing.assert_allclose(upright[:, 1] - upright[:, 0], 5 * w)
        np.testing.assert_allclose(upright[:, 3] - upright[:, 2], w)
        np.testing.assert_allclose(upright[1:, 2] - upright[:-1, 3], w)
        np.testing.assert_allclose(level[:, 1] - level[:, 0], w)
        np.testing.assert_allclose(level[:, 3] - level[:, 2], 5 * w)
        np.testing.assert_allclose(level[1:, 0] - level[:-1, 1], w)
        np.testing.assert_allclose(upright[1].reshape(2, 2).mean(axis=1), element.upright)
        np.testing.assert_allclose(level[1].reshape(2, 2).mean(axis=1), element.level)
        np.testing.assert_allclose(level[0, 2] - upright[2, 3], 2 * w)


def test_bars_keep_clear_of_each_other_and_the_chart_is_centred():
    for groups in [(0, 1, 2, 3, 4, 5, 6), (-1, 2), (3,), (-2,), (5, 4)]:
        elements = usaf1951_elements(groups, centre=(2e-3, 5e-3))
        assert [(e.group, e.element) for e in elements] == [
            (g, k) for g in sorted(groups) for k in range(1, 7)
        ]
        bars = np.concatenate([e.bars for e in elements])
        widths = np.repeat([e.width for e in elements], 6)
        gap_y = np.maximum(bars[:, None, 0] - bars[:, 1], bars[:, 0] - bars[:, None, 1])
        gap_x = np.maximum(bars[:, None, 2] - bars[:, 3], bars[:, 2] - bars[:, None, 3])
        apart = np.maximum(gap_y, gap_x) - 0.999 * np.minimum(widths, widths[:, None])
        assert (apart + np.eye(len(bars)) > 0).all()
        assert bars[:, 0].min() + bars[:, 1].max() == pytest.approx(4e-3)
        assert bars[:, 2].min() + bars[:, 3].max() == pytest.approx(10e-3)


def test_area_weights_at_any_sampling():
    """A coarse chart is the mean of a fine one, exactly; its area is that of its bars."""
    for groups in [(1, 2), (2, 5)]:
        coarse = Grid((45, 63), (180e-6, 140e-6), origin=(20e-6, 0))
        fine = Grid((45 * 3, 63 * 5), (60e-6, 28e-6), origin=(20e-6, 0))
        options = {"groups": groups, "centre": (70e-6, -50e-6)}
        chart = usaf1951(coarse, **options)
        np.testing.assert_allclose(block_mean(usaf1951(fine, **options), 3, 5), chart, atol=1e-12)
        bars = sum(30 * e.width**2 for e in usaf1951_elements(groups))
        assert chart.sum() * 180e-6 * 140e-6 == pytest.approx(bars, rel=1e-12, abs=0)
        assert chart.min() == 0
        assert 0.3 < chart.max() <= 1
        assert ((chart > 0) & (chart < 1)).any()


def test_dark_bars_and_a_chart_cut_by_the_window():
    grid = Grid((50, 61), 40e-6)
    whole = Grid((250, 305), 40e-6)
    clear = usaf1951(grid, groups=(0,), centre=(5e-3, 5e-3))
    np.testing.assert_allclose(usaf1951(grid, groups=(0,), centre=(5e-3, 5e-3), invert=True),
                               1 - clear)  # fmt: skip
    full = usaf1951(whole, groups=(0,), centre=(5e-3, 5e-3))
    np.testing.assert_allclose(clear, full[100:150, 122:183], atol=1e-12)


def test_an_element_finer_than_the_grid():
    grid = Grid((60, 60), (4e-6, 5e-6))
    usaf1951(grid, groups=(5,), aliasing="raise")  # bars of 8.8 um
    message = r"Element 6 of group 6 has bars 4\.385e-06 m wide, less .* at most 4\.385e-06 m"
    with pytest.raises(SamplingError, match=message):
        usaf1951(grid, groups=(5, 6), aliasing="raise")
    with pytest.warns(SamplingWarning, match="fades to grey"):
        usaf1951(grid, groups=(6,), aliasing="warn")
    usaf1951(grid, groups=(6,))


def test_bad_charts():
    for change, error, message in [
        ({"groups": ()}, ValueError, "groups of a target must be different integers"),
        ({"groups": (1, 1)}, ValueError, "groups of a target"),
        ({"groups": (1.5,)}, ValueError, "groups of a target"),
        ({"groups": 3}, ValueError, "groups of a target"),
        ({"centre": (np.nan, 0)}, ValueError, "centre of a target must be finite"),
        ({"centre": (1, 0)}, ValueError, "target is outside of the window"),
        ({"aliasing": "no"}, ValueError, "'raise', 'warn' or 'allow'"),
        ({"grid": Grid((1, 50), 1e-5)}, ShapeError, r"both axes; the grid has shape \(1, 50\)"),
    ]:
        values = {"grid": Grid((50, 50), 1e-5), "groups": (3,)} | change
        grid = values.pop("grid")
        with pytest.raises(error, match=message):
            usaf1951(grid, **values)


def star_points(grid, spokes, diameter, centre, count):
    """Mean of count x count points a cell."""
    part = (np.arange(count) + 0.5) / count - 0.5
    y = (grid.y[:, None] + part * grid.pitch[0]).reshape(-1, 1) - centre[0]
    x = (grid.x[:, None] + part * grid.pitch[1]).reshape(1, -1) - centre[1]
    clear = (np.cos(spokes * np.arctan2(y, x)) > 0) & (np.hypot(y, x) < diameter / 2)
    return block_mean(clear.astype(float), count, count)


def test_star_against_points():
    for spokes in [2, 5, 12]:
        for shape in [(31, 40), (26, 21)]:
            grid = Grid(shape, (6e-6, 5e-6), origin=(2e-6, -1e-6))
            centre = (11e-6, -17e-6)
            got = siemens_star(grid, spokes, diameter=130e-6, centre=centre)
            expected = star_points(grid, spokes, 130e-6, centre, 40)
            assert np.abs(got - expected).max() <= 0.03  # a row of 40 points
            assert np.abs(got - expected).mean() <= 5e-4


def test_area_and_middle_of_a_star():
    grid = Grid((101, 120), (5e-6, 4e-6))
    star = siemens_star(grid, 36, diameter=440e-6, centre=(2.5e-6, -2e-6))
    assert star.sum() * 20e-12 == pytest.approx(np.pi * 220e-6**2 / 2, rel=1e-12, abs=0)
    r = np.hypot(grid.y[:, None] - 2.5e-6, grid.x + 2e-6)
    assert np.abs(star[r < 8e-6] - 0.5).max() <= 0.1
    assert star[50, 60 + 50] == 1  # a spoke points to +x


def test_bad_stars():
    for change, error, message in [
        ({"spokes": 1}, ValueError, "spokes must be an integer of at least 2"),
        ({"spokes": 3.5}, ValueError, "spokes must be an integer of at least 2"),
        ({"diameter": -1}, ValueError, "diameter of a star must be positive"),
        ({"diameter": np.inf}, ValueError, "diameter of a star must be positive"),
        ({"centre": (0, np.nan)}, ValueError, "centre of a star must be finite"),
        ({"centre": (0, -1)}, ValueError, "star is outside of the window"),
        ({"centre": (0, 1)}, ValueError, "star is outside of the window"),
        ({"grid": Grid((50, 1), 1e-5)}, ShapeError, "varies along both axes"),
    ]:
        values = {"grid": Grid((50, 50), 1e-5), "spokes": 8, "diameter": 1e-4} | change
        grid, spokes = values.pop("grid"), values.pop("spokes")
        with pytest.raises(error, match=message):
            siemens_star(grid, spokes, **values)
