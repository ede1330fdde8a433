"""The command line: what it writes, what it says, and what it says of bad input."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import click
import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from command_line import invoke as run
from command_line import said, write_views

import clplen
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cli import main
from clplen.cli.shared.console import error_sentence
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file
from clplen.config.example import EXAMPLE
from clplen.io import read_lightfield, read_pfm, write_lightfield
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.wave.elements.lenslets import MicrolensArray

D_TRUE = 1.0
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(clplen.__file__).parents[1])}


@pytest.fixture
def views(tmp_path: Path) -> Path:
    """3 x 5 views of a plane at disparity 1, named a_{v}_{u}.png."""
    return write_views(tmp_path / "views", (48, 56))


@pytest.fixture
def camera_file(tmp_path: Path) -> Path:
    """The example with fewer lenslets and one point near the axis."""
    text = EXAMPLE.replace("count = 101", "count = 31")
    start, end = text.index("points_mm"), text.index("\ndiameter_um = 10.0")
    text = text[:start] + "points_mm = [[0.3, -0.2, -30.0]]" + text[end:]
    path = tmp_path / "camera.toml"
    path.write_text(text)
    return path


def test_help_has_an_example_of_each_command():
    assert "Start with 'clplen demo'" in run("-h").output
    assert sorted(main.commands) == [
        "analyse",
        "batch",
        "bench",
        "calibrate",
        "demo",
        "depth",
        "devices",
        "epi",
        "info",
        "lenticular",
        "microscope",
        "poses",
        "quilt",
        "refocus",
        "render",
        "sampling",
        "score",
        "simulate",
        "stack",
        "stereo",
        "view",
        "worker",
    ]
    for name, command in main.commands.items():
        first = {"batch": "run", "microscope": "psf"}.get(name, "")
        words = (name, first) if first else (name,)
        output = run(*words, "-h").output
        assert f"Example:\n    clplen {name}" in output
        if isinstance(command, click.Group):
            command = command.commands[first]
        options = [name for param in command.params for name in param.opts]
        assert ("--device" in options) == (name not in ("sampling", "score"))  # need none


def test_names_that_are_no_text(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch):
    """Bytes that are not UTF-8, a formula, a line break, HTML, quotes, placeholders, escapes."""
    # pytest-xdist cannot send such names.
    monkeypatch.setattr(logging.getLogger("clplen"), "propagate", False)
    name = os.fsdecode(b"-\xff $5_$9^\n<b>\"'%s{}#?\x1b[31m")
    source, out = tmp_path / f"{name}.h5", tmp_path / "out" / name
    out.parent.mkdir()
    write_lightfield(source, LightField.from_array(np.random.default_rng(1).random((3, 2, 20, 30))))
    for words in (
        ("depth", source, "-o", f"{out}.pfm", "--disparities", "-1:1:3"),
        ("view", source, "--depth-map", f"{out}.pfm", "-o", f"{out}.html"),
    ):
        result = run(*words, "--device", device.place)
        assert result.exit_code == 0, result.output
        assert "a picture" in result.stdout or "\\udcff $5_$9^\n<b>" in result.stdout
    assert read_pfm(f"{out}.pfm").shape == (20, 30)
    assert Path(f"{out}.png").stat().st_size > 0
    page = Path(f"{out}.html").read_text(encoding="utf-8")
    assert "<title>-\\udcff $5_$9^\\n&lt;b&gt;&quot;&#x27;%s{}#?\\x1b[31m</title>" in page
    data = json.loads(run("info", source, "--json", "--device", device.place).stdout)
    assert str(source) in data.values()


def test_devices_lists_everything_and_gives_the_reason(device: Device):
    result = run("devices", "--device", device.place)
    assert result.exit_code == 0
    for one in Device.all():
        assert one.name in result.output
        assert one.driver in result.output
    assert f"* {device.place}  {device.name}" in result.output
    assert f"it matches '{device.place}'" in result.output
    assert result.output.count("fp64") == result.output.count("FFT  ") == len(Device.all())


def test_devices_says_what_was_done_to_a_device(device: Device, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(device, "note", "it was given another CPU name")
    assert "note    it was given another CPU name" in run("devices").output


def test_devices_without_a_fitting_one_still_lists():
    result = run("devices", "--device", "zebra")
    assert result.exit_code == 1
    assert "No device can be used: No OpenCL device matches 'zebra'. Available" in result.output
    assert all(device.name in result.output for device in Device.all())


def test_stack_writes_one_series_and_names_the_sharpest_plane(
    tmp_path: Path, views: Path, device: Device
):
    out = tmp_path / "stack.tif"
    result = run("stack", views, "-o", out, "--device", device.place)
    assert result.exit_code == 0, result.output
    planes = tifffile.imread(out)
    assert planes.shape == (33, 48, 56, 3)
    assert planes.dtype == np.float32
    assert "33 planes; the sharpest is number 24 (from 0), d = 1.0000." in result.output
    assert "'a_{v}_{u}.png' (guessed from the names)" in result.stderr


def test_stack_with_every_word(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "stack.tif"
    for file in list(views.iterdir()):
        v, u = file.stem.split("_")[1:]
        file.rename(views / f"b{9 - int(u)}-{7 - int(v)}.png")
    result = run(
        "stack",
        views,
        "-o",
        out,
        "--device",
        device.place,
        "--pattern",
        "b{v}-{u}.png",
        "--views",
        5,
        3,
        "--swap-uv",
        "--flip-v",
        "--flip-u",
        "--disparities",
        "0:2:5",
        "--aperture",
        "3",
    )
    assert result.exit_code == 0, result.output
    assert tifffile.imread(out).shape == (5, 48, 56, 3)
    assert "number 2 (from 0), d = 1.0000." in result.output
    assert "swap_uv, flip_v, flip_u" in result.stderr


def test_depth_writes_values_and_a_picture(tmp_path: Path, views: Path, device: Device):
    result = run(
        "depth",
        views,
        "-o",
        tmp_path / "d.pfm",
        "--device",
        device.place,
        "--disparities",
        "0.4:1.6:9",
    )
    assert result.exit_code == 0, result.output
    lf = read_lightfield(views, device=device)
    expected = depth_map(lf, disparities=np.linspace(0.4, 1.6, 9)).disparity
    np.testing.assert_array_equal(read_pfm(tmp_path / "d.pfm"), expected)
    assert imageio.imread(tmp_path / "d.png").ndim == 3


@pytest.mark.thorough
def test_simulate_then_stack_by_alpha(tmp_path: Path, camera_file: Path, device: Device):
    out = tmp_path / "simulated"
    result = run("simulate", camera_file, "-o", out, "--device", device.place)
    assert result.exit_code == 0, result.output
    assert "working f-number" in result.output
    assert sorted(file.name for file in out.iterdir()) == ["lightfield.h5", "raw.png", "raw.tif"]
    raw = tifffile.imread(out / "raw.tif")
    file = read_camera_file(camera_file)
    expected = file.camera.build(device).expose(file.scene.build()).to_numpy()
    assert expected.shape == (930, 930)
    np.testing.assert_array_equal(raw, expected)
    lf = read_lightfield(out / "lightfield.h5", device=device)
    assert lf.shape == (30, 30, 31, 31)
    true = lf.camera.alpha(-30e-3)
    result = run(
        "stack",
        out / "lightfield.h5",
        "-o",
        tmp_path / "s.tif",
        "--device",
        device.place,
        "--alphas",
        f"{true - 0.2}:{true + 0.2}:5",
    )
    assert f"number 2 (from 0), d = {lf.disparity(true):.4f}, alpha = {true:.4f}" in result.output


def test_the_printed_example_is_a_camera_file(tmp_path: Path):
    result = run("simulate", "--example")
    assert result.exit_code == 0
    (tmp_path / "camera.toml").write_text(result.output)
    assert read_camera_file(tmp_path / "camera.toml").camera.microlenses.count == (101, 101)


def test_the_real_flower_is_sharpest_where_it_lies(
    tmp_path: Path, data_folder: Path, device: Device
):
    flower = data_folder / "lytro_f01_flower"
    words = ("--pattern", "IMG_0001_{n}_{u}_{v}.png", "--device", device.place)
    result = run("stack", flower, "-o", tmp_path / "s.tif", *words)
    assert result.exit_code == 0, result.output
    assert "10 x 10 views (V x U) of 256 x 256 x 3 uint8" in result.stderr
    best = float(result.output.split("d = ")[1].rstrip(".\n"))
    assert best == pytest.approx(-0.65, abs=0.1)
    assert tifffile.imread(tmp_path / "s.tif").shape == (33, 256, 256, 3)


BAD_WORDS = (  # of stack, with the exit status and what is said
    ("--disparities -1:1", 2, "must be START:STOP:N with 1 to 1,000,000 planes"),
    ("--disparities 0:inf:3", 2, "must be START:STOP:N"),
    ("--disparities 0:1:2000000000000", 2, "must be START:STOP:N"),
    ("--disparities 0:1:1", 2, "must have at least 2 planes between two different ends"),
    ("--disparities 0:1:3 --alphas 0.9:1.1:3", 2, "--alphas and --disparities both set"),
    ("--aperture wide", 2, "must be views across (9), a fraction of the diameter"),
    ("--aperture 7", 2, "--aperture must be at most the 5 views across of a"),
    ("--alphas 0.9:1.1:3", 1, "which this light field does not have: use --disparities."),
    ("--device zebra", 1, "No OpenCL device matches 'zebra'. Available devices:"),
    ("--views 5 3", 1, "must equal 3 x 5"),
    ("--views 5 3", 1, "--views 5 3 must equal"),
    ("--pattern a_{v}.png", 1, "must have {v} and {u} once each, or {i} once"),
    ("--pattern b_{v}_{u}.png", 1, "matches the pattern 'b_{v}_{u}.png'"),
)


def test_bad_words_of_stack(tmp_path: Path, views: Path):
    for words, code, message in BAD_WORDS:
        result = run("stack", views, "-o", tmp_path / "s.tif", *words.split())
        assert message in said(result, code)
    assert [file.name for file in tmp_path.iterdir()] == ["views"]


def test_missing_and_broken_views_are_listed(tmp_path: Path, views: Path):
    (views / "a_1_2.png").unlink()
    message = said(run("stack", views, "-o", tmp_path / "s.tif"))
    assert "1 of 3 x 5 views are missing" in message
    assert "(v=1, u=2). Give them weight 0 by --allow-missing." in message
    assert run("stack", views, "-o", tmp_path / "s.tif", "--allow-missing").exit_code == 0
    (views / "a_1_2.png").write_bytes(b"\x89PNG\r\n")
    assert "a_1_2.png is unreadable" in said(run("stack", views, "-o", tmp_path / "s.tif"))


def test_an_output_that_cannot_be_written_is_found_before_computing(
    tmp_path: Path, views: Path, monkeypatch: pytest.MonkeyPatch
):
    for command in ("stack", "depth"):
        monkeypatch.setattr("clplen.io.read_lightfield", lambda *_, **__: pytest.fail("computed"))
        message = said(run(command, views, "-o", tmp_path / "nowhere" / "s.tif"))
        assert "does not exist" in message
        assert "end in .p" in said(run("depth", views, "-o", tmp_path / "s.jpg"), 2)
        assert "end in .tif" in said(run("stack", views, "-o", tmp_path / "s.png"), 2)


@pytest.mark.parametrize(
    ("command", "name", "lost"),
    [
        ("depth", "a_1_1.tif", "a_1_1.png"),
        ("depth", "a_0_3.tif", "a_0_3.tif"),
        ("stack", "a_0_3.tif", "a_0_3.tif"),
    ],
)
def test_what_is_read_is_not_overwritten(
    tmp_path: Path, views: Path, command: str, name: str, lost: str
):
    if lost.endswith(".tif"):
        for file in list(views.iterdir()):
            tifffile.imwrite(file.with_suffix(".tif"), imageio.imread(file))
            file.unlink()
    before = {file.name: file.read_bytes() for file in views.iterdir()}
    message = said(run(command, views, "-o", views / name, "--disparities", "0:1:3"), 2)
    assert f"{views / lost} is one of the input files of {views}: choose another" in message
    (tmp_path / "link").symlink_to(views)
    words = ("-o", tmp_path / "link" / name, "--disparities", "0:1:3")
    assert "is one of the input files" in said(run(command, views, *words), 2)
    assert {file.name: file.read_bytes() for file in views.iterdir()} == before


def test_an_earlier_result_beside_the_views_may_be_replaced(views: Path, device: Device):
    for _ in range(2):
        words = ("-o", views / "depth.pfm", "--disparities", "0:1:3", "--device", device.place)
        assert run("depth", views, *words).exit_code == 0


def test_a_row_of_views(tmp_path: Path, views: Path):
    for file in views.glob("a_[02]_*"):
        file.unlink()
    words = ("-o", tmp_path / "s.tif", "--disparities", "0.5:0.5:1")
    result = run("stack", views, *words)
    assert "read 1 x 5 views (V x U)" in result.stderr
    assert "holds 1 plane; the sharpest" in result.output


def test_planes_beyond_the_picture_are_noted(tmp_path: Path, views: Path):
    words = ("-o", tmp_path / "s.tif", "--disparities", "20:30:2")
    result = run("stack", views, *words)
    assert result.exit_code == 0
    assert "Note: 1 of 2 planes shift the outermost views by more than the size" in result.stderr


def test_a_plane_on_which_no_views_overlap_writes_nothing(tmp_path: Path, views: Path):
    output = tmp_path / "far.png"
    words = said(run("refocus", views, "-o", output, "--disparity", "1e6"))
    assert "Error: At disparity 1e+06 no two views overlap" in words
    assert not output.exists()


def test_default_planes_suit_a_known_camera(tmp_path: Path, device: Device):
    values = np.random.default_rng(1).random((5, 5, 20, 20), np.float32)
    cases = {1.35: None, 1.08: 1.35}  # largest alpha: where infinity lies at 1.35 or beyond, or not
    for highest, distance in cases.items():
        camera = PlenopticCamera.type1(
            focal_length=0.1,
            mla=MicrolensArray(150e-6, 10e-3, count=20, fill="full"),
            wavelength=532e-9,
            pixels_per_lenslet=10,
            device=device,
            object_distance=distance,
        )
        spacing = (-1e-4, -1e-4, 1.5e-4, 1.5e-4)
        lf = LightField.from_array(values, device=device, spacing=spacing, camera=camera)
        write_lightfield(tmp_path / "a.h5", lf)
        words = ("-o", tmp_path / "s.tif", "--device", device.place)
        result = run("stack", tmp_path / "a.h5", *words)
        assert result.exit_code == 0, result.output
        found = tifffile.tiffcomment(tmp_path / "s.tif")
        alphas = json.loads(ET.fromstring(found).findtext("{*}Image/{*}Description"))["alphas"]
        assert (len(alphas), alphas[0]) == (33, pytest.approx(0.65))
        assert alphas[-1] == pytest.approx(highest, abs=1e-3)
        assert run("depth", tmp_path / "a.h5", *words).exit_code == 0


def test_a_failed_run_leaves_no_folder(
    tmp_path: Path, camera_file: Path, monkeypatch: pytest.MonkeyPatch
):
    result = run("demo", "-o", tmp_path / "new", "--device", "zebra")
    assert "No OpenCL device matches" in said(result)

    def no_route(_: Device) -> None:
        raise ValueError("no FFT")

    monkeypatch.setattr(Device, "fft", property(no_route))
    result = run("simulate", camera_file, "-o", tmp_path / "new")
    assert "no FFT" in said(result)
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == [camera_file]


def test_demo_into_a_file_is_refused_at_once(tmp_path: Path):
    (tmp_path / "file").touch()
    assert "is a file or a broken link" in said(run("demo", "-o", tmp_path / "file"))


def test_demo_with_fewer_lenslets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    counts = []
    for scene in "lights", "three_points":
        monkeypatch.setattr(
            f"clplen.demo.{scene}.run",
            lambda *_, count, scene=scene, **__: counts.append((scene, count)),
        )
    for words in (), ("--points", "--lenslets", 53):
        assert run("demo", "-o", tmp_path / "demo", *words).exit_code == 0
    assert counts == [("lights", 101), ("three_points", 53)]
    message = said(run("demo", "-o", tmp_path / "few", "--lenslets", 52), 2)
    assert "52 is not in the range x>=53" in message


def test_a_wrong_camera_file(tmp_path: Path, camera_file: Path):
    camera_file.write_text(camera_file.read_text().replace("wavelength_nm", "wavelenght_nm"))
    message = said(run("simulate", camera_file, "-o", tmp_path / "out"))
    assert "unknown key camera.wavelenght_nm; did you mean wavelength_nm?" in message
    assert not (tmp_path / "out").exists()


def test_a_camera_that_contradicts_the_lens_law(tmp_path: Path, camera_file: Path):
    text = camera_file.read_text()
    camera_file.write_text(
        text.replace("# object_distance_mm = 240.0", "object_distance_mm = 300").replace(
            "# image_distance_mm = 240.0", "image_distance_mm = 240"
        )
    )
    assert "contradict the lens law" in said(run("simulate", camera_file, "-o", tmp_path / "out"))


def test_no_input(tmp_path: Path):
    message = said(run("stack", tmp_path / "nothing", "-o", tmp_path / "s.tif"))
    assert "There is no file or folder" in message


def test_a_failed_build_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from clplen.errors import KernelBuildError

    def fail(*_: object, **__: object) -> None:
        raise KernelBuildError("The kernel does not build.", source="a\nb", log="line 1: no")

    monkeypatch.setattr("clplen.io.read_lightfield", fail)
    assert said(run("stack", tmp_path, "-o", tmp_path / "s.tif")) == (
        "Error: The kernel does not build.\n"
    )


def test_little_memory_says_how_little():
    assert error_sentence(MemoryError("Unable to allocate 14 TiB")) == (
        "This computer has too little memory: Unable to allocate 14 TiB."
    )
    assert error_sentence(MemoryError()) == "This computer has too little memory."


def test_warnings_become_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import warnings

    def warn(*_: object, **__: object) -> None:
        warnings.simplefilter("always")
        warnings.warn("the device is odd", RuntimeWarning, stacklevel=2)
        raise ValueError("stop")

    monkeypatch.setattr("clplen.io.read_lightfield", warn)
    assert said(run("stack", tmp_path, "-o", tmp_path / "s.tif")) == (
        "Note: the device is odd\nError: stop\n"
    )


WRITE_AND_INTERRUPT = """
import os, signal, sys
from clplen.cli import main
from clplen.compute.device import Device

