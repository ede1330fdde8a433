"""Cells of square and hexagonal arrays, and the light of a point outside its own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clplen.analysis.cameras.crosstalk import (
    cell_centres,
    cell_energies,
    cell_outline,
    crosstalk,
    energy_in_cell,
)
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.wave.elements.lenslets import MicrolensArray

SHAPE = (67, 83)


def cells_of(pitch: float, count: tuple[int, int], *, hexagonal: bool, turn: float) -> LensletGrid:
    """Of an array in pixels, turned by ``turn`` and off the middle of SHAPE."""
    cos, sin = math.cos(turn), math.sin(turn)
    height = pitch * (math.sqrt(3) / 2 if hexagonal else 1)
    row, column = (height * cos, -height * sin), (pitch * sin, pitch * cos)
    middle = (35.37, 38.43)
    first = [
        m - count[0] // 2 * r - count[1] // 2 * c
        for m, r, c in zip(middle, row, column, strict=True)
    ]
    return LensletGrid(
        count, (1, 1), (first[0], first[1]), row, column, odd_row_shift=0.5 if hexagonal else 0.0
    )


ARRAYS = {
    "turned square": cells_of(8.3, (6, 5), hexagonal=False, turn=0.21),
    "turned hexagonal": cells_of(9.1, (6, 4), hexagonal=True, turn=-0.37),
}


@pytest.fixture(params=ARRAYS)
def cells(request: pytest.FixtureRequest) -> LensletGrid:
    return ARRAYS[request.param]


def brute(cells: LensletGrid, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) of the nearest of all centres, and of two more rings around the array."""
    i, k = np.mgrid[-2 : cells.count[0] + 2, -2 : cells.count[1] + 2]
    along = k + cells.odd_row_shift * (i % 2)
    places = [
        cells.first[axis] + i * cells.row_step[axis] + along * cells.column_step[axis]
        for axis in (0, 1)
    ]
    down, right = (np.subtract.outer(c, p.ravel()) for c, p in zip((y, x), places, strict=True))
    distance = down**2 + right**2
    near = distance.argmin(axis=-1)
    return i.ravel()[near], k.ravel()[near]


def test_centres_of_a_lattice_whose_rows_run_along_y() -> None:
    lattice = Lattice("hexagonal", (31.3, 40.1), (11.0, 0.4), (-0.35, 9.53), shape=SHAPE)
    assert lattice.turned
    cells = lattice.grid(lattice.views())
    every = lattice.centres()
    for centre in cell_centres(cells).reshape(-1, 2):
        assert np.hypot(*(every - centre).T).min() < 1e-9
    even = np.ones(SHAPE)
    area = 11.0 * 9.53 + 0.4 * 0.35
    assert energy_in_cell(even, cells, (1, 1)) == pytest.approx(area)


def test_even_light_fills_every_cell_by_its_area(cells: LensletGrid) -> None:
    (a, b), (c, d) = cells.row_step, cells.column_step
    even = np.full(SHAPE, 0.3)
    for cell in ((1, 1), (2, 3), (3, 2)):
        assert energy_in_cell(even, cells, cell) == pytest.approx(0.3 * abs(a * d - b * c))
        assert len(cell_outline(cells, cell)) == (6 if cells.odd_row_shift else 4)


