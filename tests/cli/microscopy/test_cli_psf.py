"""``clplen microscope psf``: parameters in their units, planes, and what is said of them."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from microscope_commands import CAMERA, KNOWN, done, run, said

from clplen.cli import main
from clplen.compute.device import Device
from clplen.config.microscope import read_microscope_file
from clplen.errors import FormatError


def test_bad_microscopes(tmp_path: Path, device: Device) -> None:
    for old, new, message in [
        ("na = 1.2", "na = 1.4", "1.4"),
        ("num_slices = 3", "num_slices = 9001", "The plane at z = -11250 um needs"),
        ("ulens_pitch", "ulens_pich", "unknown key ulens_pich; did you mean ulens_pitch?"),
        ("num_slices = 3\n", "", "nor"),
        ("wavelength = 593", "wavelength = -593", "wavelength"),
        (
            "wavelength = 593",
            "wavelength = 0.593",
            "must be 150 to 3000 nm: did you mean 593? (got 0.593)",
        ),
        ("pixel_size = 6.666666667", "pixel_size = 65", "pixels per lenslet by pixel_size is 1.54"),
        ("ulens_focal_length = 2500", "ulens_focal_length = 2.5", "did you mean 2500?"),
        ("na = 1.2", "na = 12", "na must be 0.01 to 1.8, got 12"),
        ("medium_index = 1.33\n", " ", "medium_index is missing"),
        ("apodisation = 0.4", "[camera]", "has magnification beside [camera]: put all"),
    ]:
        (tmp_path / "k.toml").write_text(KNOWN.replace(old, new))
        result = run("psf", tmp_path / "k.toml", "-o", tmp_path / "p.h5", "--device", device.place)
        code = 2 if not new else 1
        assert message.replace("nor", "set the planes") in said(result, code)
        assert not (tmp_path / "p.h5").exists()


def test_pixels_are_divided_by_the_apertures(tmp_path: Path, device: Device) -> None:
    for size, pixels, parts in ((6.666666667, 15, 2), (8, 13, 2), (20, 5, 5)):
        (tmp_path / "k.toml").write_text(KNOWN.replace("6.666666667", f"{size:.9g}"))
        file = read_microscope_file(tmp_path / "k.toml")
        assert file.camera.pixels_per_lenslet == pixels * parts
        assert (file.pixels, file.binning) == (pytest.approx(100 / size), parts)
    words = ("--binning", 2, "--planes-um", "0:2:2", "-o", tmp_path / "p.h5")
    message = said(run("psf", tmp_path / "k.toml", *words, "--device", device.place), 2)
    assert "--binning must be at least 3 to sample the light, got 2" in message


def test_units_of_a_camera_file(tmp_path: Path) -> None:
    for old, new, message in [
        (
            "wavelength_nm = 593",
            "wavelength_nm = 0.593",
            "camera.wavelength_nm is 0.593; it must be 150 to 3000 nm: did you mean 593?",
        ),
        ("focal_length_mm = 2.5", "focal_length_mm = 2500", "is 2500; it must be 0.01 to 200 mm"),
        ("pixels_per_lenslet = 15", "pixels_per_lenslet = 1.5", "must be 3 to 1000"),
        ("tube_lens_mm = 200", "tube_lens_mm = 0.2", "did you mean 200?"),
    ]:
        text = CAMERA.replace("apodisation", "tube_lens_mm = 200\napodisation")
        (tmp_path / "k.toml").write_text(text)
        assert read_microscope_file(tmp_path / "k.toml").assumptions == ()
        (tmp_path / "k.toml").write_text(text.replace(old, new))
        with pytest.raises(FormatError) as error:
            read_microscope_file(tmp_path / "k.toml")
        assert message in str(error.value)


def test_what_is_taken_is_said(tmp_path: Path) -> None:
    (tmp_path / "k.toml").write_text(CAMERA.replace("medium_index = 1.33\n", ""))
    index, tube = read_microscope_file(tmp_path / "k.toml").assumptions
    assert "medium_index is not given; the default is 1 (air" in index
    assert "tube_lens_mm is not given; the default is 200" in tube
    (tmp_path / "k.toml").write_text(KNOWN.replace("na =", "cover = {thickness_um = 150}\nna ="))
    file = read_microscope_file(tmp_path / "k.toml")
    assert file.camera.cover is not None
    assert file.camera.cover.thickness_um == 150
    assert [sentence.split()[0] for sentence in file.assumptions] == ["tubelens_focal_length"]
    (tmp_path / "k.toml").write_bytes(b"II*\0\xfe\x01")
    with pytest.raises(FormatError, match="is not a text file"):
        read_microscope_file(tmp_path / "k.toml")
    (tmp_path / "k.toml").write_text('output = "out"')
    with pytest.raises(FormatError, match=r"has neither .* nor .* 'clplen microscope psf"):
        read_microscope_file(tmp_path / "k.toml")
    with pytest.raises(FormatError, match=r"no file .*; 'clplen microscope psf --example' prints"):
        read_microscope_file(tmp_path / "none.toml")


def test_the_example_is_the_vesicle(tmp_path: Path, psf: Path, device: Device) -> None:
    (tmp_path / "guv.toml").write_text(done(run("psf", "--example")).output)
    file = read_microscope_file(tmp_path / "guv.toml")
    assert (file.camera.na, file.camera.medium_index, file.camera.wavelength_nm) == (1.2, 1.35, 593)
    assert (file.pixels, file.slices, file.assumptions) == (pytest.approx(100 / 6.5), 20, ())
    info = CliRunner().invoke(main, ["info", str(tmp_path / "guv.toml"), "--device", device.place])
    assert "light-field range          14.8696 um" in done(info).output
    info = CliRunner().invoke(main, ["info", str(psf)])
    for words in ("60x/1.2", "index 1.33, 593 nm, apodisation 0.4", "15 x 15 a lenslet",
                  "3 x 3 a lenslet, 0.5556 um", "3, z = -2.5, 0, 2.5 um", "0.02 of"):  # fmt: skip
        assert words in done(info).output
    info = CliRunner().invoke(main, ["info", str(psf), "--json"])
    assert json.loads(info.output)["planes"] == [-2.5e-6, 0, 2.5e-6]


@pytest.mark.thorough
def test_planes_are_told_from_the_objective_on(
    tmp_path: Path, psf: Path, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "k.toml").write_text(KNOWN)
    words = ("--planes-um", "2.5:-2.5:3", "--cut", 0.02, "--device", device.place, "-o", psf)
    result = done(run("psf", tmp_path / "k.toml", *words))
    assert "is nearest to the objective: -2.5 to 2.5 um" in result.stderr
    monkeypatch.setattr(sys.modules["clplen.microscopy.model.psf"], "point_images", stopped)
    words = ("--planes-um", "-400:20:2", "--device", device.place, "-o", tmp_path / "p.h5")
    result = run("psf", tmp_path / "k.toml", *words)
    # tan = 1.2/sqrt(1.33^2 - 1.2^2): M z tan/p = 502.2; .94 lam M z/d = 133.8 um
    assert "1 of 2 planes lie more than 2 light-field ranges" in result.stderr
    assert "a point covers 1007 x 1007 lenslets, and the resolution is 134 um" in result.stderr
    assert (result.exit_code, "Interrupted" in result.stderr) == (130, True)


def stopped(*_: Any, **__: Any) -> None:
    """As a simulation that is asked to end."""
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(5)
