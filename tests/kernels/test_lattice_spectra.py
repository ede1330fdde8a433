"""lattice_spectra.cl: spectra in the basis of mirrored pairs, against NumPy."""

import math

import numpy as np
import pytest
from reference_spectra import PLANES, WIDTH, packed, rows_of
from tolerance import relative_max


def paired(cells, w):
    """Fields of lattice.cl from samples on the lattice, and their spectra."""
    count = (math.prod(w) + 1) // 2
    values = cells[..., :count, :, :] + 1j * cells[..., ::-1, :, :][..., :count, :, :]
    return np.fft.fft2(values).astype(np.complex64)


@pytest.mark.parametrize(
    ("w", "window", "parts"),
    [((3, 3), (5, 6), (0, 1)), ((2, 3), (6, 9), (0, 1, 2, 3))],
)
def test_pack_and_unpack(device, w, window, parts):
    cells = np.random.default_rng(w).random((2, PLANES, math.prod(w), *window))
    spectra = paired(cells, w)
    count, pairs = spectra.shape[2] * 2 * PLANES, spectra.shape[2]
    expected = packed(cells, w, parts)
    fields = device.upload(spectra.reshape(count, *window))
    out = device.upload(np.full(expected.shape, np.nan, np.float32))
    bits = sum(part << 2 * number for number, part in enumerate(parts))
    sizes = [np.int32(k) for k in (*w, PLANES, len(parts), bits, *window)]
    frequencies = expected.shape[1] * WIDTH
    size = (1 if device.rows else frequencies, pairs, 2 * PLANES)
    device.launch(device.kernel("lattice_spectra.cl", "pack"), size, out, fields, *sizes)
    # one rounding of each field and of each sum
    assert relative_max(expected, device.download(out)) < 3e-7
    again = device.empty(fields.shape, np.complex64)
    unpack = device.kernel("lattice_spectra.cl", "unpack")
    device.launch_rows(unpack, fields.shape, again, out, *sizes)
    # every part gives the whole back: the transpose of an isometry, times their number
    assert relative_max(len(parts) * spectra.reshape(fields.shape), device.download(again)) < 5e-7


@pytest.mark.parametrize(
    ("w", "v", "odd"), [((3, 3), (2, 2), 0), ((5, 2), (1, 3), 1)]
)
def test_assembled_matrix_multiplies_spectra(device, w, v, odd):
    # H[m, s] of any point images with H[m', s'](k) = H[m, s](-k), or -H[m, s](-k) where odd
    window, rng = (5, 6), np.random.default_rng(v)
    n, s = math.prod(w), math.prod(v)
    h = rng.random((n, s, *window))
    turned = np.roll(h[::-1, ::-1, ::-1, ::-1], (1, 1), axis=(2, 3))
    h = (h - turned if odd else h + turned) / 2
    voxels = (s + 1) // 2
    spectra = np.concatenate([paired(h[:, t], w) for t in range(voxels)])
    q = (window[0] // 2 + 1) * (window[1] // 2 + 1)
    blocks, columns = -(-q // WIDTH), s + 1
    R = device.upload(np.full((blocks, n, columns, WIDTH), 7, np.float32))
    kernel, pairs = device.kernel("lattice_spectra.cl", "assemble"), (n + 1) // 2
    for start, stop in ((0, 1), (1, voxels)):  # those of some voxels at a time
        if start == stop:
            continue
        size = (1 if device.rows else blocks * WIDTH, pairs, stop - start)
        fields = device.upload(spectra[start * pairs : stop * pairs])
        sizes = (start, n, s, 1, columns, odd, *window)
        device.launch(kernel, size, R, fields, *(np.int32(k) for k in sizes))
    got = device.download(R)
    assert (got[:, :, 0] == 7).all()
    matrix = got[:, :, 1:].transpose(0, 3, 1, 2).reshape(-1, n, s)[:q]
    f = rng.random((s, *window))
    F, H = np.fft.fft2(f), np.fft.fft2(h)
    expected = rows_of(np.einsum("ms...,s...->m...", H, F), w)
    corner = (slice(None), slice(window[0] // 2 + 1), slice(window[1] // 2 + 1))
    given = rows_of(F, v)[corner].reshape(s, q) * (1j if odd else 1)
    found = np.einsum("qij,jq->iq", matrix, given)
    assert relative_max(expected[corner].reshape(n, q), found) < 5e-7
