"""``clplen microscope deconvolve`` of many frames to one file, ended at any moment."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import batchworks
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result
from microscope_commands import done, run, said

from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.results.volume_files import is_volume, read_volume
from clplen.io.results.volume_series import count_complete, read_volume_series, series_in
from clplen.microscopy.model import point_image_files
from clplen.microscopy.reconstruction.projector import Projector

FRAMES = 5
ENDINGS = ("ome.zarr", "ome.tif")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, psf: Path, device: Device) -> Path:
    """Point images, and five frames of a bead that moves, as one TIFF and as files."""
    made = tmp_path_factory.mktemp("series")
    (made / "psf.h5").write_bytes(psf.read_bytes())
    images = point_image_files.read_point_images(psf)
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


def described_by(*words: object) -> Result:
    return CliRunner().invoke(main, ["info", *(str(word) for word in words)])


def volumes_in(path: Path) -> np.ndarray:
    return np.stack([read_volume_series(path, t) for t in range(count_complete(path))])


@pytest.mark.parametrize("ending", ENDINGS)
def test_one_file_of_all_frames(tmp_path: Path, folder: Path, device: Device, ending: str) -> None:
    out = tmp_path / f"s.{ending}"
    result = done(run(*words_of(folder, device, "-o", out, "--preview", tmp_path / "p.png")))
    assert "holds 5 volumes of 3 x 18 x 21 voxels" in result.output
    assert "in groups of 2" in result.output
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
    with pytest.raises(FormatError, match="must hold a single volume, got a series of 5"):
        read_volume(out)
    entries = json.loads(done(described_by(out, "--json")).output)
    assert entries["shape"] == [FRAMES, 3, 18, 21]
    assert entries["light"] == pytest.approx(found.sum(dtype=float), rel=1e-6)
    assert "5 x 3 x 18 x 21 voxels (t, z, y, x)" in done(described_by(out)).output
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    stamp = out.stat().st_mtime_ns
    assert "is up to date" in done(run(*words_of(folder, device, "-o", out))).output
    assert out.stat().st_mtime_ns == stamp
    assert [path.name for path in tmp_path.iterdir() if path.name[0] == "."] == []


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
@pytest.mark.parametrize(("ending", "start"), [("ome.zarr", "limited"), ("ome.tif", "time")])
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
    assert count_complete(out) == 2
    part = volumes_in(out)
    assert "continues after 2 of 5 frames" in fresh(words).stdout
    assert np.array_equal(volumes_in(out)[:2], part)
    assert np.array_equal(volumes_in(out), volumes_in(whole))
    assert series_in(out) == series_in(whole)


def test_frames_that_are_compared_are_in_one_file(
    tmp_path: Path, folder: Path, device: Device
) -> None:
    words = ["deconvolve", folder / "frame3.tif", "-c", folder / "psf.h5", "--prior", "time"]
    place = ("--device", device.place)
    result = run(*words, "-o", tmp_path / "one.tif", *place)
    assert "--prior time needs a series of frames in one file" in said(result, 2)
    out = tmp_path / "s.ome.zarr"
    done(run(*words_of(folder, device, "-o", out, "--prior", "time", "--gain", 2)))
    plain = tmp_path / "plain.ome.zarr"
    done(run(*words_of(folder, device, "-o", plain, "--gain", 2)))
    changes = [np.abs(np.diff(volumes_in(one), axis=0)).sum() for one in (out, plain)]
    assert changes[0] < changes[1]


def test_a_job_makes_the_same_series(tmp_path: Path, folder: Path, device: Device) -> None:
    out, made = tmp_path / "s.ome.tif", tmp_path / "out" / "t" / "volume.ome.tif"
    more = ("--prior", "time", "--rolling-background", 3)
    done(run(*words_of(folder, device, "-o", out, *more)))
    job = tmp_path / "job.toml"
    job.write_text(
        f'output = "out"\n[[inputs]]\nfiles = "{folder}/t.tif"\n[deconvolve]\n'
        f'psf = "{folder}/psf.h5"\niterations = 3\nbatch = 2\nprior = "time"\nrolling = 3\n'
    )
    assert batchworks.run(job, device)[0].failed == {}
    assert np.array_equal(volumes_in(made), volumes_in(out))
    assert series_in(made) == series_in(out)
    job.write_text(job.read_text().replace("t.tif", "frame3.tif").replace('"out"', '"alone"'))
    (said_of,) = batchworks.run(job, device)[0].failed.values()
    assert "prior time needs a series of frames in one file" in said_of


def test_other_words_and_frames_are_refused(tmp_path: Path, folder: Path, device: Device) -> None:
    out = tmp_path / "s.ome.tif"
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
        assert "recompute all volumes with --force" in text_said
    assert np.array_equal(volumes_in(out), before)
    done(run(*words_of(folder, device, "-o", out, "--iterations", 4, "--force")))
    assert not np.allclose(volumes_in(out), before)


def test_what_is_refused_before_anything_is_written(
    tmp_path: Path, folder: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "s.ome.zarr"
    for more, code, text in (
        (("-o", tmp_path / "s.png"), 2, "end in .tif or .tiff or .zarr"),
        (("-o", out, "--preview", tmp_path / "p.jpg"), 2, "end in .png"),
        (("-o", out, "--warm-start", "--start", "limited"), 2, "--warm-start means --start"),
        (("-o", out, "--motion-um", 1), 2, "--motion-um needs --start limited"),
        (("-o", tmp_path / "{name}.tif"), 2, "--batch needs a series of frames in one file"),
        (("-o", out, "--prior", "time", "--strength", 0), 2, "must be a positive number, got 0"),
    ):
        assert text in said(run(*words_of(folder, device, *more)), code)
    (tmp_path / "s.ome.zarr").mkdir()
    (tmp_path / "s.ome.zarr" / "mine.txt").write_text("mine")
    assert "is not an OME-Zarr" in said(run(*words_of(folder, device, "-o", out)))
    shutil.rmtree(out)
    tifffile.imwrite(tmp_path / "other.tif", np.ones((30, 45), np.uint16))
    words = words_of(folder, device, "-o", out)
    assert "other.tif must have the size" in said(run(*words, tmp_path / "other.tif"))
    shutil.rmtree(out)
