"""The camera file: what its example builds, and what is said about a wrong one."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from datetime import date, time
from itertools import cycle
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from pydantic import BaseModel

import clplen
from clplen.batch import Job
from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.camera_aberrations import LensletScatter
from clplen.cameras.optics.objective import CoverGlass
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.config import tables as config_tables
from clplen.config.camera import KEYS as CAMERA_KEYS
from clplen.config.camera import (
    AberrationsTable,
    CameraTable,
    MicrolensTable,
    PixelsTable,
    SensorTable,
)
from clplen.config.camera_file import CameraFile, read_camera_file
from clplen.config.example import EXAMPLE
from clplen.config.fourier_microscope import FourierCameraFile
from clplen.config.kinds import refuse_fourier, refuse_lfanalyze, require_fourier
from clplen.config.microscope import LFAnalyzeTable, read_microscope_file
from clplen.config.scene import KEYS, SPECTRA, CoherenceTable, PictureTable, SceneTable
from clplen.config.tables import Table, read_toml
from clplen.errors import FormatError
from clplen.io.store.attributes import CAMERA_NAMES, camera_attributes, read_camera
from clplen.lightfield.raw.raw_image import Sensor
from clplen.wave.coherence import averaging, coherence
from clplen.wave.coherence.extended_source import ExtendedSource
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.coherence.spatial_models import IncoherentLight
from clplen.wave.spectrum.spectral_distribution import SpectralDistribution
from clplen.wave.spectrum.spectrum import Spectrum

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


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
    (scene,) = file.scene.build()
    assert isinstance(scene, PointSources)
    expected = [[-3e-3, -3e-3, -50e-3], [0, 0, 0], [3e-3, 3e-3, 50e-3]]
    np.testing.assert_allclose(scene.positions, expected, rtol=1e-12)
    assert scene.diameter == pytest.approx(10e-6)
    assert file.sensor is not None
    assert file.sensor.build().exposure is None


TABLES: dict[str, type[Table]] = {
    "camera": CameraTable,
    "microlenses": MicrolensTable,
    "pixels": PixelsTable,
    "aberrations": AberrationsTable,
    "scene": SceneTable,
    "pictures": PictureTable,
    "coherence": CoherenceTable,
    "sensor": SensorTable,
}
NO_DEFAULT = "default:", "required"  # what comments of such keys say


def shown(line: str) -> tuple[str, str]:
    """Key and value of a line of the example."""
    key, _, value = line.lstrip("# ").partition(" = ")
    return key, value.partition(" #")[0].strip()


def test_the_example_shows_every_key_and_its_default(tmp_path: Path, device: Device):
    """What is commented out, taken in, changes nothing, unless its comment says otherwise."""
    lines = [line for line in EXAMPLE.splitlines() if " = " in line]
    known = [name for table in TABLES.values() for name in table.model_fields]
    inner = ("microlenses", "pixels", "aberrations", "pictures")
    known = [name for name in known if name not in inner]
    assert sorted(shown(line)[0] for line in lines) == sorted(known)
    camera = read(tmp_path, EXAMPLE).camera.build(device)
    effective = {
        "image_distance_mm": 1e3 * camera.image_distance,
        "wavelengths": coherence.DEFAULT_WAVELENGTHS,
        "snapshots": averaging.DEFAULT_SNAPSHOTS,
        "power": [1.0],
    }
    table, found = "", []
    for line in EXAMPLE.splitlines():
        if header := re.match(r"#? ?\[+([\w.]+)\]", line):
            table = header[1].split(".")[-1]
        elif " = " in line and line.startswith("# ") and not any(n in line for n in NO_DEFAULT):
            key, value = shown(line)
            fields = TABLES[table].model_fields
            default = effective.get(key, fields[key].default)
            says = tomllib.loads(f"value = {value}")["value"]
            assert np.array_equal(np.atleast_1d(says), np.atleast_1d(default)), key
            found.append(key)
    assert len(found) == 35, found


def test_pixels_by_their_pitch(tmp_path: Path, device: Device) -> None:
    pixels = """
[camera.pixels]
pitch_um = 2.5
fill_factor = 0.5
shape = [401, 501]
offset_um = [10.0, -20.0]
rotation_deg = 1.0
crosstalk = [[0.0, 0.1, 0.8]]

[scene]"""
    text = EXAMPLE.replace("pixels_per_lenslet = 30 ", "# ").replace("\n[scene]", pixels)
    text = text.replace('# lens_model = "auto"', 'lens_model = "corrected"')
    camera = read(tmp_path, text).camera.build(device)
    assert camera.pixels_per_lenslet == pytest.approx(60)
    assert camera.lens_model == "corrected"
    assert camera.grid.shape == (401, 501)
    assert camera.grid.origin == pytest.approx((10e-6, -20e-6))
    assert camera.mla.rotation == pytest.approx(-math.radians(1))
    assert camera.pixels.active == pytest.approx(math.sqrt(0.5))
    assert camera.pixels.crosstalk == ((0.0, 0.1, 0.8),)
    with pytest.raises(FormatError, match="pixels_per_lenslet"):
        read(tmp_path, text.replace("pitch_um = 2.5", "# "))


def test_pictures_with_opacity(tmp_path: Path) -> None:
    table = """[[scene.pictures]]
