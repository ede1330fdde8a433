"""Intrinsics of a light-field camera: rays of pixels, pixels of points, metric depth."""

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

_EXACT = 1e-6  # of the largest entry of a row of H
_PARALLEL = 1e-4  # pixels a view step at infinity: below it views are parallel


@dataclass(frozen=True, repr=False, eq=False)
class Intrinsics(OneLine):
    """Rays of the pixels of a light-field camera, from `calibrate`.

    Pixel (k, l) of view (i, j) sees along a ray [s, t, u, v, 1] = H [i, j, k, l, 1] (Dansereau,
    Pizarro and Williams 2013). i is the column and j the row of the view, k the column and l the
    row of the pixel: the sample is L[j, i, l, k]. (s, t) is the ray's position on the plane of the
    views in metres, x right and y down; (u, v) is its direction, x and y per z. Rays are distorted:
    with r the distance of the true direction from b, (u, v) = b + (1 + k1 r^2 + k2 r^4 + k3 r^6)
    (true - b). The middle of the middle view has s = t = 0, and z counts from the plane of the
    views. That plane may lie anywhere along the axis, as the board poses compensate it. `calibrate`
    puts it where the pixels of a view meet, H13 = H24 = 0, or midway if rows and columns meet at
    different distances, H13/H33 = -H24/H44.

    Attributes
    ----------
    matrix : numpy.ndarray
        Matrix H, float64, shape (5, 5): H11 H13 H15, H22 H24 H25, H31 H33 H35, H42 H44 H45 and
        H55 = 1, 0 elsewhere (1-based rows and columns).
    distortion : numpy.ndarray
        Distortion b_u, b_v, k1, k2, k3; float64, shape (5,).
    shape : tuple of int
        Shape (V, U, y, x) of the light fields.
    rms : float
        Root mean square distance between computed and detected corners, in pixels.
    board : tuple of int
        Number (rows, columns) of inner corners of the boards.
    spacing : float
        Distance between corners in metres.
    board_rms : numpy.ndarray
        Value of ``rms`` for each board, shape (boards,); NaN for excluded boards.
    view_rms : numpy.ndarray
        Value of ``rms`` for each view, shape (V, U); NaN for views without a board.
    deviations : numpy.ndarray
        Standard deviation of the entries of H, shape (5, 5), for independent noise of all
        corners; 0 for fixed entries.

    Raises
    ------
    ValueError
        If the matrix has other non-zero entries, is not finite, or has a wrong direction.
    ShapeError
        If an array has a wrong shape.

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
            raise ShapeError(f"shape must be (V, U, y, x), got {self.shape!r}.")
        V, U = shape[:2]
        shapes: dict[str, tuple[int, ...]] = {"matrix": (5, 5), "distortion": (5,)}
        for name, expected in (shapes | {"view_rms": (V, U), "deviations": (5, 5)}).items():
            if getattr(self, name) is None:
                continue
            values = np.array(real_array(getattr(self, name), name, np.float64))
            if values.shape != expected:
                raise ShapeError(f"{name} must have shape {expected}, got {values.shape}.")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
            if name in shapes and not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite, but includes NaN or infinity.")
        object.__setattr__(self, "shape", shape)
        self._check_matrix()

    def _check_matrix(self) -> None:
        """Reject a matrix that does not describe a camera."""
        H = self.matrix
        if not (H[2, 2] > 0 and H[3, 3] > 0):
            raise ValueError(
                f"H33 and H44, directions a pixel, must be positive, got {H[2, 2]:g} and "
                f"{H[3, 3]:g}."
            )
        if H[0, 0] == 0 or H[1, 1] == 0:
            raise ValueError("H11 and H22, metres between views, must be other than 0.")
        with np.errstate(over="ignore", invalid="ignore"):  # numbers near 1.8e308
            expected = matrix_of(self._parameters, self.shape)
            scale = np.abs(H[:, :4]).max(1, keepdims=True) * float(max(self.shape))
            scale[4] = 1
            limit = np.minimum(_EXACT * scale, sys.float_info.max)
            wrong = np.argwhere(~(np.abs(H - expected) <= limit))
        if len(wrong):
            row, column = wrong[0]
            raise ValueError(
                f"H{row + 1}{column + 1} must be {expected[row, column]:g}, got "
                f"{H[row, column]:g}: H has 12 free numbers, and the middle of the middle view has "
                "s = t = 0."
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
        """Distance of zero disparity in metres; inf for parallel views.

        The mean over rows and columns; also inf if objects at infinity have a positive disparity.
        """
        H = self.matrix
        inverse = -(H[2, 0] / H[0, 0] + H[3, 1] / H[1, 1]) / 2
        return float(1 / inverse) if inverse * H[0, 0] / H[2, 2] > _PARALLEL else np.inf

    def rays(self, i: ArrayLike, j: ArrayLike, k: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """Return the rays of pixels, without distortion.

        Parameters
        ----------
        i, j : array_like
            Column and row of views, fractions included.
        k, l : array_like
            Column and row of pixels, whose centres are integers.

        Returns
        -------
        numpy.ndarray
            s, t in metres and the true direction u, v; shape (..., 4), float64. The ray's point at
            the distance z is (s + z u, t + z v, z). NaN where the distortion folds back.
        """
        indices = (real_array(a, "Rays", np.float64) for a in (i, j, k, l))
        index = np.stack(np.broadcast_arrays(*indices), -1)
        rays = index @ self.matrix[:4, :4].T + self.matrix[:4, 4]
        rays[..., 2:] = undistorted(rays[..., 2:], self.distortion)
        return rays

    def project(self, points: ArrayLike) -> Array:
        """Project points to pixels in each view.

        Parameters
        ----------
        points : array_like
            Points x, y, z in metres, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            Pixels (y, x), shape (V, U, n, 2), float64; NaN for points behind the views and for
            non-finite points.
        """
        at = real_array(points, "points", np.float64)
        if at.ndim != 2 or at.shape[1] != 3:
            raise ShapeError(f"points must have shape (n, 3), got {at.shape}.")
        V, U = self.shape[:2]
        (i, k), (j, l) = middles(self.shape)  # noqa: E741
        row, column = np.mgrid[:V, :U].reshape(2, -1)
        behind = ~((at[:, 2] > 0) & np.isfinite(at).all(1))
        safe = np.where(behind[:, None], [0.0, 0.0, 1.0], at)
        pixels = pixels_of(self._parameters, np.stack([column - i, row - j], -1), safe)
        pixels[:, behind] = np.nan
        return (pixels + np.array([k, l]))[..., ::-1].reshape(V, U, len(at), 2)

    def disparity(self, z: ArrayLike) -> Array:
        """Compute the disparity along x of points on the axis.

        Parameters
        ----------
        z : array_like
            Distance from the plane of the views in metres, positive, or inf.

        Returns
        -------
        numpy.ndarray
            Disparity (H11 + z H31)/(H13 + z H33) in pixels a view step, nearer larger; float64.

        Raises
        ------
        ValueError
            If a distance is not positive.
        """
        distance = real_array(z, "z", np.float64)
        if not (distance > 0).all():
            raise ValueError(f"z must be positive, in metres, got {z!r}.")
        H = self.matrix
        return np.asarray((H[0, 0] / distance + H[2, 0]) / (H[0, 2] / distance + H[2, 2]))

    def depth(self, disparity: ArrayLike) -> Array:
        """Compute the distance of a disparity, the inverse of `disparity`.

        Parameters
        ----------
        disparity : array_like
            Disparity in pixels a view step along x, nearer larger. The result holds near the axis
            of distorted light fields, and everywhere after `rectify_views`.

        Returns
        -------
        numpy.ndarray
            Distance z in metres, float64: (H11 - d H13)/(d H33 - H31); inf at the disparity of
            infinity, NaN beyond it and for NaN.
        """
        d = real_array(disparity, "disparity", np.float64)
        H = self.matrix
        with np.errstate(all="ignore"):
            numerator, denominator = H[0, 0] - d * H[0, 2], d * H[2, 2] - H[2, 0]
            z = numerator / denominator
        return np.where(denominator == 0, np.inf, np.where(z > 0, z, np.nan))

    @property
    def rectified(self) -> Intrinsics:
        """Intrinsics of the light field returned by `rectify_views`.

        No distortion, square pixels, pinholes on an even grid (H13 = H24 = 0), the axis through the
        middle of the pictures, and zero disparity at `focus` for rows and columns.
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
        """Lengths of the rectified light field for `metric_depth` and `points_of`.

        ``baseline`` in metres, ``focal_length`` 1 with its ``pixel_pitch``, and ``focus_distance``
        in metres, None if infinite.
        """
        flat = self.rectified
        return {
            "baseline": abs(flat.baseline),
            "focal_length": 1.0,
            "pixel_pitch": float(flat.matrix[2, 2]),
            "focus_distance": flat.focus if is_finite(flat.focus) else None,
        }
