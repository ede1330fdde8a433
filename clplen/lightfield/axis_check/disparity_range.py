"""Between which disparities a scene lies: from a depth map of the whole views at reduced size."""

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
_LEAST_SIDE = 32  # pixels: no side is reduced to less
_MOST_VIEWS = 5  # along an axis, the outermost ones among them
_STEP = 1 / 4  # between planes, in pixels a view step
_AT_ENDS = 0.01  # of the pixels: so many at the ends of the planes ask for more of them
_SURE = 0.05  # confidence from which a pixel counts
_FEW = 0.02  # of the pixels: if fewer count, nothing is known
_OUTER = (0.5, 99.5)  # per cent of the pixels
_MARGIN = 0.05  # pixels a view step: error of the ends


def disparity_range(lf: LightField, *, farthest: float) -> tuple[float, float]:
    """Lowest and highest disparity of a scene, but for 1 % of its pixels.

    The views, at most 5 x 5 of them, are reduced to about 144 x 144 pixels by means over squares
    and matched (cue "combined"). Pixels count by area, however much detail they have; those whose
    disparity is not sure do not count.
    """
    V, U, ny, nx = lf.shape[:4]
    lit = lf.weights > 0
    rows, columns = (_spread(np.flatnonzero(lit.any(axis=axis))) for axis in (1, 0))
    if np.count_nonzero(lit[np.ix_(rows, columns)]) < 2:
        return UNKNOWN
    factor = max(1, min(math.ceil(math.sqrt(ny * nx) / _SIDE), min(ny, nx) // _LEAST_SIDE))
    small = _reduced(lf, rows, columns, factor)
    limit = search_limit((V, U), (ny, nx))
    while True:
        farthest = min(farthest, limit)
        count = max(1, math.ceil(farthest / _STEP))
        planes = np.linspace(-farthest, farthest, 2 * count + 1)
        disparity, confidence = combined_disparity(small, planes / factor)
        if farthest >= limit or _at_ends(disparity * factor, planes) <= _AT_ENDS:
            return _between(disparity[confidence > _SURE], factor, disparity.size)
        farthest *= 2


def _spread(lit: Any) -> Any:
    """At most 5 of the indices, evenly apart."""
    chosen = np.linspace(0, lit.size - 1, min(lit.size, _MOST_VIEWS)).round().astype(int)
    return lit[chosen]


def _reduced(lf: LightField, rows: Any, columns: Any, factor: int) -> LightField:
    """Grey means over squares of pixels of some views; disparities shrink by the factor."""

    def picture(v: int, u: int) -> Any:
        view = plane(lf.data, {0: v, 1: u}, (2, 3), lf.device)
        return _means(grey_picture(lf.device.download(view)), factor)

    pictures = [picture(int(v), int(u)) for v in rows for u in columns]
    samples = np.array(pictures, np.float32).reshape(rows.size, columns.size, *pictures[0].shape)
    kept = np.ix_(rows, columns)
    weights = np.array(lf.weights[kept])
    return LightField.from_array(
        samples, device=lf.device, weights=weights, positions=-unit_steps(lf)[kept]
    )


def _means(picture: Any, factor: int) -> Any:
    ny, nx = (n // factor for n in picture.shape)
    whole = picture[: ny * factor, : nx * factor]
    return whole.reshape(ny, factor, nx, factor).mean(axis=(1, 3))


def _at_ends(disparity: Any, planes: Real) -> float:
    """Share of the pixels nearer to the first or last plane than to any other."""
    inside = (planes[0] + planes[1]) / 2, (planes[-2] + planes[-1]) / 2
    return float(np.mean((disparity < inside[0]) | (disparity > inside[1])))


def _between(sure: Any, factor: int, pixels: int) -> tuple[float, float]:
    """Outermost disparities of the pixels that are sure, unless they are too few."""
    if sure.size < max(1, _FEW * pixels):
        return UNKNOWN
    low, high = factor * np.percentile(sure, _OUTER)
    return float(low) - _MARGIN, float(high) + _MARGIN