file = "picture.png"
width_mm = 3.0
z_mm = -2.0
opacity_file = "opacity.png"
"""
    imageio.imwrite(tmp_path / "picture.png", np.full((2, 3), 200, np.uint8))
    values = np.array([[0, 51, 255], [255, 0, 102]], np.uint8)
    imageio.imwrite(tmp_path / "opacity.png", values)
    text = EXAMPLE.replace("# [coherence]", table + "# [coherence]")
    _, picture = read(tmp_path, text).scene.build()
    assert picture.occluder.z == picture.z == -2e-3
    np.testing.assert_allclose(picture.occluder.opacity, values / 255)
    imageio.imwrite(tmp_path / "opacity.png", values[:, :2])
    with pytest.raises(FormatError, match=r"picture's shape \(2, 3\), got \(2, 2\)"):
        read(tmp_path, text).scene.build()
    slide = text.replace("z_mm = -2.0", 'mode = "transmission"')
    with pytest.raises(FormatError, match="opacity must be None for a slide"):
        read(tmp_path, slide + "[coherence]\n").scene.build()


def test_what_the_example_has_in_comments_is_valid(tmp_path: Path):
    """All at once, but for keys that exclude each other."""
    imageio.imwrite(tmp_path / "picture.png", np.full((2, 3), 200, np.uint8))
    (tmp_path / "lamp.csv").write_text("500, 1\n550, 2\n")
    kinds = {"mask": RandomPhaseMask, "source": ExtendedSource, "incoherent": IncoherentLight}
    for spectrum, spatial in zip(SPECTRA, cycle(kinds), strict=False):
        other = {key for name, keys in KEYS.items() if name != spatial for key in keys}
        other |= {key for key in SPECTRA if key != spectrum}
        other |= set(CAMERA_KEYS["plenoptic2"]) | set(CAMERA_KEYS["microscope"])
        other |= {"wavelengths"} if spectrum == "lines_nm" else {"line_powers"}
        other |= {"opacity_file"}  # slides have none
        taken = "\n".join(
            line.removeprefix("# ") if " = " in line or "# [" in line else line
            for line in EXAMPLE.splitlines()
            if shown(line)[0] not in other
        ).replace('spatial = "coherent"', f'spatial = "{spatial}"')
        file = read(tmp_path, taken.replace('mode = "emission"', 'mode = "transmission"'))
        assert len(file.scene.build()) == 2
        light = file.light()
        assert light is not None
        assert type(light.spatial) is kinds[spatial]
        if spatial == "source":
            assert (light.spatial.size, light.spatial.distance) == (1e-3, 0.1)
        assert light.spectrum is not None
        assert file.coherence.snapshots == 100


def test_every_key_reaches_the_camera(tmp_path: Path, device: Device):
    (tmp_path / "there").mkdir()
    slide = np.array([[0.5, 0.25, 0], [0, 0, 1]], np.float32)
    tifffile.imwrite(tmp_path / "there" / "slide.tif", slide)
    imageio.imwrite(tmp_path / "lamp.png", np.array([[0, 255], [10, 188], [0, 0]], np.uint8))
    file = read(
        tmp_path,
        """
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
        [[scene.pictures]]
        file = "there/slide.tif"
        width_mm = 2.5
        z_mm = -4
        mode = "transmission"
        [[scene.pictures]]
        file = "lamp.png"
        width_mm = 3
        srgb = true
        [coherence]
        spatial = "mask"
        cell_um = [30, 40]
        kernel = "gaussian"
        kind = "phase"
        fwhm_nm = 20
        wavelengths = 5
        seed = 11
        snapshots = 7
        rtol = 0.02
        koehler = false
        [sensor]
        exposure_electrons = 1e5
        shot_noise = true
        read_noise_electrons = 2.5
        full_well_electrons = 4095
        bit_depth = 12
        seed = 7
    """,
    )
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
    points, first, second = file.scene.build()
    np.testing.assert_array_equal(points.power, [2.0, 0.5])
    np.testing.assert_array_equal(first.image, slide)
    assert (first.width, first.z, first.mode) == (2.5e-3, -4e-3, "transmission")
    # sRGB: 10 is below the knee, 10/255/12.92; ((188/255 + .055)/1.055)^2.4
    np.testing.assert_allclose(second.image, [[0, 1], [0.00303527, 0.50288646], [0, 0]], rtol=1e-5)
    assert (second.width, second.z, second.mode) == (3e-3, 0.0, "emission")
    light, table = file.light(), file.coherence
    assert light.spatial == RandomPhaseMask((30e-6, 40e-6), kernel="gaussian", kind="phase")
    assert light.spectrum == Spectrum.gaussian(633e-9, 20e-9)
    assert (light.wavelengths, light.seed) == (5, 11)
    assert (table.snapshots, table.rtol, table.koehler) == (7, 0.02, False)
    sensor = file.sensor.build()
    assert (sensor.exposure, sensor.shot_noise, sensor.read_noise) == (1e5, True, 2.5)
    assert (sensor.full_well, sensor.bit_depth, sensor.seed) == (4095, 12, 7)


def test_what_is_said_about_a_wrong_file(tmp_path: Path):
    for old, new, said in (
        (
            "focal_length_mm = 120.0",
            "focal_lenght_mm = 120.0",
            r"unknown key camera\.focal_lenght_mm; did you mean focal_length_mm\?",
        ),
        (
            "[sensor]",
            "[sensor]\nzebra = 1",
            "unknown key sensor.zebra; the keys are exposure_electrons, shot_noise",
        ),
        ("wavelength_nm = 532.0", "", r"camera\.wavelength_nm is missing"),
        ("pitch_um = 150.0", "pitch_um = -1", r"pitch_um must be a positive number, got -1"),
        (
            "wavelength_nm = 532.0",
            "wavelength_nm = 'green'",
            r"wavelength_nm must be a number, got 'green'",
        ),
        (
            "wavelength_nm = 532.0",
            "wavelength_nm = inf",
            r"wavelength_nm must be a finite number, got inf",
        ),
        (
            "count = 101",
            "count = 0",
            r"microlenses\.count must be 1 or more, got 0\.$",
        ),
        ('fill = "square"', 'fill = "half"', r"fill must be 'circular', 'square' or 'full'"),
        ('fill = "square"', 'fill = "square"\nlattice = "hexagonal"', "cells are hexagons"),
        (
            "[0.0, 0.0, 0.0]",
            "[0.0, 0.0]",
            r"points_mm\.1 must be three numbers, \[x, y, z\], got \[0\.0, 0\.0\]\.$",
        ),
        ("count = 101", "count = 101.5", r"count must be a whole number, got 101\.5\.$"),
        (
            "pitch_um = 150.0",
            'pitch_um = "150"',
            r"pitch_um must be a number, got '150'",
        ),
        ("[camera]", "[camera", r"camera\.toml is not TOML"),
        ("[sensor]", "[coherance]\n[sensor]", r"unknown key coherance; did you mean coherence\?"),
    ):
        assert old in EXAMPLE
        with pytest.raises(FormatError, match=said) as caught:
            read(tmp_path, EXAMPLE.replace(old, new, 1))
        assert "camera.toml" in str(caught.value)
        assert "pydantic" not in str(caught.value)


WRONG = (["x"], [], [[1]], [{"a": 1}], {"a": 1}, {}, True, "x" * 500, date(2026, 1, 2), time(3, 4))


def keys_of(model: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every key of a file, behind those of the tables that it is in."""
    for key, field in model.model_fields.items():
        yield (*above, key)
        table = config_tables.model_in(field.annotation)
        if table is not None:
            yield from keys_of(table, (*above, key))


