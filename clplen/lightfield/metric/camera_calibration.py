"""`calibrate`: intrinsics of a light-field camera from light fields of a checkerboard."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from clplen.checks import is_finite
from clplen.compute.device import DeviceLike
from clplen.errors import SamplingWarning, ShapeError, warn_caller
from clplen.lightfield.metric.board_corners import checked_board, find_corners, opencv
from clplen.lightfield.metric.bundle_adjustment import Adjusted, Sighting, adjusted, rotation
from clplen.lightfield.metric.intrinsics import Intrinsics
from clplen.lightfield.metric.ray_model import Shape, matrix_of, middles
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield

Array = np.ndarray[Any, Any]

_BOARDS = 3  # that a calibration needs
_VIEWS = 0.25  # of the views must show a board
_ALIKE = 10.0  # degrees between boards; below, they are held alike
_SURE = 0.01  # largest standard deviation of the focal length, as a share of it
_LISTED = 6  # boards that a sentence names


def calibrate(
    light_fields: Iterable[LightField | Array],
    board: tuple[int, int],
    spacing: float,
    *,
    names: Sequence[str] | None = None,
    device: DeviceLike | None = None,
) -> Intrinsics:
    """Find the intrinsics of a light-field camera from light fields of a checkerboard.

    First values are those of Zhang's method (2000) in the middle views and of the disparities. Then
    the squares of the distances between computed and found corners of all views are made least over
    the matrix H, the distortion and the poses of the boards (Dansereau, Pizarro and Williams 2013).
    Corners beyond six standard deviations are left out.

    Parameters
    ----------
    light_fields : iterable of LightField
        One for each pose of the board, at least 3 of different tilts, better 10 over the range of
        distances that is measured later; all of one shape. A generator holds one at a time.
    board : tuple of int
        (rows, columns) of inner corners, where four squares meet: a board of 7 x 10 squares has
        (6, 9).
    spacing : float
        Side of a square, in metres.
    names : sequence of str, optional
        Of the light fields, for messages.
    device : Device or str, optional
        Where arrays go; default ``Device.open()``.

    Returns
    -------
    Intrinsics
        With the rms of all corners, of each board and of each view, and standard deviations.

    Raises
    ------
    ModuleNotFoundError
        If OpenCV is not installed.
    ValueError
        If fewer than 3 boards are found, the spacing is not positive, or the views are stored in
        reverse order.
    ShapeError
        If light fields have different shapes, or one view only.

    Warns
    -----
    SamplingWarning
        If boards are left out because few views show them, or the boards are held so much alike
        that they do not determine the intrinsics.

    Examples
    --------
    >>> light_fields = [clplen.read_lightfield(f"board_{n}.h5") for n in range(8)]  # doctest: +SKIP
    >>> camera = clplen.lightfield.calibrate(light_fields, (6, 9), 0.025)  # doctest: +SKIP
    >>> clplen.io.write_intrinsics("camera.json", camera)  # doctest: +SKIP
    """
    board = checked_board(board)
    if not (is_finite(spacing) and spacing > 0):
        raise ValueError(
            f"spacing is the side of a square in metres, positive and finite, not {spacing!r}."
        )
    opencv()
    if isinstance(light_fields, LightField) or not isinstance(light_fields, Iterable):
        raise TypeError(
            "calibrate takes a list of light fields, one for each pose of the board, not one of "
            f"type {type(light_fields).__name__}."
        )
    found: list[Array] = []
    shape: Shape | None = None
    if isinstance(light_fields, Sequence):
        _check_count(len(light_fields))
    for number, light_field in enumerate(light_fields):
        lf = as_lightfield(light_field, device=device)
        name = _name(number, names)
        shape = _checked_shape(lf.shape, shape, name)
        found.append(find_corners(lf, board))
    _check_count(len(found))
    assert shape is not None
    return intrinsics_of(found, shape, board, float(spacing), names)


def intrinsics_of(
    corners: list[Array],
    shape: Shape,
    board: tuple[int, int],
    spacing: float,
    names: Sequence[str] | None = None,
) -> Intrinsics:
    """`calibrate` of corners as `find_corners` gives them."""
    used = _used_boards(corners, names)
    (_, k), (_, l) = middles(shape)  # noqa: E741
    row, column = np.mgrid[: board[0], : board[1]].reshape(2, -1)
    flat = np.stack([column, row, 0 * row], -1) * spacing
    sightings = [Sighting(flat, corners[n][..., ::-1] - (k, l)) for n in used]
    parameters, poses = _first_values(sightings, shape)
    found = adjusted(sightings, shape, parameters, poses)
    _check_order(found.parameters, shape)
    _warn_of_alike(found)
    board_rms = np.full(len(corners), np.nan)
    board_rms[used] = [_rms(off) for off in found.residuals]
    every = np.concatenate(found.residuals, axis=2)
    view_rms = np.array([[_rms(off) for off in line] for line in every])
    return Intrinsics(
        matrix_of(found.parameters, shape),
        found.parameters[10:],
        shape,
        _rms(every),
        board,
        spacing,
        board_rms,
        view_rms,
        _deviations(found),
    )


def _check_count(count: int) -> None:
    if count < _BOARDS:
        raise ValueError(
            f"Calibration takes at least {_BOARDS} light fields of a board at different tilts, not "
            f"{count}: one tilt alone does not determine the focal length."
        )


def _checked_shape(shape: tuple[int, ...], first: Shape | None, name: str) -> Shape:
    """(V, U, y, x), which is the same for all."""
    V, U, ny, nx = shape[:4]
    if V * U < 2:
        raise ShapeError(f"{name} has one view only: distances need at least two.")
    if first is not None and (V, U, ny, nx) != first:
        raise ShapeError(
            f"{name} has the shape (v, u, y, x) = {(V, U, ny, nx)}, and those before it {first}: "
            "give light fields of one camera, read in the same way."
        )
    return (V, U, ny, nx)


def _name(number: int, names: Sequence[str] | None, count: int = 0) -> str:
    of = f" of {count}" if count else ""
    return f"board {number + 1}{of}" + (f" ({names[number]})" if names is not None else "")


def _used_boards(corners: list[Array], names: Sequence[str] | None) -> list[int]:
    """The boards that enough views show; the others are named."""
    counts = [int(np.isfinite(found).all((-1, -2)).sum()) for found in corners]
    views = corners[0].shape[0] * corners[0].shape[1]
    needed = max(2, int(np.ceil(_VIEWS * views)))
    used = [n for n, count in enumerate(counts) if count >= needed]
    lost = [n for n in range(len(counts)) if n not in used]
    told = "; ".join(
        f"{_name(n, names, len(counts))}: found in {counts[n]} of {views} views"
        for n in lost[:_LISTED]
    ) + (" ..." if len(lost) > _LISTED else "")
    if len(used) < _BOARDS:
        raise ValueError(
            f"The board was found in too few light fields, {len(used)} where at least {_BOARDS} "
            f"are needed ({told}): board counts inner corners, one less than squares each way, and "
            "every view must show it whole, with a bright border."
        )
    if lost:
        warn_caller(f"Left out, as too few views show the board: {told}.", SamplingWarning)
    return used


def _first_values(sightings: list[Sighting], shape: Shape) -> tuple[Array, Array]:
    """Parameters and poses by Zhang's method in the middle views, and by the disparities."""
    cv2 = opencv()
    V, U, ny, nx = shape
    (_, k), (_, l) = middles(shape)  # noqa: E741
    flat = [board.flat.astype(np.float32) for board in sightings]
    seen = [_middle(board).astype(np.float32) + np.array([k, l], np.float32) for board in sightings]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points = [corners.reshape(-1, 1, 2).copy() for corners in seen]
    _, camera, bent, turns, places = cv2.calibrateCamera(
        flat, points, (nx, ny), None, None, flags=flags
    )
    parameters = np.zeros(15)
    parameters[4:6] = 1 / camera[0, 0], 1 / camera[1, 1]
    parameters[6:8] = (np.array([k, l]) - camera[:2, 2]) * parameters[4:6]
    parameters[12] = bent.ravel()[0]
    poses = np.stack([np.r_[r.ravel(), t.ravel()] for r, t in zip(turns, places, strict=True)])
    for axis, count in enumerate((U, V)):
        if count > 1:
            far, moved = _disparities(sightings, poses, axis)
            rows = np.stack([1 / far, np.ones_like(far)], -1)
            step, converge = np.linalg.lstsq(rows, moved * parameters[4 + axis], rcond=None)[0]
            parameters[axis], parameters[2 + axis] = step, converge
    if V == 1 or U == 1:
        parameters[[1, 3] if V == 1 else [0, 2]] = parameters[[0, 2] if V == 1 else [1, 3]]
    return parameters, poses


