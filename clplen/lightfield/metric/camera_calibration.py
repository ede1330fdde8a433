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

_MIN_BOARDS = 3  # minimum number of boards
_MIN_VIEW_SHARE = 0.25  # minimum share of the views that show a board
_MIN_TILT_DEG = 10.0  # degrees: minimum tilt between boards
_MAX_FOCAL_ERROR = 0.01  # maximum relative standard deviation of the focal length
_MAX_LISTED = 6  # number of boards in a message


def calibrate(
    light_fields: Iterable[LightField | Array],
    board: tuple[int, int],
    spacing: float,
    *,
    names: Sequence[str] | None = None,
    device: DeviceLike | None = None,
) -> Intrinsics:
    """Calibrate a light-field camera from light fields of a checkerboard.

    Initial values come from Zhang's method (2000) in the middle views and from the disparities.
    Least squares over all views then adjust the matrix H, the distortion and the poses of the
    boards to the detected corners (Dansereau, Pizarro and Williams 2013). Corners beyond six
    standard deviations are excluded.

    Parameters
    ----------
    light_fields : iterable of LightField
        Light fields of equal shape, each with another pose of the board: at least 3 different
        tilts, better 10 over the range of distances to be measured. A generator saves memory.
    board : tuple of int
        Number (rows, columns) of inner corners, where four squares meet; (6, 9) for a board of
        7 x 10 squares.
    spacing : float
        Side of a square in metres.
    names : sequence of str, optional
        Names of the light fields in messages.
    device : Device or str, optional
        Device for arrays; default ``Device.open()``.

    Returns
    -------
    Intrinsics
        Intrinsics with the rms of all corners, of each board and view, and standard deviations.

    Raises
    ------
    ModuleNotFoundError
        If OpenCV is not installed.
    ValueError
        If fewer than 3 boards are detected, the spacing is not positive, or the views are in
        reverse order.
    ShapeError
        If light fields differ in shape or have a single view.

    Warns
    -----
    SamplingWarning
        If boards are excluded because too few views show them, or the boards are too parallel to
        determine the intrinsics.

    Examples
    --------
    >>> light_fields = [clplen.read_lightfield(f"board_{n}.h5") for n in range(8)]  # doctest: +SKIP
    >>> camera = clplen.lightfield.calibrate(light_fields, (6, 9), 0.025)  # doctest: +SKIP
    >>> clplen.io.write_intrinsics("camera.json", camera)  # doctest: +SKIP
    """
    board = checked_board(board)
    if not (is_finite(spacing) and spacing > 0):
        raise ValueError(
            f"spacing must be the side of a square in metres, positive and finite, got {spacing!r}."
        )
    opencv()
    if isinstance(light_fields, LightField) or not isinstance(light_fields, Iterable):
        raise TypeError(
            "light_fields must be a list of light fields, one for each pose of the board, got "
            f"{type(light_fields).__name__}."
        )
    corners: list[Array] = []
    shape: Shape | None = None
    if isinstance(light_fields, Sequence):
        _check_count(len(light_fields))
    for number, light_field in enumerate(light_fields):
        lf = as_lightfield(light_field, device=device)
        name = _name(number, names)
        shape = _checked_shape(lf.shape, shape, name)
        corners.append(find_corners(lf, board))
    _check_count(len(corners))
    assert shape is not None
    return intrinsics_of(corners, shape, board, float(spacing), names)


