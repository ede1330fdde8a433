"""What is said of frames that do not fit, and that nothing is said of those that do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from clplen.batch.work import diagnostics
from clplen.compute.device import Device
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage
from clplen.microscopy.frames.prepare import Preparation, Prepared, preparation
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

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
    assert "hardly anything is left" in said(frame, 1.1 * frame.mean())
    assert "the background of 900 counts is above the mean of the frame" in said(frame, 900)
    assert "(+2.0, +0.0)" in said(np.roll(frame, 2, axis=0))
    assert not said(0.6 * frame + 0.4 * np.roll(frame, 1, axis=1))
    assert "60 saturated or not finite pixels are left out (1.9 %)" in said(frame, left_out=60)
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
    assert "taken as 0 (0.12 %), 2 of them by more than the noise" in text
    frame[0, 2:4] += 60
    (text,) = diagnostics.diagnose_frame(replace(prepare, level=None), prepare(frame), 0)
    assert "all of them within the noise of the dark frame" in text
    with pytest.raises(ValueError, match=r"in the mean, is brighter than the frame, 49\.9"):
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
    assert "residual of 0.151 is high, lenslets lit evenly would leave 0.2:" in said(0.151)
    assert "no depth at all, 3" in said(0.99, None)  # 3e-13: all are as their own mean is
    assert "no white frame and no lattice told" in said(0.21, placed=False)
    assert "worse than no depth" in said(0.21)
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
    first, down, right = (np.array(one) for one in prepare.place(3).values())
    assert first + (3 * i + 1) * down + (3 * k + 1) * right == pytest.approx(centre, abs=0.01)
    assert 3 * down == pytest.approx(lattice.row, abs=1e-3)
    flat = Preparation(10, device, None, None, None).place(5)  # of rectified frames
    assert flat == {"first": (0.5, 0.5), "down": (2.0, 0.0), "right": (0.0, 2.0)}


@pytest.mark.parametrize(
    ("name", "pixels", "dark"),
    [("guv", 15, None), pytest.param("beads", 20, 88.8, marks=pytest.mark.thorough)],
)
def test_real_frames(device: Device, data_folder: Path, name: str, pixels: int, dark: Any) -> None:
    folder = data_folder / f"lfm_{name}"
    if not folder.is_dir():
        pytest.skip(f"no lfm_{name} in {data_folder}")
    names = ["Light*", "Radio*", "Dark*"] if name == "guv" else ["img_beads*", "img_bg*"]
    frame, white, *more = (
        tifffile.imread(next(folder.glob(one)))[:700, :800].astype(np.float32) for one in names
    )
    black = more[0] if more else np.full(frame.shape, dark, np.float32)
    prepare = preparation(pixels, device=device, white=white, dark=black)
    moves = {"": frame, "(+0.": np.roll(frame, 3, axis=1)}
    if name == "guv":
        moves["was the array"] = frame[::-1, ::-1]
    for text, seen in moves.items():
        said = [
            one for one in diagnostics.diagnose_frame(prepare, prepare(seen), 0) if "sub-im" in one
        ]
        assert len(said) == bool(text)
        assert text in "".join(said)
    exchanged = replace(prepare, level=prepare(frame).counts)
    assert any("exch" in one for one in diagnostics.diagnose_frame(exchanged, prepare(white), 0))


def test_raw_images_are_frames(device: Device, white: Any) -> None:
    lattice = Lattice("square", (2.5, 2.5), (N, 0), (0, N), white.shape)
    grid = lattice.grid((N, N))
    raw = RawImage(device.upload(white), device, 1e-6, grid, grid)
    whole = Preparation(N, device, None, None, None)
    assert np.array_equal(whole(raw).counts, white)
    made = preparation(N, device=device, white=raw, dark=RawImage(
        device.upload(0 * white), device, 1e-6, grid, grid))  # fmt: skip
    assert made.dark is not None
    assert made.level is not None
    one = np.zeros((1, N, N), np.float32)
    one[0, 2:4, 2:4] = 1
    about = {"lenslet_pitch": 1e-4, "magnification": 10.0, "na": 0.2, "medium_index": 1.0}
    projector = Projector(
        PointImages(about, np.zeros(1), 1, N, (one,), np.ones(1)), SIZE, device=device
    )
    found = [deconvolve(frame, projector, iterations=1).volume for frame in (raw, white)]
    assert np.array_equal(*found)
