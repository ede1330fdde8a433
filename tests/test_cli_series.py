"""``clplen microscope deconvolve`` of many frames to one file, ended at any moment."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result

from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.results.volume_files import is_volume, read_volume
from clplen.io.results.volume_series import count_whole, read_volume_series, series_in
from clplen.microscopy.model import point_image_files
from clplen.microscopy.reconstruction.projector import Projector

KNOWN = """
magnification = 60
na = 1.2
medium_index = 1.33
wavelength = 593
ulens_pitch = 100
ulens_focal_length = 2500
pixel_size = 6.666666667
num_slices = 3
um_per_slice = 2.5
supersample = 3
"""
FRAMES = 5
ENDINGS = ("ome.zarr", "ome.tif")


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["microscope", *(str(word) for word in words)])


def done(result: Result) -> Result:
    assert result.exit_code == 0, result.output
    return result


def said(result: Result, code: int = 1) -> str:
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, device: Device) -> Path:
    """Point images, and five frames of a bead that moves, as one TIFF and as files."""
    made = tmp_path_factory.mktemp("series")
    (made / "known.toml").write_text(KNOWN)
    done(
        run("psf", made / "known.toml", "-o", made / "psf.h5", "--cut", 0.02, "--device",
            device.place)
    )  # fmt: skip
    images = point_image_files.read_point_images(made / "psf.h5")
    projector = Projector(images, (6, 7), device=device)
    volumes = np.zeros((FRAMES, *projector.volume_shape), np.float32)
    for t in range(FRAMES):
        volumes[t, 2, 7, 5 + 2 * t] = 1e5
    counts = np.random.default_rng(1).poisson(projector.forward(volumes) + 2).astype(np.uint16)
    tifffile.imwrite(made / "t.tif", counts, photometric="minisblack")
    for t in range(FRAMES):
        tifffile.imwrite(made / f"frame{t}.tif", counts[t])
    return made


def words_of(folder: Path, device: Device, *more: object) -> list[object]:
    return ["deconvolve", folder / "t.tif", "-c", folder / "psf.h5", "--iterations", 3,
            "--device", device.place, "--batch", 2, *more]  # fmt: skip


def volumes_in(path: Path) -> np.ndarray:
    return np.stack([read_volume_series(path, t) for t in range(count_whole(path))])


@pytest.mark.parametrize("ending", ENDINGS)
def test_one_file_of_all_frames(tmp_path: Path, folder: Path, device: Device, ending: str) -> None:
    out = tmp_path / f"s.{ending}"
    result = done(run(*words_of(folder, device, "-o", out, "--preview", tmp_path / "p.png")))
    assert "holds 5 volumes of 3 x 18 x 21 voxels" in result.output
    assert "frames a second, 2 together" in result.output
    found = volumes_in(out)
    assert [int(one.argmax() % 21) for one in found] == [5, 7, 9, 11, 13]
    words = ["deconvolve", folder / "frame3.tif", "-c", folder / "psf.h5", "--iterations", 3]
    done(run(*words, "-o", tmp_path / "one.tif", "--device", device.place))
    one, about = read_volume(tmp_path / "one.tif")
    np.testing.assert_allclose(found[3], one, rtol=1e-4, atol=1e-5 * one.max())
    known, records = series_in(out)
    assert known["planes_um"] == about["planes_um"]
    assert records[3]["residual"] == pytest.approx(about["residuals"][-1], rel=1e-5)
    assert [one["name"] for one in records] == [f"t_{t:04d}" for t in range(FRAMES)]
    assert is_volume(out)
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    stamp = out.stat().st_mtime_ns
    assert "of the same frames and words" in done(run(*words_of(folder, device, "-o", out))).output
    assert out.stat().st_mtime_ns == stamp
    assert [path.name for path in tmp_path.iterdir() if path.name[0] == "."] == []


@pytest.mark.thorough
def test_other_programs_read_it(tmp_path: Path, folder: Path, device: Device) -> None:
    zarr = pytest.importorskip("zarr")
    for ending in ENDINGS:
        done(run(*words_of(folder, device, "-o", tmp_path / f"s.{ending}")))
    with tifffile.TiffFile(tmp_path / "s.ome.tif") as file:
        assert (file.series[0].axes, file.series[0].shape) == ("TZYX", (5, 3, 18, 21))
        assert 'PhysicalSizeZ="2.5"' in file.ome_metadata
        values = file.asarray()
    group = zarr.open_group(str(tmp_path / "s.ome.zarr"), mode="r")
    assert np.array_equal(np.asarray(group["0"])[:, 0], values)
    assert group["0"].chunks == (1, 1, 3, 18, 21)
    (scales,) = group.attrs["multiscales"]
    assert [(axis["name"], axis["type"]) for axis in scales["axes"]] == [
        ("t", "time"), ("c", "channel"), ("z", "space"), ("y", "space"), ("x", "space"),
    ]  # fmt: skip
    move = scales["datasets"][0]["coordinateTransformations"]
    assert move[0]["scale"] == pytest.approx([1, 1, 2.5, 100 / 180, 100 / 180])
    assert move[1]["translation"] == pytest.approx([0, 0, -2.5, 0, 0])


KILLED = """\
import os, signal
from clplen.io.results import volume_series
append = volume_series.VolumeSeries.append
def killed(self, *words):
    if self.done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    append(self, *words)