def intrinsics_of(
    corners: list[Array],
    shape: Shape,
    board: tuple[int, int],
    spacing: float,
    names: Sequence[str] | None = None,
) -> Intrinsics:
    """Calibrate from corners in the format of `find_corners`."""
    boards_used = _used_boards(corners, names)
    (_, k), (_, l) = middles(shape)  # noqa: E741
    row, column = np.mgrid[: board[0], : board[1]].reshape(2, -1)
    flat = np.stack([column, row, 0 * row], -1) * spacing
    sightings = [Sighting(flat, corners[n][..., ::-1] - (k, l)) for n in boards_used]
    parameters, poses = _first_values(sightings, shape)
    adjustment = adjusted(sightings, shape, parameters, poses)
    _check_order(adjustment.parameters, shape)
    _warn_of_parallel(adjustment)
    board_rms = np.full(len(corners), np.nan)
    board_rms[boards_used] = [_rms(residuals) for residuals in adjustment.residuals]
    all_residuals = np.concatenate(adjustment.residuals, axis=2)
    view_rms = np.array([[_rms(residuals) for residuals in line] for line in all_residuals])
    return Intrinsics(
        matrix_of(adjustment.parameters, shape),
        adjustment.parameters[10:],
        shape,
        _rms(all_residuals),
        board,
        spacing,
        board_rms,
        view_rms,
        _deviations(adjustment),
    )


def _check_count(count: int) -> None:
    if count < _MIN_BOARDS:
        raise ValueError(
            f"Calibration needs at least {_MIN_BOARDS} light fields of a board at different tilts, "
            f"got {count}; one tilt does not determine the focal length."
        )


def _checked_shape(shape: tuple[int, ...], first: Shape | None, name: str) -> Shape:
    """Check that the shape (V, U, y, x) is equal for all light fields."""
    V, U, ny, nx = shape[:4]
    if V * U < 2:
        raise ShapeError(f"{name} must have at least two views to measure distances, got one.")
    if first is not None and (V, U, ny, nx) != first:
        raise ShapeError(
            f"{name} has shape (v, u, y, x) = {(V, U, ny, nx)}, unlike {first} before; pass light "
            "fields of one camera, read with equal options."
        )
    return (V, U, ny, nx)


def _name(number: int, names: Sequence[str] | None, count: int = 0) -> str:
    total = f" of {count}" if count else ""
    return f"board {number + 1}{total}" + (f" ({names[number]})" if names is not None else "")


def _used_boards(corners: list[Array], names: Sequence[str] | None) -> list[int]:
    """Return the boards that enough views show; warn about the others."""
    counts = [int(np.isfinite(board_corners).all((-1, -2)).sum()) for board_corners in corners]
    views = corners[0].shape[0] * corners[0].shape[1]
    min_views = max(2, int(np.ceil(_MIN_VIEW_SHARE * views)))
    used = [n for n, count in enumerate(counts) if count >= min_views]
    excluded = [n for n in range(len(counts)) if n not in used]
    details = "; ".join(
        f"{_name(n, names, len(counts))}: found in {counts[n]} of {views} views"
        for n in excluded[:_MAX_LISTED]
    ) + (" ..." if len(excluded) > _MAX_LISTED else "")
    if len(used) < _MIN_BOARDS:
        raise ValueError(
            f"At least {_MIN_BOARDS} light fields must show the board, got {len(used)} "
            f"({details}). Pass the number of inner corners, one less than squares each way, and "
            "views that show the whole board with a bright border."
        )
    if excluded:
        warn_caller(f"Boards excluded because too few views show them: {details}.", SamplingWarning)
    return used


def _first_values(sightings: list[Sighting], shape: Shape) -> tuple[Array, Array]:
    """Estimate parameters and poses by Zhang's method in the middle views, and by disparities."""
    cv2 = opencv()
    V, U, ny, nx = shape
    (_, k), (_, l) = middles(shape)  # noqa: E741
    flat = [board.flat.astype(np.float32) for board in sightings]
    middle_corners = [
        _middle(board).astype(np.float32) + np.array([k, l], np.float32) for board in sightings
    ]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points = [corners.reshape(-1, 1, 2).copy() for corners in middle_corners]
    _, camera, lens_distortion, turns, translations = cv2.calibrateCamera(
        flat, points, (nx, ny), None, None, flags=flags
    )
    parameters = np.zeros(15)
    parameters[4:6] = 1 / camera[0, 0], 1 / camera[1, 1]
    parameters[6:8] = (np.array([k, l]) - camera[:2, 2]) * parameters[4:6]
    parameters[12] = lens_distortion.ravel()[0]
    poses = np.stack(
        [np.r_[r.ravel(), t.ravel()] for r, t in zip(turns, translations, strict=True)]
    )
    for axis, count in enumerate((U, V)):
        if count > 1:
            distance, shifts = _disparities(sightings, poses, axis)
            rows = np.stack([1 / distance, np.ones_like(distance)], -1)
            step, converge = np.linalg.lstsq(rows, shifts * parameters[4 + axis], rcond=None)[0]
            parameters[axis], parameters[2 + axis] = step, converge
    if V == 1 or U == 1:
        parameters[[1, 3] if V == 1 else [0, 2]] = parameters[[0, 2] if V == 1 else [1, 3]]
    return parameters, poses


