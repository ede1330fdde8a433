"""Pictures from the views of a light field: one view, a synthetic aperture, a surface, a slice."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral
from typing import Any, TypeVar

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.compute.arrays import Image, OnDevice
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.arrays.ray_samples import along_rays, checked_disparity
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.model.alpha_law import (
    AlphaLaw,
    require_overlap,
    require_steps_overlap,
    shifts,
    unit_steps,
)
from clplen.lightfield.model.apertures import Weights, aperture_weights
from clplen.lightfield.model.sampled_views import SampledViews

Views = TypeVar("Views", bound=SampledViews)
DisparityMap = np.ndarray[Any, np.dtype[np.float64]]

_ROUNDS = 8  # iterations of the fixed point in `carry_disparity`
_FLAT = 1e-9  # points on one line, relative to their spread


def plane_through(points: ArrayLike, shape: tuple[int, ...]) -> DisparityMap:
    """Return the disparity of every pixel on the plane through three or more points.

    A plane in space is a plane d = a + b y + c x in the disparities of a light field: d is linear
    in 1/z by the lens law, and perspective preserves planes.

    Parameters
    ----------
    points : array_like
        Points (y, x, d), shape (n, 3), n >= 3, with y, x in pixels of the centre view. Three are
        interpolated exactly, more by least squares.
    shape : tuple of int
        Size (y, x[, c]) of a view, as in ``lf.shape[2:]``.

    Returns
    -------
    numpy.ndarray
        Disparity, float64, shape (y, x), for ``refocus(lf, disparity=...)``.

    Raises
    ------
    ShapeError
        If the points are not (n, 3) with at least three.
    ValueError
        If a point is not finite, or the points lie on one line.

    Examples
    --------
    >>> points = [(0, 0, 0.0), (0, 31, 1.0), (31, 0, 0.0)]
    >>> tilted = clplen.lightfield.plane_through(points, (32, 32))
    >>> f"{tilted[16, 31]:.1f}"
    '1.0'
    """
    values = real_array(points, "points", np.float64)
    if values.ndim != 2 or values.shape[1:] != (3,) or len(values) < 3:
        raise ShapeError(
            f"points must have shape (n, 3), n >= 3, of (y, x, d), got {values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError(f"points must be finite (y, x, d), got {points!r}.")
    middle = values[:, :2].mean(axis=0)
    offsets = values[:, :2] - middle
    spread = np.linalg.svd(offsets, compute_uv=False)
    if spread[1] <= _FLAT * spread[0]:
        raise ValueError("points must not lie on one line; add a point beside it.")
    columns = np.column_stack((np.ones(len(values)), offsets))
    offset, down, right = np.linalg.lstsq(columns, values[:, 2], rcond=None)[0]
    y, x = (np.arange(n) - at for n, at in zip(shape, middle, strict=False))
    return offset + down * y[:, None] + right * x[None, :]


def carry_disparity(disparity: DisparityMap, step: DisparityMap) -> DisparityMap:
    """Warp a disparity map of the centre view to another viewpoint.

    A point p of the centre view moves to p + step d(p), so the warped map solves
    e(q) = d(q - step e(q)) by a few fixed-point iterations. At occlusions it follows one of the two
    surfaces, beyond the edges the nearest pixel.
    """
    from scipy.ndimage import map_coordinates

    if not step.any():
        return disparity
    y, x = np.indices(disparity.shape)
    result = disparity
    for _ in range(_ROUNDS):
        positions = (y - step[0] * result, x - step[1] * result)
        result = map_coordinates(disparity, positions, order=1, mode="nearest")
    return np.asarray(result)


def render_weights(
    lf: SampledViews, aperture: Any, viewpoint: Any, total: bool
) -> np.ndarray[Any, Any]:
    """Return the weights of the views in a picture of `LightField.render`."""
    if aperture is None and viewpoint is not None and not total:
        return _to_one(_nearest(lf, viewpoint)[1])
    weights = view_weights(lf, aperture, viewpoint)
    return weights if total else _to_one(weights)


def view_weights(lf: SampledViews, aperture: Any, viewpoint: Any) -> Weights:
    """Return the weights of an aperture times the light field's own."""
    weights = aperture_weights(lf, aperture, viewpoint) * lf.weights
    if not weights.any():
        raise ValueError(
            f"aperture must include a view with a weight, got {aperture!r} (viewpoint "
            f"{viewpoint!r}); pass a wider aperture or another viewpoint."
        )
    return weights


