"""aperture.cl and coverage.cl: the covered fraction of every sample's cell."""

import numpy as np
import pytest
import reference

from clplen.wave.elements.hard_apertures import aperture
from clplen.wave.field.field import Field, Grid

# shape, pitch, origin, diameter in samples, centre
CASES = [
    ((23, 31), (1e-6, 1e-6), (0, 0), 9.37, (0, 0)),
    ((24, 19), (1e-6, 1.6e-6), (0.5e-6, 0), 11.0, (0.4e-6, -1.3e-6)),
    ((31, 32), (2e-6, 1e-6), (0, 0.5e-6), 21.7, (0, 0)),
    ((9, 64), (5e-6, 5e-6), (0, 0), 51.3, (1e-6, 2e-6)),
    # the rim in the last sample of sixteen, and in the first
    ((9, 37), (1e-6, 1e-6), (0, 0), 6.4, (0, 0)),
    ((9, 37), (1e-6, 1e-6), (0, 0), 6.4, (0, -5e-6)),
]


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_disc_is_area_weighted(wave):
    for shape, pitch, origin, width, centre in CASES:
        grid = Grid(shape, pitch, origin=origin)
        field = Field.from_array(np.full(shape, 2 - 1j), grid, wavelength=5e-7, device=wave)
        diameter = width * pitch[1]
        got = aperture(field, diameter, centre=centre).to_numpy() / (2 - 1j)
        expected = reference.circle_coverage(shape, pitch, diameter, centre=centre, origin=origin)
        # 32 strips: a kink of slope 2 inside a strip costs at most 2 (1/32)^2/8 of the cell
        assert np.abs(got - expected).max() <= 2 * (1 / 32) ** 2 / 8 + 1e-5


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_square_is_exact(wave):
    for shape, pitch, origin, width, centre in CASES:
        grid = Grid(shape, pitch, origin=origin)
        field = Field.from_array(np.ones(shape), grid, wavelength=5e-7, device=wave)
        side = width * pitch[1]
        got = aperture(field, side, shape="square", centre=centre).to_numpy()
        expected = reference.rectangle_coverage(
            shape, pitch, (side, side), centre=centre, origin=origin
        )
        # an edge N/2 samples from the centre is itself rounded to N/2 eps of a sample, twice
        bound = 4 * np.finfo(wave.real).eps + max(shape) * np.finfo(np.float64).eps
        assert np.abs(got - expected).max() <= bound
