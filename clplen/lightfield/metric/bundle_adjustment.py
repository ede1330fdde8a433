"""Bundle adjustment: intrinsics, distortion and board poses by least squares over all corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.metric.ray_model import Shape, pixels_and_slopes, pixels_of

Array = np.ndarray[Any, Any]

_HUBER_LIMIT = 0.5  # pixels: residual above which a corner counts less in the first pass
_OUTLIER = 6.0  # standard deviations: larger residuals are excluded from the second pass
_MIN_DEVIATION = 0.02  # pixels: minimum standard deviation
_CENTRE_DEVIATION = 0.05  # slope: prior deviation of the centre of distortion
_PRIOR = _MIN_DEVIATION / _CENTRE_DEVIATION
_MAX_STEPS = 100  # maximum number of steps
_MAX_TRIALS = 12  # trials of a step with increasing damping
_MIN_GAIN = 1e-9  # minimum relative decrease of the cost by a step


@dataclass(frozen=True)
class Sighting:
    """Board as seen in all views."""

    flat: Array  # Corners on the board, (X, Y, 0) in metres, shape (n, 3)
    # Their positions (x, y) from the middle pixel in the views, shape (V, U, n, 2); NaN if not
    # detected
    pixels: Array

    @property
    def detected(self) -> Array:
        """Mask of the views with detected corners, shape (V, U)."""
        return np.asarray(np.isfinite(self.pixels).all(-1).any(-1))


@dataclass(frozen=True)
class Adjusted:
    """Result of the adjustment."""

    parameters: Array  # `clplen.lightfield.metric.ray_model.PARAMETERS`
    deviations: Array  # One standard deviation of each
    poses: Array  # Rotation vector and translation of each board, shape (boards, 6)
    # Computed minus detected corners (x, y) of each board in pixels, shape (V, U, n, 2); NaN if not
    # detected or excluded
    residuals: tuple[Array, ...]
    left_out: int  # Number of detected corners that are excluded


def adjusted(sightings: list[Sighting], shape: Shape, parameters: Array, poses: Array) -> Adjusted:
    """Refine initial values by least squares of the residuals."""
    spread = _spread_of(shape)
    values = np.concatenate([np.linalg.pinv(spread) @ parameters, poses.ravel()])
    detected = [np.asarray(np.isfinite(board.pixels).all(-1)) for board in sightings]
    problem = _Problem(sightings, detected, spread)
    values = _minimum(problem, values, robust=True)
    residuals = problem.residuals(values)
    limit = _OUTLIER * _deviation(residuals)
    inliers = [
        mask & (np.linalg.norm(np.nan_to_num(part), axis=-1) <= limit)
        for mask, part in zip(detected, residuals, strict=True)
    ]
    problem = _Problem(sightings, inliers, spread)
    values = _minimum(problem, values, robust=False)
    residuals = problem.residuals(values)
    variance = _variance(problem, values)
    return Adjusted(
        spread @ values[: spread.shape[1]],
        np.sqrt(np.einsum("ij,jk,ik->i", spread, variance, spread)),
        values[spread.shape[1] :].reshape(-1, 6),
        tuple(residuals),
        sum(int(mask.sum()) for mask in detected) - sum(int(mask.sum()) for mask in inliers),
    )


def _spread_of(shape: Shape) -> Array:
    """Return the matrix (15, n) from the free variables to the parameters.

    e_y = -e_x fixes the (s, t) plane on the axis; a single row or column has equal steps.
    """
    spread = np.delete(np.eye(15), 9, axis=1)
    spread[9, 8] = -1
    ties = [] if min(shape[:2]) > 1 else [(1, 0), (3, 2)] if shape[0] == 1 else [(0, 1), (2, 3)]
    for dependent, independent in ties:
        spread[dependent, independent] = 1
    return np.delete(spread, [dependent for dependent, _ in ties], axis=1)


def _minimum(problem: _Problem, values: Array, *, robust: bool) -> Array:
    """Minimise the sum of squares by the method of Levenberg and Marquardt.

    With ``robust`` the sum is Huber's, linear in large residuals.
    """
    damping = 1e-3
    residuals = problem.residuals(values)
    cost = problem.cost(residuals, values, robust=robust)
    for _ in range(_MAX_STEPS):
        normal, right = problem.normal(values, robust=robust)
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal / np.outer(scale, scale)
        for _trial in range(_MAX_TRIALS):
            damped = normal + damping * np.eye(len(normal))
            step = np.linalg.solve(damped, -right / scale) / scale
            residuals = problem.residuals(values + step)
            trial_cost = problem.cost(residuals, values + step, robust=robust)
            if trial_cost <= cost:
                break
            damping *= 8
        else:
            break
        gain, cost, values, damping = (
            cost - trial_cost,
            trial_cost,
            values + step,
            max(damping / 8, 1e-12),
        )
        if gain <= _MIN_GAIN * cost:
            break
    return values


def _deviation(residuals: list[Array]) -> float:
    """Return the standard deviation of the residuals, robust to outliers."""
    all_residuals = np.concatenate([part[np.isfinite(part)] for part in residuals])
    return max(1.4826 * float(np.median(np.abs(all_residuals))), _MIN_DEVIATION)


def _variance(problem: _Problem, values: Array) -> Array:
    """Return the covariance of the adjusted parameters, without the poses."""
    normal, _right = problem.normal(values, robust=False)
    residuals = problem.residuals(values)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True, rcond=1e-15)
    squares = sum(float(np.nansum(part**2)) for part in residuals)
    degrees_of_freedom = max(
        sum(int(np.isfinite(part).sum()) for part in residuals) - len(values), 1
    )
    count = problem.spread.shape[1]
    return np.asarray(
        (inverse * squares / degrees_of_freedom / np.outer(scale, scale))[:count, :count]
    )


class _Problem:
    """Residuals of the corners in use, and the normal equations."""

    def __init__(self, sightings: list[Sighting], masks: list[Array], spread: Array) -> None:
        self.spread = spread
        self.sightings = sightings
        self.masks = masks
        self.views = []
        for board in sightings:
            V, U = board.pixels.shape[:2]
            j, i = np.nonzero(board.detected)
            self.views.append(np.stack([i - (U - 1) / 2, j - (V - 1) / 2], -1))

    def residuals(self, values: Array) -> list[Array]:
        """Return computed minus detected corners of each board, (V, U, n, 2); NaN if excluded."""
        boards = []
        for number, (board, mask) in enumerate(zip(self.sightings, self.masks, strict=True)):
            points, _ = placed(board.flat, self._pose(number, values))
            with np.errstate(all="ignore"):  # of trial steps, which their cost rejects
                pixel = pixels_of(self._parameters(values), self.views[number], points)
            residual = np.full(board.pixels.shape, np.nan)
            residual[board.detected] = pixel - board.pixels[board.detected]
            residual[~mask] = np.nan
            boards.append(residual)
        return boards

    def cost(self, residuals: list[Array], values: Array, *, robust: bool) -> float:
        """Return the sum that is minimised."""
        parameters = self._parameters(values)
        total = float(((parameters[10:12] * _PRIOR) ** 2).sum())
        if not (parameters[4:6] > 0).all():
            return np.inf
        for residual, mask in zip(residuals, self.masks, strict=True):
            part = residual[mask]
            if not np.isfinite(part).all():
                return np.inf
            squares = (part**2).sum(-1)
            total += float((_huber(squares) if robust else squares).sum())
        return total

    def normal(self, values: Array, *, robust: bool) -> tuple[Array, Array]:
        """Return matrix and right side of the normal equations, shapes (n, n) and (n,)."""
        count = self.spread.shape[1]
        matrix, right = np.zeros((len(values), len(values))), np.zeros(len(values))
        prior = self.spread[10:12] * _PRIOR
        matrix[:count, :count] = prior.T @ prior
        right[:count] = prior.T @ (prior @ values[:count])
        for number, (board, used) in enumerate(zip(self.sightings, self.masks, strict=True)):
            pixel, by_parameters, by_pose = self._pixels(number, values)
            mask = used[board.detected]
            residual = (pixel - board.pixels[board.detected])[mask]
            slope = np.concatenate([by_parameters[mask] @ self.spread, by_pose[mask]], -1)
            if robust:
                size = np.linalg.norm(residual, axis=-1)
                weight = np.sqrt(_HUBER_LIMIT / np.maximum(size, _HUBER_LIMIT))[:, None]
                residual, slope = residual * weight, slope * weight[..., None]
            slope = slope.reshape(-1, slope.shape[-1])
            first = count + 6 * number
            index = np.r_[:count, first : first + 6]
            matrix[np.ix_(index, index)] += slope.T @ slope
            right[index] += slope.T @ residual.ravel()
        return matrix, right

    def _pixels(self, number: int, values: Array) -> tuple[Array, Array, Array]:
        """Return the pixels of a board's corners in its views, and their derivatives."""
        points, by_pose = placed(self.sightings[number].flat, self._pose(number, values))
        pixel, by_parameters, by_points = pixels_and_slopes(
            self._parameters(values), self.views[number], points
        )
        return pixel, by_parameters, by_points @ by_pose

    def _parameters(self, values: Array) -> Array:
        return np.asarray(self.spread @ values[: self.spread.shape[1]])

    def _pose(self, number: int, values: Array) -> Array:
        first = self.spread.shape[1] + 6 * number
        return values[first : first + 6]