def test_every_key_of_another_type_is_one_sentence(tmp_path: Path):
    for model in (CameraFile, FourierCameraFile, LFAnalyzeTable, Job):
        for *above, key in keys_of(model):
            for value in WRONG:
                content = {key: value}
                for table in reversed(above):
                    content = {table: content}
                with pytest.raises(FormatError, match=r"^job\.toml: .*[^.][.?]$") as caught:
                    config_tables.validated(model, content, Path("job.toml"))
                said = str(caught.value)
                assert not re.search(r"pydantic|instance of|valid |Input should|item", said), said
                assert len(re.sub(r"unknown key [^;]*; the keys are [^;]*", "", said)) < 800, said


def test_a_kind_that_is_no_word():
    for value in WRONG:
        content = {"camera": {"kind": value}}
        require_fourier(content, Path("camera.toml"))  # what reads the table refuses it
        refuse_fourier(content, Path("camera.toml"))


def test_a_camera_file_with_the_names_of_lfanalyze() -> None:
    with pytest.raises(FormatError, match="names of LFAnalyze, but a camera file is expected: use"):
        refuse_lfanalyze({"magnification": 20.0, "ulens_pitch": 100.0}, Path("scope.toml"))
    refuse_lfanalyze({"camera": {}, "ulens_pitch": 100.0}, Path("camera.toml"))


FOCUSED = """
    [camera]
    kind = "plenoptic2"
    focal_length_mm = 120
    wavelength_nm = 532
    pixels_per_lenslet = 20
    a_mm = -30
    match = "cone"
    [camera.microlenses]
    pitch_um = 150
    focal_length_mm = [10, 11.5, 9]
    count = [41, 43]
    lattice = "hexagonal"
    [scene]
    points_mm = [[0.1, 0.2, 3.0]]
"""


