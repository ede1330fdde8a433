"""``clplen simulate`` with pictures, light and checkpoints."""

from __future__ import annotations

import io
import shutil
from importlib import import_module
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner, Result
from command_line import said
from tqdm import tqdm

from clplen import cli
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.cli.shared import console
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file
from clplen.io import read_lightfield
from clplen.wave.coherence import averaging
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.spectrum.spectrum import Spectrum

SMALL = """
[camera]
focal_length_mm = 30.0
wavelength_nm = 532
pixels_per_lenslet = 12
[camera.microlenses]
pitch_um = 150
focal_length_mm = 10
count = 15
fill = "full"
[scene]
"""
PICTURE = '[[scene.pictures]]\nfile = "L.png"\nwidth_mm = 0.6\n'
SLIDE = PICTURE + 'mode = "transmission"\n'
MASK = '[coherence]\nspatial = "mask"\ncell_um = 50\nseed = 5\nsnapshots = 4\n'


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A small camera's file without a scene, and a picture."""
    values = np.zeros((9, 8), np.uint8)
    values[1:7, 2:4] = 255
    values[5:7, 2:7] = 153
    imageio.imwrite(tmp_path / "L.png", values)
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def simulated(file: Path, tables: str, device: Device, *words: object) -> tuple[Result, Path]:
    """The command run on a camera file with these tables."""
    file.write_text(SMALL + tables)
    out = file.parent / "out"
    typed = ["simulate", file, "-o", out, "--device", device.place, *words]
    return CliRunner().invoke(cli.main, [str(word) for word in typed]), out / "raw.tif"


@pytest.mark.thorough
def test_simulate_a_scene_of_points_and_pictures(small: Path, device: Device):
    points = "points_mm = [[0.2, -0.1, 3.0]]\npower = 0.5\n"
    lines = "[coherence]\nlines_nm = [532, 500]\nline_powers = [3, 1]\n"
    result, raw = simulated(small, points + PICTURE + "z_mm = 1\n" + lines, device)
    assert result.exit_code == 0, result.output
    image = np.zeros((9, 8))
    image[1:7, 2:4] = 1
    image[5:7, 2:7] = 0.6
    scene = [
        PointSources((0.2e-3, -0.1e-3, 3e-3), power=0.5),
        PicturePlane(image, 0.6e-3, 1e-3),
    ]
    light = Coherence(None, Spectrum.lines([532e-9, 500e-9], [3, 1]))
    expected = read_camera_file(small).camera.build(device).expose(scene, coherence=light)
    np.testing.assert_array_equal(tifffile.imread(raw), expected.to_numpy())
    assert f"\nExposure: {expected.exposure}\n{raw.parent} holds raw.tif" in result.stdout
    assert "L.png: 9 x 8 samples (y x x) of 75 um, grey, mode emission\n" in result.stderr


