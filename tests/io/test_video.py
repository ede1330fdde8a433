"""MP4 read back by ffmpeg: frames, size, colours and rate; one sentence where it is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from clplen.cli import main
from clplen.compute.device import Device
from clplen.io import write_animation
from clplen.outputs import is_ours

REASON = "the extra video is not installed"
# Limited range has 219 steps of luminance for 255, and quantisation adds a step or two.
STEP = 3.0

Array = np.ndarray[Any, Any]


def frames_of(path: Path) -> tuple[str, Array]:
    """What ffmpeg says of a film, and its frames as RGB."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason=REASON).get_ffmpeg_exe()
    words = [ffmpeg, "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(words, capture_output=True, check=True)
    about = next(line for line in done.stderr.decode().splitlines() if "Video:" in line)
    size = re.search(r", (\d+)x(\d+)", about)
    assert size is not None
    width, height = int(size[1]), int(size[2])
    return about, np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)


def test_frames_and_colours(tmp_path: Path) -> None:
    """Five frames of 37 x 50: two flat colours beside each other, other ones in each."""
    pytest.importorskip("imageio_ffmpeg", reason=REASON)
    colours = np.random.default_rng(4).integers(20, 236, (5, 2, 3))
    pictures = np.repeat(colours[:, None, :], (20, 30), axis=2)
    pictures = np.broadcast_to(pictures, (5, 37, 50, 3)).astype(np.uint8)
    write_animation(tmp_path / "a.mp4", pictures, seconds=0.25)
    about, found = frames_of(tmp_path / "a.mp4")
    assert found.shape == (5, 38, 50, 3)
    for word in ("h264", "yuv420p", "tv", "bt709/bt709/iec61966-2-1", " 4 fps"):
        assert word in about
    assert is_ours(tmp_path / "a.mp4")
    for frame, pair in zip(found.astype(float), colours, strict=True):
        np.testing.assert_allclose(frame[:, 2:18].mean((0, 1)), pair[0], atol=STEP)
        np.testing.assert_allclose(frame[:, 22:48].mean((0, 1)), pair[1], atol=STEP)


def test_the_last_row_and_column_stand_twice(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason=REASON)
    grey = np.full((21, 33), 60, np.uint8)
    grey[-1], grey[:, -1] = 200, 200
    write_animation(tmp_path / "a.mp4", [grey, grey[::-1]])
    about, found = frames_of(tmp_path / "a.mp4")
    assert " 10 fps" in about
    assert found.shape == (2, 22, 34, 3)
    first = found[0, ..., 1].astype(float)
    assert first[20:].mean() > 180
    assert first[:, 32:].mean() > 180
    assert abs(first[:18, :30].mean() - 60) < STEP
    assert found[1, 0].mean() > 150


def test_a_sweep(tmp_path: Path, device: Device) -> None:
    pytest.importorskip("imageio_ffmpeg", reason=REASON)
    levels = np.array([40, 80, 120, 160, 200], np.uint8)
    samples = np.broadcast_to(levels[:, None, None], (3, 5, 22, 31))
    np.save(tmp_path / "views.npy", samples)
    words = ["render", tmp_path / "views.npy", "-o", tmp_path / "a.mp4", "--sweep", "views"]
    words += ["--seconds", 0.05, "--device", device.place]
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    about, found = frames_of(tmp_path / "a.mp4")
    assert " 20 fps" in about
    assert found.shape == (24, 22, 32, 3)
    across = 120 + 64 * np.cos(2 * np.pi * np.arange(24) / 24)  # 0.8 of the way, 40 a view
    np.testing.assert_allclose(found.mean((1, 2, 3)), across, atol=STEP)


def test_without_the_extra(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    grey = np.zeros((8, 8), np.uint8)
    with pytest.raises(ValueError, match=r'pip install "clplen\[video\]", or write \.gif'):
        write_animation(tmp_path / "a.mp4", [grey])
    words = ["render", tmp_path / "no.npy", "-o", tmp_path / "a.mp4", "--sweep", "views"]
    result = CliRunner().invoke(main, [*map(str, words), "--device", device.place])
    assert result.exit_code == 1
    assert "needs the package imageio-ffmpeg" in result.stderr  # before the input is looked for
    assert not list(tmp_path.iterdir())


def test_ffmpeg_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg", reason=REASON)
    monkeypatch.setattr("clplen.io.formats.video._CONVERT", "none")
    with pytest.raises(OSError, match="ffmpeg failed") as caught:
        write_animation(tmp_path / "a.mp4", [np.zeros((8, 8), np.uint8)])
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"must be 0\.02"):
        write_animation(tmp_path / "a.mp4", [np.zeros((8, 8), np.uint8)], seconds=float("nan"))
