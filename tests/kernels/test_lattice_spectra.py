"""lattice_spectra.cl: spectra in the basis of mirrored pairs, against NumPy."""

import math

import numpy as np
import pytest
from tolerance import relative_max

PLANES, WIDTH = 2, 16


def rows_of(spectra, w):
    """alpha, beta of every pair, and the middle sample: (w^2, ...) from (w^2, ...)."""
    out = []
    for r in range(w * w // 2):
        a, b = spectra[r], spectra[w * w - 1 - r]
        out += [(a + b) / math.sqrt(2), (a - b) / math.sqrt(2) / 1j]
    return np.array(out + [spectra[w * w // 2]] * (w % 2))


def packed(pictures, w):
    """What pack makes of samples on the lattice (frames, planes, w^2, ny, nx), by definition."""
    ny, nx = pictures.shape[-2:]
    q = [(y, x) for y in range(ny // 2 + 1) for x in range(nx // 2 + 1)]
    out = np.zeros((len(pictures), -(-len(q) // WIDTH) * WIDTH, PLANES * w * w, 4))
    flip = np.arange(w * w).reshape(w, w)[::-1].ravel()
    for b, stack in enumerate(pictures):
        for p, cells in enumerate(stack):
            spectra = np.fft.fft2(cells)
            upper, lower = rows_of(spectra, w), rows_of(spectra[flip], w)
            for n, (y, x) in enumerate(q):
                u, v = upper[:, y, x], lower[:, -y % ny, x]
                part = slice(p * w * w, (p + 1) * w * w)
                out[b, n, part] = np.stack([u.real, u.imag, v.real, v.imag], axis=-1)
    blocks = out.reshape(len(pictures), -1, WIDTH, PLANES * w * w, 4)
    return blocks.transpose(0, 1, 3, 4, 2)


def paired(cells, w):
    """Fields of lattice.cl from samples on the lattice, and their spectra."""
    count = (w * w + 1) // 2
    values = cells[..., :count, :, :] + 1j * cells[..., ::-1, :, :][..., :count, :, :]
    return np.fft.fft2(values).astype(np.complex64)


@pytest.mark.parametrize("w", [1, 2, 3])
@pytest.mark.parametrize("window", [(5, 6), (6, 9), (4, 4)])
def test_pack_and_unpack(device, w, window):
    cells = np.random.default_rng(w).random((2, PLANES, w * w, *window))
    spectra = paired(cells, w)
    count, pairs = spectra.shape[2] * 2 * PLANES, spectra.shape[2]
    expected = packed(cells, w)
    fields = device.upload(spectra.reshape(count, *window))
    out = device.upload(np.full(expected.shape, np.nan, np.float32))
    sizes = [np.int32(k) for k in (w, PLANES, *window)]
    frequencies = expected.shape[1] * WIDTH
    size = (1 if device.rows else frequencies, pairs, 2 * PLANES)
    device.launch(device.kernel("lattice_spectra.cl", "pack"), size, out, fields, *sizes)
    # one rounding of each field and of each sum
    assert relative_max(expected, device.download(out)) < 3e-7
    again = device.empty(fields.shape, np.complex64)
    unpack = device.kernel("lattice_spectra.cl", "unpack")
    device.launch_rows(unpack, fields.shape, again, out, *sizes)
    assert relative_max(spectra.reshape(fields.shape), device.download(again)) < 3e-7


@pytest.mark.parametrize(("w", "v"), [(3, 2), (2, 3), (3, 3), (4, 1)])
def test_assembled_matrix_multiplies_spectra(device, w, v):
    # H[m, s] of any point images with H[m', s'](k) = H[m, s](-k)
    window, rng = (5, 6), np.random.default_rng(v)
    h = rng.random((w * w, v * v, *window))
    turned = np.roll(h[::-1, ::-1, ::-1, ::-1], (1, 1), axis=(2, 3))
    h = (h + turned) / 2
    voxels = (v * v + 1) // 2
    spectra = np.concatenate([paired(h[:, t], w) for t in range(voxels)])
    q = (window[0] // 2 + 1) * (window[1] // 2 + 1)
    blocks, columns = -(-q // WIDTH), v * v + 1
    R = device.upload(np.full((blocks, w * w, columns, WIDTH), 7, np.float32))
    kernel, pairs = device.kernel("lattice_spectra.cl", "assemble"), (w * w + 1) // 2
    for start, stop in ((0, 1), (1, voxels)):  # those of some voxels at a time
        size = (1 if device.rows else blocks * WIDTH, pairs, stop - start)
        fields = device.upload(spectra[start * pairs : stop * pairs])
        sizes = (start, w, v, 1, columns, *window)
        device.launch(kernel, size, R, fields, *(np.int32(k) for k in sizes))
    got = device.download(R)
    assert (got[:, :, 0] == 7).all()
    matrix = got[:, :, 1:].transpose(0, 3, 1, 2).reshape(-1, w * w, v * v)[:q]
    f = rng.random((v * v, *window))
    F, H = np.fft.fft2(f), np.fft.fft2(h)
    expected = rows_of(np.einsum("ms...,s...->m...", H, F), w)
    corner = (slice(None), slice(window[0] // 2 + 1), slice(window[1] // 2 + 1))
    found = np.einsum("qij,jq->iq", matrix, rows_of(F, v)[corner].reshape(v * v, q))
    assert relative_max(expected[corner].reshape(w * w, q), found) < 5e-7
