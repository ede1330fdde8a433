"""lenslet_gradient.cl and lenslet_moments.cl, lenslet by lenslet, against float64 twins."""

import math
from functools import lru_cache

import numpy as np

from clplen.wave.elements.hard_apertures import polygon_coverage
from clplen.wave.elements.lenslet_gradients import (
    array_gradient,
    array_rates,
    array_sums,
    array_tangents,
    lenslet_moments,
)
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Grid

DX, LAM, P = 5e-6, 532e-9, 9.37 * 5e-6
GRID = Grid((33, 38), (DX, 1.1 * DX), origin=(0, DX / 2))
STRIPS = 32
ARRAYS = {
    "discs": MicrolensArray(P, (2.5e-3, 3e-3), count=(3, 2), offset=(2e-6, -6e-6), rotation=0.12),
    "squares": MicrolensArray(
        P, 2.5e-3, count=(2, 3), fill="full", diameter=0.9 * P, offset=(2e-6, -6e-6), rotation=0.3
    ),
    "hexagonal": MicrolensArray(
        P, (2.5e-3, 3.5e-3, 2.8e-3), count=(3, 2), lattice="hexagonal", rotation=-0.5
    ),
    "hexagons": MicrolensArray(
        P, 2.5e-3, count=(3, 2), lattice="hexagonal", fill="full", diameter=0.8 * P, rotation=-0.5
    ),
}


def loss_gradient():
    random = np.random.default_rng(1)
    return random.normal(size=GRID.shape) + 1j * random.normal(size=GRID.shape) + (0.5 - 0.2j)


def disc(centre, radius):
    """Covered share of every cell: strips of exact chord, along the axis as in coverage.cl."""
    y, x = np.abs(GRID.y[:, None] - centre[0]), np.abs(GRID.x - centre[1])
    y, x = np.broadcast_arrays(y, x)
    hy, hx = GRID.pitch[0] / 2, GRID.pitch[1] / 2
    t = (2 * np.arange(STRIPS) + 1) / STRIPS - 1

    def share(along, across, ha, hs):
        chord = np.sqrt(np.maximum(radius**2 - (across[..., None] + hs * t) ** 2, 0))
        right, left = np.minimum(along[..., None] + chord, ha), along[..., None] - chord
        return np.maximum(right - np.maximum(left, -ha), 0).mean(axis=-1) / (2 * ha)

    found = np.where(x * hy >= y * hx, share(x, y, hx, hy), share(y, x, hy, hx))
    return np.where((x + hx) ** 2 + (y + hy) ** 2 <= radius**2, 1, found)


def cell(mla, centre, diameter, angle):
    sides = 6 if mla.lattice == "hexagonal" else 4
    turns = angle + 2 * np.pi * (np.arange(sides) + 0.5) / sides
    corner = diameter / 2 / math.cos(math.pi / sides)
    return polygon_coverage(GRID, centre + corner * np.stack([np.sin(turns), np.cos(turns)], -1))


def parts(mla):
    """(y, x) of every sample from its nearest lenslet, and which that is."""
    y, x = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    return np.argmin([(y - a) ** 2 + (x - b) ** 2 for a, b in centres], axis=0), y, x


def transmission(mla, index, centres, lengths, diameter, angle):
    _, y, x = parts(mla)
    if mla.fill == "full":
        share = sum(cell(mla, centre, diameter, angle) for centre in centres)
    else:
        share = sum(disc(centre, diameter / 2) for centre in centres)
    r2 = (y - centres[index, 0]) ** 2 + (x - centres[index, 1]) ** 2
    return share * np.exp(-1j * np.pi * r2 / (LAM * lengths[index]))


@lru_cache
def expected(name):
    """Central differences of the twin, every lenslet with a place and a focal length of its own."""
    mla, weight = ARRAYS[name], loss_gradient().conj()
    index, _, _ = parts(mla)
    start = {
        "centres": mla.centres().reshape(-1, 2),
        "lenslet_focal_lengths": np.asarray(mla.focal_lengths)[mla.types()].ravel(),
        "diameter": np.array(mla.diameter),
        "angle": np.array(0.0),
    }

    def loss(key, value):
        given = start | {key: value}
        angle = mla.rotation + given["angle"]
        t = transmission(
            mla, index, given["centres"], given["lenslet_focal_lengths"], given["diameter"], angle
        )
        return (weight * t).sum().real

    def slope(key, at, step):
        unit = np.zeros(start[key].shape)
        unit[at] = step
        return (loss(key, start[key] + unit) - loss(key, start[key] - unit)) / (2 * step)

    steps = {"centres": 2e-12, "lenslet_focal_lengths": 1e-7, "diameter": 1e-12, "angle": 1e-8}
    return {
        key: np.reshape([slope(key, at, step) for at in np.ndindex(start[key].shape)],
                        start[key].shape)
        for key, step in steps.items()
    }  # fmt: skip