def _middle(board: Sighting) -> Array:
    """(x, y) of the corners in the view that is nearest to the middle."""
    V, U = board.seen.shape
    j, i = np.nonzero(board.seen)
    nearest = np.argmin(np.hypot(j - (V - 1) / 2, i - (U - 1) / 2))
    return np.asarray(board.pixels[j[nearest], i[nearest]])


def _disparities(sightings: list[Sighting], poses: Array, axis: int) -> tuple[Array, Array]:
    """Distance of each corner, and pixels that it moves against the step from view to view."""
    far, moved = [], []
    for board, pose in zip(sightings, poses, strict=True):
        V, U = board.seen.shape
        j, i = np.nonzero(board.seen)
        step = (i - (U - 1) / 2, j - (V - 1) / 2)
        if np.ptp(step[axis]) == 0:
            continue
        rows = np.stack([*step, np.ones(len(i))], -1)
        slopes = np.linalg.lstsq(rows, board.pixels[board.seen][..., axis], rcond=None)[0]
        moved.append(-slopes[axis])
        far.append((board.flat @ rotation(pose[:3]).T + pose[3:])[:, 2])
    return np.concatenate(far), np.concatenate(moved)


def _check_order(parameters: Array, shape: Shape) -> None:
    """Refuse views that are stored against the order of the pixels."""
    wrong = [
        f"{option}=True"
        for step, count, option in zip(parameters, shape[1::-1], ("flip_u", "flip_v"), strict=False)
        if step < 0 and count > 1
    ]
    if wrong:
        raise ValueError(
            "The views are stored in reverse order, so that nearer boards have smaller "
            f"disparities: read the light fields with {' and '.join(wrong)}."
        )


