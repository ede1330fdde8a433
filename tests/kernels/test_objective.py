"""objective.cl: pupils times tables, against NumPy."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen import Grid, PointSources
from clplen.cameras.optics.objective import Objective


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_each_point_has_its_own_plane_and_place(wave):
    grid = Grid((20, 33), 1e-6, origin=(0.5e-6, 0.0))
    objective = Objective(3.0, 0.4, 1.33, 600e-9)
    points = np.array([(1.1e-6, -2.3e-6, 4e-6), (-0.7e-6, 0.4e-6, -3e-6), (0, 1e-6, 4e-6)])
    found = objective.fields(PointSources(points), grid, wave).to_numpy()
    for field, (x0, y0, z) in zip(found, points, strict=True):
        ky = np.exp(2j * np.pi * np.outer(grid.y - 3 * y0, grid.fy))
        kx = np.exp(2j * np.pi * np.outer(grid.x - 3 * x0, grid.fx))
        expected = ky @ objective.pupil(grid, z) @ kx.T / field.size
        # tables and transform rounded: measured 3e-7
        assert relative_max(expected, field) < (2e-6 if wave.precision == "single" else 1e-13)
