"""Frames that do not fit their white frame, on sub-images in closed form."""

import numpy as np
import pytest

from clplen.microscopy.reconstruction.fit import displacement, unevenness, without_depth

ROWS, COLUMNS, N = 9, 13, 12


def frame_of(light, move=lambda i, k: (0.0, 0.0), radius=4.2):
    """Discs of pupils with soft rims, moved by (y, x) pixels in lenslet (i, k)."""
    found = np.zeros((ROWS, N, COLUMNS, N), np.float32)
    for i in range(ROWS):
        for k in range(COLUMNS):
            y, x = (np.arange(N) - (N - 1) / 2 - one for one in move(i, k))
            y, x = ((one + N / 2) % N - N / 2 for one in (y, x))
            away = np.hypot(y[:, None], 1.2 * x)
            found[i, :, k] = light[i, k] / (1 + np.exp((away - radius) / 0.5))
    return found.reshape(ROWS * N, COLUMNS * N)


@pytest.fixture(scope="module")
def light():
    return np.random.default_rng(3).uniform(0.2, 2, (ROWS, COLUMNS))


@pytest.fixture(scope="module")
def white():
    return frame_of(np.ones((ROWS, COLUMNS)))


# places of maxima are multiples of .1 pixel
@pytest.mark.parametrize("moved", [(0.0, 0.0), (2.3, -1.4), (-5.2, 5.7)])
def test_a_moved_frame(light, white, moved):
    found = displacement(frame_of(light, lambda i, k: moved), white, N)
    assert (found.y, found.x) == pytest.approx(moved, abs=0.06)
    assert found.rms == pytest.approx(np.hypot(*moved), abs=0.06)


@pytest.mark.parametrize("middle", [0.5, 5.5])  # and across the border to the next lenslet
def test_a_turned_frame(light, white, middle):
    angle = 0.02  # y moves by up to 1.5 pixels along x, x by up to 1 along y

    def move(i, k):
        return angle * N * (k - (COLUMNS - 1) / 2) + middle, -angle * N * (i - (ROWS - 1) / 2)

    found = displacement(frame_of(light, move), white, N)
    assert (found.y, found.x) == pytest.approx((middle, 0), abs=0.1)
    wide = angle * N * np.hypot(ROWS, COLUMNS) / np.sqrt(12)
    assert found.rms == pytest.approx(np.hypot(middle, wide), abs=0.1)


def test_frames_that_do_not_tell(light, white):
    moved = frame_of(light, lambda i, k: (3.0, 0.0))
    assert displacement(moved, white, N).rms == pytest.approx(3, abs=0.06)
    for lit in ((slice(None), slice(0, 5)), (slice(4, 5), slice(6, 7))):
        some = np.zeros_like(light)
        some[lit] = 1
        assert displacement(frame_of(some, lambda i, k: (3.0, 0.0)), white, N) is None
    narrow = frame_of(light, lambda i, k: (3.0, 0.0), radius=1.5)  # beads that all light one part
    assert displacement(narrow, white, N) is None
    patched = frame_of(light, lambda i, k: (3.0 * (k % 6 > 2) * (i % 5 > 1), 0.0))
    assert displacement(patched, white, N) is None
    assert displacement(np.ones_like(white), white, N) is None
    assert displacement(moved[: 7 * N], white[: 7 * N], N) is None


def test_residual_of_lenslets_without_depth(light, white):
    even = 3 + frame_of(light)
    background = np.full_like(even, 3)
    seen = np.ones_like(even)
    assert without_depth(even, seen, background, white, N) < 1e-10
    stripes = white * np.where(np.arange(COLUMNS * N) % N < N // 2, 1, -1)  # no part of a disc
    counts = even + 0.5 * stripes
    expected = np.square(0.5 * stripes).sum() / np.square(counts).sum()
    assert without_depth(counts, seen, background, white, N) == pytest.approx(expected, rel=1e-5)
    seen[:, ::2] = 0  # whatever they hold
    left = np.where(seen > 0, even, 1e6)
    assert without_depth(left, seen, background, white, N) < 1e-10


def test_unevenness(light, white):
    assert unevenness(white, N) < 1e-6
    assert unevenness(frame_of(light), N) == pytest.approx(light.std() / light.mean(), rel=1e-5)
