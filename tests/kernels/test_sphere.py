"""sphere.cl: spherical phases of lenses and point sources against float64."""

import numpy as np
import pytest
from reference_elements import spherical_wave

from clplen.wave.field.field import Field, Grid
from clplen.wave.field.transmission import multiply_sphere

LAM = 532e-9
# shape, pitch, origin, foot of the centre, distance
CASES = [
    ((13, 18), (6.6e-6, 5e-6), (0, 0), (0, 0), 0.12),
    ((24, 19), (5e-6, 6.6e-6), (2.5e-6, 0), (40e-6, -31e-6), 3e-3),
    ((1, 40), (5e-6, 4e-6), (3e-6, 1e-6), (2e-6, 7e-6), -2e-3),
    ((31, 1), (4e-6, 5e-6), (0, 0), (-9e-6, 5e-6), 1e-3),
    ((17, 23), (20e-6, 30e-6), (0, 0), (1e-3, -2e-3), -5e-3),  # 300 turns beside the tables
    ((9, 11), (3e-6, 2e-6), (0, 0), (0, 0), 4e-6),
]


def field_on(device, shape, pitch, origin):
    rng = np.random.default_rng(3)
    u = rng.normal(size=(2, *shape)) + 1j * rng.normal(size=(2, *shape))
    grid = Grid(shape, pitch, origin=origin)
    return u, Field.from_array(u, grid, wavelength=LAM, device=device)


def routes(device):
    if device.precision == "double":
        return ["tables"]
    return ["tables", "twofloat"] + ["fp64"] * device.has_fp64


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_sphere(wave):
    for fades in [False, True]:
        for shape, pitch, origin, centre, z in CASES:
            u, field = field_on(wave, shape, pitch, origin)
            wanted = spherical_wave(shape, pitch, z, LAM, source=centre, origin=origin)
            wanted = u * (wanted * abs(z) if fades else wanted / np.abs(wanted))
            eps = np.finfo(wave.real).eps
            for phase in routes(wave):
                got = multiply_sphere(field, z, centre, fades=fades, phase=phase).to_numpy()
                got = got * (abs(z) if fades else 1)
                # tables, products and 1/r: 12 eps; in double both sides round thousands of turns
                bound = 12 * eps + (2 * np.pi * 8 * eps * 1e4 if wave.precision == "double" else 0)
                assert np.abs((got - wanted) / np.abs(u)).max() <= bound, phase
