"""Intrinsics, distortion and poses of boards by least squares over all corners of all views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.lightfield.metric.ray_model import Shape, pixels_and_slopes, pixels_of

Array = np.ndarray[Any, Any]

_ROBUST = 0.5  # pixels from which a corner counts less, in the first pass
_OUTLIER = 6.0  # standard deviations beyond which a corner is left out of the second one
_LEAST = 0.02  # pixels that a standard deviation is at least taken for
_CENTRE = 0.05  # slope; how far the centre of distortion may be where no distortion tells it
_PRIOR = _LEAST / _CENTRE
_STEPS = 100
_TRIES = 12  # of a step, each damped more
_GAIN = 1e-9  # share of the sum by which a step must lower it


@dataclass(frozen=True)
class Sighting:
    """One board in all views."""

    flat: Array  # Corners on the board, (X, Y, 0) in metres, shape (n, 3)
    # Where views see them: (x, y) from the middle pixel, shape (V, U, n, 2); NaN: not seen
    pixels: Array

    @property
    def seen(self) -> Array:
        """Views that see any of it, shape (V, U)."""
        return np.asarray(np.isfinite(self.pixels).all(-1).any(-1))


@dataclass(frozen=True)
class Adjusted:
    """What fits the corners best."""

    parameters: Array  # `clplen.lightfield.metric.ray_model.PARAMETERS`
    deviations: Array  # One standard deviation of each
    poses: Array  # Rotation vector and translation of each board, shape (boards, 6)
    # (x, y) of computed minus found corners of each board, pixels, shape (V, U, n, 2); NaN where a
    # corner was not found or left out
    residuals: tuple[Array, ...]
    left_out: int  # Corners that were found and left out


def adjusted(sightings: list[Sighting], shape: Shape, parameters: Array, poses: Array) -> Adjusted:
    """Improve first values until the squares of the residuals are least."""
    spread = _spread_of(shape)
    values = np.concatenate([np.linalg.pinv(spread) @ parameters, poses.ravel()])
    known = [np.asarray(np.isfinite(board.pixels).all(-1)) for board in sightings]
    problem = _Problem(sightings, known, spread)
    values = _minimum(problem, values, robust=True)
    off = problem.residuals(values)
    limit = _OUTLIER * _deviation(off)
    kept = [
        mask & (np.linalg.norm(np.nan_to_num(part), axis=-1) <= limit)
        for mask, part in zip(known, off, strict=True)
    ]
    problem = _Problem(sightings, kept, spread)
    values = _minimum(problem, values, robust=False)
    off = problem.residuals(values)
    variance = _variance(problem, values)
    return Adjusted(
        spread @ values[: spread.shape[1]],
        np.sqrt(np.einsum("ij,jk,ik->i", spread, variance, spread)),
        values[spread.shape[1] :].reshape(-1, 6),
        tuple(off),
        sum(int(mask.sum()) for mask in known) - sum(int(mask.sum()) for mask in kept),
    )


def _spread_of(shape: Shape) -> Array:
    """Matrix (15, n) from what is adjusted to the parameters.

    e_y = -e_x, because the plane of (s, t) may lie anywhere along the axis. Of views in one row the
    step along y is taken for that along x, in one column alike.
    """
    spread = np.delete(np.eye(15), 9, axis=1)
    spread[9, 8] = -1
    tied = [] if min(shape[:2]) > 1 else [(1, 0), (3, 2)] if shape[0] == 1 else [(0, 1), (2, 3)]
    for loser, winner in tied:
        spread[loser, winner] = 1
    return np.delete(spread, [loser for loser, _ in tied], axis=1)


def _minimum(problem: _Problem, values: Array, *, robust: bool) -> Array:
    """Where the sum of squares is least, by the method of Levenberg and Marquardt.

    With ``robust`` the sum is Huber's, which grows in proportion to large residuals.
    """
    damping = 1e-3
    off = problem.residuals(values)
    cost = problem.cost(off, values, robust=robust)
    for _ in range(_STEPS):
        normal, right = problem.normal(values, robust=robust)
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal / np.outer(scale, scale)
        for _again in range(_TRIES):
            damped = normal + damping * np.eye(len(normal))
            step = np.linalg.solve(damped, -right / scale) / scale
            off = problem.residuals(values + step)
            tried = problem.cost(off, values + step, robust=robust)
            if tried <= cost:
                break
            damping *= 8
        else:
            break
        gain, cost, values, damping = cost - tried, tried, values + step, max(damping / 8, 1e-12)
        if gain <= _GAIN * cost:
            break
    return values


def _deviation(residuals: list[Array]) -> float:
    """Standard deviation of most of the residuals, which outliers do not change."""
    every = np.concatenate([off[np.isfinite(off)] for off in residuals])
    return max(1.4826 * float(np.median(np.abs(every))), _LEAST)


def _variance(problem: _Problem, values: Array) -> Array:
    """Covariance of the adjusted parameters, without those of the poses."""
    normal, _right = problem.normal(values, robust=False)
    off = problem.residuals(values)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True, rcond=1e-15)
    squares = sum(float(np.nansum(part**2)) for part in off)
    free = max(sum(int(np.isfinite(part).sum()) for part in off) - len(values), 1)
    count = problem.spread.shape[1]
    return np.asarray((inverse * squares / free / np.outer(scale, scale))[:count, :count])


class _Problem:
    """Residuals of the corners that are kept, and the normal equations."""

    def __init__(self, sightings: list[Sighting], kept: list[Array], spread: Array) -> None:
        self.spread = spread
        self.sightings = sightings
        self.kept = kept
        self.views = []
        for board in sightings:
            V, U = board.pixels.shape[:2]
            j, i = np.nonzero(board.seen)
            self.views.append(np.stack([i - (U - 1) / 2, j - (V - 1) / 2], -1))

    def residuals(self, values: Array) -> list[Array]:
        """Computed minus found corners of each board, shape (V, U, n, 2); NaN where not kept."""
        boards = []
        for number, (board, kept) in enumerate(zip(self.sightings, self.kept, strict=True)):
            points, _ = placed(board.flat, self._pose(number, values))
            with np.errstate(all="ignore"):  # of steps that are tried, and refused by their cost
                pixel = pixels_of(self._parameters(values), self.views[number], points)
            off = np.full(board.pixels.shape, np.nan)
            off[board.seen] = pixel - board.pixels[board.seen]
            off[~kept] = np.nan
            boards.append(off)
        return boards

    def cost(self, residuals: list[Array], values: Array, *, robust: bool) -> float:
        """The sum that is made least."""
        parameters = self._parameters(values)
        total = float(((parameters[10:12] * _PRIOR) ** 2).sum())
        if not (parameters[4:6] > 0).all():
            return np.inf
        for off, kept in zip(residuals, self.kept, strict=True):
            part = off[kept]
            if not np.isfinite(part).all():
                return np.inf
            squares = (part**2).sum(-1)
            total += float((_huber(squares) if robust else squares).sum())
        return total

    def normal(self, values: Array, *, robust: bool) -> tuple[Array, Array]:
        """Matrix and right side of the normal equations, shapes (n, n) and (n,)."""
        count = self.spread.shape[1]
        matrix, right = np.zeros((len(values), len(values))), np.zeros(len(values))
        prior = self.spread[10:12] * _PRIOR
        matrix[:count, :count] = prior.T @ prior
        right[:count] = prior.T @ (prior @ values[:count])
        for number, (board, kept) in enumerate(zip(self.sightings, self.kept, strict=True)):
            pixel, by_parameters, by_pose = self._pixels(number, values)
            mask = kept[board.seen]
            off = (pixel - board.pixels[board.seen])[mask]
            slope = np.concatenate([by_parameters[mask] @ self.spread, by_pose[mask]], -1)
            if robust:
                size = np.linalg.norm(off, axis=-1)
                weight = np.sqrt(_ROBUST / np.maximum(size, _ROBUST))[:, None]
                off, slope = off * weight, slope * weight[..., None]
            slope = slope.reshape(-1, slope.shape[-1])
            first = count + 6 * number
            where = np.r_[:count, first : first + 6]
            matrix[np.ix_(where, where)] += slope.T @ slope
            right[where] += slope.T @ off.ravel()
        return matrix, right

    def _pixels(self, number: int, values: Array) -> tuple[Array, Array, Array]:
        """Pixels of a board's corners in the views that see it, and their derivatives."""
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
    """Squares of residuals up to the limit, a line beyond it."""
    beyond = 2 * _ROBUST * np.sqrt(squares) - _ROBUST**2
    return np.where(squares < _ROBUST**2, squares, beyond)


def placed(flat: Array, pose: Array) -> tuple[Array, Array]:
    """Points of a board in space, shape (n, 3), and their derivatives by its pose, (n, 3, 6).

    Those of a rotation by its vector are of Gallego and Yezzi (2015).
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
    """The matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-10:
        return np.eye(3) + _cross(turn)
    K = _cross(turn / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def _cross(a: Array) -> Array:
    """The matrix of a cross product a x."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
