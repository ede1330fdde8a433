"""Slopes and places of points in light fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen import LightField

Values = np.ndarray[Any, Any]


def line(lf: LightField, radius: float) -> tuple[float, Values]:
    """Slope of a point's centroid (x, y) over (u, v) within a radius on the lens, and its place."""
    samples = lf.to_numpy().astype(np.float64)
    axes = [(np.arange(n) - (n - 1) / 2) * d for n, d in zip(lf.shape, lf.spacing, strict=True)]
    total = samples.sum((2, 3))
    y = samples.sum(3) @ axes[2] / np.maximum(total, 1e-30)
    x = samples.sum(2) @ axes[3] / np.maximum(total, 1e-30)
    v, u = np.meshgrid(axes[0], axes[1], indexing="ij")
    weight = total * (np.hypot(v, u) < radius)
    weight /= weight.sum()
    up, down = 0.0, 0.0
    place = []
    for along, at in ((u, x), (v, y)):
        middle = (weight * along).sum()
        up += (weight * (along - middle) * at).sum()
        down += (weight * (along - middle) ** 2).sum()
        place.append((weight * at).sum())
    return up / down, np.array(place)
