"""``clplen depth``: cues, confidence, metres, points, and one sentence for wrong words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from click.testing import Result
from command_line import done, invoke, write_views

import clplen
from clplen.cameras import Plane, noise, rectangle
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.compute.device import Device
from clplen.io import read_lightfield, read_pfm, write_lightfield
from clplen.lightfield.depth.depth_maps import metric_depth
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import view_weights
from clplen.wave.elements.lenslets import MicrolensArray

D = 1.2
PLANES = ("--disparities", "0.6:1.8:7")
LENGTHS = ("--baseline-mm", 2, "--focal-length-mm", 50, "--pixel-um", 10)


@pytest.fixture
def views(tmp_path: Path) -> Path:
    """3 x 5 views of a textured plane at disparity 1.2, named a_{v}_{u}.png."""
    return write_views(tmp_path / "views", (38, 47), D)


def run(device: Device, *words: object) -> Result:
    words = ("depth", *words, "--device", device.place)
    return invoke(*words)


def test_maps_of_a_cue(device: Device, tmp_path: Path, views: Path):
    cue = "correspondence"
    out, sure = tmp_path / "d.npy", tmp_path / "c.tif"
    text = done(run(device, views, "-o", out, "--cue", cue, "--confidence", sure, *PLANES))
    lf = read_lightfield(views, device=device)
    found = depth_map(lf, disparities=np.linspace(0.6, 1.8, 7), cue=cue)
    np.testing.assert_array_equal(np.load(out), found.disparity)
    np.testing.assert_array_equal(tifffile.imread(sure), found.confidence)
    assert imageio.imread(tmp_path / "d.png").ndim == 3
    share = np.mean(found.confidence > 0.5)
    assert f"{100 * share:.0f} % of the pixels are reliable (confidence above 0.5)" in text
    low = found.disparity[found.confidence > 0.5].min()
    assert f"from {low:.3f} to" in text
    low = np.percentile(found.disparity, 1)
    assert f"98 % of the disparities lie from {low:.3f} to" in text
    assert "metre" not in text


@pytest.mark.thorough
def test_metres_and_points(device: Device, tmp_path: Path, views: Path):
    out, metric, ply = tmp_path / "d.pfm", tmp_path / "z.pfm", tmp_path / "p.ply"
    words = ("-o", out, "--cue", "energy", "--metric", metric, "--ply", ply, *PLANES, *LENGTHS)
    text = done(run(device, views, *words))
    d = read_pfm(out)
    Z = metric_depth(d, baseline=2e-3, focal_length=0.05, pixel_pitch=10e-6)
    np.testing.assert_allclose(read_pfm(metric), Z, rtol=1e-6)
    assert f"median {np.median(Z):.4g} m" in text
    head, body = ply.read_bytes().split(b"end_header\n", 1)
    assert f"element vertex {d.size}".encode() in head
    assert b"x right, y down" in head
    vertices = np.frombuffer(body, np.dtype([("p", "<f4", 3), ("c", "u1", 3)])).reshape(d.shape)
    corner = vertices["p"][0, -1]
    expected = np.array([23, -18.5, 5000]) * 10e-6 / 0.05 * Z[0, -1]
    np.testing.assert_allclose(corner, expected, rtol=1e-5)
    np.testing.assert_array_equal(vertices["c"], imageio.imread(views / "a_1_2.png"))
    near = done(run(device, views, *words, "--focus-m", 4))
    Z = metric_depth(d, baseline=2e-3, focal_length=0.05, pixel_pitch=10e-6, focus_distance=4)
    assert f"median {np.median(Z):.4g} m" in near


def test_wrong_words(device: Device, tmp_path: Path, views: Path, monkeypatch: pytest.MonkeyPatch):
    for words, said in (
        (("--baseline-mm", 2, "--pixel-um", 3), "together; --focal-length-mm is missing."),
        (("--focus-m", 3), "--baseline-mm and --focal-length-mm and --pixel-um are missing."),
        ((*LENGTHS[:4], "--pixel-um", 0), "'--pixel-um': must be a positive number, got 0"),
        ((*LENGTHS, "--focus-m", -2), "'--focus-m': must be a positive number"),
        ((*LENGTHS, "--ply", "p.obj"), "end in .ply"),
        ((*LENGTHS, "--metric", "z.png"), "end in .pfm or .tif or .tiff or .npy"),
        (("--confidence", "c.jpg"), "end in .pfm"),
        (("--confidence", "d.pfm"), "used for two outputs"),
        (("--cue", "magic"), "must be 'energy', 'correspondence', 'structure-tensor' or"),
    ):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("clplen.io.read_lightfield", lambda *_, **__: pytest.fail("computed"))
        result = run(device, views, "-o", "d.pfm", *words)
        assert result.exit_code == 2, result.output
        assert said in " ".join(result.stderr.split())
        assert "Traceback" not in result.output
        assert [file.name for file in tmp_path.iterdir()] == ["views"]


def test_points_without_a_camera_are_pixels_and_disparity(
    device: Device, tmp_path: Path, views: Path
):
    out, ply, sure = tmp_path / "d.pfm", tmp_path / "p.ply", tmp_path / "c.pfm"
    words = ("-o", out, "--cue", "energy", "--ply", ply, "--confidence", sure, *PLANES)
    text = done(run(device, views, *words))
    for file in (out, ply, sure, tmp_path / "d.png"):
        assert str(file) in text
    assert "in pixels, with the disparity as z" in text
    d = read_pfm(out)
    head, body = ply.read_bytes().split(b"end_header\n", 1)
    assert b"no camera: x and y in pixels" in head
    vertices = np.frombuffer(body, np.dtype([("p", "<f4", 3), ("c", "u1", 3)])).reshape(d.shape)
    np.testing.assert_array_equal(vertices["p"][3, 7], [7, 3, d[3, 7]])
    result = run(device, views, "-o", out, "--metric", tmp_path / "z.pfm", *PLANES)
    assert result.exit_code == 2
    assert "--metric needs lengths, because this light field stores no camera" in result.stderr
    assert not (tmp_path / "z.pfm").exists()


def test_metres_of_a_known_camera(device: Device, tmp_path: Path, views: Path):
    """By the lens law, as from lengths of the camera that are typed."""
    camera = PlenopticCamera.type1(
        focal_length=0.1,
        mla=MicrolensArray(150e-6, 10e-3, count=47, fill="full"),
        wavelength=532e-9,
        pixels_per_lenslet=10,
        device=device,
        object_distance=1.35,
    )
    values = read_lightfield(views, device=device).to_numpy()
    spacing = (-2e-4, 2e-4, 1.5e-4, -1.5e-4)
    lf = LightField.from_array(values, device=device, spacing=spacing, camera=camera)
    write_lightfield(tmp_path / "a.h5", lf)
    out, metric, ply = tmp_path / "d.pfm", tmp_path / "z.npy", tmp_path / "p.ply"
    words = ("-o", out, "--cue", "energy", "--metric", metric, "--ply", ply, *PLANES)
    text = done(run(device, tmp_path / "a.h5", *words))
    assert f"{metric} the distances in metres from the plane in focus" in text
    Z = metric_depth(
        read_pfm(out),
        baseline=2e-4,
        focal_length=camera.image_distance,
        pixel_pitch=1.5e-4,
        focus_distance=1.35,
    )
    z = np.load(metric)
    np.testing.assert_allclose(z, Z - 1.35, rtol=1e-4, atol=1e-6)
    head, body = ply.read_bytes().split(b"end_header\n", 1)
    assert b"z from the plane in focus" in head
    corner = np.frombuffer(body, np.dtype([("p", "<f4", 3), ("c", "u1", 3)])).reshape(z.shape)
    scale = 1.5e-4 * Z[0, -1] / camera.image_distance
    expected = [23 * scale, -18.5 * scale, z[0, -1]]
    np.testing.assert_allclose(corner["p"][0, -1], expected, rtol=1e-4)


def test_planes_that_end_before_the_scene(device: Device, tmp_path: Path, views: Path):
    words = (views, "-o", tmp_path / "d.pfm", "--cue", "energy", "--disparities")
    for planes, end in (
        ("-1:0.5:4", "last plane tried: the scene may extend above disparity 0.5"),
        ("1.9:3:4", "first plane tried: the scene may extend below disparity 1.9"),
    ):
        said = run(device, *words, planes).stderr
        assert f"for more than half of the pixels the sharpest plane is the {end}" in said
        assert "'clplen info' estimates its range" in said
    assert "Note:" not in run(device, *words, "0.6:1.8:7").stderr


@pytest.mark.thorough
def test_an_aperture_leaves_out_views(device: Device, tmp_path: Path, views: Path):
    out = tmp_path / "d.npy"
    done(run(device, views, "-o", out, "--cue", "energy", "--aperture", "3", *PLANES))
    lf = read_lightfield(views, device=device)
    inner = replace(lf, weights=view_weights(lf, 3, None))
    assert 0 < np.count_nonzero(inner.weights) < np.count_nonzero(lf.weights)
    planes = np.linspace(0.6, 1.8, 7)
    wanted = depth_map(inner, disparities=planes, cue="energy").disparity
    np.testing.assert_array_equal(np.load(out), wanted)
    assert not np.array_equal(wanted, depth_map(lf, disparities=planes, cue="energy").disparity)


def test_the_summary_says_how_much_lies_at_the_ends_of_the_planes(device: Device, tmp_path: Path):
    """A strip at disparity 2.6, a fifth of the views, beyond the planes of the default."""
    ground = Plane(-0.4, (0.0, 0.01), texture=noise(3))
    near = Plane(2.6, texture=noise(4), outline=rectangle((0.0, 20.0), (40.0, 10.0)))
    said = "of the pixels lie at the first or last plane: give a wider range of --disparities."
    for surfaces, share in (([ground, near], True), ([ground], False)):
        lf, truth = clplen.SurfaceScene(surfaces).light_field((5, 5), (64, 90), device=device)
        write_lightfield(tmp_path / "a.h5", lf)
        text = done(run(device, tmp_path / "a.h5", "-o", tmp_path / "d.npy"))
        lines = [line for line in text.splitlines() if line.endswith(said)]
        assert len(lines) == share, text
        if share:
            d = np.load(tmp_path / "d.npy")
            ends = np.mean((d < -1.9375) | (d > 1.9375))
            assert lines == [f"{100 * ends:.0f} % {said}"]
            assert abs(ends - np.mean(truth.disparity > 2)) < 0.07
