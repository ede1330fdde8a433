"""Light fields of checkerboards, traced ray by ray in float64 through a camera that is known.

Independent of the calibration: rays are followed from pixels to the board, and distortion is taken
away by iteration.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

Array = np.ndarray[Any, Any]
_SAMPLES = 2  # a pixel and axis, each averaged over its share of the pixel


@dataclass(frozen=True)
class KnownCamera:
    """A camera [s, t, u, v, 1] = H [i, j, k, l, 1] with radial distortion of (u, v).

    Attributes
    ----------
    matrix : numpy.ndarray
        H, shape (5, 5).
    distortion : tuple of float
        b_u, b_v, k1, k2, k3.
    shape : tuple of int
        (V, U, y, x).
    """

    matrix: Array
    distortion: tuple[float, ...]
    shape: tuple[int, int, int, int]

    def rays(self, i: Array, j: Array, k: Array, l: Array) -> Array:  # noqa: E741
        """(s, t, u, v) in space of pixels, which need not be whole numbers."""
        index = np.broadcast_arrays(i, j, k, l, 1.0)
        s, t, u, v = (sum(h * n for h, n in zip(row, index, strict=True) if h)
                      for row in self.matrix[:4])
        bu, bv, k1, k2, k3 = self.distortion
        x, y = x0, y0 = u - bu, v - bv
        for _ in range(50):
            r = x * x + y * y
            scale = 1 + r * (k1 + r * (k2 + r * k3))
            moved = np.abs(x0 / scale - x).max()
            x, y = x0 / scale, y0 / scale
            if moved < 1e-12:
                break
        return np.stack([s, t, x + bu, y + bv])


def made_camera(
    shape: tuple[int, int, int, int],
    *,
    steps: tuple[float, float],
    converge: tuple[float, float],
    pitch: tuple[float, float],
    centre: tuple[float, float] = (0.0, 0.0),
    tilt: tuple[float, float] = (0.0, 0.0),
    distortion: tuple[float, ...] = (0.0,) * 5,
) -> KnownCamera:
    """A camera by its 10 numbers, each pair along x first, then along y.

    Parameters
    ----------
    shape : tuple of int
        (V, U, y, x).
    steps : tuple of float
        H11, H22 in metres.
    converge, pitch : tuple of float
        H31, H42 and H33, H44.
    centre : tuple of float
        (u, v) of the middle pixel of the middle view.
    tilt : tuple of float
        H13, H24 in metres a pixel.
    distortion : tuple of float
        b_u, b_v, k1, k2, k3.
    """
    H = np.eye(5)
    for axis in range(2):
        view, pixel = (shape[1 - axis] - 1) / 2, (shape[3 - axis] - 1) / 2
        H[axis, axis], H[axis, axis + 2] = steps[axis], tilt[axis]
        H[axis + 2, axis], H[axis + 2, axis + 2] = converge[axis], pitch[axis]
        H[axis, 4] = -steps[axis] * view - tilt[axis] * pixel
        H[axis + 2, 4] = centre[axis] - converge[axis] * view - pitch[axis] * pixel
    return KnownCamera(H, distortion, shape)


@dataclass(frozen=True)
class Pose:
    """Where a board is held: X = R (column, row, 0) spacing + t, about the board's middle."""

    distance: float
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # degrees about x, y, z
    aside: tuple[float, float] = (0.0, 0.0)  # x and y of its middle, metres

    @property
    def rotation(self) -> Array:
        return Rotation.from_euler("xyz", self.turn, degrees=True).as_matrix()

    @property
    def middle(self) -> Array:
        return np.array([*self.aside, self.distance])


def corners_in_space(pose: Pose, board: tuple[int, int], spacing: float) -> Array:
    """Shape (rows columns, 3): inner corners row by row, metres."""
    row, column = np.mgrid[: board[0], : board[1]].reshape(2, -1)
    flat = np.stack([column - (board[1] - 1) / 2, row - (board[0] - 1) / 2, 0 * row]) * spacing
    return (pose.rotation @ flat).T + pose.middle


def photographed(
    camera: KnownCamera,
    pose: Pose,
    board: tuple[int, int],
    spacing: float,
    *,
    noise: float = 0.01,
    blur: float = 0.6,
    seed: int = 0,
    samples: int = _SAMPLES,
) -> Array:
    """The board as the camera sees it: float32, shape (V, U, y, x), black .1 and white .9.

    Samples of a part of a pixel each are blurred by the lens, a Gaussian of ``blur`` pixels, and
    summed over the pixels.
    """
    V, U, ny, nx = camera.shape
    random = np.random.default_rng(seed)
    fine = [(np.arange(n * samples) + 0.5) / samples - 0.5 for n in (ny, nx)]
    picture = np.empty(camera.shape, np.float32)

    def one(view: tuple[int, int]) -> None:
        rays = camera.rays(view[1], view[0], fine[1][None, :], fine[0][:, None])
        seen = gaussian_filter(_shade(rays, pose, board, spacing), blur * samples, mode="nearest")
        picture[view] = seen.reshape(ny, samples, nx, samples).mean((1, 3))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(one, np.ndindex(V, U)))
    picture += noise * random.standard_normal(picture.shape, np.float32)
    return picture


def _shade(rays: Array, pose: Pose, board: tuple[int, int], spacing: float) -> Array:
    """What rays (s, t, u, v), each of a sample as wide as their distance, see of the board."""
    s, t, u, v = rays
    R, middle = pose.rotation, pose.middle
    normal = R[:, 2]
    z = (normal @ middle - normal[0] * s - normal[1] * t) / (
        normal[0] * u + normal[1] * v + normal[2]
    )
    X = np.stack([s + z * u, t + z * v, z]) - middle[:, None, None]
    x = np.tensordot(R[:, 0], X, 1) / spacing + (board[1] + 1) / 2  # squares from the outline
    y = np.tensordot(R[:, 1], X, 1) / spacing + (board[0] + 1) / 2
    shade = np.full(x.shape, 0.9)
    pattern, cover = np.ones_like(x), np.ones_like(x)
    for a, count in ((x, board[1] + 1), (y, board[0] + 1)):
        width = np.hypot(*np.gradient(a))
        pattern *= (_triangle(a + width / 2) - _triangle(a - width / 2)) / width
        low, high = np.clip(a - width / 2, 0, count), np.clip(a + width / 2, 0, count)
        cover *= (high - low) / width
    return (shade - 0.4 * cover * (1 + pattern)).astype(np.float32)


def _triangle(a: Array) -> Array:
    """Integral of a square wave of period 2, +1 from 0 to 1."""
    return 1 - np.abs(a % 2 - 1)


def poses_at(distances: Sequence[float], seed: int = 3, *, tilt: float = 35.0) -> list[Pose]:
    """Boards at these distances, each tilted another way."""
    random = np.random.default_rng(seed)
    made = []
    for number, z in enumerate(distances):
        way = 2.4 * number  # the golden angle: ways spread over the circle
        strength = tilt * (0.6 + 0.4 * random.random())
        turn = (strength * np.cos(way), strength * np.sin(way), random.uniform(-15, 15))
        made.append(Pose(z, turn, tuple(random.uniform(-0.03, 0.03, 2) * z)))
    return made
