"""lags.cl: products of a field and its conjugate at a distance, and weighted sums of products."""

import numpy as np
import pytest
from tolerance import relative_max

SHAPES = [(1, 13), (13, 1), (5, 8), (16, 11)]


def samples(wave, shape, seed):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape) + 0.3).astype(wave.complex)


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_lag_products(wave):
    for shape in SHAPES:
        a, (ny, nx) = samples(wave, shape, 1), shape
        shift = np.array([[0, 0], [ny - 1, nx - 1], [ny // 2, nx // 3]], np.int32)
        out = wave.empty((3, ny, nx), wave.complex)
        wave.launch_rows(
            wave.kernel("lags.cl", "lag_products", **wave.wave_defines()),
            out.shape,
            out,
            wave.upload(a),
            wave.upload(shift),
            np.int32(ny),
            np.int32(nx),
        )
        exact = a.astype(np.complex128)
        expected = np.stack([exact * np.roll(exact, (-y, -x), (0, 1)).conj() for y, x in shift])
        got = wave.download(out).astype(np.complex128)
        assert relative_max(expected, got) <= 4 * np.finfo(wave.real).eps  # one complex product


@pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
def test_add_products(wave):
    for shape in SHAPES:
        ny, nx = shape
        start, (T, G) = (
            samples(wave, shape, 2),
            (samples(wave, (3, *shape), seed) for seed in (3, 4)),
        )
        weights = np.array([0.5 + 2j, -1j, 0.25]).astype(wave.complex)
        sums = wave.upload(start)
        wave.launch_rows(
            wave.kernel("lags.cl", "add_products", **wave.wave_defines()),
            shape,
            sums,
            wave.upload(T),
            wave.upload(G),
            wave.upload(weights),
            np.int32(3),
            np.int32(ny),
            np.int32(nx),
        )
        products = T.astype(np.complex128) * G.astype(np.complex128)
        expected = start.astype(np.complex128) + np.tensordot(weights, products, axes=1)
        got = wave.download(sums).astype(np.complex128)
        assert (
            relative_max(expected, got) <= 12 * np.finfo(wave.real).eps
        )  # two products, three sums
