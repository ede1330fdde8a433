"""Pictures from the views of a light field: one view, a synthetic aperture, a surface, a slice."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import real_array
from clplen.compute.arrays import Image
from clplen.errors import ShapeError
from clplen.lightfield.arrays.ray_samples import along_rays, checked_disparity
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.model.alpha_law import (
    require_overlap,
    require_steps_overlap,
    shifts,
    unit_steps,
)
from clplen.lightfield.model.apertures import Weights, aperture_weights
from clplen.lightfield.model.sampled_views import DeviceViews, SampledViews

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


def view(lf: DeviceViews, v: float, u: float, *, disparity: Any, interpolation: str) -> Image:
    """See `LightField.view`."""
    if disparity is None:
        return render(lf, aperture=None, viewpoint=(v, u), total=False)
    return _view_along_rays(lf, (v, u), disparity, interpolation)


def render(lf: DeviceViews, *, aperture: Any, viewpoint: Any, total: bool) -> Image:
    """See `LightField.render`."""
    return _sum(lf, render_weights(lf, aperture, viewpoint, total))


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


def epi(lf: DeviceViews, *, y: int | None, x: int | None, v: int | None, u: int | None) -> Image:
    """See `LightField.epi`."""
    indices = {name: n for name, n in zip("yxvu", (y, x, v, u), strict=True) if n is not None}
    if set(indices) not in ({"y", "v"}, {"x", "u"}):
        raise ValueError(
            "An epipolar-plane image takes y and v, or x and u, not "
            f"{', '.join(indices) or 'none'}."
        )
    for name, n in indices.items():
        size = lf.shape["vuyx".index(name)]
        if not isinstance(n, Integral) or not 0 <= n < size:
            raise ValueError(f"{name} is a whole number from 0 to {size - 1}, not {n!r}.")
    fixed = {"vuyx".index(name): int(n) for name, n in indices.items()}
    axes = (1, 3) if "y" in indices else (0, 2)
    return Image(plane(lf.data, fixed, axes, lf.device), lf.device)


def _nearest(lf: SampledViews, viewpoint: Any) -> tuple[Weights, Weights]:
    """Bilinear weights of the four views round a viewpoint, and those that are used."""
    nearest = aperture_weights(lf, None, viewpoint)
    weights = nearest * lf.weights
    return nearest, weights if weights.any() else nearest


def _view_along_rays(lf: DeviceViews, viewpoint: Any, disparity: Any, interpolation: str) -> Image:
    nearest, weights = _nearest(lf, viewpoint)
    steps = unit_steps(lf)
    viewpoint_step = np.tensordot(nearest.astype(np.float64), steps, 2)
    d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
    require_steps_overlap((steps - viewpoint_step)[weights > 0], lf.shape, d)
    picture = along_rays(
        lf.data,
        "mean",
        device=lf.device,
        weights=weights,
        steps=steps - viewpoint_step,
        disparity=carry_disparity(d, viewpoint_step) if d.ndim else d,
        interpolation=interpolation,
    )
    return Image(picture, lf.device)


def _to_one(weights: Weights) -> np.ndarray[Any, Any]:
    """Weights over their sum."""
    return np.asarray(weights / weights.sum(dtype=np.float64))


def _sum(lf: DeviceViews, weights: np.ndarray[Any, Any]) -> Image:
    """The sum of w[v, u] L[v, u]."""
    V, U = weights.shape
    picture = shear_sum(
        lf.data,
        weights,
        np.zeros((1, V)),
        np.zeros((1, U)),
        device=lf.device,
        total=True,
    )
    return Image(picture.reshape(lf.shape[2:]), lf.device)


def flatten(
    lf: DeviceViews,
    statistic: str,
    *,
    disparity: Any,
    aperture: Any,
    viewpoint: Any,
    mask: Any,
    interpolation: str,
) -> Image:
    """See `LightField.flatten`."""
    weights = view_weights(lf, aperture, viewpoint)
    d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
    require_overlap(lf, weights, d)
    if statistic == "mean" and d.ndim == 0 and mask is None and interpolation == "linear":
        picture = shear_sum(lf.data, weights, *shifts(lf, d.reshape(1)), device=lf.device)
        return Image(picture.reshape(lf.shape[2:]), lf.device)
    picture = along_rays(
        lf.data,
        statistic,
        device=lf.device,
        weights=weights,
        steps=unit_steps(lf),
        disparity=d,
        interpolation=interpolation,
        mask=mask,
    )
    return Image(picture, lf.device)
