"""poses on the command line: rays of one point through all views meet, in both formats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import imageio.v3 as imageio
import numpy as np
import pytest
from command_line import done, refused
from command_line import invoke_on as run

import clplen
from clplen import LightField
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.io import read_ply, write_colmap, write_nerf
from clplen.lightfield import metric_depth, view_cameras

Array = np.ndarray[Any, Any]
VIEWS, SIZE = (4, 7), (37, 53)
LENGTHS = ("--baseline-mm", 4, "--focal-length-mm", 35, "--pixel-um", 9)
METRIC = {"baseline": 4e-3, "focal_length": 35e-3, "pixel_pitch": 9e-6}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    samples = np.random.default_rng(1).integers(1, 255, (*VIEWS, *SIZE, 3)).astype(np.uint8)
    np.save(tmp_path / "views.npy", samples)
    return tmp_path / "views.npy"


class Pose(NamedTuple):
    """A camera of a file, as OpenCV has it: P = R X + t."""

    name: str
    intrinsic: Array
    rotation: Array
    translation: Array


def nerf_poses(folder: Path) -> list[Pose]:
    """Of transforms.json: x right, y up, z back in camera and world."""
    told = json.loads((folder / "transforms.json").read_text())
    flip = np.diag([1.0, -1, -1])
    poses = []
    for frame in told["frames"]:
        every = told | frame
        K = [[every["fl_x"], 0, every["cx"]], [0, every["fl_y"], every["cy"]], [0, 0, 1]]
        pose = np.array(frame["transform_matrix"])
        R = (flip @ pose[:3, :3] @ flip).T
        centre = flip @ pose[:3, 3]
        assert (every["h"], every["w"]) == SIZE
        poses.append(Pose(frame["file_path"], np.array(K), R, -R @ centre))
    return poses


def colmap_poses(folder: Path) -> list[Pose]:
    """Of COLMAP's text files, world to camera."""
    text = (folder / "sparse/0/cameras.txt").read_text().splitlines()
    cameras = {}
    for line in text:
        if not line.startswith("#"):
            number, model, w, h, *numbers = line.split()
            assert (model, int(h), int(w)) == ("PINHOLE", *SIZE)
            fx, fy, cx, cy = map(float, numbers)
            cameras[number] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    lines = (folder / "sparse/0/images.txt").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    assert not any(lines[1::2])  # no points in the pictures
    poses = []
    for line in lines[::2]:
        _, *numbers, camera, name = line.split()
        w, x, y, z, *t = map(float, numbers)
        assert (w, x, y, z) == (1, 0, 0, 0)
        poses.append(Pose(f"images/{name}", cameras[camera], np.eye(3), np.array(t)))
    return poses


READERS = {"nerf": nerf_poses, "colmap": colmap_poses}


def meeting(poses: list[Pose], y: float, x: float, d: float) -> tuple[Array, float]:
    """Where the rays of a point meet, and how far from it they are imaged, in pixels.

    (y, x) is its pixel in the centre view, centres of pixels being whole numbers.
    """
    rows, pixels = [], []
    for pose in poses:
        v, u = (int(n) for n in Path(pose.name).stem.split("_")[1:])
        at_y = y - d * (v - (VIEWS[0] - 1) / 2)
        at_x = x - d * (u - (VIEWS[1] - 1) / 2)
        pixels.append([at_x + 0.5, at_y + 0.5])  # from the corner
        P = pose.intrinsic @ np.column_stack((pose.rotation, pose.translation))
        rows += [P[0] - pixels[-1][0] * P[2], P[1] - pixels[-1][1] * P[2]]
    equations = np.array(rows)
    point = np.linalg.lstsq(equations[:, :3], -equations[:, 3], rcond=None)[0]
    apart = 0.0
    for pose, pixel in zip(poses, pixels, strict=True):
        seen = pose.intrinsic @ (pose.rotation @ point + pose.translation)
        assert seen[2] > 0  # before the camera
        apart = max(apart, float(np.abs(seen[:2] / seen[2] - pixel).max()))
    return point, apart