def through(lf: Views, aperture: Any) -> Views:
    """Return the light field with the weights of an aperture, unchanged for None."""
    if aperture is None:
        return lf
    light_field: Any = lf
    masked: Views = replace(light_field, weights=view_weights(lf, aperture, None))
    return masked


def _nearest(lf: SampledViews, viewpoint: Any) -> tuple[Weights, Weights]:
    """Return bilinear weights of the four views around a viewpoint, and the weights in use."""
    nearest = aperture_weights(lf, None, viewpoint)
    weights = nearest * lf.weights
    return nearest, weights if weights.any() else nearest


def _to_one(weights: Weights) -> np.ndarray[Any, Any]:
    """Return weights over their sum."""
    return np.asarray(weights / weights.sum(dtype=np.float64))


def sum_of_views(data: cla.Array, weights: np.ndarray[Any, Any], *, device: Device) -> cla.Array:
    """Return the sum of w[v, u] L[v, u], shape (y, x[, c])."""
    no_shifts = [np.zeros((1, n)) for n in weights.shape]
    picture = shear_sum(data, weights, *no_shifts, device=device, total=True)
    return picture.reshape(data.shape[2:])


class Rendering(AlphaLaw, OnDevice):
    """Methods that make pictures from views on a device."""

    weights: Weights
    positions: np.ndarray[Any, np.dtype[np.float64]] | None

    def view(
        self,
        v: float,
        u: float,
        *,
        disparity: ArrayLike | None = None,
        interpolation: str = "cubic",
    ) -> Image:
        """Return the view at (v, u), also between views (bilinear in the aperture, by `weights`).

        A view of weight 0 is returned as stored, but not mixed into others. Between views,
        defocused objects appear several times unless ``disparity`` is set: each view is then
        shifted by its distance from (v, u) times d.

        Parameters
        ----------
        v, u : float
            Viewpoint, 0 <= v <= V - 1, 0 <= u <= U - 1.
        disparity : float or array_like, optional
            Disparity of the scene in pixels a view step: a number, or a map of the centre view of
            shape (y, x), such as a `DepthMap`, which is warped to (v, u).
        interpolation : {"cubic", "linear", "nearest"}
            Interpolation of shifted views, see `flatten`.

        Returns
        -------
        Image
            Picture, float32, shape (y, x[, c]).

        Raises
        ------
        ValueError, ShapeError
            If (v, u) lies outside the views, or a disparity is not finite or of wrong shape.
        """
        if disparity is None:
            return self.render(viewpoint=(v, u))
        nearest, weights = _nearest(self, (v, u))
        steps = unit_steps(self)
        viewpoint_step = np.tensordot(nearest.astype(np.float64), steps, 2)
        d = checked_disparity(disparity, (self.shape[2], self.shape[3]))
        require_steps_overlap((steps - viewpoint_step)[weights > 0], self.shape, d)
        picture = along_rays(
            self.data,
            "mean",
            device=self.device,
            weights=weights,
            steps=steps - viewpoint_step,
            disparity=carry_disparity(d, viewpoint_step) if d.ndim else d,
            interpolation=interpolation,
        )
        return Image(picture, self.device)

    def epi(
        self,
        *,
        y: int | None = None,
        x: int | None = None,
        v: int | None = None,
        u: int | None = None,
    ) -> Image:
        """Return an epipolar-plane image.

        ``epi(y=, v=)`` has shape (u, x[, c]), ``epi(x=, u=)`` has shape (v, y[, c]).

        Raises
        ------
        ValueError
            If the indices are neither pair, or outside the light field.
        """
        indices = {name: n for name, n in zip("yxvu", (y, x, v, u), strict=True) if n is not None}
        if set(indices) not in ({"y", "v"}, {"x", "u"}):
            raise ValueError(
                f"epi must get y and v, or x and u, got {', '.join(indices) or 'none'}."
            )
        for name, n in indices.items():
            size = self.shape["vuyx".index(name)]
            if not isinstance(n, Integral) or not 0 <= n < size:
                raise ValueError(f"{name} must be an integer from 0 to {size - 1}, got {n!r}.")
        fixed = {"vuyx".index(name): int(n) for name, n in indices.items()}
        axes = (1, 3) if "y" in indices else (0, 2)
        return Image(plane(self.data, fixed, axes, self.device), self.device)

    def render(
        self,
        *,
        aperture: Any = None,
        viewpoint: tuple[float, float] | None = None,
        total: bool = False,
    ) -> Image:
        """Render the picture with the recorded focus, through part of the aperture.

        Parameters
        ----------
        aperture : int, float, str or array_like, optional
            Aperture. int: number of views across (of N views, thesis eq. 3.3 drops (N - N')//2
            below and the rest above); float in (0, 1]: a disc of that fraction of the full diameter
            (an ellipse V views high and U wide); ``"f/66"``: a disc on the main lens by f-number at
            its image, needs camera and spacing; array (V, U): weights. Views at the rim are
            weighted by the covered fraction of their cell. None: all views.
        viewpoint : tuple of float, optional
            Centre (v, u) of the aperture, also between views; parts outside the views are cut off.
            Without an aperture, the picture is that view.
        total : bool
            True for the weighted sum over views, False for the weighted mean.

        Returns
        -------
        Image
            Picture, float32, shape (y, x[, c]).

        Raises
        ------
        ValueError
            If the aperture or the viewpoint lies outside the views, leaves only views of weight 0,
            or needs an unknown camera.
        ShapeError
            If an array of weights does not match the views.
        TypeError
            If the aperture has another type.
        """
        weights = render_weights(self, aperture, viewpoint, total)
        return Image(sum_of_views(self.data, weights, device=self.device), self.device)

    def flatten(
        self,
        statistic: str = "mean",
        *,
        disparity: ArrayLike = 0.0,
        aperture: Any = None,
        viewpoint: tuple[float, float] | None = None,
        mask: ArrayLike | None = None,
        interpolation: str = "linear",
    ) -> Image:
        """Compute a statistic over the views of one plane or surface.

        The picture is registered to the centre view. Samples of a point are weighted with the
        aperture times `weights` times the share of their interpolation inside the view and the
        mask. The median sees around thin objects in front of the surface; the variance is small on
        the surface.

        Parameters
        ----------
        statistic : {"mean", "median", "max", "min", "variance"}
            Weighted statistic, see `clplen.lightfield.arrays.ray_samples.along_rays`.
        disparity : float or array_like
            Disparity d in pixels a view step, a number or shape (y, x).
        aperture, viewpoint
            Arguments of `render`.
        mask : array_like, optional
            Mask of valid samples, shape (V, U, y, x).
        interpolation : {"linear", "nearest", "cubic"}
            Interpolation. "cubic" (Keys 1981, a = -1/2) repeats the edge within a view, and accepts
            no positions outside it and no mask.

        Returns
        -------
        Image
            Picture, float32, shape (y, x[, c]); 0 where no view sees the surface.

        Raises
        ------
        ValueError
            If the statistic or the interpolation is unknown, a disparity is not finite, no two
            views overlap on the plane or the surface, more than 1024 views enter a median, or
            `render` raises.
        ShapeError
            If disparities or mask do not match the pixels or rays.
        """
        weights = view_weights(self, aperture, viewpoint)
        d = checked_disparity(disparity, (self.shape[2], self.shape[3]))
        require_overlap(self, weights, d)
        if statistic == "mean" and d.ndim == 0 and mask is None and interpolation == "linear":
            moves = shifts(self, d.reshape(1))
            picture = shear_sum(self.data, weights, *moves, device=self.device)
            return Image(picture.reshape(self.shape[2:]), self.device)
        picture = along_rays(
            self.data,
            statistic,
            device=self.device,
            weights=weights,
            steps=unit_steps(self),
            disparity=d,
            interpolation=interpolation,
            mask=mask,
        )
        return Image(picture, self.device)
