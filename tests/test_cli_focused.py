"""simulate, render, stack, depth and info with raw images of focused cameras."""

from __future__ import annotations

import json
import math
import shutil
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from command_line import done, refused
from command_line import invoke_on as run
from setups_focused import captured

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, SurfaceScene
from clplen.cameras import Plane
from clplen.cameras.optics.ray_optics import view_step
from clplen.cameras.scenes.textures import noise
from clplen.compute.device import Device
from clplen.config.camera_file import read_camera_file
from clplen.io import read_pfm, read_raw, write_picture, write_raw, write_raytrix
from clplen.lightfield.focused.focused_depth import focused_depth, focused_maps
from clplen.lightfield.focused.focused_rendering import focused_stack, render_focused
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.lightfield.raw.raw_image import RawImage

FILE = """
[camera]
kind = "plenoptic2"
m = 0.2
focal_length_mm = 30.0
wavelength_nm = 532
pixels_per_lenslet = 20
[camera.microlenses]
pitch_um = 150
focal_length_mm = [10, 9.8]
count = [11, 12]
fill = "full"
[scene]
points_mm = [[0.2, -0.1, 1.0]]
"""
DZ = 1e-3


@lru_cache
def exposed(device: Device) -> RawImage:
    """A textured plane 1 mm behind the focused one, by rays."""
    camera = PlenopticCamera.type2(
        focal_length=0.03, mla=MicrolensArray(150e-6, 10e-3, count=(11, 12), fill="full"),
        wavelength=532e-9, pixels_per_lenslet=20, device=device, m=0.2,
    )  # fmt: skip
    d = (1 - camera.array_alpha(DZ)) * view_step(camera) / 150e-6
    texture = noise(5, 64, finest=0.45, coarsest=1 / 8, contrast=0.2)
    return camera.expose(SurfaceScene(Plane(d, texture=texture)), model="rays")


@pytest.fixture
def raw_file(tmp_path: Path, device: Device) -> Path:
    write_raw(tmp_path / "raw.h5", exposed(device))
    return tmp_path / "raw.h5"


def test_simulate_keeps_the_camera(tmp_path: Path, device: Device) -> None:
    (tmp_path / "camera.toml").write_text(FILE)
    said = done(run(device, "simulate", tmp_path / "camera.toml", "-o", tmp_path / "out"))
    assert "raw.h5, 11 x 12 lenslets with their camera" in said
    assert not (tmp_path / "out/lightfield.h5").exists()
    raw = read_raw(tmp_path / "out/raw.h5", device=device)
    expected = read_camera_file(tmp_path / "camera.toml").camera.build(device)
    assert raw.camera == expected
    image = expected.expose(PointSources((2e-4, -1e-4, 1e-3)))
    np.testing.assert_array_equal(raw.to_numpy(), image.to_numpy())
    assert (raw.lens_types, raw.cells) == (image.lens_types, image.cells)
    said = " ".join(done(run(device, "info", tmp_path / "out/raw.h5")).split())
    assert "a raw image of a focused camera (plenoptic 2.0): see 'clplen render'" in said
    assert "Lens type 1" in said
    known = json.loads(done(run(device, "info", tmp_path / "out/raw.h5", "--json")))
    assert (known["shape"], known["camera"]["m"]) == ([220, 240], 0.2)


def test_render(tmp_path: Path, raw_file: Path, device: Device) -> None:
    out, raw = tmp_path / "a.tif", exposed(device)
    said = done(run(device, "render", raw_file, "-o", out))
    picture = render_focused(raw)
    np.testing.assert_array_equal(tifffile.imread(out), picture.to_numpy())
    assert "blended, m = 0.2, patches of 2.00 px, linear float32" in said
    with tifffile.TiffFile(out) as file:
        text = file.ome_metadata
    assert f'PhysicalSizeX="{picture.pitch * 1e6}' in text
    assert "step_px" in text
    words = ("--method", "basic", "--m", 0.25, "--patch", 3, "--view", 2, -1.5, "--step", 4)
    done(run(device, "render", raw_file, "-o", out, *words))
    expected = render_focused(raw, method="basic", m=0.25, patch=3, view=(2, -1.5), step=4)
    np.testing.assert_array_equal(tifffile.imread(out), expected.to_numpy())
    done(run(device, "render", raw_file, "-o", out, "--method", "depth", "--aperture", 0.8))
    expected = render_focused(raw, method="depth", aperture=0.8)
    np.testing.assert_array_equal(tifffile.imread(out), expected.to_numpy())
    png = tmp_path / "a.png"
    assert "not for measurements" in done(run(device, "render", raw_file, "-o", png))
    assert imageio.imread(png).shape == picture.shape


