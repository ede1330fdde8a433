"""Items that are simulated: what a job expands to, and what is computed for one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest

from clplen.batch import Job
from clplen.batch.jobs.items import tasks_of
from clplen.batch.jobs.simulations import MAX_SLOPE, scenes_of, simulations_of
from clplen.batch.jobs.tables import ALL_KINDS, SceneTable, SimulationTable
from clplen.batch.jobs.task import Source
from clplen.batch.work.simulation import Simulation, simulate
from clplen.cameras.scenes.gallery import SCENES, sample_scenes
from clplen.cameras.scenes.surfaces import Plane
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file
from clplen.config.example import EXAMPLE
from clplen.errors import FormatError
from clplen.lightfield.model.light_field import LightField

SMALL = """
[camera]
focal_length_mm = 30.0
wavelength_nm = 532
pixels_per_lenslet = 12
[camera.microlenses]
pitch_um = 150
focal_length_mm = 10
count = [20, 24]
fill = "full"
"""
POINTS = "[scene]\npoints_mm = [[0.1, -0.05, 3.0], [-0.1, 0.15, -1.0]]\npower = [1.0, 0.5]\n"
SENSOR = "[sensor]\nexposure_electrons = 1e5\nshot_noise = true\nseed = 3\n"
PICTURE = '[scene]\n[[scene.pictures]]\nfile = "L.png"\nwidth_mm = 0.6\n'
DEPTHS = {"key": "scene.points_mm.*.2", "values": [-50, -25, 0, 25, 50], "name": "dz_mm"}


def camera_file(folder: Path, text: str, name: str = "small.toml") -> Path:
    folder.mkdir(exist_ok=True)
    values = np.zeros((9, 8), np.uint8)
    values[1:7, 2:4] = 255
    values[5:7, 2:7] = 153
    imageio.imwrite(folder / "L.png", values)
    (folder / name).write_text(text)
    return folder / name


def items(folder: Path, *sweep: dict[str, Any], camera: str = "small.toml") -> list[Source]:
    table = SimulationTable.model_validate({"camera": camera, "sweep": list(sweep)})
    return simulations_of(table, folder)


def scenes(folder: Path, **words: Any) -> list[Source]:
    return scenes_of(SceneTable.model_validate(words), folder)


def run(source: Source, folder: Path, device: Device) -> Simulation:
    """As a worker does it: the words went through JSON, and another folder is current."""
    return simulate(json.loads(json.dumps(source.origin)), device=device, base=folder)


def same(a: LightField, b: LightField) -> None:
    np.testing.assert_array_equal(a.to_numpy(), b.to_numpy())
    assert a.spacing == b.spacing


# What a job expands to


def test_the_example_camera_over_depths_and_pitches(tmp_path: Path):
    camera_file(tmp_path, EXAMPLE, "camera.toml")
    (tmp_path / "job.toml").write_text(
        'output = "out"\n[[simulations]]\ncamera = "camera.toml"\nname = "depths"\n'
        '[[simulations.sweep]]\nkey = "scene.points_mm.*.2"\nvalues = [-50, -25, 0, 25, 50]\n'
        'name = "dz_mm"\n'
        '[[simulations.sweep]]\nkey = "camera.microlenses.pitch_um"\nvalues = [100, 150]\n'
    )
    job = Job.read(tmp_path / "job.toml")
    found = simulations_of(job.simulations[0], tmp_path)
    assert [task.name for task in tasks_of(job)] == [one.name for one in found]
    assert len({one.name.casefold() for one in found}) == 10
    assert [found[0].name, found[1].name] == [
        "depths_dz_mm=-50_pitch_um=100",
        "depths_dz_mm=-50_pitch_um=150",
    ]
    for one, (dz, pitch) in zip(
        found, [(dz, p) for dz in DEPTHS["values"] for p in (100, 150)], strict=True
    ):
        content = one.origin["content"]
        assert content["camera"]["microlenses"]["pitch_um"] == pitch
        assert [point[2] for point in content["scene"]["points_mm"]] == [dz] * 3
        assert (one.origin["kind"], one.files) == ("camera", ())
        assert json.loads(json.dumps(one.origin)) == one.origin


def test_a_camera_file_in_another_folder(tmp_path: Path):
    camera_file(tmp_path / "cameras", SMALL + PICTURE)
    (tmp_path / "job").mkdir()
    (found,) = items(tmp_path / "job", camera="../cameras/small.toml")
    assert found.name == "small"
    assert found.files == ("../cameras/L.png",)
    assert found.origin["folder"] == "../cameras"


def test_swept_pictures_are_the_files_of_their_items(tmp_path: Path):
    camera_file(tmp_path, SMALL + PICTURE)
    imageio.imwrite(tmp_path / "M.png", np.full((3, 2), 9, np.uint8))
    found = items(tmp_path, {"key": "scene.pictures.0.file", "values": ["L.png", "M.png"]})
    assert [one.files for one in found] == [("L.png",), ("M.png",)]
    assert [one.name for one in found] == ["small_file=L.png", "small_file=M.png"]


def test_a_spectrum_is_a_file_too(tmp_path: Path):
    (tmp_path / "lamp.csv").write_text("500, 1\n550, 2\n")
    camera_file(tmp_path, SMALL + POINTS + '[coherence]\nspectrum_file = "lamp.csv"\n')
    assert items(tmp_path)[0].files == ("lamp.csv",)


def test_a_combination_that_makes_no_camera(tmp_path: Path):
    for key, value, said in (
        ("camera.microlenses.pitch_um", -1, r"microlenses\.pitch_um must be a positive number"),
        ("camera.object_distance", 9, r"unknown key .*; did you mean object_distance_mm\?"),
        ("camera.microlens.pitch_um", 100, r"camera has no table 'microlens'; did you mean"),
        ("camera.object_distance_mm", 20, r"larger than the focal length .* got 0\.02 m"),
        ("camera.microlenses.focal_length_mm", 500, r"must be shorter than the image distance"),
        ("scene.points_mm.*.2", -100, r"The point .* is behind the main lens"),
        ("scene.points_mm.0.0", 9.0, r"is imaged at .*, beyond the array"),
        ("sensor.bit_depth", 8, r"bit_depth requires full_well"),
        ("scene.power", [1.0, 2.0, 3.0], r"power must be one value or 2, got shape \(3,\)"),
    ):
        camera_file(tmp_path, SMALL + POINTS + SENSOR)
        with pytest.raises(FormatError, match=said) as caught:
            items(tmp_path, {"key": key, "values": [value]})
        text = str(caught.value)
        assert text.startswith(f"{tmp_path / 'small.toml'}, item 'small_")
        assert f"({key} = {value!r}): " in text
        assert text.count("\n") == 0
        assert "pydantic" not in text


def test_a_wavelength_of_the_spectrum_that_the_pixels_do_not_sample(tmp_path: Path):
    camera_file(tmp_path, SMALL + POINTS + "[coherence]\nlines_nm = [532, 700]\n")
    sweep = {"key": "coherence.lines_nm.1", "values": [700, 280]}
    with pytest.raises(FormatError, match=r"lines_nm\.1 = 280\): Light reaches the sensor"):
        items(tmp_path, sweep)


def test_what_a_microscope_does_not_expose(tmp_path: Path):
    known = 'kind = "microscope"\nmagnification = 20\nna = 0.15\n'
    camera = SMALL.replace("focal_length_mm = 30.0\n", known)
    points = camera + "[scene]\npoints_mm = [[0.01, 0, 0.02]]\n[coherence]\nlines_nm = [532, 700]\n"
    camera_file(tmp_path, points)
    sweep = {"key": "coherence.lines_nm.1", "values": [700, 280]}
    with pytest.raises(FormatError, match=r"lines_nm\.1 = 280\): Light reaches the sensor"):
        items(tmp_path, sweep)
    camera_file(tmp_path, camera + PICTURE)
    with pytest.raises(FormatError, match="must consist of points, got pictures"):
        items(tmp_path)


def test_lenses_that_the_pixels_do_not_sample(tmp_path: Path):
    """A slide's light converges on the main lens at 60 mm: R = 20 x 75 um is more than R_max."""
    slide = SMALL + PICTURE + 'mode = "transmission"\n[coherence]\n'
    camera_file(tmp_path, slide + "koehler = true\n")
    with pytest.raises(
        FormatError, match=r"item 'small': The phase of a lens of f = 0\.06 m is al"
    ):
        items(tmp_path)
    camera_file(tmp_path, slide + "koehler = false\n")
    assert len(items(tmp_path)) == 1
    camera_file(tmp_path, SMALL + PICTURE)
    with pytest.raises(
        FormatError, match=r"field_lens = True\): The phase of a lens of f = 0\.06 m"
    ):
        items(tmp_path, {"key": "camera.field_lens", "values": [False, True]})


