"""Which views a picture is made of: weights w[v, u] of an aperture, by words or by shape."""

from __future__ import annotations

import re
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.errors import ShapeError
from clplen.lightfield.model.aperture_shapes import (
    Pair,
    Vector,
    Weights,
    ellipse_cells,
)

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField
    from clplen.lightfield.model.stored_light_field import StoredLightField


_F_NUMBER = re.compile(r"\s*f\s*/\s*(\d+\.?\d*|\.\d+)\s*", re.IGNORECASE)


def aperture_weights(lf: LightField | StoredLightField, aperture: Any, viewpoint: Any) -> Weights:
    """Weights of an aperture, without the light field's own.

    A rim that crosses a view gives it the covered fraction of its cell, one view step wide and
    high; what lies outside the views is cut off.

    Parameters
    ----------
    lf : LightField
    aperture : int, float, str, array_like or None
        See `LightField.render`.
    viewpoint : tuple of float or None
        (v, u) of the aperture's centre; None leaves it where the aperture has it. Without an
        aperture, the four nearest views (bilinear).

    Returns
    -------
    numpy.ndarray
        float32, shape (V, U).

    Raises
    ------
    ValueError
        If the aperture or the viewpoint lies outside the views, or what it needs is not known.
    ShapeError
        If an array of weights has not one for each view.
    TypeError
        If the aperture is none of these.
    """
    views = (lf.shape[0], lf.shape[1])
    centre = None if viewpoint is None else _checked_viewpoint(viewpoint, views)
    if aperture is None:
        weights = np.ones(views) if centre is None else _point(views, centre)
    elif isinstance(aperture, str):
        weights = _disc(views, _f_number_diameter(lf, aperture), centre)
    elif np.ndim(aperture) == 2:
        weights = _shifted(_checked_array(aperture, views), centre)
    elif isinstance(aperture, Integral) and not isinstance(aperture, bool):
        weights = _square(views, int(aperture), centre)
    elif isinstance(aperture, Real) and not isinstance(aperture, bool):
        weights = _disc(views, _fraction_diameter(views, float(aperture)), centre)
    else:
        raise TypeError(
            "An aperture is a number of views (int), a fraction of the full diameter (float), an "
            f"f-number such as 'f/66' or an array of weights, not {aperture!r}."
        )
    return weights.astype(np.float32)


def f_number_radius(lf: LightField, f_number: str) -> Pair:
    """Radius of the main lens stopped down to an f-number at its image, for the shapes.

    Parameters
    ----------
    lf : LightField
        With camera and spacing.
    f_number : str
        Such as "f/66".

    Returns
    -------
    tuple of float
        In view steps along v and u.

    Raises
    ------
    ValueError
        If it is no f-number, wider than the lens, or camera or spacing are not known.
    """
    along_v, along_u = _f_number_diameter(lf, f_number)
    return along_v / 2, along_u / 2


def _checked_viewpoint(viewpoint: Any, views: tuple[int, int]) -> Pair:
    values = np.asarray(viewpoint, np.float64)
    if values.shape != (2,):
        raise ValueError(f"A viewpoint is (v, u), not {viewpoint!r}.")
    if not ((values >= 0) & (values <= np.asarray(views) - 1)).all():
        raise ValueError(
            f"The viewpoint {viewpoint!r} lies outside the views: v is from 0 to {views[0] - 1}, "
            f"u from 0 to {views[1] - 1}."
        )
    return float(values[0]), float(values[1])


def _point(views: tuple[int, int], at: Pair) -> Vector:
    """Bilinear between the four views round a point."""
    v, u = (np.maximum(1 - np.abs(np.arange(n) - t), 0) for n, t in zip(views, at, strict=True))
    return np.outer(v, u)


def _square(views: tuple[int, int], across: int, centre: Pair | None) -> Vector:
    """So many views across, cells that the edge crosses in part; eq. 3.3 when not moved."""
    if not 1 <= across <= max(views):
        raise ValueError(
            f"The aperture is {across} views across, the light field {views[0]} x {views[1]}: give "
            f"1 to {max(views)} (a float in (0, 1] is a fraction of the full diameter)."
        )
    sides = []
    for axis, n in enumerate(views):
        kept = min(across, n)
        below = (n - kept) // 2 if centre is None else centre[axis] - (kept - 1) / 2
        covered = np.minimum(np.arange(n) + 1, below + kept) - np.maximum(np.arange(n), below)
        sides.append(np.clip(covered, 0, 1))
    return np.outer(*sides)


def _disc(views: tuple[int, int], diameter: Pair, centre: Pair | None) -> Vector:
    """Covered fraction of every view's cell by an ellipse (a disc on the main lens)."""
    v, u = ((n - 1) / 2 for n in views)
    return ellipse_cells(views, (diameter[0] / 2, diameter[1] / 2), centre or (v, u))


def _fraction_diameter(views: tuple[int, int], fraction: float) -> Pair:
    if not 0 < fraction <= 1:
        raise ValueError(
            f"A float aperture is a fraction of the full diameter, in (0, 1], not {fraction!r} (an "
            "int is a number of views)."
        )
    return fraction * views[0], fraction * views[1]


def _f_number_diameter(lf: LightField | StoredLightField, text: str) -> Pair:
    """Diameter, in view steps along v and u, of the main lens stopped down to an f-number."""
    match = _F_NUMBER.fullmatch(text)
    if match is None or float(match[1]) == 0:
        raise ValueError(f"An aperture in words is an f-number such as 'f/66', not {text!r}.")
    if lf.camera is None or lf.spacing is None or not np.isfinite(lf.spacing).all():
        raise ValueError(
            f"The aperture {text!r} needs the camera and the spacing of views in metres, which "
            "this light field does not have: give a number of views or a fraction instead."
        )
    full, distance = lf.camera.aperture_diameter, lf.camera.image_distance
    dv, du = abs(lf.spacing[0]), abs(lf.spacing[1])
    diameter = distance / float(match[1])
    if diameter > full + min(dv, du):  # f-numbers are round numbers: a view step is forgiven
        raise ValueError(
            f"The aperture {text!r} is wider than the main lens, which is f/{distance / full:.4g} "
            f"at its image: give at least f/{distance / full:.4g}."
        )
    return diameter / dv, diameter / du


def _checked_array(aperture: Any, views: tuple[int, int]) -> Vector:
    weights = np.asarray(aperture, np.float64)
    if weights.shape != views:
        raise ShapeError(f"The aperture has shape {weights.shape}, the views {views}.")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise ValueError("Weights of an aperture are finite and not negative.")
    return weights


def _shifted(weights: Vector, centre: Pair | None) -> Vector:
    """Weights shifted from the middle of the views to a viewpoint, bilinear, 0 from outside."""
    if centre is None:
        return weights
    sides = []
    for n, at in zip(weights.shape, centre, strict=True):
        j = np.arange(n)
        away = j[:, None] - j[None, :] - (at - (n - 1) / 2)
        sides.append(np.maximum(1 - np.abs(away), 0))
    return sides[0] @ weights @ sides[1].T