@pytest.mark.thorough
def test_sweeps(tmp_path: Path, raw_file: Path, device: Device) -> None:
    out = tmp_path / "a.gif"
    done(run(device, "render", raw_file, "-o", out, "--sweep", "focus", "--m", "0.15:0.25:3"))
    assert len(imageio.imread(out, plugin="pillow")) == 4
    done(run(device, "render", raw_file, "-o", out, "--sweep", "views"))
    frames = imageio.imread(out, plugin="pillow").astype(float)
    assert len(frames) == 24
    assert np.abs(frames[0] - frames[12]).mean() > 3


def test_stack(tmp_path: Path, raw_file: Path, device: Device) -> None:
    out, raw = tmp_path / "a.tif", exposed(device)
    said = done(run(device, "stack", raw_file, "-o", out, "--m", "0.15,0.2,0.26"))
    assert "3 planes, m = 0.15 to 0.26" in said
    made = focused_stack(raw, ms=[0.15, 0.2, 0.26])
    np.testing.assert_array_equal(tifffile.imread(out), made.to_numpy())
    with tifffile.TiffFile(out) as file:
        description = json.loads(
            file.ome_metadata.split("<Description>")[1].split("</Description>")[0]
            .replace("&quot;", '"').replace("&gt;", ">")
        )  # fmt: skip
    assert description["ms"] == [0.15, 0.2, 0.26]
    assert description["dz_m"] == pytest.approx(made.zs)
    assert description["step_px"] == made.grid.step
    done(run(device, "stack", raw_file, "-o", out))
    assert tifffile.imread(out).shape[0] == 11


def test_depth(tmp_path: Path, raw_file: Path, device: Device) -> None:
    raw = exposed(device)
    out, z, ply = tmp_path / "d.ome.tif", tmp_path / "z.npy", tmp_path / "p.ply"
    words = ("--metric", z, "--ply", ply, "--confidence", tmp_path / "c.pfm")
    said = done(run(device, "depth", raw_file, "-o", out, *words))
    found = focused_depth(raw)
    maps = focused_maps(raw, found)
    channels = tifffile.imread(out)
    expected = (maps.m, 1 / maps.m, maps.z, maps.confidence)
    np.testing.assert_array_equal(channels, np.array(expected, np.float32))
    np.testing.assert_array_equal(np.load(z), channels[2])
    np.testing.assert_array_equal(read_pfm(tmp_path / "c.pfm"), channels[3])
    assert np.median(channels[2]) == pytest.approx(DZ, abs=2e-4)
    assert imageio.imread(tmp_path / "d.ome.png").ndim == 3
    assert "sub-images are reliable" in said
    assert "virtual depth 1/m" in said
    assert "Distances from the plane in focus" in said
    head, body = ply.read_bytes().split(b"end_header\n", 1)
    points = np.frombuffer(body, np.dtype([("p", "<f4", 3), ("c", "u1", 3)]))["p"]
    points = points.reshape(*maps.grid.shape, 3)
    assert b"metres: x right" in head
    scale = raw.camera.array_scale(maps.z[0, 3])  # the chief ray of an object at the array
    chief = np.array([maps.grid.axes()[1][3] - 119.5, maps.grid.axes()[0][0] - 109.5]) * 7.5e-6
    on_array = chief / raw.camera.sub_image_scale
    np.testing.assert_allclose(points[0, 3], (*(on_array / scale), maps.z[0, 3]), rtol=1e-4)
    done(run(device, "depth", raw_file, "-o", tmp_path / "d.h5", "--m", "0.15:0.3"))
    wide = focused_depth(raw, ms=(0.15, 0.3))
    with h5py.File(tmp_path / "d.h5") as file:
        np.testing.assert_array_equal(file["lenslets/m"], wide.m.astype(np.float32))
        np.testing.assert_array_equal(file["lenslets/centre"], wide.geometry.centres.astype("f4"))
        assert file["picture/m"].shape == maps.grid.shape
        assert file["picture"].attrs["step_px"] == maps.grid.step
        assert "z" in file["lenslets"]


@pytest.fixture
def shot(tmp_path: Path) -> tuple[Path, Any]:
    """A captured frame with its XML and white image, and what they are made of."""
    made = captured()
    write_raytrix(tmp_path / "shot.xml", made.calibration)
    for name, values in (("shot", made.image), ("white", made.white)):
        write_picture(tmp_path / f"{name}.tif", np.round(values * 65535).astype(np.uint16))
    return tmp_path / "shot.xml", made


