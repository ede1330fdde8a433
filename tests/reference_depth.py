"""Plain depth in NumPy, not to lose to: energy or variance of refocused pictures, best plane.

Grey, bilinear shifts with the edge repeated, planes 0.1 apart, a parabola through the best plane
and its neighbours. Nothing here imports the package under test.
"""

from __future__ import annotations

import numpy as np
from reference_optics import Real
from scipy.ndimage import gaussian_filter, shift, uniform_filter

PLANES = np.arange(-2.0, 2.05, 0.1)


def moments(L: Real, d: float) -> tuple[Real, Real]:
    """Mean and mean of squares over views of L[v, u](y - (v - vc) d, x - (u - uc) d)."""
    V, U = L.shape[:2]
    first, second = np.zeros(L.shape[2:]), np.zeros(L.shape[2:])
    for v, u in np.ndindex(V, U):
        moved = (d * (v - (V - 1) / 2), d * (u - (U - 1) / 2))
        seen = shift(L[v, u], moved, order=1, mode="nearest")
        first += seen
        second += seen**2
    return first / (V * U), second / (V * U)


def energy(L: Real, d: float) -> Real:
    """-G_4 * (R - G_1.5 * R)^2, R refocused on d: smallest where it is sharp."""
    picture, _ = moments(L, d)
    return -gaussian_filter((picture - gaussian_filter(picture, 1.5)) ** 2, 4)


def variance(L: Real, d: float) -> Real:
    """Variance over views in a box of 9 pixels: smallest where views agree."""
    first, second = moments(L, d)
    return uniform_filter(second - first**2, 9)


def depth(L: Real, cue: str, planes: Real = PLANES) -> Real:
    """Disparity of the centre view of L[v, u, y, x(, c)] by "energy" or "variance"."""
    grey = L.mean(axis=4) if L.ndim == 5 else L
    cost = np.stack([{"energy": energy, "variance": variance}[cue](grey, d) for d in planes])
    best = np.clip(cost.argmin(axis=0), 1, len(planes) - 2)[None]
    before, at, after = (np.take_along_axis(cost, best + k, 0)[0] for k in (-1, 0, 1))
    curve = before - 2 * at + after
    off = np.where(curve > 0, (before - after) / np.where(curve > 0, 2 * curve, 1), 0)
    return planes[best[0]] + np.clip(off, -0.5, 0.5) * (planes[1] - planes[0])
