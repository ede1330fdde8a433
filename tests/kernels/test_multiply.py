"""multiply.cl and separable.cl: fields times a transmission."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.compute.fft.blocks import add
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.transmission import multiply, multiply_separable


def fields(device, shape):
    rng = np.random.default_rng(5)
    u = rng.normal(size=(3, *shape)) + 1j * rng.normal(size=(3, *shape))
    return u, Field.from_array(u, Grid(shape, 1e-6), wavelength=5e-7, device=device)


def table(n, seed):
    rng = np.random.default_rng(seed)
    return rng.normal(size=n) + 1j * rng.normal(size=n)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_multiply(wave):
    for shape in [(5, 7), (1, 67), (8, 1)]:
        u, field = fields(wave, shape)
        t = table(shape, 1)
        got = multiply(field, wave.upload(t.astype(wave.complex))).to_numpy()
        assert relative_max(u * t, got) <= 8 * np.finfo(wave.real).eps
        assert relative_max(u, field.to_numpy()) <= np.finfo(wave.real).eps  # input untouched
        back = multiply(field, wave.upload(t.astype(wave.complex)), conjugate=True).to_numpy()
        assert relative_max(u * t.conj(), back) <= 8 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_add(wave):
    for shape in [(5, 7), (1, 67), (8, 1)]:
        (u, field), v = fields(wave, shape), table((3, *shape), 4)
        other = wave.upload(v.astype(wave.complex))
        add(field.data, other, wave)
        assert relative_max(u + v, field.to_numpy()) <= 2 * np.finfo(wave.real).eps
        assert relative_max(v, wave.download(other)) <= np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_multiply_separable(wave):
    for shape in [(5, 7), (1, 67), (8, 1), (3, 32)]:
        u, field = fields(wave, shape)
        ty, tx = table(shape[0], 2), table(shape[1], 3)
        got = multiply_separable(field, ty.astype(wave.complex), tx.astype(wave.complex)).to_numpy()
        assert relative_max(u * ty[:, None] * tx, got) <= 12 * np.finfo(wave.real).eps
