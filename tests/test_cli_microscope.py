"""``clplen microscope``: from parameters and frames to volumes, and what it says of bad input."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import batchworks
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.batch.work import volume_products
from clplen.cli import main
from clplen.compute.device import Device
from clplen.errors import FormatError
from clplen.io.results.volume_files import read_volume, write_volume
from clplen.io.store.picture_series import describe_series
from clplen.microscopy.frames.prepare import preparation
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
apodisation = 0.4
"""
CAMERA = """
[camera]
kind = "microscope"
magnification = 60
na = 1.2
medium_index = 1.33
wavelength_nm = 593
pixels_per_lenslet = 15
apodisation = 0.4
[camera.microlenses]
pitch_um = 100
focal_length_mm = 2.5
count = 9
fill = "full"
"""
VOXEL = 100e-6 / 60 / 3
SIZE = (7, 8)  # lenslets


def run(*words: object) -> Result:
    return CliRunner().invoke(main, ["microscope", *(str(word) for word in words)])


def done(result: Result) -> Result:
    assert result.exit_code == 0, result.output
    return result


def said(result: Result, code: int = 1) -> str:
    """What went to standard error: one sentence, and no traceback."""
    assert result.exit_code == code, result.output
    assert "Traceback" not in result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.stderr


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory, device: Device) -> Path:
    """Point images on three planes, of the names of LFAnalyze."""
    folder = tmp_path_factory.mktemp("psf")
    (folder / "known.toml").write_text(KNOWN)
    out = folder / "psf.h5"
    words = ("-o", out, "--cut", 0.02, "--device", device.place)
    result = done(run("psf", folder / "known.toml", *words))
    assert "3 planes, 3 x 3 voxels and 15 x 15 pixels a lenslet" in result.output
    return out


@pytest.fixture(scope="module")
def projector(psf: Path, device: Device) -> Projector:
    return Projector(point_image_files.read_point_images(psf), SIZE, device=device)


def beads(projector: Projector, *voxels: tuple[int, int, int]) -> Any:
    volume = np.zeros(projector.volume_shape, np.float32)
    for voxel in voxels:
        volume[voxel] = 1e5
    return volume


@pytest.fixture
def frame(tmp_path: Path, projector: Projector) -> Path:
    """Counts of one bead, rectified."""
    mean = projector.forward(beads(projector, (2, 10, 13))) + 2
    counts = np.random.default_rng(1).poisson(mean).astype(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", counts)
    return tmp_path / "a.tif"


def test_a_camera_file_gives_the_same_and_other_parameters_are_named(
    tmp_path: Path, psf: Path, device: Device
) -> None:
    (tmp_path / "camera.toml").write_text(CAMERA)
    before = psf.read_bytes()
    words = ("--planes-um", "-2.5:2.5:3", "--voxels", 3, "--device", device.place, "-o", psf)
    done(run("psf", tmp_path / "camera.toml", "--cut", 0.02, *words))
    assert psf.read_bytes() == before
    for other, difference in (
        (("--cut", 0.03), "made with cut = 0.02, not 0.03"),
        (("--cut", 0.02, "--planes-um", "-2.5:2.5:2"), "made with 3 planes, not 2"),
        (("--cut", 0.02, "--planes-um", "-2.5:3.5:3"), "planes[1] = 0.0, not 5e-07"),
    ):
        assert difference in said(run("psf", tmp_path / "camera.toml", *words, *other))


def test_project_is_the_projection(tmp_path: Path, psf: Path, projector: Projector) -> None:
    volume = beads(projector, (0, 5, 9), (2, 17, 4))
    planes = projector.images.planes
    write_volume(tmp_path / "v.ome.tif", volume, planes=planes, voxel=(VOXEL, VOXEL))
    words = ("-c", psf, "-o", tmp_path / "f.tif", "--device", projector.device.place)
    result = done(run("project", tmp_path / "v.ome.tif", *words))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "f.tif"), projector.forward(volume))
    assert "7 x 8 lenslets of 15 x 15 pixels" in result.output
    write_volume(tmp_path / "w.tif", volume, planes=planes + 1e-6, voxel=(VOXEL, VOXEL))
    assert "lies at z = -1.5 um, that of the point images at -2.5 um" in said(
        run("project", tmp_path / "w.tif", *words)
    )
    np.save(tmp_path / "few.npy", volume[:2])
    assert "has 2 planes, the point images have 3" in said(
        run("project", tmp_path / "few.npy", *words)
    )
    np.save(tmp_path / "odd.npy", volume[:, 1:])
    assert "no whole number of lenslets of 3 x 3" in said(
        run("project", tmp_path / "odd.npy", *words)
    )
    np.save(tmp_path / "minus.npy", -volume)
    assert "has 2 voxels that are negative" in said(run("project", tmp_path / "minus.npy", *words))


