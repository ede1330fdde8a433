"""What ``clplen microscope`` says of frames that do not fit: pixels, lattices, masks, pupils."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from microscope_commands import done, run, said

from clplen.compute.device import Device
from clplen.config.microscope import read_microscope_file
from clplen.errors import FormatError
from clplen.io.results.volume_files import read_volume
from clplen.lightfield import Lattice
from clplen.microscopy import read_point_images, square_lattice
from clplen.microscopy.pupil.even_light import EvenLight
from clplen.microscopy.reconstruction.projector import Projector

KNOWN = """
magnification = 20
na = 0.5
medium_index = 1
wavelength = 525
ulens_pitch = 125
ulens_focal_length = 2500
pixel_size = {size}
num_slices = 2
um_per_slice = 30
supersample = 1
"""
N = 11
ROWS, COLUMNS = 12, 13


@pytest.fixture(scope="module")
def psf(tmp_path_factory: pytest.TempPathFactory, device: Device) -> Path:
    folder = tmp_path_factory.mktemp("psf")
    (folder / "known.toml").write_text(KNOWN.format(size=125 / 11.04))
    out = folder / "psf.h5"
    words = ("--cut", 0.03, "--binning", 3, "--device", device.place)
    text = done(run("psf", folder / "known.toml", "-o", out, *words)).output
    assert "a lenslet has 11.04 pixels: frames are rectified to 11" in text
    assert "3 x 3 samples per pixel the relative error" in text
    return out


def frame_of(psf: Path, device: Device) -> Any:
    projector = Projector(read_point_images(psf), (ROWS, COLUMNS), device=device)
    volume = np.random.default_rng(3).random(projector.volume_shape) ** 3
    frame = projector.forward(volume)
    return np.random.default_rng(4).poisson(frame * 300 / frame.mean()).astype(np.uint16)


def white_of(psf: Path, pitch: float, na: float = 0.5) -> Any:
    about = read_point_images(psf).parameters
    shape = (round(ROWS * pitch), round(COLUMNS * pitch))
    frame = np.maximum(EvenLight(about).frame(square_lattice(pitch, shape), na, 0.5, 3), 0)
    return np.random.default_rng(5).poisson(2000 * frame).astype(np.uint16)


def test_pixels_a_lenslet_are_made_whole(tmp_path: Path) -> None:
    for across, whole in [
        (33.038, 33),
        (33.000006, 33),
        (33.1, 33),
        (33.11, 34),
        (15.385, 16),
        (3.4, 4),
    ]:
        (tmp_path / "k.toml").write_text(KNOWN.format(size=f"{125 / across:.12g}"))
        file = read_microscope_file(tmp_path / "k.toml")
        assert round(file.camera.pixels_per_lenslet or 0) == whole * file.binning
        assert file.pixels == pytest.approx(across)


def test_pixels_a_lenslet_by_key_and_word(tmp_path: Path) -> None:
    path = tmp_path / "k.toml"
    path.write_text(KNOWN.format(size=125 / 33.4) + "pixels_per_lenslet = 33\n")
    file = read_microscope_file(path)
    assert round(file.camera.pixels_per_lenslet or 0) == 33 * file.binning
    file = read_microscope_file(path, pixels=40)
    assert round(file.camera.pixels_per_lenslet or 0) == 40 * file.binning
    for pixels in (30, 1001):
        with pytest.raises(
            FormatError, match=r"per lenslet must be 31 to 1000 for frames with 33.4"
        ):
            read_microscope_file(path, pixels=pixels)
    for bad in ("0", "33.5"):
        path.write_text(KNOWN.format(size=125 / 33.4) + f"pixels_per_lenslet = {bad}\n")
        with pytest.raises(FormatError, match="pixels_per_lenslet"):
            read_microscope_file(path)


def test_a_frame_is_checked_before_anything_is_made(
    tmp_path: Path, psf: Path, device: Device
) -> None:
    known = psf.parent / "known.toml"
    words = ("psf", known, "-o", tmp_path / "p.h5", "--device", device.place)
    tifffile.imwrite(tmp_path / "f.tif", np.ones((120, 132), np.uint16))
    text = said(run(*words, "--frame", tmp_path / "f.tif"))
    assert "must have a whole number of lenslets of 11 x 11 pixels (11.04" in text
    assert "--pixels 12" in text
    tifffile.imwrite(tmp_path / "w.tif", white_of(psf, 12.6))
    text = said(run(*words, "--white", tmp_path / "w.tif"))
    assert "lenslets 12.6" in text
    assert "--pixels 13" in text
    text = said(run(*words, "--frame", tmp_path / "f.tif", "--white", tmp_path / "w.tif"))
    assert "has shape" in text
    tifffile.imwrite(tmp_path / "n.tif", np.ones((120, 132), np.uint16))
    assert "white" in said(run(*words, "--white", tmp_path / "n.tif"))
    assert "no file" in said(run(*words, "--frame", tmp_path / "none.tif"))
    assert not (tmp_path / "p.h5").exists()


@pytest.mark.thorough
def test_another_pitch_and_a_smaller_pupil_are_told(
    tmp_path: Path, psf: Path, device: Device
) -> None:
    tifffile.imwrite(tmp_path / "w.tif", white_of(psf, 11.25, na=0.475))
    tifffile.imwrite(tmp_path / "f.tif", white_of(psf, 11.25, na=0.475) // 3)
    words = ("deconvolve", tmp_path / "f.tif", "-c", psf, "--device", device.place)
    words += ("--white", tmp_path / "w.tif", "--iterations", 8)
    text = done(run(*words, "-o", tmp_path / "v.ome.tif")).output
    assert "lenslet pitch is 11.25 pixels, 11.04 by the parameters: 1.9" in text
    assert "model pupil against white frame: 1" in text
    assert "NA 0.47" in text
    _, about = read_volume(tmp_path / "v.ome.tif")
    assert any("model pupil" in one for one in about["remarks"])
    text = done(run(*words, "--radiometric", "-o", tmp_path / "r.ome.tif")).output
    assert "the pixel sensitivity corrects it (radiometric)" in text
    changed = read_volume(tmp_path / "r.ome.tif")[1]
    assert changed["residuals"][-1] != about["residuals"][-1]
    assert changed["job"]["radiometric"] is True


@pytest.mark.thorough
def test_a_told_lattice(tmp_path: Path, psf: Path, device: Device) -> None:
    frame = frame_of(psf, device)
    wide = np.pad(frame, ((3, 2), (5, 1)))
    tifffile.imwrite(tmp_path / "f.tif", wide)
    words = ("deconvolve", tmp_path / "f.tif", "-c", psf, "--device", device.place)
    words += ("--iterations", 5, "-o", tmp_path / "v.ome.tif")
    assert "must be a whole number of lenslets" in said(run(*words))
    assert "or the lattice" in said(run(*words))
    text = done(run(*words, "--pitch", 11, "--offset", "8:10")).output
    assert "2 x 12 x 13 voxels" in text
    square_lattice(11.0, wide.shape, offset=(8, 10)).save(tmp_path / "l.json")
    first = read_volume(tmp_path / "v.ome.tif")[0]
    done(run(*words, "--lattice", tmp_path / "l.json", "--force"))
    np.testing.assert_array_equal(read_volume(tmp_path / "v.ome.tif")[0], first)


def test_bad_words(tmp_path: Path, psf: Path, device: Device) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.ones((132, 143), np.uint16))
    out = tmp_path / "v.ome.tif"
    given = ("deconvolve", tmp_path / "f.tif", "-c", psf, "-o", out, "--device", device.place)
    for words, message in [
        (("--pitch", "nan"), "must be a positive number"),
        (("--pitch", "2"), "at least 3 pixels"),
        (("--pitch", "1e9"), "do not fit"),
        (("--pitch", "20"), "fewer would lose light"),
        (("--pitch", "11", "--offset", "8"), "must be two finite numbers, got 8"),
        (("--pitch", "11", "--rotation", "inf"), "must be a finite number"),
        (("--pitch", "11", "--rotation", "120"), "less than 90 degrees"),
        (("--offset", "8:8"), "--offset needs the pitch of the lattice: give --pitch"),
        (("--radiometric",), "--radiometric needs the white frame"),
    ]:
        assert message in said(run(*given, *words))
        assert not out.exists()


def test_files_that_are_no_lattice_or_mask(tmp_path: Path, psf: Path, device: Device) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.ones((132, 143), np.uint16))
    out = tmp_path / "v.ome.tif"
    given = ("deconvolve", tmp_path / "f.tif", "-c", psf, "-o", out, "--device", device.place)
    tiny = json.loads(Lattice("square", (5, 5), (11, 0), (0, 11)).to_json())
    texts = {
        "cannot be read": b"\xff\xfe\0",
        "at least 3 pixels": json.dumps(tiny | {"row": [1e-7, 0], "column": [0, 1e-7]}).encode(),
        "and the lattice": json.dumps(tiny | {"shape": [100, 100]}).encode(),
    }
    for words, content in texts.items():
        (tmp_path / "l.json").write_bytes(content)
        text = said(run(*given, "--lattice", tmp_path / "l.json"))
        assert words in text
    assert "There is no lattice" in said(run(*given, "--lattice", tmp_path / "none.json"))
    (tmp_path / "m.tif").write_bytes(b"II*\0" + b"\xff" * 40)
    assert "m.tif" in said(run(*given, "--mask", tmp_path / "m.tif"))
    assert not out.exists()


def test_hot_pixels_and_masks(tmp_path: Path, psf: Path, device: Device) -> None:
    frame = frame_of(psf, device)
    places = np.random.default_rng(6).choice(frame.size, 30, replace=False)
    spoilt = frame.copy()
    spoilt.flat[places] = 60000
    mask = np.zeros(frame.shape, np.uint8)
    mask.flat[places] = 1
    residuals = {}
    for name, picture, words in (
        ("clean", frame, ()), ("found", spoilt, ()),
        ("masked", spoilt, ("--keep-hot", "--mask", tmp_path / "m.tif")),
    ):  # fmt: skip
        tifffile.imwrite(tmp_path / f"{name}.tif", picture)
        tifffile.imwrite(tmp_path / "m.tif", mask)
        out = tmp_path / f"{name}.ome.tif"
        given = ("deconvolve", tmp_path / f"{name}.tif", "-c", psf, "-o", out)
        text = done(run(*given, "--iterations", 10, "--device", device.place, *words)).output
        residuals[name] = read_volume(out)[1]["residuals"][-1]
        assert ("30 hot pixels" in text) == (name == "found")
        assert ("30 pixels are excluded by the mask" in text) == (name == "masked")
    for name in ("found", "masked"):
        assert residuals[name] == pytest.approx(residuals["clean"], rel=0.1)
