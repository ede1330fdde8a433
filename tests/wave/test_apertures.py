"""Apertures: the exact covered fraction of every cell, and what is refused."""

import numpy as np
import pytest
import reference
from reference_elements import polygon_coverage

from clplen import Field, Grid, ShapeError, aperture
from clplen.wave.elements.hard_apertures import (
    annular_aperture,
    polygonal_aperture,
    rectangular_aperture,
)

GRID = Grid((37, 52), (3e-6, 2e-6), origin=(1e-6, -0.7e-6))
ARROW = np.array([(-40, -31), (12.5, -43.3), (-3.3, 2.2), (39, 41), (-21, 17.1)]) * 1e-6
COMB = np.array(
    [(-20, -30), (20, -30), (20, -10), (-9, -10), (-9, 3.1), (17, 3.1), (17, 25), (-20, 25)]
)
STAR = 4 * np.pi * np.arange(5) / 5  # a pentagram, its middle twice inside
BATCH = np.array([2 - 1j, 0.5j])[:, None, None]  # complex: a conjugate or a lost batch shows


def through(device, cut, *args, grid=GRID, **kwargs):
    """The real transmission of an aperture, found with a batch of two constant fields."""
    u = BATCH * np.ones(grid.shape)
    field = Field.from_array(u, grid, wavelength=5e-7, device=device)
    got = cut(field, *args, **kwargs).to_numpy() / BATCH
    assert np.abs(field.to_numpy() - u).max() <= 1e-6  # the input is left alone
    eps = np.finfo(device.real).eps
    assert np.abs(got[0] - got[1]).max() <= 4 * eps
    assert np.abs(got.imag).max() <= 4 * eps
    return got[0].real


def sampled(inside, grid, fine=40):
    """The covered fractions by fine x fine points in every cell; error below 1/fine."""
    part = (np.arange(fine) + 0.5) / fine - 0.5
    y = (grid.y[:, None] + part * grid.pitch[0]).ravel()
    x = (grid.x[:, None] + part * grid.pitch[1]).ravel()
    ny, nx = grid.shape
    return inside(y[:, None], x[None, :]).reshape(ny, fine, nx, fine).mean(axis=(1, 3))


def rounding(device):
    """float32 of a fraction, or float64 of coordinates 50 samples from the origin."""
    return max(4 * np.finfo(device.real).eps, 1e-12)


# Polygons


def test_polygon_either_way_round(device, precise):
    for turn in [1, -1]:
        for vertices in [ARROW, COMB * 1e-6, ARROW * 3 + 20e-6]:
            expected = polygon_coverage(GRID.shape, GRID.pitch, vertices, origin=GRID.origin)
            assert 0 < expected.mean() < 1
            for where in (device, precise):
                got = through(where, polygonal_aperture, vertices[::turn])
                assert np.abs(got - expected).max() <= rounding(where)


def test_polygon_on_the_borders_of_cells(precise):
    """Edges along the borders of cells, and vertices on their corners."""
    grid = Grid((8, 9), (0.5, 0.75))
    edges = (grid.y[0] - 0.25, grid.x[0] - 0.375)
    corners = np.array([(1, 2), (1, 6), (5, 6), (5, 4), (3, 4), (3, 2)]) * (0.5, 0.75) + edges
    expected = np.zeros(grid.shape)
    expected[1:5, 2:6] = 1
    expected[3:5, 2:4] = 0
    got = through(precise, polygonal_aperture, corners, grid=grid)
    np.testing.assert_allclose(got, expected, atol=1e-15)
    diamond = np.array([(1, 4), (4, 7), (7, 4), (4, 1)]) * (0.5, 0.75) + edges
    got = through(precise, polygonal_aperture, diamond, grid=grid)
    assert sorted(set(np.round(got, 12).ravel())) == [0, 0.5, 1]


# Rectangles


def check_turned_rectangle(device, precise, rotation):
    size, centre = (31e-6, 55e-6), (4e-6, -7e-6)

    def inside(y, x):
        y, x = y - centre[0], x - centre[1]
        along_x = x * np.cos(rotation) + y * np.sin(rotation)
        along_y = -x * np.sin(rotation) + y * np.cos(rotation)
        return (np.abs(along_y) < size[0] / 2) & (np.abs(along_x) < size[1] / 2)

    got = [
        through(where, rectangular_aperture, size, centre=centre, rotation=rotation)
        for where in (device, precise)
    ]
    assert np.abs(got[1] - sampled(inside, GRID)).max() <= 1 / 40
    assert np.abs(got[0] - got[1]).max() <= rounding(device)
    assert got[1].sum() * 6e-12 == pytest.approx(size[0] * size[1], rel=1e-11)


def test_turned_rectangle(device, precise):
    """+x turns towards +y; the sides of (y, x) go along."""
    for rotation in [0.3, -1.2, np.pi / 2, 4.0]:
        check_turned_rectangle(device, precise, rotation)


