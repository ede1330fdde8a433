"""``clplen calibrate`` and ``--intrinsics``: from pictures of boards to metres."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from checkerboards import Pose, corners_in_space, made_camera, photographed, poses_at
from command_line import invoke as run
from command_line import said

import clplen
from clplen.cli import main
from clplen.cli.calibrate import summary
from clplen.io import read_intrinsics, read_pfm, write_intrinsics
from clplen.lightfield import Intrinsics, rectify_views

BOARD, SPACING = (4, 6), 0.025
CAMERA = made_camera(
    (3, 3, 96, 120),
    steps=(4e-3, 4e-3),
    converge=(-5e-3, -5e-3),
    pitch=(4.5e-3, 4.5e-3),
    centre=(0.01, 0.02),
    distortion=(0.0, 0.0, -0.25, 0.1, 0.0),
)
KNOWN = Intrinsics(CAMERA.matrix, np.array(CAMERA.distortion), CAMERA.shape, rms=0.01)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Light fields of a board in four poses, as .npy."""
    folder = tmp_path_factory.mktemp("boards")
    files = []
    for number, pose in enumerate(poses_at([0.4, 0.5, 0.65])):
        files.append(folder / f"board_{number}.npy")
        np.save(files[-1], photographed(CAMERA, pose, BOARD, SPACING, seed=number))
    return files


@pytest.fixture(scope="module")
def calibrated(boards: list[Path]) -> tuple[Intrinsics, str]:
    """What the command finds, and says."""
    out = boards[0].parent / "camera.json"
    result = run("calibrate", *boards, "--board", "4x6", "--spacing", "25mm", "-o", out)
    assert result.exit_code == 0, result.output
    assert (
        f"{out} holds the intrinsics; pass it to other commands as --intrinsics." in result.output
    )
    return read_intrinsics(out), result.output


