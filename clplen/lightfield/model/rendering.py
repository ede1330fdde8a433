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

_ROUNDS = 8  # of the fixed point in `carry_disparity`
_FLAT = 1e-9  # points on one line, relative to their spread


def plane_through(points: ArrayLike, shape: tuple[int, ...]) -> DisparityMap:
    """Disparity of every pixel on the plane through three points, or nearest to more of them.

    A plane in space is a plane d = a + b y + c x in the disparities of a light field (d is linear
    in 1/z by the lens law, and perspective keeps planes).

    Parameters
    ----------
    points : array_like
        Shape (n, 3), n >= 3: y, x in pixels of the centre view and d there. Three are met exactly,
        more by least squares.
    shape : tuple of int
        (y, x[, c]) of a view, as in ``lf.shape[2:]``.

    Returns
    -------
    numpy.ndarray
        float64, shape (y, x); for ``refocus(lf, disparity=...)``.

    Raises
    ------
    ShapeError
        If the points are not (n, 3) with at least three.
    ValueError
        If one is not finite, or they lie on one line.

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
            f"A plane goes through at least three points (y, x, d), shape (n, 3), not "
            f"{values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError(f"The points of a plane are finite numbers (y, x, d), not {points!r}.")
    middle = values[:, :2].mean(axis=0)
    around = values[:, :2] - middle
    spread = np.linalg.svd(around, compute_uv=False)
    if spread[1] <= _FLAT * spread[0]:
        raise ValueError(
            "The points of a plane lie on one line (or one place): pick one beside it."
        )
    known = np.column_stack((np.ones(len(values)), around))
    offset, down, right = np.linalg.lstsq(known, values[:, 2], rcond=None)[0]
    y, x = (np.arange(n) - at for n, at in zip(shape, middle, strict=False))
    return offset + down * y[:, None] + right * x[None, :]


def carry_disparity(disparity: DisparityMap, step: DisparityMap) -> DisparityMap:
    """A disparity map of the centre view as another viewpoint sees it.

    What lies at p in the centre view is at p + step d(p) in the other, so the map there solves
    e(q) = d(q - step e(q)): a fixed point, found in a few rounds. Where a surface hides another
    it takes one of the two, beyond the edges the nearest pixel.
    """
    from scipy.ndimage import map_coordinates

    if not step.any():
        return disparity
    y, x = np.indices(disparity.shape)
    result = disparity
    for _ in range(_ROUNDS):
        at = (y - step[0] * result, x - step[1] * result)
        result = map_coordinates(disparity, at, order=1, mode="nearest")
    return np.asarray(result)


def render_weights(
    lf: SampledViews, aperture: Any, viewpoint: Any, total: bool
) -> np.ndarray[Any, Any]:
    """Weights of the views in a picture that `LightField.render` makes; see there."""
    if aperture is None and viewpoint is not None and not total:
        return _to_one(_nearest(lf, viewpoint)[1])
    weights = view_weights(lf, aperture, viewpoint)
    return weights if total else _to_one(weights)


def view_weights(lf: SampledViews, aperture: Any, viewpoint: Any) -> Weights:
    """Weights of an aperture times the light field's own."""
    weights = aperture_weights(lf, aperture, viewpoint) * lf.weights
    if not weights.any():
        raise ValueError(
            f"The aperture {aperture!r} (viewpoint {viewpoint!r}) leaves only views of weight 0: "
            "give a wider one or another viewpoint."
        )
    return weights


def through(lf: Views, aperture: Any) -> Views:
    """The light field with the weights of an aperture; without one as it is."""
    if aperture is None:
        return lf
    whole: Any = lf
    seen: Views = replace(whole, weights=view_weights(lf, aperture, None))
    return seen


def _nearest(lf: SampledViews, viewpoint: Any) -> tuple[Weights, Weights]:
    """Bilinear weights of the four views round a viewpoint, and those that are used."""
    nearest = aperture_weights(lf, None, viewpoint)
    weights = nearest * lf.weights
    return nearest, weights if weights.any() else nearest


def _to_one(weights: Weights) -> np.ndarray[Any, Any]:
    """Weights over their sum."""
    return np.asarray(weights / weights.sum(dtype=np.float64))