def test_every_key_reaches_a_focused_camera(tmp_path: Path, device: Device):
    camera = read(tmp_path, FOCUSED).camera.build(device)
    assert isinstance(camera, Plenoptic2)
    assert camera.m == pytest.approx(-0.25)
    assert (camera.a, camera.b) == pytest.approx((-30e-3, 7.5e-3))
    assert camera.mla.focal_lengths == (10e-3, 11.5e-3, 9e-3)
    assert camera.aperture_diameter == pytest.approx(150e-6 * 240 / 7.5)
    by_m = read(tmp_path, FOCUSED.replace("a_mm = -30", "m = -0.25")).camera.build(device)
    assert by_m.a == pytest.approx(camera.a)


def test_what_is_said_about_a_wrong_focused_camera(tmp_path: Path):
    for old, new, said in (
        ("a_mm = -30", "", "camera needs either m or a_mm .* has neither"),
        ("a_mm = -30", "a_mm = -30\n m = -0.25", "needs either m or a_mm .* has both"),
        ('match = "cone"', "field_lens = true", "has field_lens, which applies to kind = .*1'"),
        ('kind = "plenoptic2"', "", "has a_mm, which applies to kind = 'plenoptic2'"),
        (
            'kind = "plenoptic2"\n    focal_length_mm = 120\n    wavelength_nm = 532\n'
            '    pixels_per_lenslet = 20\n    a_mm = -30\n    match = "cone"',
            "focal_length_mm = 120\n    wavelength_nm = 532\n    pixels_per_lenslet = 20",
            "several focal lengths, which need kind = 'plenoptic2'",
        ),
        ("[10, 11.5, 9]", "[]", r"focal_length_mm must have 1 or more values"),
    ):
        assert old in FOCUSED
        with pytest.raises(FormatError, match=said):
            read(tmp_path, FOCUSED.replace(old, new, 1))


REAL = """
    [camera]
    focal_length_mm = 12
    object_distance_mm = 900
    aperture_diameter_mm = 3
    wavelength_nm = 520
    lens_model = "corrected"
    [camera.microlenses]
    pitch_um = 20
    focal_length_mm = 0.08
    count = [13, 17]
    lattice = "hexagonal"
    offset_um = [2, -3]
    rotation_deg = 1
    [camera.pixels]
    pitch_um = 1.4
    shape = [181, 201]
    fill_factor = 0.6
    offset_um = [7, -5]
    rotation_deg = 0.3
    crosstalk = [[0, 0.01, 0], [0.03, 0.9, 0.02], [0, 0.04, 0]]
    [scene]
    points_mm = [[0.1, 0.2, 30.0]]
"""


def test_every_key_reaches_the_pixels(tmp_path: Path, device: Device):
    camera = read(tmp_path, REAL).camera.build(device)
    pixels = camera.pixels
    assert pixels is not None
    assert (pixels.pitch, pixels.shape, pixels.fill_factor) == (1.4e-6, (181, 201), 0.6)
    assert pixels.offset == pytest.approx((7e-6, -5e-6), rel=1e-12)
    assert pixels.rotation == pytest.approx(math.radians(0.3), rel=1e-12)
    assert pixels.crosstalk == ((0, 0.01, 0), (0.03, 0.9, 0.02), (0, 0.04, 0))
    assert camera.lens_model == "corrected"
    assert camera.grid.shape == (181, 201)
    assert camera.pixels_per_lenslet == pytest.approx(20 / 1.4, rel=1e-12)
    assert camera.mla.rotation == pytest.approx(math.radians(0.7), rel=1e-12)
    both = REAL.replace("wavelength_nm", "pixels_per_lenslet = 14.2857143\n    wavelength_nm")
    assert read(tmp_path, both).camera.build(device).grid == camera.grid


def test_filters_and_light_of_a_camera_file(tmp_path: Path, device: Device) -> None:
    for name, tile in (
        ("GBRG", (("G", "B"), ("R", "G"))),
        ("quad BGGR", (("B", "B", "G", "G"),) * 2 + (("G", "G", "R", "R"),) * 2),
        ("monochrome", (("L",),)),
    ):
        text = EXAMPLE.replace("# [camera.pixels]  ", "[camera.pixels]  ")
        text = text.replace('# filters = "RGGB"', f'filters = "{name}"')
        text = text.replace("# [coherence]", "[coherence]").replace("# spectrum =", "spectrum =")
        file = read(tmp_path, text.replace('"white-led"', '"D65"'))
        assert file.camera.build(device).pixels.filters.tile == tile
        light = file.light()
        assert light is not None
        assert light.spectrum == SpectralDistribution.illuminant("D65").spectrum
        with pytest.raises(
            FormatError, match=r"camera.pixels.filters must be one of 'RGGB', 'GRBG'"
        ):
            read(tmp_path, text.replace(f'"{name}"', '"RGB"'))


