"""Packed spectra of samples of lenslets by definition, float64: see lattice_spectra.cl."""

import math

import numpy as np

PLANES, WIDTH = 2, 16


def rows_of(spectra, w):
    """alpha, beta of every pair, and the middle sample: (w^2, ...) from (w^2, ...)."""
    out = []
    count = math.prod(w)
    for r in range(count // 2):
        a, b = spectra[r], spectra[count - 1 - r]
        out += [(a + b) / math.sqrt(2), (a - b) / math.sqrt(2) / 1j]
    return np.array(out + [spectra[count // 2]] * (count % 2))


def packed(pictures, w, parts=(0,)):
    """What pack makes of samples on the lattice (frames, planes, w^2, ny, nx), by definition."""
    ny, nx = pictures.shape[-2:]
    q = [(y, x) for y in range(ny // 2 + 1) for x in range(nx // 2 + 1)]
    rows, samples = PLANES * len(parts) * math.prod(w), math.prod(w)
    out = np.zeros((len(pictures), -(-len(q) // WIDTH) * WIDTH, rows, 4))
    flip = np.arange(samples).reshape(w)[::-1].ravel()
    for b, stack in enumerate(pictures):
        for p, cells in enumerate(stack):
            spectra = np.fft.fft2(cells)
            upper, lower = rows_of(spectra, w), rows_of(spectra[flip], w)
            for n, (y, x) in enumerate(q):
                for place, part in enumerate(parts, p * len(parts)):
                    turn = 1j if part & 1 else 1
                    u = turn * upper[:, y, x]
                    v = turn * lower[:, -y % ny, x] * (-1 if part & 2 else 1)
                    where = slice(place * samples, (place + 1) * samples)
                    out[b, n, where] = np.stack([u.real, u.imag, v.real, v.imag], axis=-1)
    blocks = out.reshape(len(pictures), -1, WIDTH, rows, 4)
    return blocks.transpose(0, 1, 3, 4, 2)
