"""Figures of fields: where the samples lie, in which unit, and sentences for bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clplen import Field, Grid, plot
from clplen.compute.arrays import Image
from clplen.errors import ShapeError

GRID = Grid((6, 9), (4e-6, 2e-6), origin=(30e-6, -1e-6))  # y: 18 to 38, x: -9 to 7 um


def field(device, grid: Grid = GRID) -> Field:
    rng = np.random.default_rng(1)
    u = rng.random(grid.shape) + 0.1 + 1j * rng.normal(size=grid.shape)
    return Field.from_array(u, grid, wavelength=550e-9, device=device)


def shown(figure):
    """Axes, values and bar of the one image of a figure."""
    axes = next(axes for axes in figure.axes if axes.images)
    image = axes.images[0]
    return axes, np.ma.filled(image.get_array(), np.nan), image.colorbar


def test_the_intensity_lies_on_its_grid(device, precise):
    for f in (field(device), field(precise)):
        axes, values, bar = shown(plot.intensity(f, title="a field"))
        np.testing.assert_array_equal(values, np.abs(f.to_numpy()) ** 2)
    assert axes.images[0].get_extent() == pytest.approx((-10, 8, 40, 16))  # half a sample beyond
    assert axes.images[0].origin == "upper"  # row 0 at the top, where y is least
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x / µm", "y / µm")
    assert (axes.get_title(), bar.ax.get_ylabel()) == ("a field", "intensity")
    assert axes.get_aspect() == 1
    assert (bar.vmin, bar.vmax) == (0, pytest.approx(values.max()))


def test_the_unit_suits_the_place(device):
    for pitch, origin, unit, first in [
        (1e-6, 0.0, "µm", -4),
        (1e-6, 5e-3, "mm", 4.996),
        (0.3e-3, 0.0, "mm", -1.2),
        (0.25, 0.0, "m", -1.0),
    ]:
        grid = Grid((5, 9), pitch, origin=(0.0, origin))
        axes = shown(plot.intensity(field(device, grid)))[0]
        assert axes.get_xlabel() == f"x / {unit}"
        step = pitch * {"µm": 1e6, "mm": 1e3, "m": 1}[unit]
        assert axes.images[0].get_extent()[0] == pytest.approx(first - step / 2)


def test_a_logarithm_has_six_decades(device):
    f = field(device)
    values = shown(plot.intensity(f, scale="log"))[1]
    _, _, bar = shown(plot.intensity(f, scale="log"))
    assert bar.ax.get_ylabel() == "intensity (logarithmic)"
    assert bar.vmax / bar.vmin == pytest.approx(1e6)
    assert bar.extend == "neither"
    u = f.to_numpy().copy()
    u[2, 3] = 0
    _, dark, bar = shown(
        plot.intensity(Field.from_array(u, GRID, wavelength=1e-6, device=device), scale="log")
    )
    assert bar.extend == "min"
    assert dark[2, 3] == pytest.approx(values.max() * 1e-6)


def test_the_phase_is_cyclic_and_blank_in_the_dark(device):
    u = np.exp(1j * np.linspace(-3.0, 3.0, 54).reshape(GRID.shape)) * 5
    u[4, 1] = 4e-6  # below 1e-6 of 5
    f = Field.from_array(u, GRID, wavelength=550e-9, device=device)
    axes, values, bar = shown(plot.phase(f, title="p"))
    expected = np.angle(u)
    expected[4, 1] = np.nan
    np.testing.assert_allclose(values, expected, atol=1e-6)  # a few units of float32
    assert (bar.vmin, bar.vmax) == (-np.pi, np.pi)
    colours = axes.images[0].cmap([0.0, 1.0])
    np.testing.assert_allclose(colours[0], colours[1], atol=0.01)
    assert bar.ax.get_ylabel() == "phase / rad"
    assert axes.images[0].get_extent() == pytest.approx((-10, 8, 40, 16))
    assert axes.get_title() == "p"


def test_one_axis_gives_a_line(device):
    for shape, name in [((1, 7), "x"), ((7, 1), "y")]:
        grid = Grid(shape, (3e-6, 3e-6), origin=(1e-6, 1e-6))
        f = field(device, grid)
        for draw, values, label in (
            (plot.intensity, np.abs(f.to_numpy()) ** 2, "intensity"),
            (plot.phase, np.angle(f.to_numpy()), "phase / rad"),
        ):
            (axes,) = draw(f).axes
            (line,) = axes.lines
            np.testing.assert_allclose(line.get_xdata(), [-8, -5, -2, 1, 4, 7, 10])
            np.testing.assert_array_equal(line.get_ydata(), values.ravel())
            assert (axes.get_xlabel(), axes.get_ylabel()) == (f"{name} / µm", label)
        (axes,) = plot.intensity(f, scale="log").axes
        assert axes.get_yscale() == "log"
        assert axes.get_ylabel() == "intensity (logarithmic)"


def test_a_region_of_one_row_is_a_cut(device):
    f = field(device)
    (axes,) = plot.intensity(f, region=(slice(2, 3), slice(None))).axes
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), np.abs(f.to_numpy()[2]) ** 2)
    (axes,) = plot.intensity(f, region=(slice(2, 3), slice(4, 5))).axes
    assert axes.lines[0].get_marker() == "o"


def titled(figure):
    """Axes of items, without the colour bar."""
    return [axes for axes in figure.axes if axes.get_title()]


def batch(device, *counts: int, line: bool = False) -> Field:
    grid = Grid((1, 9), 1e-6) if line else GRID
    values = np.random.default_rng(1).random((*counts, *grid.shape))
    return Field.from_array(values, grid, wavelength=1e-6, device=device)


def test_a_batch_has_a_panel_an_item_on_one_scale(device):
    many = batch(device, 2, 3)
    panels = titled(plot.intensity(many, title="beams"))
    assert [axes.get_title() for axes in panels] == [
        f"item {v}, {u}" for v in range(2) for u in range(3)
    ]
    power = np.abs(many.to_numpy()) ** 2
    for axes, values in zip(panels, power.reshape(6, *GRID.shape), strict=True):
        (drawn,) = axes.images
        np.testing.assert_allclose(drawn.get_array(), values)
        assert drawn.norm.vmax == power.max()
    figure = plot.intensity(batch(device, 4, line=True))
    assert [len(axes.lines) for axes in figure.axes] == [1] * 4
    assert len({axes.get_ylim() for axes in figure.axes}) == 1
    assert 10 < len(titled(plot.intensity(batch(device, 40)))) <= 15


def test_an_item_of_a_batch(device):
    many = batch(device, 2, 3)
    values = many.to_numpy()
    for index in (0, -1, (1, 2), (-2, -1), (1,)):
        np.testing.assert_array_equal(many[index].to_numpy(), values[index])
    assert many[1, 2].grid == many.grid
    with pytest.raises(ShapeError, match=r"got a batch of shape \(2, 3, 6, 9\).*field\[0, 0\]"):
        plot.phase(many)
    assert plot.phase(many[0, 0]).axes
    for index, error in ((2, IndexError), ((0, 3), IndexError), (0.5, TypeError), ("a", TypeError)):
        with pytest.raises(error, match=r"of a field must be|must lie in a batch"):
            many[index]
    with pytest.raises(ShapeError, match="2 batch axes, got 3 indices"):
        many[0, 0, 0]
    with pytest.raises(ShapeError, match="0 batch axes"):
        list(many[0, 0])


def test_bad_fields_get_a_sentence(device):
    for draw in [plot.intensity, plot.phase]:
        with pytest.raises(TypeError, match=r"^plot\.\w+ needs a Field, got ndarray\.$"):
            draw(np.ones((4, 5)))
        with pytest.raises(TypeError, match="two slices of samples"):
            draw(field(device), region=(2, slice(None)))
        for region in ((slice(6, 9), slice(None)), (slice(None), slice(None, None, 2))):
            with pytest.raises(ValueError, match="samples of a field of"):
                draw(field(device), region=region)


def test_other_scales_are_refused(device):
    with pytest.raises(ValueError, match='"linear" or "log", got \'decibel\''):
        plot.intensity(field(device), scale="decibel")
    image = Image(device.upload(np.ones((4, 5), np.float32)), device)
    with pytest.raises(ValueError, match=r"one of .* got 'decibel'"):
        plot.picture(image, scale="decibel")


def test_what_is_no_picture_gets_a_sentence(device):
    with pytest.raises(TypeError, match=r"got Field \(plot.intensity draws a field\)"):
        plot.picture(field(device))
    with pytest.raises(TypeError, match=r"must be an Image or an array, got str\.$"):
        plot.picture("picture.png")
    assert plot.picture(np.ones((4, 5))).axes[0].images
    for shape in ((3, 4, 5), (2, 3, 4, 3)):
        planes = Image(device.upload(np.ones(shape, np.float32)), device)
        with pytest.raises(ShapeError, match=r"shape \(y, x\) or .*choose one plane"):
            plot.picture(planes)


def test_a_figure_is_saved_as_its_name_says(device, tmp_path: Path):
    figure = plot.intensity(field(device))
    for ending, start in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("SVG", b"<?xml")):
        path = tmp_path / f"figure.{ending}"
        plot.save(figure, path, dpi=40)
        assert path.read_bytes().startswith(start)
    for name in ("figure.bmp", "figure"):
        with pytest.raises(ValueError, match=rf"\.png, \.pdf, \.svg, got .*{name}"):
            plot.save(figure, tmp_path / name)
    assert len(list(tmp_path.iterdir())) == 3
