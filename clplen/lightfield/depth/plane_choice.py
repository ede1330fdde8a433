"""Planes that suit a light field of which nothing was said."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from clplen.lightfield.depth.best_focus import farthest_disparity
from clplen.lightfield.raw.raw_image import is_telecentric

DISPARITIES = (-2.0, 2.0, 33)  # first, last, how many
ALPHAS = (0.65, 1.35, 33)
_FAR = 1e3  # metres: as good as infinity, and still a place


class _Known(Protocol):
    @property
    def camera(self) -> Any: ...

    def alpha(self, disparity: Any) -> Any: ...


def suitable_planes(lf: _Known, *, count: int | None = None) -> dict[str, Any]:
    """Planes that suit what a light field knows, as ``alphas`` or ``disparities`` of `focal_stack`.

    Parameters
    ----------
    lf : LightField
    count : int, optional
        How many; default 33, and for a microscope at least as many as resolve its depth range:
        one pixel in the sub-images moves a point by one lenslet between the outermost views.

    Returns
    -------
    dict
        ``alphas`` from .65 to 1.35, at most up to infinity, where the spacing is known;
        ``disparities`` over the depth range of a microscope, to where its ends are sharpest; else
        from -2 to 2.
    """
    if np.isfinite(lf.alpha(0.0)):
        low, high, many = ALPHAS
        if lf.camera is not None:
            high = min(high, lf.camera.alpha(_FAR))
        return {"alphas": np.linspace(low, high, count or many)}
    low, high, many = DISPARITIES
    if is_telecentric(lf):
        high = farthest_disparity(lf.camera)
        low = -high
        many = max(many, 2 * math.ceil(high * lf.camera.pixels_per_lenslet) + 1)
    return {"disparities": np.linspace(low, high, count or many)}


def default_disparities(lf: _Known) -> Any:
    """Disparities that are tried where none were given: `suitable_planes` of a microscope."""
    if is_telecentric(lf):
        return suitable_planes(lf)["disparities"]
    return np.linspace(*DISPARITIES)
