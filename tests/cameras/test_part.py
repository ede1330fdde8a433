"""Fields that fill only the aperture's part of a camera's grid."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.cameras.optics.wave_optics import aperture_grid, propagate_part
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.errors import ShapeError
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.propagator import Propagator

GRIDS = [
    Grid((40, 37), (5e-6, 7e-6)),
    Grid((40, 36), (5e-6, 7e-6), origin=(2.5e-6, 3.5e-6)),
    Grid((41, 38), 5e-6, origin=(-2.4e-6, 11e-6)),
]


@pytest.mark.parametrize("grid", GRIDS[::2])
def test_a_part_is_propagated_like_the_whole(device, grid):
    part = aperture_grid(grid, 60e-6)
    rng = np.random.default_rng(2)
    u = rng.normal(size=(2, *part.shape)) + 1j * rng.normal(size=(2, *part.shape))
    wide = np.zeros((2, *grid.shape), complex)
    y, x = (m // 2 - n // 2 for n, m in zip(part.shape, grid.shape, strict=True))
    wide[:, y : y + part.shape[0], x : x + part.shape[1]] = u
    plan = Propagator(grid, 1e-4, wavelength=5e-7, method="blas", pad=2, device=device)
    fields = [
        Field.from_array(values, where, wavelength=5e-7, device=device)
        for values, where in ((u, part), (wide, grid))
    ]
    got, expected = (propagate_part(plan, field) for field in fields)
    assert got.grid == expected.grid == grid
    assert np.array_equal(got.to_numpy(), expected.to_numpy())


def test_another_grid_is_no_part(device):
    for grid in [Grid((20, 44), (5e-6, 7e-6)), Grid((20, 20), (5e-6, 7e-6), origin=(0.0, 1e-6))]:
        plan = Propagator(GRIDS[0], 1e-4, wavelength=5e-7, method="blas", pad=1, device=device)
        field = Field.from_array(np.ones(grid.shape), grid, wavelength=5e-7, device=device)
        with pytest.raises(ShapeError, match="must be on a part"):
            propagate_part(plan, field)


def test_the_pupil_on_its_part_is_that_of_the_whole(precise):
    lenslets = MicrolensArray(150e-6, 10e-3, count=(9, 12), fill="full")
    cam = PlenopticCamera.type1(
        focal_length=0.012, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=30, device=precise
    )
    points = np.array([(2e-5, -3e-5, 1e-4), (0.0, 1e-5, -1e-4)])
    whole, part = (cam.optics.pupil(points, 1e-6, full_grid=full) for full in (True, False))
    assert part.grid.shape[0] < whole.grid.shape[0]
    y, x = (m // 2 - n // 2 for n, m in zip(part.grid.shape, whole.grid.shape, strict=True))
    inside = np.s_[..., y : y + part.grid.shape[0], x : x + part.grid.shape[1]]
    values = whole.to_numpy()
    assert np.array_equal(values[inside], part.to_numpy())
    values[inside] = 0
    assert not values.any()