def _warn_of_alike(found: Adjusted) -> None:
    """Warn where the boards do not determine the intrinsics."""
    normals = np.stack([rotation(pose[:3])[:, 2] for pose in found.poses])
    angle = np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T).min(), 0, 1)))
    share = float((found.deviations[4:6] / found.parameters[4:6]).max())
    if angle < _ALIKE or share > _SURE:
        warn_caller(
            f"The boards are held much alike, within {angle:.2g} degrees of each other, which "
            f"determines the focal length to no better than {100 * share:.2g} %: tilt the board "
            "by 20 to 40 degrees, to all sides.",
            SamplingWarning,
        )


def _rms(off: Array) -> float:
    """Root of the mean square of distances; NaN of none."""
    squares = (off**2).sum(-1)
    known = squares[np.isfinite(squares)]
    return float(np.sqrt(known.mean())) if known.size else float("nan")


def _deviations(found: Adjusted) -> Array:
    """Standard deviations of the numbers of H; of H35 and H45 those of the middle direction."""
    D = np.zeros((5, 5))
    d, p = found.deviations, found.parameters
    for axis in range(2):
        D[axis, axis], D[axis + 2, axis], D[axis + 2, axis + 2] = d[axis], d[2 + axis], d[4 + axis]
        D[axis + 2, 4] = d[6 + axis]
        D[axis, axis + 2] = d[8 + axis] * p[4 + axis]
    return D
