"""Rectified frames: planes in closed form, and whole pixels."""

import numpy as np
import pytest

from clplen import ShapeError
from clplen.lightfield import Lattice
from clplen.microscopy.frames.prepare import rectify


def test_a_plane_stays_a_plane(device):
    # cubic convolution is exact for polynomials of the first degree, away from the border
    shape, step = (64, 71), ((6.31, 0.12), (-0.15, 6.47))
    y, x = np.indices(shape)
    frame = 3 + 0.02 * y - 0.01 * x
    lattice = Lattice("square", (12.3, 13.8), *step, shape)
    found = rectify(frame, lattice, device=device, pixels=7)
    rows, columns = (k // 7 for k in found.shape)
    grid = lattice.grid((7, 7))
    i, k = np.indices((rows, columns)) - 0.0
    v = np.arange(7) - 3
    area = lattice.pitch[0] * lattice.pitch[1] / 49
    first = np.array(grid.first)[:, None, None]
    centres = first + np.array(step[0])[:, None, None] * i + np.array(step[1])[:, None, None] * k
    for a, down in enumerate(v):
        for b, right in enumerate(v):
            Y, X = (
                c + down / 7 * s + right / 7 * t for c, s, t in zip(centres, *step, strict=True)
            )
            expected = area * (3 + 0.02 * Y - 0.01 * X)
            inner = (slice(1, -1), slice(1, -1))
            assert np.allclose(found[a::7, b::7][inner], expected[inner], rtol=1e-5)


def test_an_even_frame_stays_even_up_to_its_rim(device):
    shape, step = (41, 52), ((6.31, 0.0), (0.0, 6.47))
    for turn in (0.0, 0.02):
        rows, columns = (step[0][0], turn), (-turn, step[1][1])
        lattice = Lattice("square", (2.9, 3.0), rows, columns, shape)
        found = rectify(np.full(shape, 7.0), lattice, device=device, pixels=7)
        assert found.shape[0] >= 42 - 7 * bool(turn)  # pixels within .3 of the rim
        assert np.allclose(found, 7 * np.prod(lattice.pitch) / 49, rtol=1e-6)
    lattice = Lattice("square", (0.0, 3.0), *step, shape)
    half = rectify(np.full(shape, 7.0), lattice, device=device, pixels=7, complete=False)
    assert half[0].max() == 0 < half[8].min()  # 2.7 pixels beyond the rim


def test_whole_pixels_stay_as_they_are(device):
    n, middle = 6, 2.5
    frame = np.random.default_rng(n).random((5 * n, 7 * n + 2), np.float32)
    lattice = Lattice("square", (middle + n, middle + 1), (n, 0), (0, n), frame.shape)
    assert np.array_equal(rectify(frame, lattice, device=device), frame[:, 1:-1])


def test_what_is_not_rectified(device):
    lattice = Lattice("square", (12, 13), (6, 0), (0, 6), (30, 30))
    hexagonal = Lattice("hexagonal", (12, 13), (5.2, 0), (0, 6), (30, 30))
    for shape, given, pixels, words in (
        ((30, 31), lattice, None, "of the lattice, got"),
        ((30, 30), lattice, 5, "must be at least 6 for a lenslet pitch of 6 pixels, got 5"),
        ((30, 30), lattice, 0, "whole number from 1"),
        ((1, 30, 30), lattice, None, r"shape \(ny, nx\), got \(1, 30, 30\)"),
        ((30, 30), None, None, "lattice must be a Lattice, as estimate_lattice returns it"),
        ((30, 30), hexagonal, None, "hexagonal"),
    ):
        with pytest.raises((ShapeError, ValueError, TypeError), match=words):
            rectify(np.ones(shape), given, device=device, pixels=pixels)