def test_simulate_passes_on_what_the_file_says(
    small: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    given, expose = {}, Plenoptic1.expose

    def spy(self: Plenoptic1, scene: object, **words: object) -> object:
        given.update(words, scene=scene)
        words["progress"](1, 1)
        return expose(self, PointSources((0, 0, 0)), sensor=words["sensor"])

    monkeypatch.setattr(Plenoptic1, "expose", spy)
    tables = SLIDE + MASK + "rtol = 0.2\nkoehler = false\n[sensor]\nexposure_electrons = 50.0\n"
    result, _ = simulated(small, tables, device, "--checkpoint", small.parent / "c")
    assert result.exit_code == 0, result.output
    (slide,) = given["scene"]
    assert slide.mode == "transmission"
    assert given["coherence"] == Coherence(RandomPhaseMask((50e-6, 50e-6)), seed=5)
    assert given["sensor"].exposure == 50
    assert (given["koehler"], given["snapshots"], given["rtol"]) == (False, 4, 0.2)
    assert given["checkpoint"][0] == small.parent / "c"


@pytest.mark.thorough
def test_simulate_goes_on_after_an_interrupt(
    small: Path, device: Device, monkeypatch: pytest.MonkeyPatch
):
    result, raw = simulated(small, SLIDE + MASK, device)
    assert result.exit_code == 0, result.output
    assert "4 snapshots" in result.stdout
    whole = tifffile.imread(raw)
    shutil.rmtree(raw.parent)

    def interrupt(_: object, done: int, total: int) -> None:
        assert total == 4
        if done == 3:
            raise KeyboardInterrupt

    counted, field = [], RandomPhaseMask.field

    def count(self: RandomPhaseMask, *words: object, index: int, **more: object) -> object:
        counted.append(index)
        return field(self, *words, index=index, **more)

    checkpoint = small.parent / "reached"
    with monkeypatch.context() as patch:
        patch.setattr(averaging, "SAVE_SECONDS", -1.0)
        patch.setattr(import_module("clplen.cli.simulate"), "update_bar", interrupt)
        result, _ = simulated(small, SLIDE + MASK, device, "--checkpoint", checkpoint)
    assert result.exit_code == 130, result.output
    assert not raw.parent.exists()
    monkeypatch.setattr(RandomPhaseMask, "field", count)
    result, _ = simulated(small, SLIDE + MASK, device, "--checkpoint", checkpoint)
    assert result.exit_code == 0, result.output
    np.testing.assert_array_equal(tifffile.imread(raw), whole)
    assert 1 not in counted  # numbers 0 and 1 were kept; 0 is asked for the grid of the image
    assert counted[-2:] == [2, 3]
    other = MASK.replace("seed = 5", "seed = 6")
    result, _ = simulated(small, SLIDE + other, device, "--checkpoint", checkpoint)
    assert "another configuration: its seed is 5, this run's is 6" in said(result)


@pytest.mark.parametrize("tables", [PICTURE, SLIDE + "[coherence]\n"])
def test_a_checkpoint_needs_snapshots(small: Path, device: Device, tables: str):
    result, _ = simulated(small, tables, device, "--checkpoint", small.parent / "c")
    assert "small.toml does not set it: leave it out, or set spatial" in said(result, 2)


def test_a_checkpoint_that_cannot_be_written(small: Path, device: Device):
    result, raw = simulated(small, SLIDE + MASK, device, "--checkpoint", small.parent / "no" / "c")
    assert "does not exist" in said(result)
    assert "Plenoptic" not in result.stdout  # nothing was begun
    assert not raw.parent.exists()


def test_a_picture_that_is_none(small: Path, device: Device):
    (small.parent / "L.png").write_text("L")
    result, _ = simulated(small, PICTURE, device)
    assert said(result).startswith("Error: scene.pictures.0.file: The picture ")
    assert result.stdout == ""


def test_progress_of_one_part_after_another():
    with tqdm(total=0, file=io.StringIO()) as bar:
        begun = []
        for done, total in ((2, 5), (5, 5), (1, 3), (3, 3)):
            console.update_bar(bar, done, total)
            assert (bar.n, bar.total) == (done, total)
            begun.append(bar.start_t)
    assert begun[0] == begun[1] < begun[2] == begun[3]  # the time left is that of this part


def test_simulate_behind_colour_filters(small: Path, device: Device):
    """raw.tif is a mosaic with its tags, lightfield.h5 has its colours."""
    tables = """points_mm = [[0.1, 0.0, 0.0], [-0.2, 0.1, 3.0]]
[coherence]
lines_nm = [470, 640]
line_powers = [0.2, 0.8]
[camera.pixels]
filters = "GBRG"
[sensor]
exposure_electrons = 1e6
full_well_electrons = 2e4
bit_depth = 12
black_level = 100
"""
    result, raw = simulated(small, tables, device)
    assert result.exit_code == 0, result.output
    assert "2 wavelengths" in result.output
    with tifffile.TiffFile(raw) as file:
        assert bytes(file.pages.first.tags[33422].value) == bytes([1, 2, 0, 1])
        values = file.asarray()
    assert values.dtype == np.uint16
    assert values.min() == 100
    lf = read_lightfield(raw.parent / "lightfield.h5", device=device)
    assert lf.shape[-1] == 3
    red, _, blue = lf.to_numpy().sum(axis=(0, 1, 2, 3))
    assert red > 1.5 * blue > 0
    assert lf.camera == read_camera_file(small).camera.build(device)
    for wrong in ("RGB", "rggb", ""):
        result, _ = simulated(small, tables.replace("GBRG", wrong), device, "--force")
        assert "camera.pixels.filters must be one of 'RGGB'" in said(result)