def test_every_key_reaches_the_sensor(tmp_path: Path) -> None:
    keys = """exposure_electrons = 3e4
full_well_electrons = 9000.0
bit_depth = 10
prnu = 0.02
dark_current_electrons_per_s = 4.0
exposure_time_s = 0.5
black_level = 32.0
white_level = 1000.0
gain = { R = 2.0, B = 1.5 }
"""
    head, _, _ = EXAMPLE.partition("[sensor]")
    table = read(tmp_path, f"{head}[sensor]\n{keys}").sensor
    assert table is not None
    assert table.build() == Sensor(
        3e4, full_well=9000, bit_depth=10, prnu=0.02, dark_current=4, exposure_time=0.5,
        black_level=32, white_level=1000, gain={"R": 2.0, "B": 1.5},
    )  # fmt: skip
    for old, new, said in (
        ("prnu = 0.02", "prnu = 2.0", "sensor.prnu"),
        ("black_level = 32.0", "black_level = -1.0", "sensor.black_level"),
        ("gain = { R = 2.0, B = 1.5 }", "gain = { R = -2.0 }", "sensor.gain .* a table such"),
    ):
        with pytest.raises(FormatError, match=said):
            read(tmp_path, f"{head}[sensor]\n{keys.replace(old, new)}")


def test_pixels_are_kept_with_a_camera(tmp_path: Path, device: Device):
    camera = read(tmp_path, REAL).camera.build(device)
    kept = camera_attributes(camera)
    assert kept is not None
    assert set(kept) <= set(CAMERA_NAMES)
    assert kept["mla_rotation"] == pytest.approx(math.radians(1))
    again = read_camera(kept, tmp_path, device)
    assert again.pixels == camera.pixels
    assert again.lens_model == camera.lens_model
    assert again.grid == camera.grid
    np.testing.assert_allclose(again.mla.centres(), camera.mla.centres(), atol=1e-15)
    with pytest.raises(FormatError, match=r"PixelArray\.to_json"):
        read_camera(kept | {"pixels": "[1]"}, tmp_path, device)
    with pytest.raises(FormatError, match="lens_model must be"):
        read_camera(kept | {"lens_model": "thick"}, tmp_path, device)


def test_what_is_said_about_wrong_pixels(tmp_path: Path):
    for old, new, said in (
        ("pitch_um = 1.4", "pitch = 1.4", r"camera\.pixels\.pitch; did you mean pitch_um\?"),
        ("    pitch_um = 1.4", "", "camera needs pixels_per_lenslet or pixels.pitch_um"),
        ("shape = [181, 201]", "shape = 181", r"shape must be \[rows, columns\], got 181"),
        ("shape = [181, 201]", "shape = [0, 3]", r"shape\S* must be 1 or more"),
        ("offset_um = [7, -5]", "offset_um = 7", r"pixels\.offset_um must be two numbers"),
        ("[[0, 0.01, 0], [0.03,", "[[0, 0.01], [0.03,", "crosstalk must be an odd number of rows"),
        ("[0.03, 0.9,", "[0.03, 0.95,", "crosstalk must be non-negative fractions with a sum"),
        ("[0.03, 0.9,", "[-0.03, 0.9,", "crosstalk must be non-negative"),
        ('"corrected"', '"thick"', "lens_model must be 'auto', 'thin' or 'corrected'"),
        (
            "wavelength_nm",
            "pixels_per_lenslet = 15\n    wavelength_nm",
            r"has pixels_per_lenslet = 15, but pixels\.pitch_um = 1\.4 gives 14\.2857 for "
            r"lenslets of 20 um: leave one out",
        ),
    ):
        assert old in REAL
        with pytest.raises(FormatError, match=said):
            read(tmp_path, REAL.replace(old, new, 1))


POINTS = EXAMPLE[EXAMPLE.index("points_mm") : EXAMPLE.index("# [[scene.pictures]]")]
PICTURE = '[[scene.pictures]]\nfile = "a.png"\nwidth_mm = 2.0\n'
SLIDE = PICTURE + 'mode = "transmission"\n'
LIT = SLIDE + "[coherence]\n"


