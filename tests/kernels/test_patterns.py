"""patterns.cl: spectra in larger windows, intensities, combs of weights, sums of products."""

import numpy as np
import pytest
from tolerance import relative_max

BOTH = pytest.mark.parametrize("wave", ["single", "double"], indirect=True)


def launch(wave, name, out, *args):
    kernel = wave.kernel("patterns.cl", name, **wave.wave_defines())
    wave.launch_rows(kernel, out.shape, out, *args)
    return wave.download(out)


def numbers(wave, shape, seed=1):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape) + 0.3).astype(wave.complex)


def ints(*values):
    return [np.int32(v) for v in values]


@pytest.mark.parametrize(
    ("wave", "shape", "finer"),
    [("single", (5, 8), 3), ("double", (7, 6), 2), ("double", (1, 11), 1)],
    indirect=["wave"],
)
def test_refine_interpolates_waves(wave, shape, finer):
    """A wave of one frequency, the lowest negative one, on a finer grid: exactly that wave."""
    ky, kx = -((shape[0] - 1) // 2), shape[1] // 2 - 1
    fine = tuple(finer * n for n in shape)

    def waves(ny, nx):
        y, x = np.arange(ny)[:, None], np.arange(nx)
        one = np.exp(2j * np.pi * (ky * y / ny + kx * x / nx))
        return np.stack([one, 0.5j * one.conj() + 0.2])

    spectrum = wave.upload(np.fft.fft2(waves(*shape)).astype(wave.complex))
    out = wave.empty((2, *fine), wave.complex)
    got = np.fft.ifft2(launch(wave, "refine", out, spectrum, *ints(*fine, *shape)))
    # rounding of the two transforms
    assert relative_max(waves(*fine), got * finer**2) <= 30 * np.finfo(wave.real).eps


@BOTH
def test_pattern_is_an_intensity_with_zeros_around(wave):
    window, u = (11, 16), numbers(wave, (3, 6, 9))
    out = wave.upload(numbers(wave, window, seed=2))  # what was there before does not matter
    gain = wave.real.type(2.5)
    got = launch(wave, "pattern", out, wave.upload(u), gain, *ints(1, *window, 6, 9))
    expected = np.zeros(window, complex)
    expected[:6, :9] = 2.5 * np.abs(u[1].astype(np.complex128)) ** 2
    assert relative_max(expected, got) <= 4 * np.finfo(wave.real).eps  # squares, sum, gain


@pytest.mark.parametrize(
    ("wave", "kinds", "tall", "wide"),
    [("single", 2, 2, 3), ("double", 1, 2, 3), ("double", 2, 1, 1)],
    indirect=["wave"],
)
def test_comb_sums_what_each_sample_meets(wave, kinds, tall, wide):
    rng = np.random.default_rng(3)
    (ny, nx), (rows, columns) = (9, 14), (5, 4)
    w = numbers(wave, (rows, columns))
    row = rng.integers(-3, rows + 2, ny).astype(np.int32)
    column = rng.integers(-3, columns + 2, (kinds, nx)).astype(np.int32)
    down, across = (rng.random(s).astype(wave.real) for s in ((ny, tall), (kinds, nx, wide)))
    down[2] = 0
    expected = np.zeros((ny, nx), complex)
    for y, x, i, k in np.ndindex(ny, nx, tall, wide):
        r = row[y] + i
        s = column[r % kinds, x] + k
        if 0 <= r < rows and 0 <= s < columns:
            expected[y, x] += float(down[y, i]) * float(across[r % kinds, x, k]) * w[r, s]
    out = wave.upload(numbers(wave, (ny, nx), seed=2))
    tables = [wave.upload(t) for t in (w, row, down, column, across)]
    sizes = ints(rows, columns, kinds, tall, wide, ny, nx)
    got = launch(wave, "comb", out, *tables, *sizes)
    # three roundings a term, up to six terms
    assert relative_max(expected, got) <= 8 * np.finfo(wave.real).eps


@BOTH
def test_products_add_up(wave):
    a, b, start = (numbers(wave, (5, 13), seed) for seed in (1, 2, 3))
    out = wave.upload(start)
    got = launch(wave, "add_product", out, wave.upload(a), wave.upload(b), *ints(5, 13))
    expected = start.astype(complex) + a.astype(complex) * b
    assert relative_max(expected, got) <= 4 * np.finfo(wave.real).eps


@BOTH
def test_parts_of_every_third_sample(wave):
    z, start = numbers(wave, (17, 22)), np.arange(35.0).reshape(5, 7)
    pick = np.array([2.0, -0.5], wave.real)
    out = wave.upload(start.astype(wave.real))
    got = launch(wave, "add_part", out, wave.upload(z), pick, *ints(3, 22, 5, 7))
    chosen = z[:15:3, :21:3].astype(complex)
    expected = start + 2 * chosen.real - 0.5 * chosen.imag
    assert relative_max(expected, got) <= 4 * np.finfo(wave.real).eps
