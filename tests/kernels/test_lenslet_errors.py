"""lenslet_errors.cl: what lenslets depart by from thin lenses, against a float64 twin."""

import math

import numpy as np

from clplen.wave.elements.lenslet_errors import LensletErrors
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid

DX, LAM, P = 5e-6, 532e-9, 9.37 * 5e-6
TERMS = {(2, -2): 0.3 * LAM, (3, 1): -0.2 * LAM, (4, 0): 0.15 * LAM}


def path(y, x):
    """Oblique astigmatism, coma in x and spherical aberration (Noll 1976, table I), in metres."""
    r2 = y**2 + x**2
    found = 0.3 * math.sqrt(6) * 2 * x * y - 0.2 * math.sqrt(8) * (3 * r2 - 2) * x
    return LAM * (found + 0.15 * math.sqrt(5) * (6 * r2**2 - 6 * r2 + 1))


def twin(mla, errors, grid):
    """Lens by lens: moved, of its own focal length and tilted, over that of the design."""
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    away = [(y - cy) ** 2 + (x - cx) ** 2 for cy, cx in centres]
    index = np.argmin(away, axis=0)
    y, x = y - centres[index, 0], x - centres[index, 1]
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    y, x = y * cos - x * sin, x * cos + y * sin
    f = np.asarray(mla.focal_lengths)[mla.types().ravel()[index]]
    own = errors.focal_lengths.ravel()[index]
    (ty, tx), (sy, sx) = (
        np.moveaxis(v.reshape(-1, 2)[index], -1, 0) for v in (errors.tilt, errors.position)
    )
    lens = -((y - sy) ** 2 + (x - sx) ** 2) / (2 * own) + (y**2 + x**2) / (2 * f)
    total = lens + ty * y + tx * x
    if errors.terms:
        total = total + path(2 * y / errors.circle, 2 * x / errors.circle)
    return np.exp(2j * np.pi * total / LAM), np.hypot(y, x) < 0.6 * mla.pitch


def scattered(mla, terms):
    random = np.random.default_rng(3)
    lengths = np.asarray(mla.focal_lengths)[mla.types()]
    return LensletErrors(
        terms,
        1.2 * mla.diameter,
        lengths * random.uniform(0.8, 1.2, mla.count),
        random.uniform(-2e-3, 2e-3, (*mla.count, 2)),
        random.uniform(-4e-6, 4e-6, (*mla.count, 2)),
    )


def test_against_the_twin(device, precise):
    for terms in [TERMS, {}]:
        for lattice, f, degrees in [
            ("square", (2.5e-3, 3e-3), 7),
            ("hexagonal", (2.5e-3, 3.5e-3, 2.8e-3), -30),
        ]:
            grid = Grid((33, 38), (DX, 1.1 * DX), origin=(0, DX / 2))
            mla = MicrolensArray(
                P,
                f,
                count=(3, 4),
                lattice=lattice,
                offset=(2e-6, -6e-6),
                rotation=np.deg2rad(degrees),
            )
            errors = scattered(mla, terms)
            expected, inside = twin(mla, errors, grid)
            assert not inside.all()
            for where, tolerance in ((device, 1e-5), (precise, 1e-12)):  # 2 pi 1e-7 of a few turns
                got = where.download(errors.phase(mla, grid, LAM, where))
                assert np.abs(got - expected)[inside].max() <= tolerance