@pytest.mark.thorough
def test_a_volume_in_ome_tiff(tmp_path: Path, psf: Path, frame: Path, device: Device) -> None:
    out = tmp_path / "v.ome.tif"
    words = ["deconvolve", frame, "-c", psf, "-o", out, "--background", 2, "--device", device.place]
    result = done(run(*words, "--max-iter", 8))
    assert "after 8 iterations" in result.output
    volume, about = read_volume(out)
    assert np.unravel_index(volume.argmax(), volume.shape) == (2, 10, 13)
    assert volume.sum() == pytest.approx(1e5, rel=0.05)
    assert about["planes_um"] == [-2.5, 0.0, 2.5]
    assert (np.diff(about["residuals"]) < 0).all()
    with tifffile.TiffFile(out) as file:
        assert file.series[0].axes == "ZYX"
        assert 'PhysicalSizeZ="2.5"' in file.ome_metadata
        assert f'PhysicalSizeX="{VOXEL * 1e6}'[:24] in file.ome_metadata
    stamp = out.stat().st_mtime_ns
    assert "is there already" in done(run(*words, "--max-iter", 8)).output
    assert out.stat().st_mtime_ns == stamp
    done(run(*words, "--iterations", 2))
    volume, about = read_volume(out)
    assert len(about["residuals"]) == 2
    tifffile.imwrite(frame, tifffile.imread(frame)[:, ::-1])
    done(run(*words, "--iterations", 2))
    mirrored = read_volume(out)[0]
    assert not np.allclose(mirrored, volume, rtol=0.1)
    done(run(*words, "--gain", 2, "--iterations", 2))
    np.testing.assert_allclose(2 * read_volume(out)[0], mirrored, rtol=1e-4)


def test_saturated_pixels_are_filled_by_the_volume(
    tmp_path: Path, psf: Path, frame: Path, device: Device
) -> None:
    counts = tifffile.imread(frame)
    brightest = counts >= np.sort(counts.ravel())[-60]
    assert counts[brightest].sum() > 3e4  # of 1e5
    tifffile.imwrite(frame, np.where(brightest, 65535, counts).astype(np.uint16))
    out = tmp_path / "v.tif"
    words = ("-c", psf, "-o", out, "--background", 2, "--device", device.place)
    result = done(run("deconvolve", frame, *words, "--iterations", 20))
    assert f"{brightest.sum()} saturated or not finite pixels are left out" in result.stderr
    volume, _ = read_volume(out)
    assert np.unravel_index(volume.argmax(), volume.shape) == (2, 10, 13)
    assert volume.sum() == pytest.approx(1e5, rel=0.1)


@pytest.mark.parametrize("warm", [False, True])
def test_a_series_that_was_ended_goes_on(
    tmp_path: Path, psf: Path, frame: Path, device: Device, warm: bool
) -> None:
    second = tmp_path / "b.tif"
    tifffile.imwrite(second, np.zeros((20, 30), np.uint16))
    words = ["deconvolve", frame, second, "-c", psf, "-o", tmp_path / "{name}.ome.tif",
             "--iterations", 2, "--device", device.place] + ["--warm-start"] * warm  # fmt: skip
    assert "b.tif: The frame of shape (20, 30) has no whole number of lenslets" in said(run(*words))
    first = (tmp_path / "a.ome.tif").read_bytes()
    tifffile.imwrite(second, tifffile.imread(frame))
    assert "a.ome.tif is there already" in done(run(*words)).output
    assert (tmp_path / "a.ome.tif").read_bytes() == first
    resumed, about = read_volume(tmp_path / "b.ome.tif")
    later = describe_series(tmp_path / "a.ome.tif")["residuals"][-1]
    assert (about["residuals"][0] < later) == warm
    for out in tmp_path.glob("*.ome.tif"):
        out.unlink()
    done(run(*words))
    np.testing.assert_array_equal(read_volume(tmp_path / "b.ome.tif")[0], resumed)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.ome.tif", "a.tif", "b.ome.tif", "b.tif",
    ]  # fmt: skip