@pytest.mark.parametrize("kind", ["nerf", "colmap"])
@pytest.mark.parametrize("focus", [None, 2.5])
def test_rays_meet_where_the_depth_is(
    tmp_path: Path, source: Path, device: Device, kind: str, focus: float | None
) -> None:
    words = (*LENGTHS, "--focus-m", focus) if focus else LENGTHS
    said = done(run(device, "poses", source, "-o", tmp_path / "out", "--format", kind, *words))
    assert "28 views with their poses; lengths are in metres" in said
    poses = READERS[kind](tmp_path / "out")
    assert len(poses) == 28
    last = -2.0 if focus else 0.1
    for y, x, d in [(3, 40, 4.5), (18, 26, 1.25), (30, 7, 0.5), (36, 50, last)]:
        point, apart = meeting(poses, y, x, d)
        assert apart < 1e-6  # pixels; 0.1 was asked for
        z = float(metric_depth(d, **METRIC, focus_distance=focus))
        scale = z * METRIC["pixel_pitch"] / METRIC["focal_length"]
        want = [(x - 26) * scale, (y - 18) * scale, z]
        np.testing.assert_allclose(point, want, rtol=1e-8, atol=1e-12)
    for pose in poses:
        v, u = (int(n) for n in Path(pose.name).stem.split("_")[1:])
        picture = imageio.imread(tmp_path / "out" / pose.name)
        np.testing.assert_array_equal(picture, np.load(source)[v, u])


@pytest.mark.parametrize("kind", ["nerf", "colmap"])
def test_without_lengths(tmp_path: Path, source: Path, device: Device, kind: str) -> None:
    y, x = np.indices(SIZE)
    disparity = (-0.9 + 0.03 * x + 0.01 * y).astype(np.float32)
    disparity[5, 9] = -1.3
    clplen.io.write_pfm(tmp_path / "map.pfm", disparity)
    words = ("--infinity", -1.2, "--focal-px", 80, "--disparity", tmp_path / "map.pfm")
    out = tmp_path / "out"
    result = run(device, "poses", source, "-o", out, "--format", kind, *words)
    assert (
        "1,960 points; the unit is the distance of neighbouring views, the focal length 80 px"
        in done(result)
    )
    assert "1 pixels at or beyond infinity" in result.stderr
    poses = READERS[kind](out)
    if kind == "nerf":
        told = json.loads((out / "transforms.json").read_text())
        points, colours = read_ply(out / told["ply_file_path"])
        points = points * (1, -1, -1)
    else:
        table = np.loadtxt(out / "sparse/0/points3D.txt")
        points, colours = table[:, 1:4], table[:, 4:7]
    order = np.delete(np.arange(disparity.size), 5 * SIZE[1] + 9)
    for at in (0, 777, 1959):
        row, column = np.unravel_index(order[at], SIZE)
        point, apart = meeting(poses, row, column, float(disparity[row, column]))
        assert apart < 1e-5
        np.testing.assert_allclose(points[at], point, rtol=1e-4)
        assert point[2] == pytest.approx(80 / (disparity[row, column] + 1.2), rel=1e-5)
    middle = np.load(source)[1:3, 3].mean(0)
    np.testing.assert_allclose(colours, middle.reshape(-1, 3)[order], atol=1)


def test_one_camera_where_nothing_shifts(tmp_path: Path, source: Path, device: Device) -> None:
    done(run(device, "poses", source, "-o", tmp_path / "a", "--format", "nerf"))
    told = json.loads((tmp_path / "a/transforms.json").read_text())
    assert (told["fl_x"], told["cx"], told["cy"]) == (53, 26.5, 18.5)
    assert "cx" not in told["frames"][0]
    done(run(device, "poses", source, "-o", tmp_path / "b", "--format", "colmap"))
    assert len((tmp_path / "b/sparse/0/cameras.txt").read_text().splitlines()) == 2


