"""Rays of the pixels of a light-field camera, and the pixels of points, with derivatives.

After Dansereau, Pizarro and Williams (CVPR 2013): [s, t, u, v, 1] = H [i, j, k, l, 1] with the
position (s, t) and the distorted direction (u, v), whose radial distortion is about (b_u, b_v).
Fifteen parameters define H and the distortion:

    s = H11 i' + e_x H33 k'    u = H31 i' + H33 k' + u0    i' = i - (U - 1)/2, k' = k - (nx - 1)/2

and t, v likewise from j' and l', so that the middle pixel of the middle view has s = t = 0. With
e_x = 0 each view is a pinhole along x, else a pinhole at the distance -e_x from the (s, t) plane.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
Shape = tuple[int, int, int, int]

PARAMETERS = (
    *("H11", "H22", "H31", "H42", "H33", "H44", "u0", "v0", "e_x", "e_y"),
    *("b_u", "b_v", "k1", "k2", "k3"),
)
_ROUNDS = 12  # maximum iterations of Newton's method
_TOLERANCE = 1e-13  # slope


def distorted(direction: Array, distortion: Array) -> tuple[Array, Array, Array]:
    """Apply the distortion to directions; return also derivatives by direction and distortion."""
    b, (k1, k2, k3) = distortion[:2], distortion[2:]
    offset = direction - b
    r2 = (offset**2).sum(-1)
    scale = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # twice the derivative of the scale by r^2
    by_direction = slope[..., None, None] * offset[..., :, None] * offset[..., None, :]
    by_direction[..., 0, 0] += scale
    by_direction[..., 1, 1] += scale
    by_distortion = np.empty((*offset.shape, 5))
    by_distortion[..., :2] = np.eye(2) - by_direction
    powers = r2[..., None] ** np.arange(1, 4)
    by_distortion[..., 2:] = offset[..., :, None] * powers[..., None, :]
    return b + scale[..., None] * offset, by_direction, by_distortion


def undistorted(direction: Array, distortion: Array) -> Array:
    """Invert `distorted` by Newton's method; NaN without convergence."""
    direction_estimate = np.array(direction)
    failed = np.zeros(direction_estimate.shape[:-1], bool)
    for _ in range(_ROUNDS):
        image, slope, _by = distorted(direction_estimate, distortion)
        error = image - direction
        failed = ~(np.abs(error).max(-1) < _TOLERANCE)
        if not failed.any():
            break
        direction_estimate = direction_estimate - _solved(slope, error)
    determinant = np.linalg.det(distorted(direction_estimate, distortion)[1])
    failed = ~(np.abs(distorted(direction_estimate, distortion)[0] - direction).max(-1) < 1e-9)
    direction_estimate[failed | (determinant <= 0)] = np.nan  # beyond the fold of the distortion
    return direction_estimate