def test_what_is_said_about_wrong_pictures_and_light(tmp_path: Path):
    for tables, said in (
        ("", r"scene is empty: give points_mm or \[\[scene\.pictures\]\]\.$"),
        (
            "power = 2.0\n" + PICTURE,
            r"scene has power, which needs points_mm\.$",
        ),
        (
            PICTURE.replace("width_mm", "wdith_mm"),
            r"scene\.pictures\.0\.width_mm is missing; "
            r"unknown key scene\.pictures\.0\.wdith_mm; did you mean width_mm\?",
        ),
        (
            PICTURE + PICTURE.replace("a.png", "none.png"),
            r"scene\.pictures\.1\.file must be an existing file, but .*/none\.png does not exist"
            r", got 'none\.png'\.$",
        ),
        (PICTURE + 'mode = "film"', r"mode must be 'emission' or 'transmission', got 'film'"),
        (
            PICTURE + SLIDE,
            r"toml: scene\.pictures\.1 is a slide \(mode = 'transmission'\) without "
            r"light: add a table \[coherence\]\.$",
        ),
        (
            PICTURE + '[coherence]\nspatial = "incoherent"',
            r"toml: coherence\.spatial applies to slides, but the scene has none: set mode",
        ),
        (LIT + 'spatial = "mask"', r"coherence needs cell_um for spatial = 'mask'\.$"),
        (
            LIT + 'spatial = "source"\nsource_size_mm = 1',
            r"coherence needs source_distance_mm for spatial = 'source'\.$",
        ),
        (LIT + 'spatial = "lamp"', r"coherence\.spatial must be 'coherent', .*, got 'lamp'"),
        (PICTURE + "[coherence]\nkoehler = true", r"coherence\.koehler applies to slides"),
        (LIT + 'spatial = "source"\nkind = "phase"', "coherence has kind, which applies to spat"),
        (LIT + "wavelengths = 9\nlines_nm = 500", r"coherence has wavelengths, which needs"),
        (LIT + "rtol = 0.1", r"coherence has rtol, but all snapshots of a plane wave are equal"),
        (
            LIT + 'fwhm_nm = 20\nspectrum = "mercury"',
            r"coherence has spectrum and fwhm_nm, but needs a single spectrum\.$",
        ),
        (LIT + "wavelengths = 9", r"coherence has wavelengths, which needs fwhm_nm, spec"),
        (
            LIT + "lines_nm = [500, 600]\nline_powers = 1",
            r"coherence must have as many line_powers as lines_nm, 2, got 1\.$",
        ),
    ):
        imageio.imwrite(tmp_path / "a.png", np.full((2, 2), 9, np.uint8))
        with pytest.raises(FormatError, match=said) as caught:
            read(tmp_path, EXAMPLE.replace(POINTS, tables))
        assert "pydantic" not in str(caught.value)


def test_what_is_said_about_an_odd_picture(tmp_path: Path):
    for values, keys, said in (
        (np.ones((3, 4), np.uint16), "srgb = true", r"a\.tif: srgb = true needs 8-bit values, "),
        (np.float32([[0.2, 3.0]]), 'mode = "transmission"', r"a\.tif: .* transmit at most 1"),
        (np.ones((3, 4), np.complex64), "", r"a\.tif must have real samples, got complex64"),
    ):
        if values is None:
            (tmp_path / "a.tif").write_text("no picture")
        else:
            tifffile.imwrite(tmp_path / "a.tif", values)
        second = PICTURE.replace("a.png", "a.tif") + keys
        imageio.imwrite(tmp_path / "a.png", np.full((2, 2), 9, np.uint8))
        text = EXAMPLE.replace(POINTS, PICTURE + second + "\n[coherence]\n")
        with pytest.raises(FormatError, match=r"^scene\.pictures\.1\.file: .*" + said):
            read(tmp_path, text).scene.build()


def test_what_is_said_about_an_odd_spectrum(tmp_path: Path):
    for keys, said in (
        ("fwhm_nm = 300", r"^coherence\.fwhm_nm: The FWHM must be positive and below half"),
        ('spectrum_file = "a.png"', r"^coherence\.spectrum_file: .*a\.png is not a text file"),
        ("lines_nm = [5e8, 3]", r"^coherence\.lines_nm: 0\.5 m is not a wavelength of light"),
        ("lines_nm = [500, 501]\nline_powers = [0, 0]", r"^coherence\.lines_nm: powers must be"),
    ):
        imageio.imwrite(tmp_path / "a.png", np.full((2, 2), 9, np.uint8))
        file = read(tmp_path, EXAMPLE.replace(POINTS, LIT + keys))
        with pytest.raises(FormatError, match=said):
            file.light()


COLOURS = np.array([[[0, 51, 102], [255, 255, 255], [255, 0, 0]]], np.uint8)


def test_values_become_grey_linear_light(tmp_path: Path):
    for values, srgb, expected in (
        (np.array([[0, 51, 255]], np.uint8), False, [[0, 0.2, 1]]),
        (np.array([[0, 13107, 65535]], np.uint16), False, [[0, 0.2, 1]]),
        (np.array([[0, 1, 1]], np.uint8), False, [[0, 1, 1]]),
        (np.array([[0.5, 0, 0.75]], np.float32), False, [[0.5, 0, 0.75]]),
        (COLOURS, False, [[0.7152 * 0.2 + 0.0722 * 0.4, 1, 0.2126]]),
        (COLOURS, True, [[0.7152 * 0.0331048 + 0.0722 * 0.1328683, 1, 0.2126]]),
    ):
        tifffile.imwrite(tmp_path / "a.tif", values)
        keys = f"mode = 'transmission'\nsrgb = {str(srgb).lower()}\n[coherence]"
        text = EXAMPLE.replace(POINTS, PICTURE.replace("a.png", "a.tif") + keys)
        (plane,) = read(tmp_path, text).scene.build()
        np.testing.assert_allclose(plane.image, expected, rtol=1e-5)
        assert plane.image.max() <= 1