def test_a_light_field_that_knows_its_camera(device: Device) -> None:
    """Through the simulated camera's lens law: d of a point and its cameras agree."""
    lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=7, fill="full")
    camera = clplen.PlenopticCamera.type1(
        focal_length=0.03, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=5,
        object_distance=0.4, device=device,
    )  # fmt: skip
    spacing = (-4e-4, -3e-4, 1.5e-4, 1e-4)
    lf = LightField.from_array(
        np.ones((3, 5, 23, 31), np.float32), device=device, spacing=spacing, camera=camera
    )
    cameras = view_cameras(lf)
    for dz in (-0.1, 0.15):
        d = float(lf.disparity(camera.alpha(dz)))
        focus = cameras.focus
        assert cameras.distance(d) == pytest.approx(focus + dz, rel=1e-9)
        seen = cameras.project([(0.003, -0.002, focus + dz)])[:, :, 0]
        down, right = np.diff(seen[..., 0], axis=0), np.diff(seen[..., 1], axis=1)
        np.testing.assert_allclose(right, -d, rtol=1e-9)
        ratio = (spacing[0] / spacing[2]) / (spacing[1] / spacing[3])
        np.testing.assert_allclose(down, -d * ratio, rtol=1e-9)
    assert cameras.centres[2, 4].tolist() == pytest.approx([4e-4, 6e-4])
    with pytest.raises(ValueError, match="are unknown; pass baseline="):
        view_cameras(LightField.from_array(np.ones((3, 5, 8, 9)), device=device))


def test_views_that_are_missing_are_left_out(tmp_path: Path) -> None:
    views = np.ones((2, 3, 8, 9), np.uint8)
    cameras = view_cameras(LightField.from_array(views), **METRIC)
    keep = np.array([[1, 0, 1], [1, 1, 1]])
    write_nerf(tmp_path / "a", views, cameras, keep=keep)
    write_colmap(tmp_path / "b", views, cameras, keep=keep)
    for folder in ("a", "b"):
        names = sorted(path.name for path in (tmp_path / folder / "images").iterdir())
        assert len(names) == 5
        assert "view_00_01.png" not in names
    assert "view_00_01" not in (tmp_path / "a/transforms.json").read_text()
    with pytest.raises(ShapeError, match="for these cameras"):
        write_nerf(tmp_path / "c", views[:, :2], cameras)
    with pytest.raises(ValueError, match="uint8"):
        write_colmap(tmp_path / "c", views.astype(float), cameras)
    places, two = np.zeros((1, 3)), np.zeros((2, 3), np.uint8)
    with pytest.raises(ShapeError, match="Colours"):
        write_colmap(tmp_path / "c", views, cameras, points=places, colours=two)
    assert not (tmp_path / "c").exists()


def test_refusals(tmp_path: Path, source: Path, device: Device) -> None:
    clplen.io.write_pfm(tmp_path / "far.pfm", np.full(SIZE, -2, np.float32))
    clplen.io.write_pfm(tmp_path / "other.pfm", np.ones((37, 52), np.float32))
    out = ("-o", tmp_path / "out", "--format", "nerf")
    for words, code, said in (
        (LENGTHS[:4], 2, "--pixel-um is missing"),
        (("--focus-m", 2), 2, "--baseline-mm and --focal-length-mm and --pixel-um are missing"),
        (("--baseline-mm", 0, *LENGTHS[2:]), 2, "--baseline-mm"),
        ((*LENGTHS, "--focal-px", 50), 2, "cannot be combined with lengths"),
        (("--infinity", 0.5), 2, "at most 0, got 0.5"),
        (("--disparity", tmp_path / "far.pfm"), 2, "No pixel"),
        (("--disparity", tmp_path / "other.pfm"), 1, "37 x 52 pixels"),
    ):
        assert said in refused(run(device, "poses", source, *out, *words), code), words
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    assert "not empty" in refused(run(device, "poses", source, *out))
    words = ("-o", tmp_path / "none" / "out", "--format", "nerf")
    assert "does not exist" in refused(run(device, "poses", source, *words))