def test_no_camera_file(tmp_path: Path):
    for make in (lambda: items(tmp_path), lambda: scenes(tmp_path, kind="all", camera="no.toml")):
        with pytest.raises(FormatError, match=r"There is no camera file .*--example"):
            make()


def test_pictures_are_read_once_for_all_combinations(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    camera_file(tmp_path, SMALL + PICTURE)
    pixels = {"key": "camera.pixels_per_lenslet", "values": [12, 13, 14]}
    depths = {"key": "scene.pictures.0.z_mm", "values": [0, 1.5]}
    with caplog.at_level("INFO", logger="clplen.config.scene"):
        assert len(items(tmp_path, pixels, depths)) == 6
    assert caplog.text.count("read ") == 1
    depths["values"] = [0, 1.5, -60.5]
    with pytest.raises(FormatError, match=r"z_mm = -60\.5\): The point .* is behind the main"):
        items(tmp_path, depths)
    (tmp_path / "L.png").write_text("L")
    with pytest.raises(FormatError, match=r"item 'small': scene\.pictures\.0\.file: The picture "):
        items(tmp_path)


def test_a_picture_beyond_the_array(tmp_path: Path):
    """Columns 2 to 6 of 8 are lit, rows 1 to 6 of 9, and the array is 3 mm high."""
    camera_file(tmp_path, (SMALL + PICTURE).replace("= 12", "= 20").replace("0.6", "3.0"))
    depths = {"key": "scene.pictures.0.z_mm", "values": [0, -30]}
    place = r"\(-0\.00075, -0\.001125, -0\.03\) m is imaged at \(0\.0015, 0\.00225\) m, beyond"
    with pytest.raises(FormatError, match=rf"z_mm = -30\): The point .* = {place}"):
        items(tmp_path, depths)


# What is computed


@pytest.mark.parametrize("tables", [POINTS + SENSOR, PICTURE])
def test_a_camera_item_is_that_of_simulate(tmp_path: Path, device: Device, tables: str):
    text = SMALL + tables
    camera_file(tmp_path, text)
    key = "scene.points_mm.1.2" if "points" in tables else "scene.pictures.0.z_mm"
    source = items(tmp_path, {"key": key, "values": [5, -2]})[1]
    found = run(source, tmp_path, device)
    changed = text.replace("-1.0]]", "-2]]").replace("width_mm", "z_mm = -2\nwidth_mm")
    file = read_camera_file(camera_file(tmp_path, changed, "changed.toml"))
    sensor = None if file.sensor is None else file.sensor.build()
    raw = file.camera.build(device).expose(file.scene.build(), sensor=sensor)
    assert found.raw is not None
    np.testing.assert_array_equal(found.raw.to_numpy(), raw.to_numpy())
    assert raw.to_numpy().any()
    same(found.light_field, LightField.from_raw(raw))
    assert found.light_field.shape == (12, 12, 20, 24)
    assert found.truth is None


def test_a_slide_in_random_light_is_the_same_each_time(tmp_path: Path, device: Device):
    light = '[coherence]\nspatial = "mask"\ncell_um = 50\nseed = 5\nsnapshots = 2\n'
    few = (SMALL + PICTURE).replace("[20, 24]", "[13, 15]")
    camera_file(tmp_path, few + 'mode = "transmission"\n' + light)
    (source,) = items(tmp_path)
    steps: list[tuple[int, int]] = []
    first = simulate(
        source.origin,
        device=device,
        base=tmp_path,
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps[-1] == (2, 2)
    assert first.raw is not None
    assert first.raw.exposure is not None
    assert first.raw.exposure.snapshots == 2
    same(first.light_field, run(source, tmp_path, device).light_field)


def test_scenes_without_a_camera(tmp_path: Path, device: Device):
    found = scenes(
        tmp_path,
        kind=["bars", "spheres"],
        seeds=[0, 3],
        shape=[40, 53],
        views=[3, 4],
        sweep=[{"key": "noise", "values": [0.0, 0.1]}],
    )
    assert [one.name for one in found] == [
        f"{kind}_{seed}_noise={noise}"
        for noise in ("0", "0.1")
        for kind in ("bars", "spheres")
        for seed in (0, 3)
    ]
    sample = next(one for one in sample_scenes(3, (40, 53)) if one.name == "spheres")
    for source, noise in ((found[3], 0.0), (found[7], 0.1)):
        lf, truth = sample.scene.light_field((3, 4), (40, 53), device=device, noise=noise, seed=3)
        made = run(source, tmp_path, device)
        same(made.light_field, lf)
        assert made.raw is None
        assert made.truth is not None
        np.testing.assert_array_equal(made.truth.disparity, truth.disparity)
        np.testing.assert_array_equal(made.truth.masks["near"], truth.masks["near"])


def test_the_noise_of_a_sample_scene(tmp_path: Path, device: Device):
    (source,) = scenes(tmp_path, kind="dots", shape=[30, 41], views=[2, 3])
    assert source.name == "dots_0"
    sample = next(one for one in sample_scenes(0, (30, 41)) if one.name == "dots")
    assert np.ndim(sample.noise) == 2
    lf, _ = sample.scene.light_field((2, 3), (30, 41), device=device, noise=sample.noise, seed=0)
    same(run(source, tmp_path, device).light_field, lf)


def test_a_scene_through_a_camera(tmp_path: Path, device: Device):
    camera_file(tmp_path, SMALL + "[scene]\nunused = 1\n" + SENSOR)
    found = scenes(
        tmp_path,
        kind="layers",
        name="set",
        camera="small.toml",
        seeds=2,
        sweep=[{"key": "sensor.seed", "values": [3, 4]}],
    )
    assert [one.name for one in found] == ["set_layers_2_seed=3", "set_layers_2_seed=4"]
    made = [run(one, tmp_path, device) for one in found]
    whole = camera_file(tmp_path, SMALL + POINTS + SENSOR, "whole.toml")
    file = read_camera_file(whole)
    sample = next(one for one in sample_scenes(2, (20, 24)) if one.name == "layers")
    assert file.sensor is not None
    raw = file.camera.build(device).expose(sample.scene, model="rays", sensor=file.sensor.build())
    assert made[0].raw is not None
    assert made[1].raw is not None
    np.testing.assert_array_equal(made[0].raw.to_numpy(), raw.to_numpy())
    assert (made[1].raw.to_numpy() != raw.to_numpy()).any()
    assert made[0].light_field.shape == (12, 12, 20, 24)
    assert made[0].truth is not None
    assert raw.truth is not None
    np.testing.assert_array_equal(made[0].truth.disparity, raw.truth.disparity)
    assert np.isfinite(made[0].truth.z).any()


def test_every_kind(tmp_path: Path):
    found = scenes(tmp_path, kind=["bars", ALL_KINDS])
    assert [one.name for one in found] == [f"{kind}_0" for kind in SCENES]
    assert {tuple(one.origin["shape"]) for one in found} == {(512, 512)}


def test_scenes_that_cannot_be_seen(tmp_path: Path):
    for words, said in (
        ({"sweep": [{"key": "views.0", "values": [0]}]}, r"\(views\.0 = 0\): views must be 1 or"),
        ({"shape": [20, 24], "views": [9, 9]}, r"item 'pyramids_0': Surface \d+, a plane of slope"),
        ({"camera": "small.toml"}, r"small\.toml, item 'pyramids_0': Surface \d+, a plane of slo"),
        (
            {"camera": "small.toml", "sweep": [{"key": "scene.x", "values": [0]}]},
            r"the key 'scene\.x' does not exist: the file has no table 'scene'; tables: camera",
        ),
    ):
        camera_file(tmp_path, SMALL)
        with pytest.raises(FormatError, match=said):
            scenes(tmp_path, kind="pyramids", **words)


@pytest.mark.parametrize("lattice", ["square", "hexagonal"])
def test_a_camera_refuses_a_steep_scene_in_the_same_words(
    tmp_path: Path, device: Device, lattice: str
):
    text = SMALL + f'lattice = "{lattice}"\n'
    camera_file(tmp_path, text)
    camera = read_camera_file(camera_file(tmp_path, text + POINTS, "whole.toml")).camera
    sample = next(one for one in sample_scenes(0, (20, 24)) if one.name == "pyramids")
    with pytest.raises(ValueError, match="edge-on") as said:
        camera.build(device).expose(sample.scene, model="rays")
    with pytest.raises(FormatError, match="edge-on") as caught:
        scenes(tmp_path, kind="pyramids", camera="small.toml")
    assert str(caught.value).endswith(str(said.value))


@pytest.mark.parametrize("seed", [0, 7])
def test_no_sample_scene_is_steeper_than_is_assumed(seed: int):
    for one in sample_scenes(seed, (60, 97)):
        slopes = [sum(map(abs, p.slope)) for p in one.scene.surfaces if isinstance(p, Plane)]
        assert max(slopes, default=0) * 30 < MAX_SLOPE
