"""lenslets.cl: microlens arrays in closed form against their float64 twin."""

import numpy as np
import reference

from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid

DX = 5e-6
WAVELENGTH = 532e-9


def both(device, *, shape, pitch=(DX, DX), **kwargs):
    grid = Grid(shape, pitch, origin=(0, pitch[1] / 2))
    p = 9.37 * DX
    field = Field.from_array(np.ones(shape), grid, wavelength=WAVELENGTH, device=device)
    got = MicrolensArray(p, 2.5e-3, **kwargs).apply(field).to_numpy()
    expected = reference.microlens_array(
        shape, grid.pitch, pitch=p, f=2.5e-3, wavelength=WAVELENGTH, origin=grid.origin, **kwargs
    )
    return got, expected


def check(got, expected, *, phase):
    assert np.abs(np.abs(got) - np.abs(expected)).max() <= 1e-3
    lit = np.abs(expected) > 1e-2
    assert lit.any()
    assert np.abs(np.angle(got[lit] * np.conj(expected[lit]))).max() <= phase


def test_phase_and_edges(device):
    for degrees in [0, 7, -30]:
        for fill in ["circular", "full"]:
            for lattice in ["square", "hexagonal"]:
                got, expected = both(
                    device,
                    shape=(33, 46),
                    count=(3, 4),
                    lattice=lattice,
                    fill=fill,
                    offset=(0.4 * DX, -1.3 * DX),
                    rotation=np.deg2rad(degrees),
                )
                check(got, expected, phase=1e-5)


def test_gaps_and_oblong_samples(device):
    for fill in ["circular", "full"]:
        for lattice in ["square", "hexagonal"]:
            got, expected = both(
                device,
                shape=(40, 29),
                pitch=(0.8 * DX, 1.1 * DX),
                count=(4, 3),
                lattice=lattice,
                fill=fill,
                diameter=0.83 * 9.37 * DX,
                rotation=0.3,
            )
            check(got, expected, phase=1e-5)


def test_double_precision(precise):
    for lattice in ["square", "hexagonal"]:
        got, expected = both(precise, shape=(33, 46), count=(3, 4), lattice=lattice, rotation=0.1)
        check(got, expected, phase=1e-11)


def test_several_focal_lengths(device):
    """Every sample has the phase of a whole array of its nearest lenslet's kind."""
    for lattice, lengths in [
        ("square", (2.5e-3, -3e-3)),
        ("square", (2.5e-3, 2.2e-3, 3e-3, 4e-3)),
        ("hexagonal", (2.5e-3, 3.5e-3, 2.8e-3)),
    ]:
        grid = Grid((40, 39), DX, origin=(DX / 2, 0))
        p, lay = 9.37 * DX, {"count": (4, 3), "lattice": lattice, "fill": "full", "rotation": 0.2}
        array = MicrolensArray(p, lengths, **lay)
        one = Field.from_array(np.ones(grid.shape), grid, wavelength=WAVELENGTH, device=device)
        got = array.apply(one).to_numpy()
        y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
        away = [(y - cy) ** 2 + (x - cx) ** 2 for cy, cx in array.centres().reshape(-1, 2)]
        kind = array.types().ravel()[np.argmin(away, axis=0)]
        assert set(kind.ravel()) == set(range(len(lengths)))
        each = [
            reference.microlens_array(
                grid.shape,
                grid.pitch,
                pitch=p,
                f=f,
                wavelength=WAVELENGTH,
                origin=grid.origin,
                **lay,
            )
            for f in lengths
        ]
        check(got, np.choose(kind, each), phase=1e-5)
