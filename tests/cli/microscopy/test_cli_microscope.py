"""``clplen microscope``: from parameters and frames to volumes, and what it says of bad input."""

from __future__ import annotations

import itertools
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import batchworks
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from microscope_commands import CAMERA, KNOWN, done, run, said

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

VOXEL = 100e-6 / 60 / 3
SIZE = (7, 8)  # lenslets


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
    other = ("--cut", 0.02, "--planes-um", "-2.5:3.5:3")
    text = said(run("psf", tmp_path / "camera.toml", *words, *other))
    assert "planes[1] = 0.0, not 5e-07" in text


def test_project_is_the_projection(tmp_path: Path, psf: Path, projector: Projector) -> None:
    volume = beads(projector, (0, 5, 9), (2, 17, 4))
    planes = projector.images.planes
    write_volume(tmp_path / "v.ome.tif", volume, planes=planes, voxel=(VOXEL, VOXEL))
    words = ("-c", psf, "-o", tmp_path / "f.tif", "--device", projector.device.place)
    result = done(run("project", tmp_path / "v.ome.tif", *words))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "f.tif"), projector.forward(volume))
    assert "7 x 8 lenslets of 15 x 15 pixels" in result.output
    write_volume(tmp_path / "w.tif", volume, planes=planes + 1e-6, voxel=(VOXEL, VOXEL))
    np.save(tmp_path / "few.npy", volume[:2])
    np.save(tmp_path / "odd.npy", volume[:, 1:])
    np.save(tmp_path / "minus.npy", -volume)
    for name, message in (
        ("w.tif", "lies at z = -1.5 um, but at -2.5 um in the point images"),
        ("few.npy", "has 2 planes, the point images have 3"),
        ("odd.npy", "a whole number of lenslets of 3 x 3"),
        ("minus.npy", "has 2 voxels that are negative"),
    ):
        assert message in said(run("project", tmp_path / name, *words))


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
    assert f"{brightest.sum()} saturated or non-finite pixels are excluded" in result.stderr
    volume, _ = read_volume(out)
    assert np.unravel_index(volume.argmax(), volume.shape) == (2, 10, 13)
    assert volume.sum() == pytest.approx(1e5, rel=0.1)


def test_a_series_that_was_ended_goes_on(
    tmp_path: Path, psf: Path, frame: Path, device: Device
) -> None:
    second = tmp_path / "b.tif"
    tifffile.imwrite(second, np.zeros((20, 30), np.uint16))
    words = ["deconvolve", frame, second, "-c", psf, "-o", tmp_path / "{name}.ome.tif",
             "--iterations", 2, "--device", device.place, "--warm-start"]  # fmt: skip
    assert "b.tif: The frame must be a whole number of lenslets" in said(run(*words))
    first = (tmp_path / "a.ome.tif").read_bytes()
    tifffile.imwrite(second, tifffile.imread(frame))
    assert "a.ome.tif is up to date" in done(run(*words)).output
    assert (tmp_path / "a.ome.tif").read_bytes() == first
    resumed, about = read_volume(tmp_path / "b.ome.tif")
    later = describe_series(tmp_path / "a.ome.tif")["residuals"][-1]
    assert about["residuals"][0] < later
    for out in tmp_path.glob("*.ome.tif"):
        out.unlink()
    done(run(*words))
    np.testing.assert_array_equal(read_volume(tmp_path / "b.ome.tif")[0], resumed)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.ome.tif", "a.tif", "b.ome.tif", "b.tif",
    ]  # fmt: skip


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


def test_frames_of_a_job_share_point_images(
    tmp_path: Path, psf: Path, frame: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "in").mkdir()
    counts = tifffile.imread(frame)
    for number in range(3):
        tifffile.imwrite(tmp_path / "in" / f"t{number}.tif", np.roll(counts, 15 * number, axis=1))
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
    assert (summary.done, summary.failed) == (3, {})
    assert next(count) == 2
    words = ("-c", psf, "-o", tmp_path / "v.tif", "--iterations", 2, "--background", 2)
    done(run("deconvolve", tmp_path / "in" / "t1.tif", *words, "--device", device.place))
    volume, about = read_volume(tmp_path / "out" / "t1" / "volume.ome.tif")
    np.testing.assert_array_equal(volume, read_volume(tmp_path / "v.tif")[0])
    assert (about["planes_um"], about["left_out"]) == ([-2.5, 0.0, 2.5], 0)
    of_command = describe_series(tmp_path / "v.tif")
    assert {name: about[name] for name in of_command} == of_command
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
    assert "2 saturated or non-finite pixels are excluded" in result.stderr
    assert "pixels below 0 are set to 0" in result.stderr
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


