"""Pictures from the views as they are: one view, a synthetic aperture, an epipolar slice."""

from __future__ import annotations

from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.arrays import Image
from clplen.lightfield.arrays.ray_samples import along_rays, checked_disparity
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.model.aperture_weights import Weights, aperture_weights
from clplen.lightfield.model.surface import carried
from clplen.lightfield.model.view_shifts import unit_steps

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField


def view(lf: LightField, v: float, u: float, *, disparity: Any, interpolation: str) -> Image:
    """See `LightField.view`."""
    if disparity is None:
        return _view(lf, (v, u))
    return _view_along_rays(lf, (v, u), disparity, interpolation)


def render(lf: LightField, *, aperture: Any, viewpoint: Any, total: bool) -> Image:
    """See `LightField.render`."""
    if aperture is None and viewpoint is not None and not total:
        return _view(lf, viewpoint)
    weights = view_weights(lf, aperture, viewpoint)
    return _sum(lf, weights) if total else _mean(lf, weights)


def view_weights(lf: LightField | StoredLightField, aperture: Any, viewpoint: Any) -> Weights:
    """Weights of an aperture times the light field's own.

    Parameters
    ----------
    lf : LightField
    aperture, viewpoint
        See `LightField.render`.

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U), not all 0.

    Raises
    ------
    ValueError
        If no view is left, or from `aperture_weights`.
    """
    weights = aperture_weights(lf, aperture, viewpoint) * lf.weights
    if not weights.any():
        raise ValueError(
            f"The aperture {aperture!r} (viewpoint {viewpoint!r}) leaves only views of weight 0: "
            "give a wider one or another viewpoint."
        )
    return weights


def epi(lf: LightField, *, y: int | None, x: int | None, v: int | None, u: int | None) -> Image:
    """See `LightField.epi`."""
    given = {name: n for name, n in zip("yxvu", (y, x, v, u), strict=True) if n is not None}
    if set(given) not in ({"y", "v"}, {"x", "u"}):
        raise ValueError(
            f"An epipolar-plane image takes y and v, or x and u, not {', '.join(given) or 'none'}."
        )
    for name, n in given.items():
        size = lf.shape["vuyx".index(name)]
        if not isinstance(n, Integral) or not 0 <= n < size:
            raise ValueError(f"{name} is a whole number from 0 to {size - 1}, not {n!r}.")
    fixed = {"vuyx".index(name): int(n) for name, n in given.items()}
    axes = (1, 3) if "y" in given else (0, 2)
    return Image(plane(lf.data, fixed, axes, lf.device), lf.device)


def _view(lf: LightField, viewpoint: Any) -> Image:
    return _mean(lf, _nearest(lf, viewpoint)[1])


def _nearest(lf: LightField, viewpoint: Any) -> tuple[Weights, Weights]:
    """Bilinear weights of the four views round a viewpoint, and those that are used."""
    nearest = aperture_weights(lf, None, viewpoint)
    weights = nearest * lf.weights
    return nearest, weights if weights.any() else nearest


def _view_along_rays(lf: LightField, viewpoint: Any, disparity: Any, interpolation: str) -> Image:
    nearest, weights = _nearest(lf, viewpoint)
    steps = unit_steps(lf)
    here = np.tensordot(nearest.astype(np.float64), steps, 2)
    d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
    picture = along_rays(
        lf.data,
        "mean",
        device=lf.device,
        weights=weights,
        steps=steps - here,
        disparity=carried(d, here) if d.ndim else d,
        interpolation=interpolation,
    )
    return Image(picture, lf.device)


def _mean(lf: LightField, weights: Weights) -> Image:
    return _sum(lf, weights / weights.sum(dtype=np.float64))


def _sum(lf: LightField, weights: np.ndarray[Any, Any]) -> Image:
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
