"""``clplen microscope pupil``: coefficients and a parameter file, and what it says of bad input."""

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.cli import main
from clplen.config.microscope import read_microscope_file
from clplen.outputs import is_ours

KNOWN = """# a microscope
magnification = 10
na = 0.2
medium_index = 1.0
wavelength = 525
tubelens_focal_length = 200
ulens_pitch = 60
ulens_focal_length = 1500
pixel_size = 5.4545454545454541
pupil_nm = { 12 = 10.0 }
cover = { thickness_um = 170 }
"""
CAMERA = """
[camera]
kind = "microscope"
magnification = 10
na = 0.2
medium_index = 1.0
tube_lens_mm = 200
wavelength_nm = 525
pixels_per_lenslet = 11
[camera.microlenses]
pitch_um = 60
focal_length_mm = 1.5
count = 9
fill = "full"
"""
TRUE = {6: 35e-9, 8: -30e-9, 12: 10e-9}
WORDS = ("--planes-um", "-75:75:11", "--beads", "--terms", "6,8", "--gain", "1")


def run(folder, *words):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return CliRunner().invoke(main, ["microscope", "pupil", *words])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("pupil")
    camera = PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11, pupil=TRUE,
        mla=MicrolensArray(60e-6, 1.5e-3, count=9, fill="full"),
    )  # fmt: skip
    beads = PointSources([(7e-6, -5e-6, 50e-6), (-9e-6, 3e-6, -45e-6)], power=[6e4, 4e4])
    mean = camera.expose(beads).to_numpy() + 0.25
    frame = np.random.default_rng(4).poisson(mean).astype(np.uint16)
    tifffile.imwrite(place / "beads.tif", frame)
    mask = np.zeros(frame.shape, np.uint8)
    places = np.random.default_rng(6).choice(frame.size, 12, replace=False)
    frame.flat[places], mask.flat[places[:2]] = frame.max(), 1
    tifffile.imwrite(place / "hot.tif", frame)
    tifffile.imwrite(place / "mask.tif", mask)
    (place / "scope.toml").write_text(KNOWN)
    (place / "camera.toml").write_text(CAMERA)
    return place


@pytest.mark.thorough
def test_beads_to_parameters(folder, device):
    words = ("beads.tif", "-c", "scope.toml", "-o", "found.toml", *WORDS)
    found = run(folder, *words)
    assert found.exit_code == 0, found.output
    assert " beads\n" in found.output
    assert "coma along x" in found.output
    terms = read_microscope_file(folder / "found.toml").camera.build(device).pupil.coefficients
    assert terms[12] == pytest.approx(10e-9)
    assert terms[6] == pytest.approx(35e-9, abs=3e-9)
    assert terms[8] == pytest.approx(-30e-9, abs=3e-9)
    assert (folder / "found.toml").read_text().count("pupil_nm") == 1


def test_camera_file_and_anything(folder, device):
    found = run(folder, "beads.tif", "-c", "camera.toml", "-o", "anything.toml", "--planes-um",
                "-45:50:2", "--terms", "6", "--steps", "1", "--voxels", "2")  # fmt: skip
    assert found.exit_code == 0, found.output
    assert "give --gain" in found.output
    camera = read_microscope_file(folder / "anything.toml").camera.build(device)
    assert 6 in camera.pupil.coefficients
    assert is_ours(folder / "anything.toml")  # and so replaced when the command runs again
    assert not is_ours(folder / "camera.toml")


def test_bad_words(folder):
    for words, said in [
        (("none.tif", "-c", "scope.toml", *WORDS), "none.tif"),
        (("beads.tif", "-c", "none.toml", *WORDS), "none.toml"),
        (("beads.tif", "-c", "scope.toml", "--planes-um", "1:2"), "START:STOP:N"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "--terms", "a,b"), "of Noll's indices"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "--terms", "3,5"), "must be from 5 on"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "--gain", "-1"), "must be a positive number"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "--haze"), "--haze needs the white frame"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "-o", "found.txt"), ".toml"),
        (("beads.tif", "-c", "scope.toml", *WORDS, "-o", "scope.toml", "--force"), "scope.toml"),
        (("scope.toml", "-c", "scope.toml", *WORDS), "scope.toml"),
        (("odd.tif", "-c", "scope.toml", *WORDS), "odd.tif"),
        (("beads.tif", "-c", "piston.toml", *WORDS), "piston"),
        (("beads.tif", "-c", "hexagons.toml", *WORDS), "hexagons.toml are hexagonal: use a square"),
        (("beads.tif", "-c", "two.toml", *WORDS), "two.toml are of several focal lengths: use"),
    ]:
        tifffile.imwrite(folder / "odd.tif", np.ones((50, 61), np.uint16))
        hexagons = CAMERA.replace("fill =", 'lattice = "hexagonal"\nfill =')
        (folder / "hexagons.toml").write_text(hexagons)
        several = CAMERA.replace("focal_length_mm = 1.5", "focal_length_mm = [1.5, 1.7]")
        (folder / "two.toml").write_text(several)
        (folder / "piston.toml").write_text(KNOWN.replace("12 = 10.0", "1 = 10.0"))
        found = run(folder, *words, "--keep-hot")
        assert found.exit_code in (1, 2)
        assert isinstance(found.exception, SystemExit), found.exception
        assert said in found.output
        assert "Traceback" not in found.output
