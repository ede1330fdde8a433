"""Calibration: of traced pictures, and of corners that are known exactly."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from checkerboards import KnownCamera, Pose, corners_in_space, made_camera, photographed, poses_at

from clplen.errors import SamplingWarning, ShapeError
from clplen.lightfield import Intrinsics, calibrate, find_corners
from clplen.lightfield.metric.bundle_adjustment import Sighting, _Problem, _spread_of
from clplen.lightfield.metric.camera_calibration import intrinsics_of
from clplen.lightfield.metric.ray_model import parameters_of

BOARD, SPACING = (5, 7), 0.02
CAMERA = made_camera(
    (3, 4, 97, 128),
    steps=(2.0e-3, 1.9e-3),
    converge=(-3.1e-3, -2.8e-3),
    pitch=(4.5e-3, 4.4e-3),
    centre=(0.01, -0.02),
    distortion=(0.003, -0.002, -0.2, 0.05, 0.0),
)
POSES = poses_at([0.38, 0.45, 0.55, 0.42])
LYTRO = made_camera(
    (5, 4, 300, 400),
    steps=(4.0e-4, 3.6e-4),
    converge=(-1.9e-3, -1.7e-3),
    pitch=(1.8e-3, 1.75e-3),
    tilt=(5.4e-6, -5.25e-6),
    centre=(-0.01, 0.02),
    distortion=(0.01, -0.005, 0.3, -0.2, 0.1),
)


def truth(camera: KnownCamera) -> Intrinsics:
    return Intrinsics(camera.matrix, np.array(camera.distortion), camera.shape)


def exact(camera: KnownCamera, poses: list[Pose]) -> list[np.ndarray]:
    """Corners without errors."""
    return [truth(camera).project(corners_in_space(pose, BOARD, SPACING)) for pose in poses]


def upright(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """What corners are off by; a board looks the same upside down."""
    return min((found - wanted, found[:, :, ::-1] - wanted), key=lambda off: np.abs(off).sum())


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return [photographed(CAMERA, pose, BOARD, SPACING, seed=n) for n, pose in enumerate(POSES)]


def test_corners_are_found_to_a_hundredth_of_a_pixel(pictures: list[np.ndarray]):
    for views, wanted in zip(pictures[1:3], exact(CAMERA, POSES)[1:3], strict=True):
        off = upright(find_corners(views[:2, :3], BOARD), wanted[:2, :3])
        assert np.sqrt((off**2).mean()) < 0.015
        assert abs(off.mean()) < 0.003


def test_the_normal_equations_have_the_gradient_of_the_sum():
    robust = True
    corners = exact(CAMERA, POSES[:2])
    row, column = np.mgrid[: BOARD[0], : BOARD[1]].reshape(2, -1)
    flat = np.stack([column, row, 0 * row], -1) * SPACING
    boards = [Sighting(flat, board[..., ::-1] - (63.5, 48)) for board in corners]
    known = [np.isfinite(board.pixels).all(-1) for board in boards]
    problem = _Problem(boards, known, _spread_of(CAMERA.shape))
    start = parameters_of(CAMERA.matrix, np.array(CAMERA.distortion), CAMERA.shape)
    poses = [0.1, -0.2, 0.1, -0.05, -0.04, 0.4, 0.2, 0.1, -0.1, -0.06, -0.03, 0.5]
    values = np.concatenate([np.linalg.pinv(problem.spread) @ start, poses])

    def total(at: np.ndarray) -> float:
        return problem.cost(problem.residuals(at), at, robust=robust)

    gradient = 2 * problem.normal(values, robust=robust)[1]
    for n in (0, 3, 4, 7, 8, 9, 11, 14, 19, 25):
        step = np.eye(len(values))[n] * 1e-6 * max(abs(values[n]), 1e-2)
        slope = (total(values + step) - total(values - step)) / (2 * step[n])
        assert gradient[n] == pytest.approx(slope, rel=1e-4), n


def test_a_square_board_is_numbered_alike_in_all_views():
    views = photographed(CAMERA, Pose(0.4, (20, -25, 40)), (5, 5), SPACING)
    found = find_corners(views, (5, 5))
    moved = found - found[1, 2]
    assert np.abs(moved).max() < 8  # pixels of parallax, where corners lie 14 apart
    assert np.ptp(moved - moved.mean(2, keepdims=True), axis=2).max() < 2


@pytest.mark.thorough
def test_intrinsics_of_traced_pictures(pictures: list[np.ndarray]):
    found = calibrate(pictures, BOARD, SPACING)
    H, K = found.matrix, CAMERA.matrix
    for at in ((0, 0), (1, 1), (2, 2), (3, 3), (2, 0), (3, 1)):
        assert H[at] == pytest.approx(K[at], rel=2e-3), at
        assert abs(H[at] - K[at]) < 5 * found.deviations[at] + 2e-4 * abs(K[at]), at
    assert 0.003 < found.rms < 0.015
    assert found.board_rms.shape == (4,)
    assert found.view_rms.shape == (3, 4)
    assert np.sqrt((found.board_rms**2).mean()) == pytest.approx(found.rms, rel=0.05)
    fresh = Pose(0.45, (10, -20, 4), (0.01, 0.0))
    points = corners_in_space(fresh, BOARD, SPACING)
    there, here = truth(CAMERA).project(points), found.project(points)
    moved = np.diff(here - there, axis=1)[..., 1]
    assert np.abs(moved).max() < 0.02  # disparities, px


def test_exact_corners_give_the_exact_camera():
    camera = LYTRO
    poses = poses_at([0.3, 0.42, 0.6, 0.9, 1.5])
    found = intrinsics_of(exact(camera, poses), camera.shape, BOARD, SPACING)
    scale = np.abs(camera.matrix).max(1, keepdims=True)
    np.testing.assert_allclose(found.matrix / scale, camera.matrix / scale, atol=5e-5)
    np.testing.assert_allclose(found.distortion, camera.distortion, atol=0.02)
    assert found.rms < 1e-4


def test_wrong_corners_and_missing_views_do_no_harm():
    corners = exact(CAMERA, poses_at([0.3, 0.4, 0.55, 0.35, 0.7]))
    random = np.random.default_rng(2)
    corners = [board + random.normal(size=board.shape) * 0.01 for board in corners]
    clean = intrinsics_of(corners, CAMERA.shape, BOARD, SPACING)
    corners[0][0, 0] += (15.0, -9.0)  # a view in which something else was taken for the board
    corners[1][2, 3, 4] += (0.0, 3.0)
    corners[2][:, 0] = np.nan
    found = intrinsics_of(corners, CAMERA.shape, BOARD, SPACING)
    assert found.rms == pytest.approx(clean.rms, rel=0.05)
    for at in ((0, 0), (2, 2), (3, 1)):
        off = abs(found.matrix[at] - CAMERA.matrix[at])
        assert off < 5 * clean.deviations[at], at
    assert np.isnan(found.view_rms[0, 0]) == np.isnan(clean.view_rms[0, 0]) == False  # noqa: E712


@pytest.mark.nightly  # twelve calibrations
def test_deviations_are_those_of_many_calibrations():
    corners = exact(CAMERA, POSES)
    random = np.random.default_rng(5)
    made = [
        intrinsics_of(
            [board + random.normal(size=board.shape) * 0.05 for board in corners],
            CAMERA.shape, BOARD, SPACING,
        )
        for _ in range(12)
    ]  # fmt: skip
    for at in ((0, 0), (2, 2), (3, 3), (2, 0), (0, 2), (2, 4)):
        each = np.array([found.matrix[at] for found in made])
        if at == (2, 4):  # of the middle direction
            each = each + np.array([f.matrix[2, 0] * 1.5 + f.matrix[2, 2] * 63.5 for f in made])
        assert 0.5 < each.std(ddof=1) / made[0].deviations[at] < 1.8, at


def test_views_in_one_line():
    """Along y nothing is known of a row of views, and the same step is taken."""
    shape = (1, 5, 120, 160)
    line = made_camera(shape, steps=(2e-3, 2e-3), converge=(-1e-3, -1e-3), pitch=(3.6e-3, 3.6e-3))
    found = intrinsics_of(exact(line, poses_at([0.3, 0.4, 0.6])), shape, BOARD, SPACING)
    np.testing.assert_allclose(found.matrix, line.matrix, atol=1e-8)


def test_views_in_reverse_order_are_refused():
    corners = [board[:, ::-1] for board in exact(CAMERA, POSES)]
    with pytest.raises(ValueError, match=r"reverse order.* read the light fields with flip_u=True"):
        intrinsics_of(corners, CAMERA.shape, BOARD, SPACING)


@pytest.mark.thorough
def test_boards_that_are_held_alike_are_warned_of():
    alike = [Pose(z, (20.0 + z, 5.0, 0.0)) for z in (0.3, 0.4, 0.5)]
    random = np.random.default_rng(2)
    corners = [board + random.normal(size=board.shape) * 0.02 for board in exact(CAMERA, alike)]
    corners = [board[:, 1:4] for board in corners]
    with pytest.warns(SamplingWarning, match="The boards are parallel to within 0"):
        intrinsics_of(corners, (3, 3, 97, 128), BOARD, SPACING)


def test_boards_that_few_views_show_are_named():
    corners = exact(CAMERA, [*POSES, Pose(0.5, (25, 20, 0))])
    corners[2][:, 1:] = corners[2][0] = np.nan
    names = [f"b{n}.h5" for n in range(5)]
    with pytest.warns(SamplingWarning, match=r"board 3 of 5 \(b2.h5\): found in 2 of 12 views"):
        found = intrinsics_of(corners, CAMERA.shape, BOARD, SPACING, names)
    assert np.isnan(found.board_rms).tolist() == [False, False, True, False, False]
    for lost in (0, 1):
        corners[lost][:] = np.nan
    with pytest.raises(
        ValueError,
        match=r"At least 3 light fields must show the board, got 2 "
        r"\(board 1 of 5: found in 0 of 12 views; .*number of inner corners",
    ):
        intrinsics_of(corners, CAMERA.shape, BOARD, SPACING)


def test_bad_words():
    given = {"light_fields": [np.ones((3, 3, 40, 40))] * 3, "board": BOARD, "spacing": SPACING}
    for words, message in (
        ({"board": (5,)}, r"board must be \(rows, columns\) of inner corners.*got \(5,\)"),
        ({"board": (2, 7)}, "at least 3 each"),
        ({"board": (5.5, 7)}, "at least 3 each"),
        ({"spacing": 0.0}, "spacing must be the side of a square in metres, positive.*got 0.0"),
        ({"spacing": -0.02}, "got -0.02"),
        ({"spacing": float("nan")}, "got nan"),
        ({"light_fields": [np.ones((3, 3, 40, 40))]}, "at least 3 light fields.*, got 1; one tilt"),
        ({"light_fields": iter([])}, "got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            calibrate(**(given | words))


def test_light_fields_of_several_shapes_or_one_view():
    views = [np.ones((3, 3, 40, 40), np.float32)] * 2 + [np.ones((3, 3, 40, 41), np.float32)]
    with pytest.raises(ShapeError, match=r"board 3 \(c\) has shape .*\(3, 3, 40, 41\), unlike"):
        calibrate(views, BOARD, SPACING, names=["a", "b", "c"])
    with pytest.raises(ShapeError, match="board 1 must have at least two views"):
        calibrate([np.ones((1, 1, 40, 40), np.float32)] * 3, BOARD, SPACING)
    with pytest.raises(TypeError, match="must be a list of light fields"):
        calibrate(3, BOARD, SPACING)  # type: ignore[arg-type]


def test_without_opencv_one_sentence_names_the_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "clplen\[calibrate\]"'):
        calibrate([np.ones((3, 3, 40, 40))] * 3, BOARD, SPACING)