def test_lines_and_a_table_without_slides(tmp_path: Path):
    """A spectrum is that of points, too."""
    with_lines = EXAMPLE.replace("[sensor]", "[coherence]\nlines_nm = [500, 600]\n[sensor]")
    light = read(tmp_path, with_lines).light()
    assert light.spatial is None
    np.testing.assert_allclose(sorted(light.lines(532e-9)), [(500e-9, 0.5), (600e-9, 0.5)])
    powers = with_lines.replace("600]", "600]\nline_powers = [3, 1]")
    light = read(tmp_path, powers).light()
    np.testing.assert_allclose(sorted(light.lines(532e-9)), [(500e-9, 0.75), (600e-9, 0.25)])
    assert read(tmp_path, EXAMPLE).light() is None


def test_a_length_keeps_its_digits(tmp_path: Path):
    text = EXAMPLE.replace("# diameter_um = 150.0", "diameter_um = 200")
    with pytest.raises(ValueError, match=r"0\.0002[^0-9]"):
        read(tmp_path, text).camera.microlenses.build()


def test_no_such_file(tmp_path: Path):
    with pytest.raises(FormatError, match=r"no camera file .*--example"):
        read_camera_file(tmp_path / "camera.toml")


def test_aberrations_of_a_camera(tmp_path: Path, device: Device):
    """Waves are of wavelength_nm; the camera carries what the table says."""
    table = """
        [camera.aberrations]
        main_lens_waves = { 6 = 0.1, 8 = -0.05 }
        main_lens_field_waves_per_mm = { 7 = [0.2, 0.1] }
        lenslets_waves = { 11 = 0.02 }
        lenslet_circle_um = 213
        focal_length_scatter = 0.01
        tilt_scatter_mrad = 0.2
        position_scatter_um = 0.5
        scatter_seed = 3
        sensor_shift_um = -20
        sensor_tilt_mrad = [10, -20]
        """
    camera = read(tmp_path, EXAMPLE + table).camera.build(device)
    found, wave = camera.aberrations, 532e-9
    assert dict(found.main_lens) == pytest.approx({6: 0.1 * wave, 8: -0.05 * wave})
    assert found.main_lens_field[0][1] == pytest.approx((200 * wave, 100 * wave))
    assert dict(found.lenslets) == pytest.approx({11: 0.02 * wave})
    assert found.lenslet_circle == pytest.approx(213e-6)
    assert found.scatter == LensletScatter(0.01, 0.2e-3, 0.5e-6, 3)
    assert camera.sensor_distance == pytest.approx(10e-3 - 20e-6)
    assert found.sensor_tilt == pytest.approx((0.01, -0.02))
    for wrong, said in (
        ("main_lens_waves = { a = 0.1 }", "Noll's indices"),
        ("main_lens_waves = 0.1", "table of Noll's indices"),
        ("main_lens_waves = { 5 = 0.1, 05 = 0.3 }", "repeat an index, has 5, 05"),
        ("sensor_shift_mm = 1", "did you mean sensor_shift_um"),
    ):
        with pytest.raises(FormatError, match=said):
            read(tmp_path, EXAMPLE + "\n[camera.aberrations]\n" + wrong)


MICROSCOPE = """
    [camera]
    kind = "microscope"
    magnification = 60
    na = 1.2
    medium_index = 1.33
    tube_lens_mm = 180
    apodisation = -0.5
    wavelength_nm = 593
    pixels_per_lenslet = 15
    [camera.microlenses]
    pitch_um = 100
    focal_length_mm = 2.5
    count = [5, 7]
    fill = "full"
    [scene]
    points_mm = [[0.001, 0.002, -0.0005]]
"""


def test_every_key_reaches_a_microscope(tmp_path: Path, device: Device):
    file = read(tmp_path, MICROSCOPE)
    camera = file.camera.build(device)
    assert isinstance(camera, Microscope)
    assert (camera.magnification, camera.na, camera.medium_index) == (60, 1.2, 1.33)
    assert camera.focal_length == pytest.approx(3e-3)
    assert camera.apodisation == -0.5
    assert camera.wavelength == pytest.approx(593e-9)
    assert camera.grid.shape == (75, 105)
    (scene,) = file.scene.build()
    assert camera.expose(scene).to_numpy().sum() == pytest.approx(1, abs=0.1)


def test_a_pupil_reaches_a_microscope_and_its_files(tmp_path: Path, device: Device):
    terms = "pupil_nm = { 6 = 30.0, 11 = -40 }"
    camera = read(tmp_path, MICROSCOPE.replace("na = 1.2", f"na = 1.2\n    {terms}")).camera
    microscope = camera.build(device)
    assert isinstance(microscope, Microscope)
    assert microscope.pupil == PupilAberration({6: 30e-9, 11: -40e-9})
    kept = camera_attributes(microscope)
    assert kept is not None
    assert set(kept) <= set(CAMERA_NAMES)
    assert read_camera(kept, tmp_path, device).pupil == microscope.pupil
    for wrong, said in (("{ 1 = 5.0 }", "a piston"), ("{ a = 5.0 }", "Noll's indices")):
        with pytest.raises(FormatError, match=said):
            read(tmp_path, MICROSCOPE.replace("na = 1.2", f"na = 1.2\n    pupil_nm = {wrong}"))