@pytest.fixture
def camera(tmp_path: Path) -> Path:
    write_intrinsics(tmp_path / "camera.json", KNOWN)
    return tmp_path / "camera.json"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Views of a board that fills the pictures, .55 m away in the middle."""
    views = photographed(CAMERA, Pose(0.55, (10, -20, 3)), (20, 22), 0.025, blur=0.8)
    np.save(tmp_path / "scene.npy", views)
    return tmp_path / "scene.npy"


def test_boards_to_a_file_of_intrinsics(calibrated: tuple[Intrinsics, str]):
    found, output = calibrated
    for at in ((0, 0), (2, 2), (3, 1)):
        assert found.matrix[at] == pytest.approx(CAMERA.matrix[at], rel=4e-3)
    assert (found.board, found.spacing) == (BOARD, SPACING)
    assert "views          3 x 3 of 96 x 120 pixels, 30.2 x 24.4 degrees" in output
    assert f"focal length   {found.focal[1]:.6g} px along x" in output
    assert "disparity 0    at 0.8" in output


def test_metres_of_a_scene(camera: Path, scene: Path, tmp_path: Path):
    out, z, ply = (tmp_path / name for name in ("d.pfm", "z.pfm", "points.ply"))
    words = ("--disparities", "0:1.2:17", "--metric", z, "--ply", ply)
    result = run("depth", scene, "-o", out, "--intrinsics", camera, *words)
    assert result.exit_code == 0, result.output
    assert "Distances: median 0.5" in result.output
    metres = read_pfm(z)
    flat = KNOWN.rectified
    np.testing.assert_allclose(metres, flat.depth(read_pfm(out)), rtol=1e-5)
    normal = Pose(0.55, (10, -20, 3)).rotation[:, 2]
    y, x = np.mgrid[20:76, 20:100]
    u, v = np.moveaxis(flat.rays(1.0, 1.0, x, y), -1, 0)[2:]
    true = normal[2] * 0.55 / (normal[0] * u + normal[1] * v + normal[2])
    assert abs(np.median(metres[20:76, 20:100] / true) - 1) < 0.01
    points = clplen.io.read_ply(ply)[0]
    middle = points.reshape(96, 120, 3)[47, 59]
    np.testing.assert_allclose(middle[:2] / middle[2], (-0.5 * 4.5e-3,) * 2, rtol=1e-4)


def test_views_are_rectified_wherever_light_fields_are_read(
    camera: Path, scene: Path, tmp_path: Path
):
    wanted = rectify_views(np.load(scene), KNOWN)
    lf = clplen.read_lightfield(scene, intrinsics=camera)
    np.testing.assert_array_equal(lf.to_numpy(), wanted.to_numpy())
    with clplen.open_lightfield(scene, intrinsics=camera) as stored:
        np.testing.assert_array_equal(stored.to_numpy(), wanted.to_numpy())
    out = tmp_path / "out.tif"
    result = run("refocus", scene, "-o", out, "--disparity", ".5", "--intrinsics", camera)
    assert result.exit_code == 0, result.output
    picture = clplen.io.read_image(out)
    np.testing.assert_allclose(picture, clplen.refocus(wanted, disparity=0.5), atol=1e-5)


def test_poses_in_metres(camera: Path, scene: Path, tmp_path: Path):
    words = ("--format", "nerf", "--intrinsics", camera)
    result = run("poses", scene, "-o", tmp_path / "poses", *words)
    assert result.exit_code == 0, result.output
    assert "lengths are in metres" in result.output
    told = json.loads((tmp_path / "poses/transforms.json").read_text())
    across = [frame["transform_matrix"][0][3] for frame in told["frames"]]
    assert np.ptp(across) == pytest.approx(2 * 4e-3)
    result = run("poses", scene, "-o", tmp_path / "more", *words, "--baseline-mm", "3")
    assert "--baseline-mm cannot be combined with --intrinsics" in said(result, 2)


def test_the_summary_tells_what_to_look_at():
    rms = np.array([0.02, 0.02, np.nan, 0.09])
    found = Intrinsics(
        CAMERA.matrix, np.array(CAMERA.distortion), CAMERA.shape, 0.05, BOARD, SPACING, rms
    )
    text = "\n".join(summary(found, ["a", "b", "c", "d"]))
    assert "of boards    0.02, 0.02, left out, 0.09" in text
    assert "largest: d" in text
    assert "about (0, 0)" in text
    y, x = 47.5 - 0.02 / 4.5e-3, 59.5 - 0.01 / 4.5e-3
    assert f"at pixel (y, x) = ({y:.2f}, {x:.2f})" in text


def test_bad_words(boards: list[Path], tmp_path: Path):
    for words, code, message in (
        (
            ("--board", "4by6", "--spacing", "25mm"),
            2,
            "'4by6' is not a board: give rows and columns",
        ),
        (("--board", "2x6", "--spacing", "25mm"), 1, "at least 3 each, got (2, 6)"),
        (("--board", "4x6", "--spacing", "0"), 2, "the length must be positive, got '0'"),
        (("--board", "4x6", "--spacing", "-25mm"), 2, "the length must be positive"),
        (("--board", "4x6", "--spacing", "nan"), 2, "'nan' is not a length"),
        (("--board", "5x7", "--spacing", "25mm"), 1, "must show the board, got 0"),
        (("--board", "4x6", "--spacing", "25mm", "-o", "camera.txt"), 2, "must end in .json, got"),
    ):
        out = tmp_path / "camera.json"
        np.save(tmp_path / "two.npy", np.load(boards[0])[:1, :2])
        inputs = [tmp_path / "two.npy"] * 3
        assert message in said(run("calibrate", *inputs, "-o", out, *words), code)
        assert not out.exists()


def test_bad_boards(boards: list[Path], tmp_path: Path):
    words = ("--board", "4x6", "--spacing", "25mm", "-o", tmp_path / "camera.json")
    message = said(run("calibrate", boards[0], *words))
    assert "at least 3 light fields of a board at different tilts, got 1" in message
    np.save(tmp_path / "grey.npy", np.full(CAMERA.shape, 0.5, np.float32))
    message = said(run("calibrate", *boards[:2], tmp_path / "grey.npy", *words))
    assert f"board 3 of 3 ({tmp_path / 'grey.npy'}): found in 0 of 9 views" in message
    np.save(tmp_path / "other.npy", np.ones((3, 3, 96, 124), np.float32))
    inputs = (tmp_path / "grey.npy", tmp_path / "other.npy", boards[1])
    message = said(run("calibrate", *inputs, *words))
    assert "board 2 (" in message
    assert "pass light fields of one camera" in message
    message = said(run("calibrate", boards[0], "missing.npy", boards[1], *words))
    assert "There is no file or folder missing.npy." in message
    assert not (tmp_path / "camera.json").exists()


def test_without_opencv(boards: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    words = ("--board", "4x6", "--spacing", "25mm", "-o", tmp_path / "camera.json")
    assert 'pip install "clplen[calibrate]"' in said(run("calibrate", *boards, *words))


def test_intrinsics_that_do_not_fit(camera: Path, scene: Path, tmp_path: Path):
    words = ("depth", scene, "-o", tmp_path / "d.pfm", "--intrinsics", camera)
    message = said(run(*words, "--baseline-mm", "3"), 2)
    assert "--baseline-mm cannot be combined with --intrinsics" in message
    np.save(tmp_path / "small.npy", np.ones((3, 3, 48, 60), np.float32))
    message = said(run("depth", tmp_path / "small.npy", *words[2:]))
    assert "the shape of the intrinsics, (3, 3, 96, 120)" in message
    camera.write_text("{}")
    assert "is not a file of intrinsics" in said(run(*words))
    assert not (tmp_path / "d.pfm").exists()


def test_every_command_that_reads_views_takes_intrinsics():
    for name in ("depth", "stack", "refocus", "view", "render", "epi", "quilt", "poses", "stereo"):
        command = main.commands[name]
        assert isinstance(command, click.Command)
        assert "--intrinsics" in [option for param in command.params for option in param.opts]


def test_corners_of_a_fresh_board_in_metres(calibrated: tuple[Intrinsics, str]):
    """Of a board that lies where it is known, by rays through its corners."""
    found = calibrated[0]
    pose = Pose(0.5, (-12, 16, 4), (0.01, 0.0))
    corners = clplen.lightfield.find_corners(
        photographed(CAMERA, pose, BOARD, SPACING, seed=9), BOARD
    )
    j, i = np.mgrid[:3, :3][:, :, :, None]
    rays = found.rays(i, j, corners[..., 1], corners[..., 0]).reshape(9, -1, 4)
    z = -(np.polyfit(rays[:, 0, 0], rays[..., 2], 1)[0] ** -1)  # u = u0 - s/z
    true = corners_in_space(pose, BOARD, SPACING)[:, 2]
    off = min((z, z[::-1]), key=lambda z: np.abs(z - true).sum()) / true - 1
    assert abs(off.mean()) < 0.005
    assert np.abs(off).max() < 0.02