download, calls = Device.download, []

def interrupted(self, array):
    if array.ndim == 3 and array.shape[-1] == 3:
        calls.append(1)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGINT)
    return download(self, array)

Device.download = interrupted
main(sys.argv[1:], prog_name="clplen")
"""


def test_an_interrupt_while_writing_leaves_nothing(tmp_path: Path, views: Path):
    words = ["stack", str(views), "-o", str(tmp_path / "s.tif")]
    done = subprocess.run(
        [sys.executable, "-c", WRITE_AND_INTERRUPT, *words],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
    )
    assert done.returncode == 130, done.stderr
    assert "Interrupted; no file was left half-written." in done.stderr
    assert "Traceback" not in done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["views"]


@pytest.mark.thorough
def test_an_interrupt_while_computing(tmp_path: Path):
    code = "from clplen.cli import main; main(prog_name='clplen')"
    child = subprocess.Popen(
        [sys.executable, "-u", "-c", code, "demo", "-o", str(tmp_path / "demo")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=ENVIRONMENT,
    )
    for line in child.stdout:
        if "plenoptic camera" in line:
            break
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=60)
    assert child.returncode == 130, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_it_is_a_group_of_commands():
    assert isinstance(main, click.Group)
    assert run("--version").output.startswith("clplen, version")


def test_a_stack_as_ome_zarr(tmp_path: Path, device: Device):
    zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")
    np.save(tmp_path / "lf.npy", np.random.default_rng(1).random((3, 4, 21, 17), np.float32))
    words = ["stack", str(tmp_path / "lf.npy"), "-o", str(tmp_path / "s.zarr"), "--device"]
    for count in (5, 5, 7):  # what it wrote itself is replaced
        run = CliRunner().invoke(main, [*words, device.place, "--disparities", f"-1:1:{count}"])
        assert run.exit_code == 0, run.output
        written = zarr.open_group(str(tmp_path / "s.zarr"), mode="r")["0"]
        assert written.shape == (count, 21, 17)
