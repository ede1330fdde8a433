"""lattice.cl: samples of lenslets to fields on their lattice and back, against NumPy."""

import math

import numpy as np
import pytest

ROWS, COLUMNS, WINDOW = 3, 4, (5, 6)


def fields(device, stacks, w, *, planes, start, first=(0, 0)):
    all_planes, rows, columns = stacks.shape[1], stacks.shape[2] // w[0], stacks.shape[3] // w[1]
    count = stacks.shape[0] * planes * ((w[0] * w[1] + 1) // 2)
    out = device.empty((count, *WINDOW), np.complex64)
    kernel = device.kernel("lattice.cl", "decimate", **({"CENTRED": True} if any(first) else {}))
    sizes = (*w, *first, planes, start, all_planes, rows, columns, *WINDOW)
    device.launch_rows(kernel, out.shape, out, device.upload(stacks), *(np.int32(k) for k in sizes))
    return out


def lattice(picture, w):
    rows, columns = (k // n for k, n in zip(picture.shape, w, strict=True))
    cells = picture.reshape(rows, w[0], columns, w[1]).transpose(1, 3, 0, 2)
    return cells.reshape(w[0] * w[1], rows, columns)


@pytest.mark.parametrize("w", [(5, 2), (1, 3)])
def test_pairs_of_samples(device, w):
    stacks = np.random.default_rng(w).random((2, 4, ROWS * w[0], COLUMNS * w[1]), np.float32)
    got = device.download(fields(device, stacks, w, planes=2, start=1))
    expected = []
    for stack in stacks:
        for picture in stack[1:3]:
            cells = lattice(picture, w)
            for r in range((len(cells) + 1) // 2):
                one = np.zeros(WINDOW, np.complex64)
                one[:ROWS, :COLUMNS] = cells[r] + 1j * cells[-1 - r]
                expected.append(one)
    assert np.array_equal(got, expected)


def test_pictures_about_their_middle_lenslet(device):
    w, picture = (2, 3), np.random.default_rng(0).random((1, 1, 6, 15), np.float32)
    got = device.download(fields(device, picture, w, planes=1, start=0, first=(1, 2)))
    for r, one in enumerate(got):
        cells = lattice(picture[0, 0], w)
        expected = np.zeros(WINDOW, np.complex64)
        expected[:3, :5] = cells[r] + 1j * cells[5 - r]
        assert np.array_equal(one, np.roll(expected, (-1, -2), axis=(0, 1)))


@pytest.mark.parametrize(("w", "least"), [((1, 3), -math.inf), ((5, 2), 0.5)])
def test_interleave_is_the_inverse(device, w, least):
    stacks = np.random.default_rng(w).random((2, 4, ROWS * w[0], COLUMNS * w[1]), np.float32)
    there = fields(device, stacks, w, planes=2, start=1)
    out = device.upload(np.full_like(stacks, 9))
    sizes = (2, 1, 4, ROWS, COLUMNS, *WINDOW)
    device.launch_rows(
        device.kernel("lattice.cl", "interleave"),
        (4, ROWS * w[0], COLUMNS * w[1]), out, there, *(np.int32(k) for k in w), np.float32(least),
        *(np.int32(k) for k in sizes),
    )  # fmt: skip
    got = device.download(out)
    assert np.array_equal(got[:, 1:3], np.maximum(stacks[:, 1:3], least))
    assert (got[:, [0, 3]] == 9).all()
