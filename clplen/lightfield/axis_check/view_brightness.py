"""Relative brightness of views, and views that are nearly black."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.lightfield.matching.view_matching import row_sums
from clplen.lightfield.model.apertures import aperture_weights
from clplen.lightfield.model.light_field import LightField

Real = np.ndarray[Any, np.dtype[np.float64]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

NEARLY_BLACK = 0.02  # of the median brightness: darker views count as nearly black


def relative_brightness(lf: LightField) -> Real:
    """Return the mean sample of every view over the median of the weighted views."""
    sums = row_sums(lf).astype(np.float64).sum(axis=1).reshape(lf.weights.shape)
    median = float(np.median(sums[lf.weights > 0]))
    return sums / median if median > 0 else np.full_like(sums, np.nan)


def nearly_black_views(lf: LightField, brightness: Real) -> Mask:
    """Return a mask of the weighted views whose mean is below 2 % of the median."""
    return (lf.weights > 0) & (brightness < NEARLY_BLACK)


def clear_aperture(lf: LightField, dim: Mask) -> int | None:
    """Return the widest aperture, in views, that excludes the dim views and exceeds one view."""
    for across in range(max(lf.shape[:2]), 1, -1):
        inside = aperture_weights(lf, across, None) * lf.weights > 0
        if not inside[dim].any() and np.count_nonzero(inside) > 1:
            return across
    return None
