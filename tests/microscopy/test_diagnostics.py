"""What is said of frames that do not fit, and that nothing is said of those that do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy import diagnostics
from clplen.microscopy.diagnostics import displacement, without_depth
from clplen.microscopy.frames.prepare import Preparation, Prepared

N, SIZE = 6, (9, 10)


def prepared(counts: Any, **more: Any) -> Prepared:
    values = np.asarray(counts, np.float32)
    given = {"negative": 0, "left_out": 0, "size": values.size} | more
    return Prepared(values, np.ones_like(values), **given)


@pytest.fixture
def white() -> Any:
    lenslet = np.outer(np.hanning(N + 2)[1:-1], np.hanning(N + 2)[1:-1])
    return np.tile(100 * lenslet, SIZE).astype(np.float32)


def prepare_of(device: Device, level: Any, dark: Any = None) -> Preparation:
    lattice = Lattice("square", (2.5, 2.5), (N, 0), (0, N), level.shape)
    return Preparation(N, device, dark, lattice, np.ones_like(level), level)


def test_of_frames(device: Device, white: Any) -> None:
    prepare = prepare_of(device, white)
    light = np.kron(np.random.default_rng(5).uniform(0.2, 2, SIZE), np.ones((N, N)))

    def said(counts: Any, background: float = 0.0, **more: Any) -> str:
        return " ".join(diagnostics.diagnose_frame(prepare, prepared(counts, **more), background))

    frame = white * light
    assert not said(frame, 0.9 * frame.mean())
    assert "almost no light remains" in said(frame, 1.1 * frame.mean())
    assert "the background of 900 counts exceeds the mean of the frame" in said(frame, 900)
    assert "(+2.0, +0.0)" in said(np.roll(frame, 2, axis=0))
    assert not said(0.6 * frame + 0.4 * np.roll(frame, 1, axis=1))
    assert "60 saturated or non-finite pixels are excluded (1.9 %)" in said(frame, left_out=60)
    prepare = prepare_of(device, frame)
    even = np.kron(np.resize([0.9, 1.1], SIZE), np.ones((N, N)))  # unevenness .1 against .5
    assert "are they exchanged?" in said(white * even)
    assert not said(frame)


def test_pixels_below_the_dark_frame(device: Device, white: Any) -> None:
    dark = np.random.default_rng(2).normal(100, 4, white.shape).astype(np.float32)
    prepare = prepare_of(device, white, dark)
    # of 3240 normal deviates the median of the deviations is right to 2 %
    assert prepare.noise == pytest.approx(4, rel=0.08)
    frame = dark + 10
    frame[0, :4] = dark[0, :4] - (1, 20, 35, 60)  # 5 sqrt(2) 4 = 28
    found = prepare(frame)
    assert (found.negative, found.deep, found.size) == (4, 2, white.size)
    (text,) = diagnostics.diagnose_frame(replace(prepare, level=None), found, 0)
    assert "set to 0 (0.12 %), 2 of them by more than the noise" in text
    frame[0, 2:4] += 60
    (text,) = diagnostics.diagnose_frame(replace(prepare, level=None), prepare(frame), 0)
    assert "all of them within the noise of the dark frame" in text
    with pytest.raises(ValueError, match=r"is brighter than the frame with mean 49\.9"):
        prepare(dark / 2)
    assert prepare(np.where(white == white.max(), 9000, dark - 5)).negative  # a bright point


def test_of_volumes(white: Any) -> None:
    half = np.arange(white.shape[1]) % N < N // 2
    frame = prepared(white * np.where(half, 3, 1))  # lenslets lit evenly leave .2
    nothing = np.zeros_like(white)

    def said(last: float, level: Any = white, variance: float = 0.0, **more: Any) -> str:
        residuals = np.array([1.0, last])
        return " ".join(
            diagnostics.diagnose_volume(residuals, frame, nothing, level, N, variance, **more)
        )

    assert not said(0.149)
    assert "residual of 0.151 is high beside 0.2, that of evenly lit lenslets:" in said(0.151)
    assert "exceeds 3" in said(0.99, None)  # 3e-13: all are as their own mean is
    assert "no white frame or lattice locates" in said(0.21, is_located=False)
    assert "exceeds 0.2, that of evenly lit lenslets without depth" in said(0.21)
    assert not said(0.21, pupil=0.07)  # .15 and what the pupil may leave
    assert "is high" in said(0.23, pupil=0.07)
    assert "is the background too high?" in said(1.01)
    counts = frame.counts.astype(float)
    variance = 0.1 * np.square(counts).sum() / counts.sum()  # noise of .1: .1 + .75 .1
    assert not said(0.174, variance=variance)
    assert said(0.176, variance=variance)


def test_voxels_have_their_place_on_the_raw_frame(device: Device) -> None:
    lattice = Lattice("square", (31.2, 24.7), (9.6, 0.3), (-0.2, 9.8), (98, 113))
    prepare = Preparation(10, device, None, lattice, None)
    centre = lattice.at(3, 5)
    y, x = np.indices(lattice.shape)
    seen = prepare(np.exp(-((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / 8)).counts
    cells = seen.reshape(-1, 10, seen.shape[1] // 10, 10).sum(axis=(1, 3))
    i, k = np.unravel_index(cells.argmax(), cells.shape)
    first, down, right = (np.array(one) for one in prepare.voxel_grid(3).values())
    assert first + (3 * i + 1) * down + (3 * k + 1) * right == pytest.approx(centre, abs=0.01)
    assert 3 * down == pytest.approx(lattice.row, abs=1e-3)
    flat = Preparation(10, device, None, None, None).voxel_grid(5)  # of rectified frames
    assert flat == {"first": (0.5, 0.5), "down": (2.0, 0.0), "right": (0.0, 2.0)}


ROWS, COLUMNS, ACROSS = 9, 13, 12


def frame_of(light, move=lambda i, k: (0.0, 0.0), radius=4.2):
    """Discs of pupils with soft rims, moved by (y, x) pixels in lenslet (i, k)."""
    found = np.zeros((ROWS, ACROSS, COLUMNS, ACROSS), np.float32)
    for i in range(ROWS):
        for k in range(COLUMNS):
            y, x = (np.arange(ACROSS) - (ACROSS - 1) / 2 - one for one in move(i, k))
            y, x = ((one + ACROSS / 2) % ACROSS - ACROSS / 2 for one in (y, x))
            away = np.hypot(y[:, None], 1.2 * x)
            found[i, :, k] = light[i, k] / (1 + np.exp((away - radius) / 0.5))
    return found.reshape(ROWS * ACROSS, COLUMNS * ACROSS)


@pytest.fixture(scope="module")
def light():
    return np.random.default_rng(3).uniform(0.2, 2, (ROWS, COLUMNS))


@pytest.fixture(scope="module")
def even_white():
    return frame_of(np.ones((ROWS, COLUMNS)))


# places of maxima are multiples of 0.1 pixel
def test_a_moved_and_turned_frame(light, even_white):
    middle = 5.5, -1.4
    angle = 0.02  # y moves by up to 1.5 pixels along x, x by up to 1 along y

    def move(i, k):
        y, x = k - (COLUMNS - 1) / 2, (ROWS - 1) / 2 - i
        return angle * ACROSS * y + middle[0], angle * ACROSS * x + middle[1]

    found = displacement(frame_of(light, move), even_white, ACROSS)
    assert (found.y, found.x) == pytest.approx(middle, abs=0.1)
    wide = angle * ACROSS * np.hypot(ROWS, COLUMNS) / np.sqrt(12)
    assert found.rms == pytest.approx(np.hypot(wide, np.hypot(*middle)), abs=0.1)


def test_frames_that_do_not_tell(light, even_white):
    moved = frame_of(light, lambda i, k: (3.0, 0.0))
    assert displacement(moved, even_white, ACROSS).rms == pytest.approx(3, abs=0.06)
    for lit in ((slice(None), slice(0, 5)), (slice(4, 5), slice(6, 7))):
        some = np.zeros_like(light)
        some[lit] = 1
        assert displacement(frame_of(some, lambda i, k: (3.0, 0.0)), even_white, ACROSS) is None
    narrow = frame_of(light, lambda i, k: (3.0, 0.0), radius=1.5)  # beads that all light one part
    assert displacement(narrow, even_white, ACROSS) is None
    patched = frame_of(light, lambda i, k: (3.0 * (k % 6 > 2) * (i % 5 > 1), 0.0))
    assert displacement(patched, even_white, ACROSS) is None
    assert displacement(np.ones_like(even_white), even_white, ACROSS) is None
    assert displacement(moved[: 7 * ACROSS], even_white[: 7 * ACROSS], ACROSS) is None


def test_residual_of_lenslets_without_depth(light, even_white):
    even = 3 + frame_of(light)
    background = np.full_like(even, 3)
    seen = np.ones_like(even)
    assert without_depth(even, seen, background, even_white, ACROSS) < 1e-10
    stripes = even_white * np.where(
        np.arange(COLUMNS * ACROSS) % ACROSS < ACROSS // 2, 1, -1
    )  # no part of a disc
    counts = even + 0.5 * stripes
    expected = np.square(0.5 * stripes).sum() / np.square(counts).sum()
    assert without_depth(counts, seen, background, even_white, ACROSS) == pytest.approx(
        expected, rel=1e-5
    )
    seen[:, ::2] = 0  # whatever they hold
    left = np.where(seen > 0, even, 1e6)
    assert without_depth(left, seen, background, even_white, ACROSS) < 1e-10
