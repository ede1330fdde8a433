"""``clplen microscope`` with a Fourier microscope, from its camera file to the volume."""

import json

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from clplen import FormatError
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


def test_from_parameters_to_a_volume(tmp_path, device):
    parameters, psf = tmp_path / "camera.toml", tmp_path / "psf.h5"
    parameters.write_text(CAMERA.format(lenslets=LATTICE))
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


def test_files_that_cannot_be(tmp_path):
    for old, new, words in [
        ("relay_mm = 50", "relay_mm = 0.05", "did you mean 50"),
        ("na = 0.3", "na = 1.9", "na lies between"),
        ("relay_mm = 50\n", "", "relay_mm"),
        (LATTICE, "", "needs one of microlenses and lenslets"),
        (LATTICE, LATTICE + "\n" + ANYWHERE, "and has both"),
        (LATTICE, ANYWHERE.replace("[0, 0],", "[0],"), "two numbers"),
    ]:
        path = tmp_path / "camera.toml"
        path.write_text(CAMERA.format(lenslets=LATTICE).replace(old, new))
        with pytest.raises(FormatError, match=words):
            read_fourier_file(path)


def test_files_of_other_cameras(tmp_path):
    for text, said in [
        (PLENOPTIC, "kind 'plenoptic1', and .* 'clplen simulate' and 'clplen analyse' take it"),
        (
            CAMERA.replace("fourier_", "").format(lenslets=LATTICE).replace("relay_mm = 50", ""),
            "kind 'microscope', and .* 'clplen microscope psf' and",
        ),
        (MICROSCOPE, "a microscope, by the names of LFAnalyze, and .* microscope psf' takes it"),
        (
            CAMERA.format(lenslets=LATTICE).replace('kind = "fourier_microscope"', ""),
            r"^\S+: camera\.kind is missing\.$",
        ),
        (CAMERA.format(lenslets=LATTICE).replace("fourier_", "furrier_"), "must be 'fourier_"),
        ("[scene]", "camera is missing"),
    ]:
        path = tmp_path / "camera.toml"
        path.write_text(text)
        with pytest.raises(FormatError, match=said):
            read_fourier_file(path)
    path.write_text(EXAMPLE)
    for read in (read_camera_file, read_microscope_file):
        with pytest.raises(FormatError, match=r"PlenopticCamera\.fourier_microscope"):
            read(path)