@pytest.mark.thorough
def test_the_light_in_a_cell_is_what_lies_nearest_to_its_centre(cells: LensletGrid) -> None:
    light = np.random.default_rng(4).uniform(0, 1, SHAPE)
    n, size = 24, 20  # points a pixel and axis: the outline is known to half of 1/24 pixel
    for cell in ((2, 2), (3, 1)):
        low = [round(float(c)) - size // 2 for c in cell_centres(cells)[cell]]
        y, x = (first - 0.5 + (np.arange(size * n) + 0.5) / n for first in low)
        row, column = brute(cells, *(v.ravel() for v in np.meshgrid(y, x, indexing="ij")))
        own = ((row == cell[0]) & (column == cell[1])).reshape(size, n, size, n).mean(axis=(1, 3))
        part = light[low[0] : low[0] + size, low[1] : low[1] + size]
        expected = np.sum(part * own)
        assert energy_in_cell(light, cells, cell) == pytest.approx(expected, rel=5e-3)
        assert crosstalk(light, cells, cell=cell) == pytest.approx(
            1 - energy_in_cell(light, cells, cell) / light.sum()
        )


def test_energies_of_all_cells(cells: LensletGrid) -> None:
    light = np.random.default_rng(6).uniform(0, 1, SHAPE)
    y, x = np.indices(SHAPE, dtype=float)
    row, column = brute(cells, y.ravel(), x.ravel())
    expected = np.zeros(cells.count)
    inside = (row >= 0) & (row < cells.count[0]) & (column >= 0) & (column < cells.count[1])
    np.add.at(expected, (row[inside], column[inside]), light.ravel()[inside])
    np.testing.assert_allclose(cell_energies(light, cells), expected, rtol=1e-12)


def test_the_brightest_cell_is_the_point_s_own(cells: LensletGrid) -> None:
    light = np.full(SHAPE, 1e-3)
    centre = cell_centres(cells)[3, 2]
    light[round(centre[0]), round(centre[1])] = 7
    light[round(centre[0]), round(centre[1]) + 16] = 2
    assert crosstalk(light, cells) == pytest.approx(crosstalk(light, cells, cell=(3, 2)))
    assert 2 / 16 < crosstalk(light, cells) < 9 / 15
    assert crosstalk(light, cells, total=100.0) == pytest.approx(
        1 - energy_in_cell(light, cells, (3, 2)) / 100
    )


def test_a_cell_that_leaves_the_sensor_has_what_is_on_it() -> None:
    cells = LensletGrid((3, 3), (1, 1), (0.0, 4.5), (6.0, 0.0), (0.0, 5.0))
    even = np.ones((12, 14))
    assert energy_in_cell(even, cells, (0, 0)) == pytest.approx(3.5 * 5)
    assert energy_in_cell(even, cells, (2, 2)) == pytest.approx(2.5 * (13.5 - 12))
    away = LensletGrid((3, 3), (1, 1), (-40.0, 4.5), (6.0, 0.0), (0.0, 5.0))
    assert energy_in_cell(even, away, (0, 0)) == 0


@pytest.mark.parametrize(("lattice", "cell"), [("square", (25, 25)), ("hexagonal", (24, 26))])
def test_crosstalk_of_a_camera(device: Device, lattice: str, cell: tuple[int, int]) -> None:
    # A wider or a narrower main lens than the matched one, 3.6 mm: figure 1.9 of the thesis.
    mla = MicrolensArray(150e-6, 0.010, count=51, lattice=lattice, fill="full")
    y, x = mla.centres()[cell]
    found = []
    for diameter in (2.4e-3, 3.6e-3, 4.8e-3):
        camera = PlenopticCamera.type1(
            focal_length=0.120,
            mla=mla,
            wavelength=532e-9,
            pixels_per_lenslet=16,
            aperture_diameter=diameter,
            device=device,
        )
        raw = camera.expose(PointSources([(-x, -y, 0.0)]))  # 2f-2f
        light = raw.to_numpy()
        assert np.unravel_index(cell_energies(light, raw.cells).argmax(), (51, 51)) == cell
        found.append(crosstalk(light, raw.cells))
    if lattice == "square":
        np.testing.assert_allclose(found, (0.14, 0.107, 0.24), atol=0.02)
    else:
        assert found[1] < found[0] < found[2]


def test_bad_input_is_told() -> None:
    cells, light = ARRAYS["turned square"], np.ones(SHAPE)
    for cell in ((6, 0), (-1, 2), (0, 5)):
        with pytest.raises(ValueError, match=r"cell must lie in .*\(6, 5\)"):
            crosstalk(light, cells, cell=cell)
    with pytest.raises(ValueError, match="must be positive"):
        crosstalk(0 * light, cells)
    with pytest.raises(ShapeError, match="A raw image must have shape"):
        cell_energies(np.ones((*SHAPE, 3)), cells)