def _huber(squares: Array) -> Array:
    """Return squares of residuals up to the limit, linear beyond."""
    beyond = 2 * _HUBER_LIMIT * np.sqrt(squares) - _HUBER_LIMIT**2
    return np.where(squares < _HUBER_LIMIT**2, squares, beyond)


def placed(flat: Array, pose: Array) -> tuple[Array, Array]:
    """Return points of a board in space, (n, 3), and their derivatives by its pose, (n, 3, 6).

    Derivatives by the rotation vector follow Gallego and Yezzi (2015).
    """
    turn, far = pose[:3], pose[3:]
    R = rotation(turn)
    points = flat @ R.T
    by_pose = np.empty((len(flat), 3, 6))
    by_pose[..., 3:] = np.eye(3)
    square = turn @ turn
    for axis in range(3):
        unit = np.eye(3)[axis]
        if square < 1e-20:
            change = _cross(unit)
        else:
            change = turn[axis] * _cross(turn) + _cross(np.cross(turn, (np.eye(3) - R) @ unit))
            change = change / square
        by_pose[..., axis] = points @ change.T
    return points + far, by_pose


def rotation(turn: Array) -> Array:
    """Return the matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-10:
        return np.eye(3) + _cross(turn)
    K = _cross(turn / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def _cross(a: Array) -> Array:
    """Return the matrix of a cross product a x."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
