"""Intrinsics of a light-field camera: rays of pixels, pixels of points, metres of disparities."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import is_finite, is_integer, real_array
from clplen.errors import ShapeError
from clplen.lightfield.metric.ray_model import (
    Shape,
    matrix_of,
    middles,
    parameters_of,
    pixels_of,
    undistorted,
)
from clplen.reprs import OneLine

Array = np.ndarray[Any, Any]

_EXACT = 1e-6  # of the largest number of a row of H
_PARALLEL = 1e-4  # pixels a view step, of what is infinitely far: then the views are parallel


@dataclass(frozen=True, repr=False, eq=False)
class Intrinsics(OneLine):
    """Rays of the pixels of a light-field camera; made by `calibrate`.

    Pixel (k, l) of view (i, j) sees along a ray [s, t, u, v, 1] = H [i, j, k, l, 1] (Dansereau,
    Pizarro and Williams 2013): i is the column and j the row of the view, k the column and l the
    row of the pixel, so that it is the sample L[j, i, l, k]. (s, t) is where the ray meets the
    plane of the views, x right and y down, in metres; (u, v) its direction, x and y per z. Rays are
    distorted: with r the distance of the true direction from b, (u, v) = b + (1 + k1 r^2 + k2 r^4 +
    k3 r^6) (true - b). The middle of the middle view has s = t = 0, and z counts from the plane of
    the views. That plane may lie anywhere along the axis, as the poses of boards move along:
    `calibrate` puts it where the pixels of a view meet, H13 = H24 = 0, or in the middle where rows
    and columns meet apart, H13/H33 = -H24/H44.

    Attributes
    ----------
    matrix : numpy.ndarray
        H, float64, shape (5, 5): H11 H13 H15, H22 H24 H25, H31 H33 H35, H42 H44 H45 and H55 = 1,
        0 elsewhere (rows and columns counted from 1).
    distortion : numpy.ndarray
        b_u, b_v, k1, k2, k3; float64, shape (5,).
    shape : tuple of int
        (V, U, y, x) of the light fields.
    rms : float
        Distance of computed from found corners, root of the mean square, in pixels.
    board : tuple of int
        (rows, columns) of inner corners of the boards.
    spacing : float
        Distance between corners, in metres.
    board_rms : numpy.ndarray
        ``rms`` of each board, shape (boards,); NaN of boards that were left out.
    view_rms : numpy.ndarray
        ``rms`` of each view, shape (V, U); NaN of views that saw no board.
    deviations : numpy.ndarray
        One standard deviation of the numbers of H, shape (5, 5); 0 where they are fixed. Of noise
        that is independent in all corners.

    Raises
    ------
    ValueError
        If the matrix has other entries than those, is not finite, or sees the wrong way round.
    ShapeError
        If an array has another shape.

    Examples
    --------
    >>> H = np.diag([1e-3, 1e-3, 2e-3, 2e-3, 1.0])
    >>> H[:4, 4] = -H.diagonal()[:4] * (2, 2, 79.5, 59.5)
    >>> camera = clplen.lightfield.Intrinsics(H, np.zeros(5), (5, 5, 120, 160))
    >>> camera
    <Intrinsics of 5 x 5 views of 120 x 160 pixels, focal length 500 px, baseline 1 mm>
    >>> camera.project([(0, 0, 1.0)])[2, :, 0, 1].tolist()  # x in the middle row of views
    [80.5, 80.0, 79.5, 79.0, 78.5]
    >>> float(camera.disparity(1.0)), float(camera.depth(0.5))
    (0.5, 1.0)
    """

    matrix: Array
    distortion: Array
    shape: Shape
    rms: float = float("nan")
    board: tuple[int, int] | None = None
    spacing: float | None = None
    board_rms: Array | None = None
    view_rms: Array | None = None
    deviations: Array | None = None

    def __post_init__(self) -> None:
        shape = tuple(int(n) for n in self.shape[:4] if is_integer(n) and n >= 1)
        if len(shape) != 4:
            raise ShapeError(f"A light field has a shape (V, U, y, x), not {self.shape!r}.")
        V, U = shape[:2]
        shapes: dict[str, tuple[int, ...]] = {"matrix": (5, 5), "distortion": (5,)}
        for name, wanted in (shapes | {"view_rms": (V, U), "deviations": (5, 5)}).items():
            if getattr(self, name) is None:
                continue
            values = np.array(real_array(getattr(self, name), name, np.float64))
            if values.shape != wanted:
                raise ShapeError(f"{name} has shape {wanted}, not {values.shape}.")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
            if name in shapes and not np.isfinite(values).all():
                raise ValueError(f"{name} holds numbers that are NaN or infinite.")
        object.__setattr__(self, "shape", shape)
        self._check_matrix()

    def _check_matrix(self) -> None:
        """Refuse a matrix that is none of a camera."""
        H = self.matrix
        if not (H[2, 2] > 0 and H[3, 3] > 0):
            raise ValueError(
                f"H33 and H44, directions a pixel, are positive, not {H[2, 2]:g} and {H[3, 3]:g}."
            )
        if H[0, 0] == 0 or H[1, 1] == 0:
            raise ValueError("H11 and H22, metres between views, are not 0.")
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers near 1.8e308
            wanted = matrix_of(self._parameters, self.shape)
            scale = np.abs(H[:, :4]).max(1, keepdims=True) * float(max(self.shape))
            scale[4] = 1
            limit = np.minimum(_EXACT * scale, sys.float_info.max)
            wrong = np.argwhere(~(np.abs(H - wanted) <= limit))
        if len(wrong):
            row, column = wrong[0]
            raise ValueError(
                f"H{row + 1}{column + 1} is {H[row, column]:g}, and {wanted[row, column]:g} is "
                "needed: H holds 12 numbers, and the middle of the middle view has s = t = 0."
            )

    def __repr__(self) -> str:
        V, U, ny, nx = self.shape
        fit = f", rms {self.rms:.3g} px" if np.isfinite(self.rms) else ""
        return (
            f"<Intrinsics of {V} x {U} views of {ny} x {nx} pixels, focal length "
            f"{self.focal[1]:.4g} px, baseline {1e3 * self.baseline:.4g} mm{fit}>"
        )

    @cached_property
    def _parameters(self) -> Array:
        return parameters_of(self.matrix, self.distortion, self.shape)

    @property
    def focal(self) -> tuple[float, float]:
        """Focal lengths (y, x) of a view in pixels, 1/H44 and 1/H33."""
        return (float(1 / self.matrix[3, 3]), float(1 / self.matrix[2, 2]))

    @property
    def baseline(self) -> float:
        """Step H11 between neighbouring views of a row, in metres."""
        return float(self.matrix[0, 0])

    @property
    def focus(self) -> float:
        """Distance at which disparity is 0, in metres; inf if the views are parallel.

        By the mean of rows and columns; inf, too, where even what is infinitely far has a positive
        disparity.
        """
        H = self.matrix
        inverse = -(H[2, 0] / H[0, 0] + H[3, 1] / H[1, 1]) / 2
        return float(1 / inverse) if inverse * H[0, 0] / H[2, 2] > _PARALLEL else np.inf

    def rays(self, i: ArrayLike, j: ArrayLike, k: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """Return the rays of pixels, without distortion.

        Parameters
        ----------
        i, j : array_like
            Column and row of views, also between them.
        k, l : array_like
            Column and row of pixels, whose centres are whole numbers.

        Returns
        -------
        numpy.ndarray
            s, t in metres and the true direction u, v; shape (..., 4), float64. A point of the ray
            at a distance z is (s + z u, t + z v, z). NaN where the distortion folds back.
        """
        places = (real_array(a, "Rays", np.float64) for a in (i, j, k, l))
        index = np.stack(np.broadcast_arrays(*places), -1)
        rays = index @ self.matrix[:4, :4].T + self.matrix[:4, 4]
        rays[..., 2:] = undistorted(rays[..., 2:], self.distortion)
        return rays

    def project(self, points: ArrayLike) -> Array:
        """Return where each view sees points.

        Parameters
        ----------
        points : array_like
            x, y, z in metres, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            (y, x) in pixels, shape (V, U, n, 2), float64; NaN of points that are not before the
            views, or not finite.
        """
        at = real_array(points, "points", np.float64)
        if at.ndim != 2 or at.shape[1] != 3:
            raise ShapeError(f"Points are (x, y, z), shape (n, 3), not {at.shape}.")
        V, U = self.shape[:2]
        (i, k), (j, l) = middles(self.shape)  # noqa: E741
        row, column = np.mgrid[:V, :U].reshape(2, -1)
        behind = ~((at[:, 2] > 0) & np.isfinite(at).all(1))
        safe = np.where(behind[:, None], [0.0, 0.0, 1.0], at)
        pixels = pixels_of(self._parameters, np.stack([column - i, row - j], -1), safe)
        pixels[:, behind] = np.nan
        return (pixels + np.array([k, l]))[..., ::-1].reshape(V, U, len(at), 2)

    def disparity(self, z: ArrayLike) -> Array:
        """Return the disparity along x of points on the axis.

        Parameters
        ----------
        z : array_like
            Distance from the plane of the views in metres, positive, or inf.

        Returns
        -------
        numpy.ndarray
            (H11 + z H31)/(H13 + z H33) in pixels a view step, nearer is larger; float64.

        Raises
        ------
        ValueError
            If a distance is not positive.
        """
        far = real_array(z, "z", np.float64)
        if not (far > 0).all():
            raise ValueError(f"Distances are positive, in metres, not {z!r}.")
        H = self.matrix
        return np.asarray((H[0, 0] / far + H[2, 0]) / (H[0, 2] / far + H[2, 2]))

    def depth(self, disparity: ArrayLike) -> Array:
        """Return the distance of points of a disparity; the inverse of `disparity`.

        Parameters
        ----------
        disparity : array_like
            Pixels a view step along x, nearer is larger. Of distorted light fields it holds about
            the axis; of those by `rectify_views`, whose intrinsics are `rectified`, everywhere.

        Returns
        -------
        numpy.ndarray
            z in metres, float64: (H11 - d H13)/(d H33 - H31); inf at the disparity of what is
            infinitely far, NaN beyond it or where ``disparity`` is NaN.
        """
        d = real_array(disparity, "disparity", np.float64)
        H = self.matrix
        with np.errstate(all="ignore"):
            above, below = H[0, 0] - d * H[0, 2], d * H[2, 2] - H[2, 0]
            z = above / below
        return np.where(below == 0, np.inf, np.where(z > 0, z, np.nan))

    @property
    def rectified(self) -> Intrinsics:
        """Intrinsics of what `rectify_views` makes of a light field of this camera.

        No distortion, square pixels, pinholes on an even grid (H13 = H24 = 0), the axis through the
        middle of the pictures, and disparity 0 at one distance for rows and columns, `focus`.
        """
        H = self.matrix
        pitch = float(np.sqrt(H[2, 2] * H[3, 3]))
        steps = np.array([H[0, 0], H[1, 1]])
        parameters = np.zeros(15)
        parameters[:2] = steps
        parameters[2:4] = -steps / self.focus
        parameters[4:6] = pitch
        return Intrinsics(
            matrix_of(parameters, self.shape),
            np.zeros(5),
            self.shape,
            self.rms,
            self.board,
            self.spacing,
            self.board_rms,
            self.view_rms,
        )

    @property
    def lengths(self) -> dict[str, float | None]:
        """Lengths of the rectified light field, for `metric_depth` and `points_of`.

        ``baseline`` in metres, ``focal_length`` 1 with the ``pixel_pitch`` of it, and
        ``focus_distance`` in metres, None if infinite.
        """
        flat = self.rectified
        return {
            "baseline": abs(flat.baseline),
            "focal_length": 1.0,
            "pixel_pitch": float(flat.matrix[2, 2]),
            "focus_distance": flat.focus if is_finite(flat.focus) else None,
        }