def test_a_cover_glass_reaches_a_microscope_and_its_files(tmp_path: Path, device: Device):
    glass = "cover = { thickness_um = 130, index = 1.51, designed_index = 1.53 }"
    file = read(tmp_path, MICROSCOPE.replace("na = 1.2", f"na = 1.2\n    {glass}"))
    camera = file.camera.build(device)
    assert isinstance(camera, Microscope)
    assert camera.cover == CoverGlass(130e-6, 1.51, 170e-6, 1.53)
    kept = camera_attributes(camera)
    assert kept is not None
    assert set(kept) <= set(CAMERA_NAMES)
    again = read_camera(kept, tmp_path, device)
    assert isinstance(again, Microscope)
    assert again.cover == camera.cover
    with pytest.raises(FormatError, match="has no parameter 'cover_index'"):
        read_camera({name: kept[name] for name in kept if name != "cover_index"}, tmp_path, device)


def test_what_is_said_about_a_wrong_microscope(tmp_path: Path):
    for old, new, said in (
        ("na = 1.2", "", "camera needs na for kind = 'microscope'"),
        ("na = 1.2", "na = 1.2\n m = 0.2", "has m, which applies to kind = 'plenoptic2'"),
        ("na = 1.2", "na = 1.2\n focal_length_mm = 3", "focal_length_mm, which does not apply"),
        ('kind = "microscope"', "", "has magnification, which applies to kind = 'microscope'"),
    ):
        assert old in MICROSCOPE
        with pytest.raises(FormatError, match=said):
            read(tmp_path, MICROSCOPE.replace(old, new, 1))


CAMERAS = Path(__file__).parents[1] / "examples" / "cameras"


@pytest.mark.parametrize("name", ["lytro_illum", "raytrix_r12", "canon_50mm"])
def test_a_camera_that_people_own(device: Device, name: str):
    """A part of it about the axis sees a point that the whole one sees."""
    file = read_camera_file(CAMERAS / f"{name}.toml")
    whole = file.camera.build(device)
    part = clplen.read_camera(CAMERAS / f"{name}.toml", device=device, count=(9, 11))
    assert part.mla.count == (9, 11)
    assert part.pixel_pitch == whole.pixel_pitch
    assert part.aperture_diameter == whole.aperture_diameter
    # the sensor of each ends where its lenslets do, within one of them
    size = np.array(whole.grid.extent) - np.array(whole.mla.extent)
    assert (np.abs(size) < whole.mla.pitch * (2 if name == "raytrix_r12" else 1)).all()
    (scene,) = file.scene.build()
    whole.check_scene(scene)
    raw = part.expose(PointSources((0, 0, 0))).to_numpy()
    assert 0.8 < raw.sum() < 1


def test_read_camera(tmp_path: Path, device: Device):
    path = tmp_path / "camera.toml"
    path.write_text(REAL[: REAL.index("    [scene]")])
    camera = clplen.read_camera(path, device=device)
    assert camera.grid.shape == (181, 201)
    with pytest.raises(ValueError, match="count must be a number of lenslets"):
        clplen.read_camera(path, device=device, count=0)
    with pytest.raises(FormatError, match="There is no camera file"):
        clplen.read_camera(tmp_path / "none.toml", device=device)


LONG_KEY = ".".join("a" * 1000)


def test_toml_that_would_take_too_long(tmp_path: Path):
    path = tmp_path / "a.toml"
    for text, said in (
        ("a = " + "[" * 5000 + "]" * 5000, "nests arrays or tables too deeply"),
        ("a = " + "{a = " * 3000 + "1" + "}" * 3000, "nests arrays or tables too deeply"),
        (f"# a comment\n{LONG_KEY} = 1", "more than 32 parts in line 2"),
        (f"[{LONG_KEY}]", "more than 32 parts in line 1"),
        ("x = {" + " . ".join(['"!"'] * 40) + " = 1}", "more than 32 parts in line 1"),
        ("a = " + "1" * 5000, "is not TOML"),
        ("a = [", "is not TOML"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(FormatError, match=said):
            read_toml(path, "file")
    for reader in (read_camera_file, Job.read, read_microscope_file):
        with pytest.raises(FormatError, match="is not TOML"):
            reader(path)


def test_toml_that_only_looks_deep(tmp_path: Path):
    path = tmp_path / "a.toml"
    dots = "a.b" * 50
    numbers = ", ".join(["1.5"] * 50)
    text = f'\ufeff# {dots}\na = \'{dots}\'\nb = """\n\\"{dots}\n"""\nc = [{numbers}]\n'
    path.write_text(text, encoding="utf-8")
    assert read_toml(path, "file") == {"a": dots, "b": f'"{dots}\n', "c": [1.5] * 50}


def test_a_long_wrong_value_is_cut(tmp_path: Path):
    text = re.sub("(?m)^wavelength_nm = .*$", f"wavelength_nm = '{'x' * 5000}'", EXAMPLE)
    with pytest.raises(FormatError, match=r", got 'x+\.\.\.x+'") as raised:
        read(tmp_path, text)
    assert len(str(raised.value)) < 1000
