"""Disparity range of a scene, from a depth map at reduced size."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.lightfield.arrays.stored_samples import plane
from clplen.lightfield.axis_check.axis_test import Real, grey_picture, search_limit
from clplen.lightfield.depth.combined_cue import combined_disparity
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField

UNKNOWN = (math.nan, math.nan)

_SIDE = 144  # pixels: mean side of the reduced pictures
_MIN_SIDE = 32  # pixels: smallest side after reduction
_MAX_VIEWS = 5  # along an axis, including the outermost
_STEP = 1 / 4  # pixels a view step between planes
# Of the pixels: a larger share at the first and last planes extends the search
_MAX_END_SHARE = 0.01
_MIN_CONFIDENCE = 0.05  # minimum confidence of a valid pixel
_MIN_VALID_SHARE = 0.02  # minimum share of valid pixels
_PERCENTILES = (0.5, 99.5)  # percentiles of the valid pixels
_MARGIN = 0.05  # pixels a view step: added for the error of the ends


def disparity_range(lf: LightField, *, farthest: float) -> tuple[float, float]:
    """Return the lowest and highest disparity of 99 % of a scene's pixels.

    At most 5 x 5 views are reduced to about 144 x 144 pixels by means over squares, then matched
    (cue "combined"). Pixels count by area, regardless of their detail; pixels of low confidence
    are ignored.
    """
    V, U, ny, nx = lf.shape[:4]
    lit = lf.weights > 0
    rows, columns = (_spread(np.flatnonzero(lit.any(axis=axis))) for axis in (1, 0))
    if np.count_nonzero(lit[np.ix_(rows, columns)]) < 2:
        return UNKNOWN
    factor = max(1, min(math.ceil(math.sqrt(ny * nx) / _SIDE), min(ny, nx) // _MIN_SIDE))
    small = _reduced(lf, rows, columns, factor)
    limit = search_limit((V, U), (ny, nx))
    while True:
        farthest = min(farthest, limit)
        count = max(1, math.ceil(farthest / _STEP))
        planes = np.linspace(-farthest, farthest, 2 * count + 1)
        disparity, confidence = combined_disparity(small, planes / factor)
        if farthest >= limit or _at_ends(disparity * factor, planes) <= _MAX_END_SHARE:
            return _between(disparity[confidence > _MIN_CONFIDENCE], factor, disparity.size)
        farthest *= 2


def _spread(lit: Any) -> Any:
    """Return at most 5 of the indices, evenly spaced."""
    indices = np.linspace(0, lit.size - 1, min(lit.size, _MAX_VIEWS)).round().astype(int)
    return lit[indices]


def _reduced(lf: LightField, rows: Any, columns: Any, factor: int) -> LightField:
    """Return grey means over squares of some views; disparities shrink by the factor."""

    def picture(v: int, u: int) -> Any:
        view = plane(lf.data, {0: v, 1: u}, (2, 3), lf.device)
        return _means(grey_picture(lf.device.download(view)), factor)

    pictures = [picture(int(v), int(u)) for v in rows for u in columns]
    samples = np.array(pictures, np.float32).reshape(rows.size, columns.size, *pictures[0].shape)
    block = np.ix_(rows, columns)
    weights = np.array(lf.weights[block])
    return LightField.from_array(
        samples, device=lf.device, weights=weights, positions=-unit_steps(lf)[block]
    )


def _means(picture: Any, factor: int) -> Any:
    ny, nx = (n // factor for n in picture.shape)
    cropped = picture[: ny * factor, : nx * factor]
    return cropped.reshape(ny, factor, nx, factor).mean(axis=(1, 3))


def _at_ends(disparity: Any, planes: Real) -> float:
    """Return the share of pixels nearest to the first or the last plane."""
    inside = (planes[0] + planes[1]) / 2, (planes[-2] + planes[-1]) / 2
    return float(np.mean((disparity < inside[0]) | (disparity > inside[1])))


def _between(disparities: Any, factor: int, pixels: int) -> tuple[float, float]:
    """Return the outermost disparities of the valid pixels, or nan if they are too few."""
    if disparities.size < max(1, _MIN_VALID_SHARE * pixels):
        return UNKNOWN
    low, high = factor * np.percentile(disparities, _PERCENTILES)
    return float(low) - _MARGIN, float(high) + _MARGIN