@pytest.mark.thorough
def test_a_captured_frame(tmp_path: Path, device: Device, shot: tuple[Path, Any]) -> None:
    xml, made = shot
    out, white = tmp_path / "out.tif", xml.with_name("white.tif")
    words = ("--method", "depth", "--white", white, "--step", 4)
    done(run(device, "render", xml, "-o", out, *words))
    picture, level = tifffile.imread(out), tifffile.imread(white).astype(np.float32)
    raw = read_raw(xml, device=device)
    expected = render_focused(raw, method="depth", white=level, step=4)
    np.testing.assert_array_equal(picture, expected.to_numpy())
    done(run(device, "render", xml, "-o", out, *words, "--no-devignette"))
    expected = render_focused(raw, method="depth", step=4)
    np.testing.assert_array_equal(tifffile.imread(out), expected.to_numpy())
    said = done(run(device, "depth", xml, "-o", tmp_path / "d.h5", "--white", white))
    with h5py.File(tmp_path / "d.h5") as file:
        found = np.asarray(file["lenslets/m"])
        sure = np.asarray(file["lenslets/confidence"]) > 0.3
        assert "z" not in file["lenslets"]
        true = made.ratio(np.asarray(file["lenslets/centre"]))
    assert np.sqrt(np.mean((found[sure] / true[sure] - 1) ** 2)) < 0.02  # measured .012
    assert "metre" not in said
    # The same lenses from another file, and the picture as it is.
    moved = shutil.copy(xml.with_name("shot.tif"), tmp_path / "other.tif")
    again = tmp_path / "again.tif"
    done(run(device, "render", moved, "-o", again, *words, "--grid", xml))
    np.testing.assert_array_equal(tifffile.imread(again), picture)
    said = " ".join(done(run(device, "info", xml)).split())
    assert "shot.tif, 250 x 270 pixels" in said
    assert "of a focused camera (plenoptic 2.0)" in said


def test_a_raw_picture_needs_a_word_that_it_is_focused(
    tmp_path: Path, device: Device, raw_file: Path
) -> None:
    raw = exposed(device)
    write_picture(tmp_path / "raw.tif", raw.to_numpy())
    grid = raw.sub_images
    lattice = Lattice("square", grid.first, grid.row_step, grid.column_step, raw.shape)
    lattice.save(tmp_path / "grid.json")
    words = ("-o", tmp_path / "d.npy", "--grid", tmp_path / "grid.json", "--focused")
    done(run(device, "depth", tmp_path / "raw.tif", *words))
    words = ("-o", tmp_path / "s.tif", "--grid", tmp_path / "grid.json", "--m", "0.15,0.2,0.26")
    for more in ((), ("--focused",)):  # --m says it too
        assert "3 planes" in done(run(device, "stack", tmp_path / "raw.tif", *words, *more))
    assert "none.tif" in refused(run(device, "stack", tmp_path / "none.tif", *words), 1)
    m = np.load(tmp_path / "d.npy")
    pupil = 12 / 120  # the lattice of sub-images alone: b/z2 is not known, m is the ratio
    expected = focused_depth(raw).geometry.ratio(focused_depth(raw).median)
    assert np.median(m) == pytest.approx(expected, rel=0.01)
    assert expected == pytest.approx((focused_depth(raw).median - pupil) / (1 + pupil))


@pytest.mark.thorough
def test_info_names_what_was_written(tmp_path: Path, raw_file: Path, device: Device) -> None:
    for command, name, words, kind, m in (
        ("render", "a.tif", (), "a picture of a focused camera", "0.2"),
        ("stack", "s.tif", ("--m", "0.15,0.2"), "a focal stack of a focused camera", "0.15, 0.2"),
        ("depth", "d.h5", (), "depth of a focused camera", None),
        ("depth", "d.ome.tif", (), "depth of a focused camera", None),
        ("depth", "m.tif", (), "a map of m = b/a of a focused camera", None),
    ):
        done(run(device, command, raw_file, "-o", tmp_path / name, *words))
        said = " ".join(done(run(device, "info", tmp_path / name)).split())
        assert f"{name}, {kind}" in said
        assert (f"m = b/a {m}" in said) == (m is not None)
        known = json.loads(done(run(device, "info", tmp_path / name, "--json")))
        assert len(known["shape"]) == 2 + (name in ("s.tif", "d.ome.tif"))


