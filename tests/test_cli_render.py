"""render, refocus and epi on the command line: files, values, and one sentence for wrong words."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from command_line import done, refused, write_views
from command_line import invoke_on as run

from clplen.compute.device import Device
from clplen.io import read_lightfield
from clplen.io.formats.animation import to_eight_bits, white_level, write_animation
from clplen.io.formats.picture import encoded
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import plane_through
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

D = 1.0


@pytest.fixture
def views(tmp_path: Path) -> Path:
    """3 x 5 views of a textured plane at disparity 1, named a_{v}_{u}.png."""
    return write_views(tmp_path / "views", (30, 37))


def light_field(views: Path, device: Device) -> LightField:
    return read_lightfield(views, device=device)


def test_viewpoints(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "view.tif"
    said = done(run(device, "render", views, "-o", out, "--viewpoint", 0.5, 3.25))
    lf = light_field(views, device)
    got = tifffile.imread(out)
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, lf.view(0.5, 3.25).to_numpy())
    assert "linear float32" in said
    done(run(device, "render", views, "-o", out, "--viewpoint", 0.5, 3.25, "--disparity", D))
    want = lf.view(0.5, 3.25, disparity=D).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(out), want)


def test_flattening(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "flat.tif"
    lf = light_field(views, device)
    done(run(device, "render", views, "-o", out, "--flatten", "median", "--disparity", -0.4))
    want = lf.flatten("median", disparity=-0.4).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(out), want)
    words = ("--aperture", 2, "--viewpoint", 1, 1.5, "--flatten", "max")
    done(run(device, "render", views, "-o", out, *words))
    want = lf.flatten("max", aperture=2, viewpoint=(1, 1.5)).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(out), want)


def test_png_is_scaled_and_says_so(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "view.png"
    said = done(run(device, "render", views, "-o", out, "--viewpoint", 1, 2))
    np.testing.assert_array_equal(imageio.imread(out), imageio.imread(views / "a_1_2.png"))
    assert "255 is white" in said
    assert "not for measurements" in said
    said = done(run(device, "render", views, "-o", out, "--viewpoint", 1, 2, "--srgb"))
    np.testing.assert_array_equal(imageio.imread(out), imageio.imread(views / "a_1_2.png"))
    assert "1 is white, encoded as sRGB" in said


@pytest.mark.parametrize("sweep", ["views", "focus"])
def test_sweeps(tmp_path: Path, views: Path, device: Device, sweep: str):
    out = tmp_path / "sweep.gif"
    words = ("--disparity", D) if sweep == "views" else ("--disparities", "0:1:4")
    said = done(run(device, "render", views, "-o", out, "--sweep", sweep, *words))
    frames = imageio.imread(out, plugin="pillow")
    assert frames.shape == (24 if sweep == "views" else 6, 30, 37, 3)
    assert f"{len(frames)} frames" in said
    lf = light_field(views, device)
    if sweep == "focus":
        want = refocus(lf, disparity=1.0).to_numpy()
        assert np.abs(frames[3] - want).mean() < 6  # 256 colours in all
        np.testing.assert_array_equal(frames[4], frames[2])
    else:
        assert np.abs(frames[0].astype(float) - frames[12]).mean() > 10


@pytest.mark.parametrize(
    ("words", "more"),
    [
        (("--disparity", -0.4), {"disparity": -0.4}),
        (("--disparity", 0.5, "--upsample", 2), {"disparity": 0.5, "upsample": 2}),
        (
            ("--disparity", 0.5, "--interpolation", "fourier"),
            {"disparity": 0.5, "interpolation": "fourier"},
        ),
    ],
)
def test_planes(tmp_path: Path, views: Path, device: Device, words, more):
    out = tmp_path / "plane.tif"
    said = done(run(device, "refocus", views, "-o", out, *words))
    want = refocus(light_field(views, device), **more).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(out), want)
    assert f"focused on d = {more['disparity']:g}" in said


def test_the_depth_of_a_pixel_is_found(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "at.tif"
    said = done(run(device, "refocus", views, "-o", out, "--at", "14,20", "--disparities", "0:2:9"))
    d = float(said.split("d = ")[1].split()[0])
    assert d == pytest.approx(D, abs=0.05)
    assert "(at 14,20)" in said
    want = refocus(light_field(views, device), disparity=d).to_numpy()
    assert np.abs(tifffile.imread(out) - want).max() < 0.1


def test_a_tilted_plane(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "tilt.tif"
    points = [(2, 3, 0.5), (25, 5, 1.0), (14, 30, -0.5)]
    words = [word for p in points for word in ("--tilt", ",".join(str(n) for n in p))]
    done(run(device, "refocus", views, "-o", out, *words))
    want = refocus(light_field(views, device), disparity=plane_through(points, (30, 37))).to_numpy()
    np.testing.assert_array_equal(tifffile.imread(out), want)
    words = ["--tilt", "14,12", "--tilt", "15,25", "--tilt", "20,20,1", "--disparities", "0:2:9"]
    said = done(run(device, "refocus", views, "-o", out, *words))
    found = [float(n) for n in said.split("d = ")[1].split(" at")[0].split(",")]
    assert found == pytest.approx([D] * 3, abs=0.1)


def test_all_in_focus(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "sharp.tif"
    words = ("--all-in-focus", "--disparities", "0:2:5")
    said = done(run(device, "refocus", views, "-o", out, *words))
    assert "the sharpest of 5 planes" in said
    centre = imageio.imread(views / "a_1_2.png").astype(float)
    assert np.abs(tifffile.imread(out) - centre)[4:-4, 4:-4].mean() < 3


@pytest.mark.parametrize("target", [("--at", "14,20"), ("--all-in-focus",)])
def test_the_scene_beyond_the_planes_is_noted(
    tmp_path: Path, views: Path, device: Device, target: tuple[str, ...]
):
    out = tmp_path / "out.tif"
    for planes, note in (
        ("-1:0.5:7", "the last plane"),
        ("1.6:3:5", "the first plane"),
        ("0:2:9", ""),
    ):
        result = run(device, "refocus", views, "-o", out, *target, "--disparities", planes)
        done(result)
        assert ("the sharpest plane is" in result.stderr) == bool(note)
        assert note in result.stderr
    result = run(device, "stack", views, "-o", out, "--disparities", "-1:0.5:7")
    done(result)
    assert "the scene may extend above disparity 0.5; 'clplen info'" in result.stderr


def test_refocusing_through_a_part_of_the_lens(tmp_path: Path, views: Path, device: Device):
    out = tmp_path / "part.tif"
    words = ("--disparity", 0.5, "--aperture", 3, "--interpolation", "cubic")
    done(run(device, "refocus", views, "-o", out, *words))
    lf = light_field(views, device)
    want = focal_stack(lf, disparities=[0.5], aperture=3, interpolation="cubic").to_numpy()[0]
    np.testing.assert_array_equal(tifffile.imread(out), want)
    assert np.abs(want - refocus(lf, disparity=0.5, interpolation="cubic").to_numpy()).max() > 1


def test_an_image_is_an_array(views: Path, device: Device):
    image = light_field(views, device).view(1, 2)
    np.testing.assert_array_equal(np.asarray(image), image.to_numpy())
    assert np.asarray(image).shape == (30, 37, 3)
    assert np.asarray(image, dtype=np.float64).dtype == np.float64
    with pytest.raises(ValueError, match="without a copy"):
        image.__array__(copy=False)


def test_a_sweep_has_32_frames(tmp_path: Path, views: Path, device: Device):
    said = done(run(device, "render", views, "-o", tmp_path / "s.gif", "--sweep", "focus"))
    assert "32 frames" in said


def test_epipolar_slices(tmp_path: Path, views: Path, device: Device):
    lf = light_field(views, device)
    out = tmp_path / "epi.tif"
    said = done(run(device, "epi", views, "-o", out, "--y", 7, "--v", 2))
    np.testing.assert_array_equal(tifffile.imread(out), lf.epi(y=7, v=2).to_numpy())
    assert "(u, x)" in said
    done(run(device, "epi", views, "-o", out, "--x", 9, "--u", 3))
    np.testing.assert_array_equal(tifffile.imread(out), lf.epi(x=9, u=3).to_numpy())
    done(run(device, "epi", views, "-o", tmp_path / "epi.png", "--y", 7, "--v", 2))
    assert imageio.imread(tmp_path / "epi.png").shape[1] > 500


def test_one_sentence(tmp_path: Path, views: Path, device: Device):
    for words, code, sentence in (
        (("render", "--sweep", "views", "--aperture", 3), 2, "cannot be combined with --viewpoint"),
        (("render", "--sweep", "views"), 2, "The output must end in .gif"),
        (("render", "--alphas", "0.9:1.1:3"), 2, "need --sweep focus"),
        (("render", "--viewpoint", 9, 0), 1, "v from 0 to 2 and u from 0 to 4"),
        (("refocus",), 2, "Give one of --disparity"),
        (("refocus", "--disparity", 1, "--at", "3,4"), 2, "Give one of --disparity"),
        (("refocus", "--at", "3"), 2, "'3' is not Y,X, for example 120,88"),
        (("refocus", "--at", "3,40"), 2, "X 0 to 36"),
        (("refocus", "--tilt", "3,4,1"), 2, "given three times, for three pixels, got 1"),
        (("refocus", *("--tilt", "3,4,1") * 3), 1, "lie on one line"),
        (("refocus", "--disparity", 1, "--upsample", 99), 2, "a whole number from 1 to 16"),
        (("refocus", "--disparity", 1, "--upsample", 0), 2, "a whole number from 1 to 16, got 0"),
        (("refocus", "--disparity", "nan"), 2, "'nan' is not a finite number"),
        (("render", "--disparity", "inf"), 2, "'inf' is not a finite number"),
        (("refocus", *("--tilt", "3,4,1") * 2), 2, "given three times, for three pixels, got 2"),
        (("refocus", *("--tilt", "3,4,1") * 3, "--aperture", 3), 2, "combined with --tilt"),
        (("refocus", "--disparity", 1, "--disparities", "0:1:3"), 2, "search these planes"),
        (("refocus", "--all-in-focus", "--upsample", 2), 2, "combined with --all-in-focus"),
        (("refocus", "--alpha", 0.9), 1, "does not store: use --disparity."),
        (("epi", "--y", 1), 2, "Give --y and --v, or --x and --u"),
        (("epi", "--y", 99, "--v", 0), 1, "y must be an integer from 0 to 29"),
    ):
        out = tmp_path / "out.tif"
        said = refused(run(device, words[0], views, "-o", out, *words[1:]), code)
        assert sentence in said
        assert not out.exists()


@pytest.mark.parametrize("command", ["render", "refocus", "epi"])
def test_inputs_are_never_overwritten(views: Path, device: Device, command: str):
    source = views / "a_1_2.png"
    before = source.read_bytes()
    words = {"refocus": ("--disparity", 0), "epi": ("--y", 1, "--v", 1)}.get(command, ())
    said = refused(run(device, command, views, "-o", source, *words), 2)
    assert "is one of the input files of" in said
    assert source.read_bytes() == before


def test_what_is_white():
    values = np.array([[0.5, 2.0]])
    assert white_level(values, np.dtype(np.uint8)) == 255
    assert white_level(values, np.dtype(np.float32)) == 2
    assert white_level(values, np.dtype(np.uint16), srgb=True) == 1
    assert white_level(0 * values, np.dtype(np.float32)) == 1
    glint = np.append(np.linspace(0, 1, 9999), 3.1)
    assert white_level(glint, np.dtype(np.float32)) == pytest.approx(0.999, abs=1e-3)
    assert white_level(np.append(glint[:-1], 2.9), np.dtype(np.uint16)) == 2.9
    assert white_level(np.append(np.zeros(9999), 7.0), np.dtype(np.float32)) == 7
    np.testing.assert_array_equal(to_eight_bits(values, 2.0), [[64, 255]])
    want = np.rint(255 * encoded(np.array([[0.25, 1.0]])))
    np.testing.assert_array_equal(to_eight_bits(values, 2.0, srgb=True), want)


def test_animations_that_are_refused(tmp_path: Path):
    grey = np.zeros((4, 5), np.uint8)
    for path, pictures, words in (
        ("a.png", [grey], "must end in .gif"),
        ("a.gif", [], "at least one picture"),
        ("a.gif", [grey, grey.T], "all of equal shape"),
        ("a.gif", [grey.astype(float)], "must be uint8"),
    ):
        with pytest.raises(ValueError, match=words):
            write_animation(tmp_path / path, pictures)
    with pytest.raises(ValueError, match=r"must be 0\.02"):
        write_animation(tmp_path / "a.gif", [grey], seconds=0)
    assert not list(tmp_path.iterdir())


def test_smooth_slopes_are_dithered(tmp_path: Path):
    """More colours than a GIF keeps: their means over 4 x 4 pixels stay within a level or two."""
    y, x = np.mgrid[:32, :48]
    slope = np.stack([100 + x, 150 + y, 90 + x // 2 + y], -1).astype(np.uint8)
    write_animation(tmp_path / "a.gif", [slope, slope[::-1]])
    got = imageio.imread(tmp_path / "a.gif", plugin="pillow").astype(float)
    means = (got - [slope, slope[::-1]]).reshape(2, 8, 4, 12, 4, 3).mean((2, 4))
    assert np.abs(means).max() < 2.5
    assert np.abs(got[0] - slope).max() <= 255 / 31 + 1
    grey = np.arange(256, dtype=np.uint8).reshape(8, 32)
    write_animation(tmp_path / "g.gif", [grey])
    got = np.squeeze(imageio.imread(tmp_path / "g.gif", plugin="pillow"))
    np.testing.assert_array_equal(got if got.ndim == 2 else got[..., 0], grey)
