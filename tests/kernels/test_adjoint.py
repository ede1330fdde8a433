"""adjoint.cl and transfer_slope.cl against float64."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen.wave.field.transmission import split

SHAPES = [(5, 7), (1, 9), (6, 1), (3, 67)]


def waves(seed, *shape):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_conjugates_and_slopes(wave):
    for shape in SHAPES:
        u, w = waves(1, 2, *shape), np.random.default_rng(2).normal(size=(2, *shape))
        data, out = wave.upload(u.astype(wave.complex)), wave.empty((2, *shape), wave.complex)
        size = [np.int32(n) for n in shape]
        kernel = wave.kernel("adjoint.cl", "conjugate", **wave.wave_defines())
        wave.launch_rows(kernel, u.shape, out, data, *size)
        np.testing.assert_array_equal(wave.download(out), u.astype(wave.complex).conj())
        kernel = wave.kernel("adjoint.cl", "intensity_slope", **wave.wave_defines())
        wave.launch_rows(kernel, u.shape, out, wave.upload(w.astype(wave.real)), data, *size)
        assert relative_max(2 * w * u, wave.download(out)) <= 4 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_inner_products_of_rows(wave):
    for shape in SHAPES:
        a, b = waves(3, 2, *shape), waves(4, 2, *shape)
        (ny, nx), out = shape, wave.empty((2, shape[0]), wave.complex)
        kernel = wave.kernel("adjoint.cl", "row_inner", **wave.wave_defines())
        data = [wave.upload(v.astype(wave.complex)) for v in (a, b)]
        wave.launch(kernel, (ny, 2), out, *data, np.int32(ny), np.int32(nx))
        expected = (np.conj(a) * b).sum(axis=-1)
        norm = np.sqrt((np.abs(a) ** 2).sum(axis=-1) * (np.abs(b) ** 2).sum(axis=-1))
        assert (np.abs(wave.download(out) - expected) / norm).max() <= 4 * np.finfo(wave.real).eps


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_slope_of_the_transfer_function(wave):
    lam, k = 500e-9, 2 * np.pi / 500e-9
    fy, fx = np.linspace(0, 1.4e6, 7), np.linspace(0, 1.9e6, 23)
    H = waves(5, 7, 23)
    s = lam**2 * np.add.outer(fy**2, fx**2)
    root = np.emath.sqrt(1 - s)  # i sqrt(s - 1) of evanescent waves
    data = wave.upload(H.astype(wave.complex))
    squares = [wave.upload(split((lam * f) ** 2, wave.real)) for f in (fx, fy)]
    kernel = wave.kernel("transfer_slope.cl", "transfer_slope", **wave.wave_defines())
    sizes = (wave.real.type(k), np.int32(7), np.int32(23))
    wave.launch_rows(kernel, H.shape, data, *squares, *sizes)
    expected = H * 1j * k * (root - 1)
    assert relative_max(expected, wave.download(data)) <= 30 * np.finfo(wave.real).eps