def _solved(matrix: Array, right: Array) -> Array:
    """Solve 2 x 2 systems; singular systems give non-finite values."""
    (a, b), (c, d) = (
        (matrix[..., 0, 0], matrix[..., 0, 1]),
        (matrix[..., 1, 0], matrix[..., 1, 1]),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1 / (a * d - b * c)
        x = (d * right[..., 0] - b * right[..., 1]) * share
        y = (a * right[..., 1] - c * right[..., 0]) * share
    return np.stack([x, y], -1)


def matrix_of(parameters: Array, shape: Shape) -> Array:
    """Build H, shape (5, 5), from the parameters for a shape (V, U, y, x)."""
    H = np.eye(5)
    for axis in range(2):
        step, converge, pitch, middle, far = parameters[axis:10:2]
        tilt = far * pitch
        view, pixel = middles(shape)[axis]
        H[axis, axis], H[axis, axis + 2] = step, tilt
        H[axis + 2, axis], H[axis + 2, axis + 2] = converge, pitch
        H[axis, 4] = -step * view - tilt * pixel
        H[axis + 2, 4] = middle - converge * view - pitch * pixel
    return H


def parameters_of(H: Array, distortion: Array, shape: Shape) -> Array:
    """Return the parameters of H and the distortion, the inverse of `matrix_of`."""
    parameters = np.empty(15)
    for axis in range(2):
        view, pixel = middles(shape)[axis]
        step, tilt, converge, pitch = H[axis::2, axis::2][:2, :2].ravel()
        middle = H[axis + 2, 4] + converge * view + pitch * pixel
        parameters[axis:10:2] = step, converge, pitch, middle, tilt / pitch
    parameters[10:] = distortion
    return parameters


def middles(shape: Shape) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the middle view and pixel along x, (i, k), and along y, (j, l)."""
    V, U, ny, nx = shape
    return ((U - 1) / 2, (nx - 1) / 2), ((V - 1) / 2, (ny - 1) / 2)


def pixels_of(parameters: Array, views: Array, points: Array) -> Array:
    """Return the pixels of points in views, without derivatives."""
    return _intersections(parameters, views[:, None], points)[0]


def pixels_and_slopes(parameters: Array, views: Array, points: Array) -> tuple[Array, Array, Array]:
    """Return the pixels of points in views, with derivatives by parameters and points."""
    pixel, direction, at = _intersections(parameters, views[:, None], points)
    by_parameters, by_points = _derivatives(
        views[:, None], direction, at, tuple(parameters[2:10].reshape(4, 2))
    )
    return pixel, by_parameters, by_points


def _intersections(
    parameters: Array, views: Array, points: Array
) -> tuple[Array, Array, tuple[Array, Array, Array, Array]]:
    """Return pixels and true directions of the rays through points, and derivative terms."""
    step, converge, pitch, middle, e = parameters[:10].reshape(5, 2)
    distortion = parameters[10:]
    start = step * views - points[:, :2] - e * (converge * views + middle)
    Z = points[:, 2:]
    direction = -(step * views - points[:, :2]) / Z
    for _ in range(_ROUNDS if e.any() else 1):
        image, slope, by_distortion = distorted(direction, distortion)
        residual = Z * direction + e * image + start  # 0 where the ray meets the point
        inner = e[:, None] * slope + Z[..., None] * np.eye(2)
        if not e.any() or np.abs(residual).max() < _TOLERANCE * np.abs(Z).max():
            break
        direction = direction - _solved(inner, residual)
    pixel = (image - converge * views - middle) / pitch
    return pixel, direction, (image, slope, by_distortion, inner)


def _derivatives(
    views: Array,
    direction: Array,
    terms: tuple[Array, Array, Array, Array],
    columns: tuple[Array, ...],
) -> tuple[Array, Array]:
    """Return the derivatives of the pixel by parameters and points (implicit function)."""
    image, slope, by_distortion, inner = terms
    converge, pitch, middle, e = columns
    # Derivative of the distorted direction by minus the condition
    turn = slope @ np.linalg.inv(inner)
    shape = direction.shape[:2]
    condition = np.zeros((*shape, 2, 18))  # its derivatives by 15 parameters and the point
    for axis in range(2):
        view_offset = views[..., axis]
        condition[..., axis, axis] = view_offset
        condition[..., axis, 2 + axis] = -e[axis] * view_offset
        condition[..., axis, 6 + axis] = -e[axis]
        leaned = image[..., axis] - converge[axis] * view_offset - middle[axis]
        condition[..., axis, 8 + axis] = leaned
        condition[..., axis, 15 + axis] = -1.0
    condition[..., 10:15] = e[:, None] * by_distortion
    condition[..., 17] = direction
    derivatives = -turn @ condition
    derivatives[..., 10:15] += by_distortion
    for axis in range(2):
        view_offset = views[..., axis]
        derivatives[..., axis, 2 + axis] -= view_offset
        derivatives[..., axis, 6 + axis] -= 1
        leaned = image[..., axis] - converge[axis] * view_offset - middle[axis]
        derivatives[..., axis, 4 + axis] -= leaned / pitch[axis]
    derivatives /= pitch[:, None]
    return derivatives[..., :15], derivatives[..., 15:]