def sum_of_views(data: cla.Array, weights: np.ndarray[Any, Any], *, device: Device) -> cla.Array:
    """Sum of w[v, u] L[v, u], shape (y, x[, c])."""
    still = [np.zeros((1, n)) for n in weights.shape]
    picture = shear_sum(data, weights, *still, device=device, total=True)
    return picture.reshape(data.shape[2:])


class Rendering(AlphaLaw, OnDevice):
    """Methods of views on a device that make pictures of them."""

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
        """The view at (v, u), between views too (bilinear in the aperture, by `weights`).

        A view of weight 0 is shown as it is stored, but not mixed into others. Between views,
        what is not in focus is seen several times, unless its ``disparity`` is given: then each
        view is shifted by its own distance from (v, u) times d.

        Parameters
        ----------
        v, u : float
            0 <= v <= V - 1, 0 <= u <= U - 1.
        disparity : float or array_like, optional
            Of the scene, pixels a view step: one number, or one of every pixel of the centre view,
            shape (y, x), as of a `DepthMap`; the map is carried to (v, u).
        interpolation : {"cubic", "linear", "nearest"}
            How views are shifted, as in `flatten`.

        Returns
        -------
        Image
            float32, shape (y, x[, c]).

        Raises
        ------
        ValueError, ShapeError
            If (v, u) lies outside the views, a disparity is not finite, or they have another shape.
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
        """An epipolar-plane image: ``epi(y=, v=)`` is (u, x[, c]), ``epi(x=, u=)`` is (v, y[, c]).

        Raises
        ------
        ValueError
            If neither pair, or an index outside the light field, is given.
        """
        indices = {name: n for name, n in zip("yxvu", (y, x, v, u), strict=True) if n is not None}
        if set(indices) not in ({"y", "v"}, {"x", "u"}):
            raise ValueError(
                "An epipolar-plane image takes y and v, or x and u, not "
                f"{', '.join(indices) or 'none'}."
            )
        for name, n in indices.items():
            size = self.shape["vuyx".index(name)]
            if not isinstance(n, Integral) or not 0 <= n < size:
                raise ValueError(f"{name} is a whole number from 0 to {size - 1}, not {n!r}.")
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
        """The picture as focused, through part of the aperture.

        Parameters
        ----------
        aperture : int, float, str or array_like, optional
            int: that many views across (of N views, thesis eq. 3.3 drops (N - N')//2 below and the
            rest above); float in (0, 1]: a disc of that fraction of the full diameter (an ellipse
            V views high and U wide); ``"f/66"``: a disc on the main lens by f-number at its image,
            needs camera and spacing; array (V, U): weights. A view that the rim crosses counts
            with the covered fraction of its cell. None: all views.
        viewpoint : tuple of float, optional
            (v, u) of the aperture's centre, between views too; what then lies outside the views is
            cut off. Alone, it is that one view.
        total : bool
            The weighted sum over views instead of the weighted mean.

        Returns
        -------
        Image
            float32, shape (y, x[, c]).

        Raises
        ------
        ValueError
            If the aperture or the viewpoint lies outside the views, leaves only views of weight 0,
            or needs a camera that is not known.
        ShapeError
            If an array of weights has not one for each view.
        TypeError
            If the aperture is none of these.
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
        """What the views see of one plane or surface, as one picture registered to the centre view.

        Samples of the same point are weighted with the aperture times `weights` times the share of
        their interpolation that lies inside the view and the mask. The median sees around thin
        things in front of the surface; the variance is small where the surface is one.

        Parameters
        ----------
        statistic : {"mean", "median", "max", "min", "variance"}
            Weighted, as in `clplen.lightfield.arrays.ray_samples.along_rays`.
        disparity : float or array_like
            d in pixels a view step, or one of every pixel, shape (y, x).
        aperture, viewpoint
            As in `render`.
        mask : array_like, optional
            Shape (V, U, y, x); where it is False, a sample is not known.
        interpolation : {"linear", "nearest", "cubic"}
            "cubic" (Keys 1981, a = -1/2) repeats the edge within a view, and takes no place
            outside it and no mask.

        Returns
        -------
        Image
            float32, shape (y, x[, c]); 0 where no view sees anything.

        Raises
        ------
        ValueError
            If the statistic or the interpolation is unknown, a disparity is not finite, no two
            views overlap on the plane or anywhere on the surface, more than 1024 views go into a
            median, or from `render`.
        ShapeError
            If disparities or mask are not one for every pixel or ray.
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