def test_a_frame_begins_with_the_one_before(
    tmp_path: Path, psf: Path, frame: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[Path | None] = []
    module = sys.modules["clplen.cli.microscopy.deconvolve"]
    monkeypatch.setattr(module, "_made", lambda *words: begun.append(words[-1]) or "")
    frames = [frame.rename(tmp_path / "0.tif"), *(tmp_path / f"{k}.tif" for k in (1, 2))]
    for path in frames[1:]:
        path.write_bytes(frames[0].read_bytes())
    words = ("-c", psf, "-o", tmp_path / "{name}.ome.tif", "--device", device.place)
    done(run("deconvolve", *frames, *words, "--warm-start"))
    done(run("deconvolve", *frames, *words))
    assert begun == [None, tmp_path / "0.ome.tif", tmp_path / "1.ome.tif", None, None, None]


def test_a_stack_of_frames_is_a_series(
    tmp_path: Path, psf: Path, frame: Path, device: Device
) -> None:
    counts = tifffile.imread(frame)
    tifffile.imwrite(
        tmp_path / "t.tif", np.stack([counts, counts[:, ::-1]]), photometric="minisblack"
    )
    words = ("-c", psf, "--iterations", 1, "--device", device.place)
    out = tmp_path / "{name}.ome.tif"
    done(run("deconvolve", tmp_path / "t.tif", *words, "-o", out))
    made = [read_volume(tmp_path / f"t_{number:04d}.ome.tif")[0] for number in (0, 1)]
    np.testing.assert_allclose(made[1], made[0][..., ::-1], rtol=1e-3, atol=1e-3 * made[0].max())
    result = done(run("deconvolve", tmp_path / "t.tif", *words, "-o", tmp_path / "v.tif"))
    assert "holds 2 volumes" in result.output
    together = tifffile.imread(tmp_path / "v.tif")
    np.testing.assert_allclose(together, made, rtol=1e-4, atol=1e-5 * made[0].max())


@pytest.mark.thorough
def test_a_killed_series_loses_no_finished_frame(
    tmp_path: Path, psf: Path, frame: Path, device: Device
) -> None:
    counts = tifffile.imread(frame)
    frames = [tmp_path / f"t{number}.tif" for number in range(4)]
    for number, path in enumerate(frames):
        tifffile.imwrite(path, np.roll(counts, 15 * number, axis=1))
    words = ["deconvolve", *frames, "-c", psf, "-o", tmp_path / "{name}.ome.tif",
             "--iterations", 30, "--device", device.place]  # fmt: skip
    series = subprocess.Popen(
        [sys.executable, "-m", "clplen", "microscope", *map(str, words)], stdout=subprocess.DEVNULL
    )
    while not (tmp_path / "t1.ome.tif").exists():
        assert series.poll() is None
        time.sleep(0.005)
    series.kill()
    series.wait()
    finished = {path: path.read_bytes() for path in tmp_path.glob("t*.ome.tif")}
    assert 2 <= len(finished) < 4
    result = done(run(*words))
    assert result.output.count("is there already") == len(finished)
    assert {path: path.read_bytes() for path in finished} == finished
    for number in range(4):
        volume, _ = read_volume(tmp_path / f"t{number}.ome.tif")
        assert np.unravel_index(volume.argmax(), volume.shape)[0] == 2


def test_frames_of_a_job_share_point_images(
    tmp_path: Path, psf: Path, frame: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    counts = tifffile.imread(frame)
    for number in range(3):
        tifffile.imwrite(tmp_path / "in" / f"t{number}.tif", np.roll(counts, 15 * number, axis=1))
    tifffile.imwrite(tmp_path / "in" / "small.tif", counts[:60])
    images = point_image_files.read_point_images(psf)
    point_image_files.write_point_images(tmp_path / "psf.h5", images)
    job = tmp_path / "job.toml"
    job.write_text(
        'output = "out"\n[[inputs]]\nfiles = "in/*.tif"\n'
        '[deconvolve]\npsf = "psf.h5"\niterations = 2\nbackground = 2.0\n'
    )
    count = itertools.count(1)
    made = volume_products.Deconvolver
    monkeypatch.setattr(
        volume_products, "Deconvolver", lambda *a, **k: (made(*a, **k), next(count))[0]
    )
    summary, _ = batchworks.run(job, device)
    assert (summary.done, list(summary.failed)) == (3, ["small"])
    assert "has 4 x 8 lenslets; at least 5 x 5" in summary.failed["small"]
    assert next(count) == 2
    words = ("-c", psf, "-o", tmp_path / "v.tif", "--iterations", 2, "--background", 2)
    done(run("deconvolve", tmp_path / "in" / "t1.tif", *words, "--device", device.place))
    volume, about = read_volume(tmp_path / "out" / "t1" / "volume.ome.tif")
    np.testing.assert_array_equal(volume, read_volume(tmp_path / "v.tif")[0])
    assert (about["planes_um"], about["left_out"]) == ([-2.5, 0.0, 2.5], 0)
    of_command = describe_series(tmp_path / "v.tif")
    assert {name: about[name] for name in of_command} == of_command
    before = (tmp_path / "out" / "t1" / "volume.ome.tif").stat().st_mtime_ns
    tifffile.imwrite(tmp_path / "in" / "t2.tif", counts)
    (tmp_path / "in" / "small.tif").unlink()
    summary, _ = batchworks.run(job, device)
    assert (summary.done, summary.skipped, summary.failed) == (1, 2, {})
    assert (tmp_path / "out" / "t1" / "volume.ome.tif").stat().st_mtime_ns == before
    doubled = replace(images, scales=images.scales * 2)
    point_image_files.write_point_images(tmp_path / "psf.h5", doubled)
    summary, _ = batchworks.run(job, device)
    assert (summary.done, summary.skipped, summary.failed) == (3, 0, {})


def raw_frames(device: Device) -> tuple[Any, Any, Any]:
    """A bead, the white and the dark frame of an array of a fractional pitch that is turned."""
    mla = MicrolensArray(100e-6, 2.5e-3, count=15, fill="full", rotation=0.003)
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, mla=mla,
        pixels_per_lenslet=15.4, device=device,
    )  # fmt: skip
    raw = camera.expose(PointSources([(0.0, 0.0, 2.5e-6)]))
    y, x = np.indices(raw.shape, float)
    grid = raw.sub_images
    steps = np.linalg.inv(np.array([grid.row_step, grid.column_step]).T)
    i, k = (steps @ np.stack([(y - grid.first[0]).ravel(), (x - grid.first[1]).ravel()])) % 1
    away = np.maximum(abs((i + 0.5) % 1 - 0.5), abs((k + 0.5) % 1 - 0.5))
    white = 5000 * (1 / (1 + np.exp((away - 0.42) / 0.03))).reshape(raw.shape) + 100
    random = np.random.default_rng(4)
    seen = random.poisson(4e6 * np.maximum(raw.to_numpy(), 0) + 100)
    dark = np.full(raw.shape, 100.0)
    return seen.astype(np.uint16), random.poisson(white).astype(np.uint16), dark


def test_raw_frames_to_ome_zarr(tmp_path: Path, psf: Path, device: Device) -> None:
    zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")
    for name, values in zip(("raw", "white", "dark"), raw_frames(device), strict=True):
        if name == "raw":
            values[3, 4:6] = 65535
        tifffile.imwrite(tmp_path / f"{name}.tif", values)
    result = done(run(
        "deconvolve", tmp_path / "raw.tif", "-c", psf, "-o", tmp_path / "v.ome.zarr", "--white",
        tmp_path / "white.tif", "--dark", tmp_path / "dark.tif", "--iterations", 8, "--background",
        3, "--device", device.place,
    ))  # fmt: skip
    assert "2 saturated or not finite pixels are left out" in result.stderr
    assert "pixels below 0 are taken as 0" in result.stderr
    volume, about = read_volume(tmp_path / "v.ome.zarr")
    light = volume.sum(axis=(1, 2))
    assert light.argmax() == 2
    plane = volume[2]
    peak = np.array(np.unravel_index(plane.argmax(), plane.shape))
    assert abs(peak - np.array(plane.shape) // 2).max() <= 1
    (scales,) = zarr.open_group(str(tmp_path / "v.ome.zarr"), mode="r").attrs["multiscales"]
    assert [axis.get("unit") for axis in scales["axes"]] == ["micrometer"] * 3
    (first, *_) = scales["datasets"][0]["coordinateTransformations"]
    assert first["scale"] == pytest.approx([2.5, VOXEL * 1e6, VOXEL * 1e6])
    assert about["job"]["background"] == 3


def test_haze_is_told_from_the_volume(tmp_path: Path, psf: Path, device: Device) -> None:
    raw, white, dark = raw_frames(device)
    haze = (0.04 * (white - 100.0)).astype(np.uint16)
    prepare = preparation(15, device=device, white=white, dark=dark)
    seen = prepare(raw + haze)
    found = prepare.haze(seen.counts, seen.white)
    # the dimmest of 20 lenslets, of 3e4 photons each, lie 1 % below their mean
    assert found.sum() == pytest.approx(prepare(dark + haze).counts.sum(), rel=0.03)
    for name, values in (("raw", raw + haze), ("w", white), ("d", dark)):
        tifffile.imwrite(tmp_path / f"{name}.tif", values)
    words = ("-c", psf, "--white", tmp_path / "w.tif", "--dark", tmp_path / "d.tif", "-o",
             tmp_path / "v.tif", "--iterations", 6, "--device", device.place)  # fmt: skip
    bead = []
    for more in ((), ("--haze",)):
        done(run("deconvolve", tmp_path / "raw.tif", *words, *more))
        volume, _ = read_volume(tmp_path / "v.tif")
        bead.append(volume[2, 18:27, 18:27].sum() / volume.sum())
    assert bead[1] > 1.5 * bead[0]


def test_sensitivity_is_what_lenslets_do_not_have_in_common(device: Device) -> None:
    _, white, dark = raw_frames(device)
    fall = np.linspace(1, 0.6, white.shape[1])
    prepare = preparation(15, device=device, white=100 + (white - 100.0) * fall, dark=dark)
    assert prepare.sensitivity is not None
    found = np.median(prepare.sensitivity, axis=0).reshape(-1, 15)[:, 4:-4].mean(axis=1)
    assert prepare.lattice is not None
    across = (np.arange(len(found)) - (len(found) - 1) / 2) * prepare.lattice.pitch[0]
    expected = 0.8 - 0.4 * across / (white.shape[1] - 1)
    np.testing.assert_allclose(found, expected / expected.mean(), rtol=0.01)  # 9 pixels' noise


def test_background_is_that_of_a_pixel_of_the_camera(device: Device) -> None:
    _, white, dark = raw_frames(device)
    prepare = preparation(15, device=device, white=white, dark=dark)
    flat = prepare(dark + 7.0)
    inner = flat.counts[30:-30, 30:-30]
    assert np.allclose(inner, 7 * prepare.area, rtol=1e-4)
    assert prepare.area == pytest.approx(15.4**2 / 225, rel=2e-3)
    frame = np.full(dark.shape, 107, np.uint16)
    frame[111, 123] = 65535
    seen = prepare(frame)
    assert (seen.left_out, seen.negative) == (1, 0)
    lost = np.argwhere((seen.white == 0) & (flat.white > 0))
    assert 1 <= len(lost) <= 36  # those that cubic interpolation mixes it into, and no others
    assert abs(lost.mean(axis=0) - np.array([111, 123]) * 15 / 15.4).max() < 15
    beside = (seen.white > 0)[30:-30, 30:-30]
    np.testing.assert_allclose(seen.counts[30:-30, 30:-30][beside], inner[beside], rtol=1e-4)


BAD: list[tuple[list[str], str, int]] = [
    (["a.tif", "-o", "v.png"], "The output ends in .tif or .tiff or .zarr", 2),
    (["a.tif", "-o", "a.tif"], "is one of the files that are read", 2),
    (["a.tif", "-o", "a.tif/v.tif"], "is to be a folder, but there is a file", 1),
    (["a.tif", "-o", "noise.tif"], "is there already, and clplen did not write it", 1),
    (["volume.tif", "-o", "v.tif"], "is a volume, as clplen writes them", 2),
    (["a.tif", "-o", "v.tif", "--memory", "1"], "--memory is at least 1MiB", 2),
    (["a.tif", "-o", "v.tif", "--white", "noise.tif", "--saturation", "9"],
     "12,600 of 12,600 pixels of the white frame are saturated (9 or more)", 1),
    (["a.tif", "-o", "v.tif", "--dark", "bright.tif"], "is brighter than the frame", 1),
    (["none.tif", "-o", "v.tif"], "There is no file", 1),
    (["a.tif", "-o", "v.tif", "--background", "-1"], "--background is not negative", 2),
    (["a.tif", "-o", "v.tif", "--white", "noise.tif"], "no lenslets of about 15 pixels", 1),
    (["a.tif", "-o", "v.tif", "--haze"], "--haze looks like the white frame: give --white", 2),
    (["a.tif", "-o", "v.tif", "--gain", "0"], "--gain is positive", 2),
    (["a.tif", "-o", "v.tif", "--strength", "2"], "--strength is of a --prior", 2),
    (["a.tif", "-o", "v.tif", "--residual", "-1"], "no positive number, nor noise", 2),
    (["a.tif", "-o", "v.tif", "--residual", "noisy"], "no positive number, nor noise", 2),
    (["a.tif", "-o", "v.tif", "--white", "few.tif"], "white frame (120, 121)", 1),
    (["a.tif", "-o", "v.tif", "--dark", "few.tif"], "dark frame (120, 121)", 1),
    (["small.tif", "-o", "v.tif"], "has 4 x 5 lenslets; at least 5 x 5", 1),
    (["colour.tif", "-o", "v.tif"], "a raw frame has one channel", 1),
    (["colour.tif", "-o", "v.tif"], "series of 3 frames, write it with photometric=", 1),
]  # fmt: skip


@pytest.mark.parametrize(("words", "message", "code"), BAD)
def test_bad_words_of_deconvolve(
    tmp_path: Path, psf: Path, frame: Path, monkeypatch: pytest.MonkeyPatch, device: Device,
    words: list[str], message: str, code: int,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    down, across = (1 + np.cos(2 * np.pi * np.arange(n) / 15) for n in (120, 121))
    tifffile.imwrite("few.tif", (99 * np.outer(down, across)).astype(np.uint16))
    noise = np.random.default_rng(0).poisson(100, (105, 120))
    tifffile.imwrite("noise.tif", noise.astype(np.uint16))
    tifffile.imwrite("small.tif", np.ones((60, 75), np.uint16))
    tifffile.imwrite("bright.tif", np.full((105, 120), 9000, np.uint16))
    write_volume("volume.tif", np.ones((2, 3, 4)), planes=[0, 1e-6], voxel=(VOXEL, VOXEL))
    tifffile.imwrite("colour.tif", np.ones((60, 75, 3), np.uint16), photometric="rgb")
    result = run("deconvolve", *words, "-c", psf, "--iterations", 1, "--device", device.place)
    assert message in said(result, code)
    assert not (tmp_path / "v.tif").exists()


def test_what_is_said_of_a_series(
    tmp_path: Path, psf: Path, projector: Projector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mean = projector.forward(np.ones(projector.volume_shape, np.float32))
    counts = np.random.default_rng(2).poisson(mean, (2, *mean.shape)) + 200
    counts[:, 0, :3] = (90, 90, 65535)
    tifffile.imwrite("t.tif", counts.astype(np.uint16), photometric="minisblack")
    tifffile.imwrite("d.tif", np.full(mean.shape, 100, np.uint16))
    words = ("-c", psf, "-o", "out/new/{name}.ome.tif", "--iterations", 1, "--device",
             projector.device.place)  # fmt: skip
    result = done(run("deconvolve", "t.tif", *words, "--dark", "d.tif", "--residual", "noise"))
    assert "--residual noise takes each count as a photon: give the --gain" in result.stderr
    share = 200 / mean.size
    assert result.stderr.count(f"2 pixels below 0 are taken as 0 ({share:.2g} %)") == 2
    assert f"of all 2 frames' pixels 2 ({share / 2:.2g} %) are left out and 4 " in result.stderr
    result = done(run("deconvolve", "t.tif", *words, "--background", 5000))
    assert result.stderr.count("the background of 5000 counts is above the mean") == 2
    assert result.stderr.count("is the background too high?") == 2
    about = describe_series("out/new/t_0001.ome.tif")
    assert [text.split()[0] for text in about["remarks"]] == ["1", "the", "the"]
    assert about["place"] == {"first": [2, 2], "down": [5, 0], "right": [0, 5]}
    told = CliRunner().invoke(main, ["info", "out/new/t_0001.ome.tif"]).output
    for text in (
        "a volume of a light-field",
        "3 x 21 x 24 voxels",
        "z from -2.5 to 2.5 um every",
        "0.555556 x 0.555556 um",
        "after 1 iterations",
        "(2, 2) px",
        "5000 counts is",
    ):
        assert text in told
    told = CliRunner().invoke(main, ["info", "out/new/t_0001.ome.tif", "--json"]).output
    assert json.loads(told)["job"] == about["job"]


def test_zarr_is_looked_for_before_anything_is_read(
    tmp_path: Path, frame: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(instead: str) -> None:
        raise FormatError(f"no package zarr: {instead}")

    monkeypatch.setattr("clplen.io.store.zarr_files.zarr_package", missing)
    words = ("-c", tmp_path / "none.h5", "-o", tmp_path / "new" / "v.ome.zarr")
    assert "no package zarr: write .ome.tif" in said(run("deconvolve", frame, *words))
    assert not (tmp_path / "new").exists()


def test_parameters_are_no_point_images(tmp_path: Path, frame: Path) -> None:
    (tmp_path / "k.toml").write_text(KNOWN)
    result = run("deconvolve", frame, "-c", tmp_path / "k.toml", "-o", tmp_path / "v.tif")
    assert "make them by 'clplen microscope psf" in said(result)


@pytest.mark.parametrize("command", ["psf", "pupil"])
def test_force_takes_a_doubtful_white_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, device: Device
) -> None:
    """As the message that refuses it says."""
    wave = 1 + np.cos(2 * np.pi * np.arange(120) / 15)
    counts = np.random.default_rng(0).poisson(0.03 * np.outer(wave, wave))  # too few of them
    tifffile.imwrite(tmp_path / "white.tif", counts.astype(np.float32))
    tifffile.imwrite(tmp_path / "frame.tif", np.ones((120, 120), np.float32))
    (tmp_path / "known.toml").write_text(KNOWN)
    words = {
        "psf": ("psf", tmp_path / "known.toml", "-o", tmp_path / "psf.h5"),
        "pupil": ("pupil", tmp_path / "frame.tif", "-c", tmp_path / "known.toml", "--planes-um",
                  "-2:2:3", "--keep-hot"),
    }[command]  # fmt: skip
    words += ("--white", tmp_path / "white.tif", "--device", device.place)

    def reached(*_: object, **__: object) -> None:
        raise FormatError("the white frame was taken")

    monkeypatch.setattr("clplen.cli.microscopy.microscope._simulated", reached)
    monkeypatch.setattr("clplen.microscopy.frames.prepare.Preparation.__call__", reached)
    assert "or --force to go on" in said(run(*words))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        result = run(*words, "--force")
    assert "not to be trusted" in result.stderr
    assert "the white frame was taken" in said(result)