def test_every_lenslet(device, precise):
    for name in ARRAYS:
        mla, twin = ARRAYS[name], expected(name)
        for where, tolerance in ((precise, 2e-6), (device, 1e-3)):
            of_transmission = where.upload(loss_gradient().astype(where.complex))
            found = array_gradient(mla, of_transmission, GRID, LAM, where)
            for key in ("centres", "lenslet_focal_lengths", "diameter"):
                got = np.reshape(found[key], twin[key].shape)
                assert np.abs(got - twin[key]).max() <= tolerance * np.abs(twin[key]).max(), key
            # the rotation moves the centres and turns the cells
            away = mla.centres() - mla.offset
            moved = (
                found["centres"][..., 0] * away[..., 1] - found["centres"][..., 1] * away[..., 0]
            )
            turned = found["rotation"] - moved.sum()
            if mla.fill == "full":
                assert abs(turned - twin["angle"]) <= tolerance * abs(twin["angle"])
            else:
                assert turned == 0 == twin["angle"]


def test_moments(device, precise):
    for order in [1, 5]:
        for name in ["discs", "hexagonal"]:
            mla, values = ARRAYS[name], loss_gradient()
            index, y, x = parts(mla)
            centres = mla.centres().reshape(-1, 2)
            y, x = (y - centres[index, 0]) / P, (x - centres[index, 1]) / P
            cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
            b, a = y * cos - x * sin, x * cos + y * sin
            assert np.hypot(a, b).max() > 1  # samples beyond the array belong to its border
            twin = np.zeros((len(centres), order + 1, order + 1))
            for i, k in np.argwhere(
                np.add.outer(np.arange(order + 1), np.arange(order + 1)) <= order
            ):
                terms = values.imag * b**i * a**k
                twin[:, i, k] = np.bincount(index.ravel(), terms.ravel(), minlength=len(centres))
            for where, tolerance in ((precise, 1e-12), (device, 1e-5)):
                of_log = where.upload(values.astype(where.complex))
                found = lenslet_moments(mla, of_log, GRID, where, order).reshape(twin.shape)
                assert (
                    np.abs(found - twin) <= tolerance * np.abs(twin).max(axis=(1, 2), keepdims=True)
                ).all()


def test_no_sample_is_left_out(device):
    """Of a small, a narrow or a large array at any angle, beside the middle of the window."""
    for count in [(1, 1), (1, 5), (6, 1), (7, 8)]:
        for lattice in ["square", "hexagonal"]:
            for rotation in [0.0, -2.1]:
                mla = MicrolensArray(
                    P, 2.5e-3, count=count, lattice=lattice, rotation=rotation, offset=(3e-5, -4e-5)
                )
                ones = device.upload(np.full(GRID.shape, 1j, device.complex))
                found = lenslet_moments(mla, ones, GRID, device, 0)
                assert found.sum() == np.prod(GRID.shape)
                assert (np.rint(found) == found).all()


def test_tangents_are_the_transpose(device, precise):
    """Re <G, dt> is the gradient: for rates of every lenslet, and for the array's parameters."""
    for name in ("squares", "hexagonal"):
        mla, values = ARRAYS[name], loss_gradient()
        random = np.random.default_rng(4)
        steps = array_rates(mla, LAM)
        mixed = random.normal(size=(2, *mla.count, 7))
        mixed[1, ..., :2], mixed[1, 1:] = 0, 0  # of the first row, without moves
        for where, tolerance in ((precise, 1e-12), (device, 1e-5)):
            of_transmission = where.upload(values.astype(where.complex))
            sums = array_sums(mla, of_transmission, GRID, LAM, where)
            found = array_gradient(mla, of_transmission, GRID, LAM, where)
            for key, rates in (*steps.items(), ("mixed", mixed)):
                expected = (rates * sums).sum(axis=(1, 2, 3))
                scale = np.abs(rates * sums).sum(axis=(1, 2, 3))
                if key != "mixed":
                    assert (np.abs(np.ravel(found[key]) - expected) <= 1e-12 * scale).all(), key
                changed = where.download(array_tangents(mla, rates, GRID, LAM, where))
                got = (values.conj() * changed).real.sum(axis=(1, 2))
                assert (np.abs(got - expected) <= tolerance * scale).all(), key


def check_tangents_sample_by_sample(precise, name):
    mla = ARRAYS[name]
    index, _, _ = parts(mla)
    rates = array_rates(mla, LAM)
    lengths = np.asarray(mla.focal_lengths)[mla.types()].ravel()
    centres, away = mla.centres().reshape(-1, 2), (mla.centres() - mla.offset).reshape(-1, 2)

    def of_pitch(step):
        moved = centres + step / mla.pitch * away
        return transmission(mla, index, moved, lengths, mla.diameter, mla.rotation)

    def of_diameter(step):
        return transmission(mla, index, centres, lengths, mla.diameter + step, mla.rotation)

    for key, twin in (("pitch", of_pitch), ("diameter", of_diameter)):
        expected = (twin(2e-12) - twin(-2e-12)) / 4e-12
        found = precise.download(array_tangents(mla, rates[key], GRID, LAM, precise))[0]
        assert np.abs(found - expected).max() <= 1e-5 * np.abs(expected).max(), key


def test_tangents_sample_by_sample(precise):
    """Central differences of the twin where lenslets move apart and grow."""
    for name in ARRAYS:
        check_tangents_sample_by_sample(precise, name)