volume_series.VolumeSeries.append = killed
"""


def fresh(words: list[object], before: str = "") -> subprocess.CompletedProcess[str]:
    """A command in a process of its own: what other tests import can change the last bit."""
    return subprocess.run(
        [sys.executable, "-c", f"{before}from clplen.cli import main\nmain()", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("start", ["none", "limited", "time"])
def test_kill_and_resume_lose_nothing(
    tmp_path: Path, folder: Path, device: Device, ending: str, start: str
) -> None:
    whole, out = tmp_path / f"whole.{ending}", tmp_path / f"killed.{ending}"
    option = ("--prior", "time") if start == "time" else ("--start", start)
    more = (*option, "--rolling-background", 3)
    words = ["microscope", *words_of(folder, device, "-o", out, *more)]
    assert fresh(["microscope", *words_of(folder, device, "-o", whole, *more)]).returncode == 0
    assert fresh(words, KILLED).returncode == -signal.SIGKILL
    assert out.exists() == (ending == "ome.zarr")  # whole time points, at any moment
    assert count_whole(out) == 2
    part = volumes_in(out)
    assert "goes on after 2 of 5 frames" in fresh(words).stdout
    assert np.array_equal(volumes_in(out)[:2], part)
    assert np.array_equal(volumes_in(out), volumes_in(whole))
    assert series_in(out) == series_in(whole)


def test_a_file_without_a_volume_is_begun_anew(
    tmp_path: Path, folder: Path, device: Device
) -> None:
    pytest.importorskip("zarr")
    out = tmp_path / "s.ome.zarr"
    done(run(*words_of(folder, device, "-o", out)))
    about = json.loads((out / ".zattrs").read_text())
    about["clplen"]["records"] = []
    (out / ".zattrs").write_text(json.dumps(about))
    result = done(run(*words_of(folder, device, "-o", out, "--iterations", 4)))
    assert "holds 5 volumes" in result.output
    assert count_whole(out) == FRAMES


def test_frames_that_are_compared_are_in_one_file(
    tmp_path: Path, folder: Path, device: Device
) -> None:
    words = ["deconvolve", folder / "frame3.tif", "-c", folder / "psf.h5", "--prior", "time"]
    place = ("--device", device.place)
    result = run(*words, "-o", tmp_path / "one.tif", *place)
    assert "--prior time is of a series in one file: give several frames" in said(result, 2)
    out = tmp_path / "s.ome.zarr"
    done(run(*words_of(folder, device, "-o", out, "--prior", "time", "--gain", 2)))
    plain = tmp_path / "plain.ome.zarr"
    done(run(*words_of(folder, device, "-o", plain, "--gain", 2)))
    changes = [np.abs(np.diff(volumes_in(one), axis=0)).sum() for one in (out, plain)]
    assert changes[0] < changes[1]


def test_killed_between_the_files_of_a_time_point(
    tmp_path: Path, folder: Path, device: Device
) -> None:
    pytest.importorskip("zarr")
    out = tmp_path / "s.ome.zarr"
    done(run(*words_of(folder, device, "-o", out)))
    expected = volumes_in(out)
    chunk = out / "0" / "3" / "0" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-4])  # cut off
    assert count_whole(out) == 3
    assert "goes on after 2 of 5" in done(run(*words_of(folder, device, "-o", out))).output
    assert np.array_equal(volumes_in(out), expected)
    about = json.loads((out / ".zattrs").read_text())
    about["clplen"]["records"] = about["clplen"]["records"][:2]  # length written, count not
    (out / ".zattrs").write_text(json.dumps(about))
    assert "goes on after 2 of 5" in done(run(*words_of(folder, device, "-o", out))).output
    assert np.array_equal(volumes_in(out), expected)


def test_a_tiff_that_was_cut_off_is_made_anew(tmp_path: Path, folder: Path, device: Device) -> None:
    out = tmp_path / "s.ome.tif"
    done(run(*words_of(folder, device, "-o", out)))
    expected, content = volumes_in(out), out.read_bytes()
    out.write_bytes(content[: len(content) // 2])
    result = done(run(*words_of(folder, device, "-o", out)))
    assert "5 made" in result.output
    assert np.array_equal(volumes_in(out), expected)


@pytest.mark.parametrize("ending", ENDINGS)
def test_other_words_and_frames_are_refused(
    tmp_path: Path, folder: Path, device: Device, ending: str
) -> None:
    out = tmp_path / f"s.{ending}"
    done(run(*words_of(folder, device, "-o", out)))
    before = volumes_in(out)
    for more, text in (
        (("--iterations", 4), "5 volumes made with iterations = 3, not 4"),
        (("--start", "decayed"), r"start = [None, None], not ['decayed', 0.5]"),
        (("--rolling-background", 3), "rolling = None, not 3"),
        (("--batch", 3), "2 frames together, not 3"),
        ((folder / "frame0.tif",), "made with other frames"),
    ):
        text_said = said(run(*words_of(folder, device, "-o", out, *more)))
        assert text in text_said
        assert "--force makes all of them anew" in text_said
    assert np.array_equal(volumes_in(out), before)
    done(run(*words_of(folder, device, "-o", out, "--iterations", 4, "--force")))
    assert not np.allclose(volumes_in(out), before)


def test_what_is_refused_before_anything_is_written(
    tmp_path: Path, folder: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "s.ome.zarr"
    for more, code, text in (
        (("-o", tmp_path / "s.png"), 2, "ends in .tif or .tiff or .zarr"),
        (("-o", out, "--preview", tmp_path / "p.jpg"), 2, "ends in .png"),
        (("-o", out, "--warm-start", "--start", "limited"), 2, "--warm-start is --start previous"),
        (("-o", out, "--motion-um", 1), 2, "--motion-um is a positive length, of --start limited"),
        (("-o", tmp_path / "{name}.tif"), 2, "--batch is of a series in one file"),
        (("-o", out, "--prior", "time", "--strength", 0), 2, "--strength is positive, not 0"),
    ):
        assert text in said(run(*words_of(folder, device, *more)), code)
    (tmp_path / "s.ome.zarr").mkdir()
    (tmp_path / "s.ome.zarr" / "mine.txt").write_text("mine")
    assert "no OME-Zarr" in said(run(*words_of(folder, device, "-o", out)))
    shutil.rmtree(out)
    tifffile.imwrite(tmp_path / "other.tif", np.ones((30, 45), np.uint16))
    words = words_of(folder, device, "-o", out)
    assert "other.tif has another size" in said(run(*words, tmp_path / "other.tif"))
    shutil.rmtree(out)
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    for ending in ENDINGS:
        text = said(run(*words_of(folder, device, "-o", tmp_path / f"full.{ending}")))
        assert "of which the disk has 1,000 free" in text
    assert [path.name for path in tmp_path.iterdir()] == ["other.tif"]


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_disk_that_fills_keeps_what_was_there(
    tmp_path: Path, folder: Path, device: Device, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / f"s.{ending}"
    synced = os.fsync
    calls = []

    def full(number: int) -> None:
        calls.append(number)
        if len(calls) > after:
            raise OSError(28, "No space left on device")
        synced(number)

    after = 10_000
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        done(run(*words_of(folder, device, "-o", out)))
    expected, after = volumes_in(out), len(calls) - 7  # in the second batch of three
    shutil.rmtree(out) if out.is_dir() else out.unlink()
    calls.clear()
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        assert "No space left on device" in said(run(*words_of(folder, device, "-o", out)))
    assert count_whole(out) in (2, 4)
    assert np.array_equal(volumes_in(out), expected[: count_whole(out)])
    assert "goes on after" in done(run(*words_of(folder, device, "-o", out))).output
    assert np.array_equal(volumes_in(out), expected)


def test_a_folder_that_takes_no_files(tmp_path: Path, folder: Path, device: Device) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tmp_path.chmod(0o500)
    text = said(run(*words_of(folder, device, "-o", tmp_path / "s.ome.zarr")))
    assert "takes no files" in text


def test_no_such_frame(tmp_path: Path, folder: Path, device: Device) -> None:
    out = tmp_path / "s.ome.tif"
    done(run(*words_of(folder, device, "-o", out)))
    with pytest.raises(FormatError, match="frames 0 to 4, not 5"):
        read_volume_series(out, 5)
    with pytest.raises(FormatError, match="no series of volumes"):
        read_volume_series(folder / "t.tif", 0)


def test_what_moves_is_said(tmp_path: Path, folder: Path, device: Device) -> None:
    result = done(run(*words_of(folder, device, "-o", tmp_path / "s.tif", "--start", "previous")))
    assert "what moves leaves a trail" in result.stderr