def _middle(board: Sighting) -> Array:
    """Return (x, y) of the corners in the view nearest to the middle."""
    V, U = board.detected.shape
    j, i = np.nonzero(board.detected)
    nearest = np.argmin(np.hypot(j - (V - 1) / 2, i - (U - 1) / 2))
    return np.asarray(board.pixels[j[nearest], i[nearest]])


def _disparities(sightings: list[Sighting], poses: Array, axis: int) -> tuple[Array, Array]:
    """Return each corner's distance and its shift in pixels against the step between views."""
    distances, shifts = [], []
    for board, pose in zip(sightings, poses, strict=True):
        V, U = board.detected.shape
        j, i = np.nonzero(board.detected)
        step = (i - (U - 1) / 2, j - (V - 1) / 2)
        if np.ptp(step[axis]) == 0:
            continue
        rows = np.stack([*step, np.ones(len(i))], -1)
        slopes = np.linalg.lstsq(rows, board.pixels[board.detected][..., axis], rcond=None)[0]
        shifts.append(-slopes[axis])
        distances.append((board.flat @ rotation(pose[:3]).T + pose[3:])[:, 2])
    return np.concatenate(distances), np.concatenate(shifts)


def _check_order(parameters: Array, shape: Shape) -> None:
    """Reject views that are stored against the order of the pixels."""
    wrong = [
        f"{option}=True"
        for step, count, option in zip(parameters, shape[1::-1], ("flip_u", "flip_v"), strict=False)
        if step < 0 and count > 1
    ]
    if wrong:
        raise ValueError(
            "The views are in reverse order (nearer boards have smaller disparities); read the "
            f"light fields with {' and '.join(wrong)}."
        )


def _warn_of_parallel(adjustment: Adjusted) -> None:
    """Warn if the boards do not determine the intrinsics."""
    normals = np.stack([rotation(pose[:3])[:, 2] for pose in adjustment.poses])
    angle = np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T).min(), 0, 1)))
    share = float((adjustment.deviations[4:6] / adjustment.parameters[4:6]).max())
    if angle < _MIN_TILT_DEG or share > _MAX_FOCAL_ERROR:
        warn_caller(
            f"The boards are parallel to within {angle:.2g} degrees, which determines the focal "
            f"length only to {100 * share:.2g} %; tilt the board by 20 to 40 degrees in all "
            "directions.",
            SamplingWarning,
        )


def _rms(residuals: Array) -> float:
    """Return the root mean square of distances; NaN without any."""
    squares = (residuals**2).sum(-1)
    finite = squares[np.isfinite(squares)]
    return float(np.sqrt(finite.mean())) if finite.size else float("nan")


def _deviations(adjustment: Adjusted) -> Array:
    """Return standard deviations of the entries of H; H35 and H45 refer to the middle direction."""
    D = np.zeros((5, 5))
    d, p = adjustment.deviations, adjustment.parameters
    for axis in range(2):
        D[axis, axis], D[axis + 2, axis], D[axis + 2, axis + 2] = d[axis], d[2 + axis], d[4 + axis]
        D[axis + 2, 4] = d[6 + axis]
        D[axis, axis + 2] = d[8 + axis] * p[4 + axis]
    return D
