"""``clplen microscope`` with a Fourier microscope, from its camera file to the volume."""

import json

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from clplen import FormatError, read_camera
from clplen.cli import main
from clplen.config.camera_file import read_camera_file
from clplen.config.example import EXAMPLE as PLENOPTIC
from clplen.config.example import MICROSCOPE
from clplen.config.fourier_microscope import EXAMPLE, is_fourier_file, read_fourier_file
from clplen.config.microscope import read_microscope_file
from clplen.io import read_volume, write_volume

CAMERA = """
[camera]
kind = "fourier_microscope"
magnification = 20
na = 0.3
wavelength_nm = 525
relay_mm = 50
pixel_um = 8
{lenslets}
[volume]
num_slices = 3
um_per_slice = 15
"""
LATTICE = "[camera.microlenses]\npitch_um = 500\nfocal_length_mm = 12\ncount = 3"
ANYWHERE = """[camera.lenslets]
positions_mm = [[0, 0], [0, 0.5], [0.45, -0.25], [-0.45, -0.25]]
focal_length_mm = 12
diameter_um = 480
"""


def run(*words, code=0):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return result.output


@pytest.mark.parametrize("lenslets", [LATTICE, pytest.param(ANYWHERE, marks=pytest.mark.thorough)])
def test_from_parameters_to_a_volume(tmp_path, device, lenslets):
    parameters, psf = tmp_path / "camera.toml", tmp_path / "psf.h5"
    parameters.write_text(CAMERA.format(lenslets=lenslets))
    chosen = ("--device", device.place)
    assert "axial resolution" in run("microscope", "psf", parameters, "-o", psf, *chosen)
    known = json.loads(run("info", psf, "--json"))
    assert known["planes"] == pytest.approx([-15e-6, 0, 15e-6])
    volume = np.zeros((3, 31, 31), np.float32)
    volume[0, 9, 20] = volume[2, 18, 12] = 1e5
    truth = tmp_path / "truth.ome.tif"
    write_volume(truth, volume, planes=known["planes"], voxel=(1e-6, 1e-6))
    frame = tmp_path / "frame.tif"
    run("microscope", "project", truth, "-c", psf, "-o", frame, *chosen)
    counts = np.random.default_rng(0).poisson(tifffile.imread(frame)) + 100
    tifffile.imwrite(frame, counts.astype(np.uint16))
    dark = tmp_path / "dark.tif"
    tifffile.imwrite(dark, np.full(counts.shape, 100, np.uint16))
    out = tmp_path / "found.ome.tif"
    words = ("-c", psf, "--dark", dark, "--iterations", 12, *chosen)
    run("microscope", "deconvolve", frame, *words, "-o", out)
    found, about = read_volume(out)
    middle = np.array(found.shape[1:]) // 2 - 15
    bright = [tuple(p) for p in np.argwhere(found > 0.3 * found.max()) - [0, *middle]]
    assert bright == [(0, 9, 20), (2, 18, 12)]
    assert about["degenerate_um"] == []
    again = run("microscope", "deconvolve", frame, *words, "-o", out)
    assert "is there already" in again
    white = ("--white", frame)
    assert "leave the white frame, the lattice" in run(
        "microscope", "deconvolve", frame, *words, *white, "-o", tmp_path / "b.ome.tif", code=1
    )
    tifffile.imwrite(frame, counts[:-1].astype(np.uint16))
    said = run("microscope", "deconvolve", frame, "-c", psf, "-o", tmp_path / "c.ome.tif", code=1)
    assert "give the whole frame" in said


def test_the_example_is_a_camera(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(run("microscope", "psf", "--fourier"))
    assert path.read_text() == EXAMPLE
    assert is_fourier_file(path)
    file = read_fourier_file(path)
    assert (file.slices, file.um_per_slice, file.voxels) == (21, 4.0, 1)
    assert "Fourier light-field microscope" in run("info", path)
    assert "--half is of microscopes" in run(
        "microscope", "psf", path, "-o", tmp_path / "psf.h5", "--half", code=2
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("relay_mm = 50", "relay_mm = 0.05", "did you mean 50"),
        ("pixel_um = 8", "pixel_um = 8e-6", "did you mean 8"),
        ("na = 0.3", "na = 1.9", "na lies between"),
        ("relay_mm = 50", "relay_m = 50", "did you mean"),
        ("relay_mm = 50\n", "", "relay_mm"),
        (LATTICE, "", "needs one of microlenses and lenslets"),
        (LATTICE, LATTICE + "\n" + ANYWHERE, "and has both"),
        (LATTICE, ANYWHERE.replace("[0, 0],", "[0],"), "two numbers"),
    ],
)
def test_files_that_cannot_be(tmp_path, old, new, words):
    path = tmp_path / "camera.toml"
    path.write_text(CAMERA.format(lenslets=LATTICE).replace(old, new))
    with pytest.raises(FormatError, match=words):
        read_fourier_file(path)


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "flfm.toml", "-o", "out"),
        ("analyse", "flfm.toml", "-o", "out"),
        ("microscope", "pupil", "frame.tif", "-c", "flfm.toml", "--planes-um", "0:1:2"),
    ],
)
def test_commands_of_other_cameras_say_what_takes_the_file(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flfm.toml").write_text(EXAMPLE)
    said = run(*words, code=1).strip().splitlines()[-1]
    assert "flfm.toml is of a Fourier microscope (kind = 'fourier_microscope')" in said
    assert "'clplen microscope psf' and 'clplen info' take it" in said
    assert "did you mean" not in said
    assert said.count(";") == 0


@pytest.mark.parametrize("read", [read_camera_file, read_camera, read_microscope_file])
def test_readers_of_other_cameras_say_what_makes_it(tmp_path, read):
    path = tmp_path / "flfm.toml"
    path.write_text(EXAMPLE)
    with pytest.raises(FormatError, match=r"PlenopticCamera\.fourier_microscope"):
        read(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PLENOPTIC, "kind 'plenoptic1', and .* 'clplen simulate' and 'clplen analyse' take it"),
        (CAMERA.replace("fourier_", "").format(lenslets=LATTICE).replace("relay_mm = 50", ""),
         "kind 'microscope', and .* 'clplen microscope psf' and"),
        (MICROSCOPE, "a microscope, by the names of LFAnalyze, and .* microscope psf' takes it"),
        (CAMERA.format(lenslets=LATTICE).replace('kind = "fourier_microscope"', ""),
         r"^\S+: camera\.kind is missing\.$"),
        (CAMERA.format(lenslets=LATTICE).replace("fourier_", "furrier_"), "must be 'fourier_"),
        ("[scene]", "camera is missing"),
    ],
)  # fmt: skip
def test_files_of_other_cameras(tmp_path, text, said):
    path = tmp_path / "camera.toml"
    path.write_text(text)
    with pytest.raises(FormatError, match=said):
        read_fourier_file(path)


def test_psf_of_a_camera_that_is_no_microscope(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(PLENOPTIC)
    said = run("microscope", "psf", path, "-o", tmp_path / "psf.h5", code=1)
    assert "kind 'plenoptic1', not 'microscope': 'clplen simulate' and" in said