def test_upright_rectangle(device):
    size, centre = (31e-6, 55e-6), (4e-6, -7e-6)
    expected = reference.rectangle_coverage(
        GRID.shape, GRID.pitch, size, centre=centre, origin=GRID.origin
    )
    got = through(device, rectangular_aperture, size, centre=centre)
    assert np.abs(got - expected).max() <= rounding(device)
    # a hair's breadth of rotation goes through the polygon instead
    turned = through(device, rectangular_aperture, size, centre=centre, rotation=1e-12)
    assert np.abs(turned - expected).max() <= 2e-6
    both = through(device, rectangular_aperture, 40e-6)
    square = through(device, aperture, 40e-6, shape="square")
    np.testing.assert_array_equal(both, square)


# Rings


def check_ring(device, precise, outer, inner, centre):
    def inside(y, x):
        r = np.hypot(y - centre[0], x - centre[1])
        return (r < outer / 2) & (r > inner / 2)

    expected = reference.circle_coverage(
        GRID.shape, GRID.pitch, outer, centre=centre, origin=GRID.origin
    )
    if inner:
        expected -= reference.circle_coverage(
            GRID.shape, GRID.pitch, inner, centre=centre, origin=GRID.origin
        )
    got = [
        through(where, annular_aperture, outer, inner=inner, centre=centre)
        for where in (device, precise)
    ]
    assert np.abs(got[0] - expected).max() <= rounding(device)
    assert np.abs(got[1] - expected).max() <= 1e-9  # rounding kept by the twin
    assert np.abs(got[1] - sampled(inside, GRID)).max() <= 1 / 40


def test_ring(device, precise):
    for outer, inner, centre in [
        (83e-6, 41e-6, (4e-6, -7e-6)),
        (160e-6, 5e-6, (0, 0)),
        (9e-6, 7.5e-6, (1e-6, 30e-6)),
        (60e-6, 0, (0, 0)),
    ]:
        check_ring(device, precise, outer, inner, centre)


# Axes of length 1


def test_an_axis_of_length_one_has_no_edge(device):
    """Far from the centre along the axis that does not vary, and with a large cell there."""
    tall = Grid((45, 1), (2e-6, 1e-3), origin=(0, 1.0))
    wide = Grid((1, 45), (1e-3, 2e-6), origin=(1.0, 0))
    slit = reference.rectangle_coverage((1, 45), (1, 2e-6), (9, 31e-6))[0]
    hole = reference.rectangle_coverage((1, 45), (1, 2e-6), (9, 11e-6))[0]
    for grid in (tall, wide):
        for cut, args, more, expected in (
            (aperture, 31e-6, {}, slit),
            (aperture, 31e-6, {"shape": "square"}, slit),
            (rectangular_aperture, 31e-6, {}, slit),
            (annular_aperture, 31e-6, {"inner": 11e-6}, slit - hole),
        ):
            got = through(device, cut, args, grid=grid, **more)
            assert np.abs(got.ravel() - expected).max() <= rounding(device)
    point = Grid((1, 1), 1e-6)
    assert through(device, annular_aperture, 3e-5, inner=1e-5, grid=point) == 1


# Bad input


def test_what_is_no_aperture(device):
    crossing = np.array([(0, 0), (0, 3), (-2, 1), (3, 2)]) * 1e-5
    pentagram = 40e-6 * np.stack([np.sin(STAR), np.cos(STAR)], axis=-1)
    rows = [
        (polygonal_aperture, [(0, 0), (1, 1)], {}, r"shape \(n, 2\), n at least 3, .* \(2, 2\)"),
        (polygonal_aperture, [(0, 0, 0)] * 4, {}, r"got \(4, 3\)"),
        (polygonal_aperture, [(0, 0), (1e-5, np.nan), (0, 1)], {}, "all finite"),
        (polygonal_aperture, [(0, 0), (1e-5, 1e-5), (2e-5, 2e-5)], {}, "must enclose an area"),
        (polygonal_aperture, [(0, 0), (0, 1e-5), (0, 2e-5)], {}, "must enclose an area"),
        (polygonal_aperture, crossing, {}, "must not cross itself"),
        (polygonal_aperture, pentagram, {}, "must not cross itself"),
        *(
            (rectangular_aperture, size, {}, "rectangle's size must be positive")
            for size in (0, (1e-5, -1e-5), (1e-5, 1e-5, 1e-5), np.inf)
        ),
        (rectangular_aperture, 1e-5, {"rotation": np.nan}, "rotation must be finite"),
        (rectangular_aperture, 1e-5, {"centre": (0, np.inf)}, "an aperture must be finite"),
        *(
            (annular_aperture, 5e-5, {"inner": inner}, "ring must be at least 0")
            for inner in (-1e-6, 5e-5, np.nan)
        ),
        (
            polygonal_aperture,
            ARROW,
            {"grid": Grid((1, 45), 2e-6)},
            "without axes of length 1.* use rect",
        ),
        (
            rectangular_aperture,
            1e-5,
            {"rotation": 0.1, "grid": Grid((45, 1), 2e-6)},
            "without axes of length 1",
        ),
    ]
    for cut, shape, more, message in rows:
        with pytest.raises((ValueError, ShapeError), match=message):
            through(device, cut, shape, **more)
