"""The camera file: what its example builds, and what is said about a wrong one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from clplen import config
from clplen.compute.device import Device
from clplen.config import EXAMPLE, CameraFile, read_camera_file
from clplen.errors import FormatError


def read(tmp_path: Path, text: str) -> CameraFile:
    path = tmp_path / "camera.toml"
    path.write_text(text, encoding="utf-8")
    return read_camera_file(path)


def test_the_example_is_the_camera_of_the_demo(tmp_path: Path, device: Device):
    file = read(tmp_path, EXAMPLE)
    camera = file.camera.build(device)
    assert camera.aperture_diameter == pytest.approx(3.6e-3, rel=1e-9)
    assert camera.grid.shape == (3030, 3030)
    assert camera.wavelength == pytest.approx(532e-9, rel=1e-12)
    scene = file.scene.build()
    expected = [[-3e-3, -3e-3, -50e-3], [0, 0, 0], [3e-3, 3e-3, 50e-3]]
    np.testing.assert_allclose(scene.positions, expected, rtol=1e-12)
    assert scene.diameter == pytest.approx(10e-6)
    assert file.sensor is not None
    assert file.sensor.build().exposure is None


def test_the_example_shows_every_key_and_its_default():
    """Every commented line, taken in, is valid, and no key is left out."""
    shown = [line.lstrip("# ").split(" = ")[0] for line in EXAMPLE.splitlines() if " = " in line]
    tables = config._TABLES.values()
    known = [name for table in tables for name in table.model_fields if name != "microlenses"]
    assert sorted(shown) == sorted(known)


def test_every_key_reaches_the_camera(tmp_path: Path, device: Device):
    file = read(tmp_path, """
        [camera]
        focal_length_mm = 100.0
        wavelength_nm = 633
        pixels_per_lenslet = 28.5
        object_distance_mm = 300
        image_distance_mm = 150
        aperture_diameter_mm = 2
        field_lens = true
        [camera.microlenses]
        pitch_um = 140
        focal_length_mm = 9
        count = [31, 33]
        lattice = "hexagonal"
        fill = "circular"
        diameter_um = 120
        offset_um = [3, -2]
        rotation_deg = -7
        [scene]
        points_mm = [[0.1, 0.2, 3.0], [0, 0, 0]]
        power = [2.0, 0.5]
        [sensor]
        exposure_electrons = 1e5
        shot_noise = true
        read_noise_electrons = 2.5
        full_well_electrons = 4095
        bit_depth = 12
        seed = 7
    """)
    camera = file.camera.build(device)
    assert (camera.object_distance, camera.image_distance) == pytest.approx((0.3, 0.15))
    assert camera.aperture_diameter == pytest.approx(2e-3)
    assert camera.pixels_per_lenslet == 28.5
    assert camera.field_lens
    array = camera.mla
    assert (array.lattice, array.fill, array.count) == ("hexagonal", "circular", (31, 33))
    assert array.offset == pytest.approx((3e-6, -2e-6))
    assert array.diameter == pytest.approx(120e-6)
    assert array.rotation == pytest.approx(math.radians(-7))
    np.testing.assert_array_equal(file.scene.build().power, [2.0, 0.5])
    sensor = file.sensor.build()
    assert (sensor.exposure, sensor.shot_noise, sensor.read_noise) == (1e5, True, 2.5)
    assert (sensor.full_well, sensor.bit_depth, sensor.seed) == (4095, 12, 7)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("focal_length_mm = 120.0", "focal_lenght_mm = 120.0",
         r"unknown key camera\.focal_lenght_mm; did you mean focal_length_mm\?"),
        ("pitch_um = 150.0", "pitch = 150.0",
         r"unknown key camera\.microlenses\.pitch; did you mean pitch_um\?"),
        ("[sensor]", "[sensr]", r"unknown key sensr; did you mean sensor\?"),
        ("[sensor]", "[sensor]\nzebra = 1",
         "unknown key sensor.zebra; known here are exposure_electrons, shot_noise"),
        ("wavelength_nm = 532.0", "", r"camera\.wavelength_nm is missing"),
        ("pitch_um = 150.0", "pitch_um = -1",
         r"pitch_um must be greater than 0 \(found -1\)"),
        ("wavelength_nm = 532.0", "wavelength_nm = 'green'",
         r"wavelength_nm must be a valid number \(found 'green'\)"),
        ("wavelength_nm = 532.0", "wavelength_nm = inf",
         r"wavelength_nm must be a finite number \(found inf\)"),
        ("count = 101", "count = 0",
         r"microlenses\.count must be greater than or equal to 1 \(found 0\)\.$"),
        ('fill = "full"', 'fill = "half"', r"fill must be 'circular' or 'full' \(found 'half'\)"),
        ("[0.0, 0.0, 0.0]", "[0.0, 0.0]",
         r"points_mm\.1 must be three numbers, \[x, y, dz\] \(found \[0\.0, 0\.0\]\)\.$"),
        ("count = 101", "count = 101.5", r"count must be a valid integer \(found 101\.5\)\.$"),
        ("count = 101", "count = [3, 3, 3]",
         r"count must be one number or \[rows, columns\] \(found \[3, 3, 3\]\)\.$"),
        ("# offset_um = [0.0, 0.0]", "offset_um = [1.0]",
         r"offset_um must be two numbers, \[y, x\] \(found \[1\.0\]\)\.$"),
        ("[0.0, 0.0, 0.0]", "[0.0, 'a', 0.0]",
         r"points_mm\.1 must be a valid number \(found 'a'\)"),
        ("pitch_um = 150.0", 'pitch_um = "150"',
         r"pitch_um must be a valid number \(found '150'\)"),
        ("# field_lens = false", "field_lens = 1",
         r"field_lens must be a valid boolean \(found 1\)"),
        ("[camera]", "[camera", r"camera\.toml is not TOML"),
    ],
)
def test_what_is_said_about_a_wrong_file(tmp_path: Path, old: str, new: str, said: str):
    assert old in EXAMPLE
    with pytest.raises(FormatError, match=said) as caught:
        read(tmp_path, EXAMPLE.replace(old, new, 1))
    assert "camera.toml" in str(caught.value)
    assert "pydantic" not in str(caught.value)


def test_a_length_keeps_its_digits(tmp_path: Path):
    text = EXAMPLE.replace("# diameter_um = 150.0", "diameter_um = 200")
    with pytest.raises(ValueError, match=r"0\.0002[^0-9]"):
        read(tmp_path, text).camera.microlenses.build()


def test_no_such_file(tmp_path: Path):
    with pytest.raises(FormatError, match=r"no camera file .*--example"):
        read_camera_file(tmp_path / "camera.toml")