BAD: list[tuple[list[str], str, int]] = [
    (["a.tif", "-o", "v.png"], "The output must end in .tif or .tiff or .zarr", 2),
    (["a.tif", "-o", "a.tif"], "is one of the input files", 2),
    (["a.tif", "-o", "a.tif/v.tif"], "a.tif is a file or a broken link", 1),
    (["a.tif", "-o", "noise.tif"], "exists already, and clplen did not write it", 1),
    (["volume.tif", "-o", "v.tif"], "is a volume written by clplen", 1),
    (["a.tif", "-o", "v.tif", "-c", "known.toml"], "simulate them by 'clplen microscope psf", 1),
    (["a.tif", "-o", "v.tif", "--memory", "1"], "--memory must be at least 1MiB", 2),
    (["a.tif", "-o", "v.tif", "--white", "noise.tif", "--saturation", "9"],
     "12,600 of 12,600 pixels of the white frame are saturated (9 or more)", 1),
    (["a.tif", "-o", "v.tif", "--dark", "bright.tif"], "is brighter than the frame", 1),
    (["none.tif", "-o", "v.tif"], "There is no file", 1),
    (["a.tif", "-o", "v.tif", "--white", "noise.tif"], "no repeated pattern of about 15", 1),
    (["a.tif", "-o", "v.tif", "--haze"], "--haze needs the white frame: give --white", 2),
    (["a.tif", "-o", "v.tif", "--gain", "0"], "must be a positive number, got 0", 2),
    (["a.tif", "-o", "v.tif", "--strength", "2"], "--strength needs --prior", 2),
    (["a.tif", "-o", "v.tif", "--residual", "noisy"], "a positive number or 'noise'", 2),
    (["a.tif", "-o", "v.tif", "--white", "few.tif"], "white frame (120, 121)", 1),
    (["small.tif", "-o", "v.tif"], "at least 5 x 5 lenslets", 1),
    (["colour.tif", "-o", "v.tif"], "series of 3 frames, write it with photometric=", 1),
]  # fmt: skip


def test_bad_words_of_deconvolve(
    tmp_path: Path, psf: Path, frame: Path, monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    monkeypatch.chdir(tmp_path)
    down, across = (1 + np.cos(2 * np.pi * np.arange(n) / 15) for n in (120, 121))
    tifffile.imwrite("few.tif", (99 * np.outer(down, across)).astype(np.uint16))
    noise = np.random.default_rng(0).poisson(100, (105, 120))
    tifffile.imwrite("noise.tif", noise.astype(np.uint16))
    tifffile.imwrite("small.tif", np.ones((60, 75), np.uint16))
    tifffile.imwrite("bright.tif", np.full((105, 120), 9000, np.uint16))
    write_volume("volume.tif", np.ones((2, 3, 4)), planes=[0, 1e-6], voxel=(VOXEL, VOXEL))
    tifffile.imwrite("colour.tif", np.ones((60, 75, 3), np.uint16), photometric="rgb")
    Path("known.toml").write_text(KNOWN)
    for words, message, code in BAD:
        given = words if "-c" in words else [*words, "-c", str(psf)]
        result = run("deconvolve", *given, "--iterations", 1, "--device", device.place)
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
    assert "residual noise treats counts as photons: give the gain" in result.stderr
    share = 200 / mean.size
    assert result.stderr.count(f"2 pixels below 0 are set to 0 ({share:.2g} %)") == 2
    result = done(run("deconvolve", "t.tif", *words, "--background", 5000))
    assert result.stderr.count("the background of 5000 counts exceeds the mean") == 2
    assert result.stderr.count("is the background too high?") == 2
    about = describe_series("out/new/t_0001.ome.tif")
    assert [text.split()[0] for text in about["remarks"]] == ["1", "the", "the"]
    assert about["place"] == {"first": [2, 2], "down": [5, 0], "right": [0, 5]}
    told = CliRunner().invoke(main, ["info", "out/new/t_0001.ome.tif", "--json"]).output
    assert json.loads(told)["job"] == about["job"]


def test_force_takes_a_doubtful_white_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    """As the message that refuses it says."""
    wave = 1 + np.cos(2 * np.pi * np.arange(120) / 15)
    counts = np.random.default_rng(0).poisson(0.03 * np.outer(wave, wave))  # too few of them
    tifffile.imwrite(tmp_path / "white.tif", counts.astype(np.float32))
    (tmp_path / "known.toml").write_text(KNOWN)
    words = ("psf", tmp_path / "known.toml", "-o", tmp_path / "psf.h5", "--white",
             tmp_path / "white.tif", "--device", device.place)  # fmt: skip

    def reached(*_: object, **__: object) -> None:
        raise FormatError("the white frame was taken")

    monkeypatch.setattr("clplen.cli.microscopy.microscope._simulate", reached)
    assert "or --force to go on" in said(run(*words))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        result = run(*words, "--force")
    assert "low trust" in result.stderr
    assert "the white frame was taken" in said(result)