BAD = [
    (
        ("render", "--disparity", 1),
        2,
        "--disparity applies to light fields, but INPUT is a raw image of a",
    ),
    (("render", "--alphas", "1:1:1"), 2, "--alphas applies to light fields"),
    (("render", "--flatten", "max"), 2, "--flatten applies to light fields"),
    (("render", "--aperture", "f/20"), 2, "fraction of a sub-image's diameter, such as 0.5, got"),
    (("render", "--aperture", 9), 1, "a share of the sub-image's diameter"),
    (("render", "--m", "0.1,0.2"), 2, "--m must be a single plane, got 2"),
    (("render", "--m", 0), 1, "m = b/a must be a finite number other than 0"),
    (("render", "--m", "a"), 2, "'a' is not m: give for example 0.2"),
    (("render", "--patch", 30), 1, "at most a sub-image, 22 px, got 30 px"),
    (("render", "--method", "depth", "--patch", 3), 1, "--method depth sets the patches"),
    (("render", "--srgb"), 1, "--srgb does not apply to a raw image of a focused camera"),
    (("render", "--grid", "g.json"), 2, "--dark and --grid do not apply"),
    (("stack", "--disparities", "-1:1:3"), 2, "--disparities applies to light fields"),
    (("stack", "--memory", "1GB"), 2, "--memory applies to light fields"),
    (("stack", "--m", "0.1:0.5"), 2, "must be START:STOP:N"),
    (("stack", "--m", "-0.1:0.3:9"), 2, "'-0.1:0.3:9' contains m = 0, where no plane is in focus"),
    (("depth", "--cue", "energy"), 2, "--cue applies to light fields"),
    (("depth", "--m", "0.2"), 2, "is not LEAST:GREATEST"),
    (("depth", "--m", "0.2:0.6"), 1, "only 1.7 lenslets a row see a point, too few"),
    (
        ("depth", "--baseline-mm", 1, "--focal-length-mm", 1, "--pixel-um", 1),
        2,
        "--baseline-mm applies to",
    ),
]


def test_wrong_words(tmp_path: Path, raw_file: Path, device: Device) -> None:
    for words, code, said in BAD:
        if "--grid" in words:
            (tmp_path / "g.json").touch()
            words = tuple(tmp_path / "g.json" if word == "g.json" else word for word in words)
        out = tmp_path / "new.tif"
        result = run(device, words[0], raw_file, "-o", out, *words[1:])
        assert said in refused(result, code)
        assert not out.exists()


def test_words_of_focused_cameras_with_light_fields(tmp_path: Path, device: Device) -> None:
    views = tmp_path / "views"
    views.mkdir()
    for v, u in np.ndindex(3, 3):
        imageio.imwrite(views / f"a_{v}_{u}.png", np.full((20, 21), 9 * v + u, np.uint8))
    out = tmp_path / "o.tif"
    for command, words in (
        ("render", ("--m", 0.2)),
        ("render", ("--focused",)),
        ("stack", ("--m", 0.2)),
        ("depth", ("--m", "0.1:0.3")),
    ):
        said = refused(run(device, command, views, "-o", out, *words), 2)
        assert "applies to raw images of focused cameras" in said
        assert "is a folder of views" in said


def test_files_that_are_not_replaced_or_of_another_camera(
    tmp_path: Path, device: Device, shot: tuple[Path, Any], raw_file: Path
) -> None:
    xml = shot[0]
    said = refused(run(device, "render", xml, "-o", xml.with_suffix(".tif")), 2)
    assert "is the raw image of" in said
    said = refused(run(device, "depth", xml, "-o", xml.with_suffix(".npy"), "--metric", "z.npy"), 2)
    assert "--metric needs the camera" in said
    said = refused(run(device, "refocus", raw_file, "-o", tmp_path / "o.tif", "--alpha", 1), 1)
    assert "is a raw image, not a light field: use 'clplen render', 'stack' and 'depth'" in said
    other = PlenopticCamera.type1(
        focal_length=0.03, mla=MicrolensArray(150e-6, 10e-3, count=9), wavelength=532e-9,
        pixels_per_lenslet=12, device=device,
    ).expose(PointSources([(0, 0, 0)]))  # fmt: skip
    write_raw(tmp_path / "one.h5", other)
    assert LightField.from_raw(read_raw(tmp_path / "one.h5", device=device)).spacing is not None
    said = refused(run(device, "render", tmp_path / "one.h5", "-o", tmp_path / "o.tif"), 1)
    assert "plenoptic 1.0 camera" in said
    assert math.isfinite(other.pixel_pitch)
