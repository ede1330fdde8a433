"""How bright views are: those that are nearly black, and how much the others differ."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.lightfield.matching.view_matching import row_sums
from clplen.lightfield.model.apertures import aperture_weights
from clplen.lightfield.model.light_field import LightField

Real = np.ndarray[Any, np.dtype[np.float64]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

NEARLY_BLACK = 0.02  # of the median: views whose mean is lower hold hardly any light


def relative_brightness(lf: LightField) -> Real:
    """Mean sample of every view over the median of those with a weight."""
    sums = row_sums(lf).astype(np.float64).sum(axis=1).reshape(lf.weights.shape)
    median = float(np.median(sums[lf.weights > 0]))
    return sums / median if median > 0 else np.full_like(sums, np.nan)


def nearly_black_views(lf: LightField, brightness: Real) -> Mask:
    """Views with a weight whose mean is below 2 % of the median."""
    return (lf.weights > 0) & (brightness < NEARLY_BLACK)


def clear_aperture(lf: LightField, dim: Mask) -> int | None:
    """Views across the widest aperture that leaves out some views, and is wider than one view."""
    for across in range(max(lf.shape[:2]), 1, -1):
        inside = aperture_weights(lf, across, None) * lf.weights > 0
        if not inside[dim].any() and np.count_nonzero(inside) > 1:
            return across
    return None
