"""lenslet_gradient.cl and lenslet_moments.cl, lenslet by lenslet, against float64 twins."""

import math

import numpy as np

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


def parts(mla):
    """(y, x) of every sample from its nearest lenslet, and which that is."""
    y, x = np.meshgrid(GRID.y, GRID.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    return np.argmin([(y - a) ** 2 + (x - b) ** 2 for a, b in centres], axis=0), y, x


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
