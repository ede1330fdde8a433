"""Float64 twins of the depth cues that compare views: moments over the views, structure tensor.

Light fields L[v, u, y, x, c]; disparity d in pixels per view step, nearer is larger: the sample of
view n that belongs to (y, x) lies at (y, x) + d steps[n]. Nothing here imports the package under
test.
"""

from __future__ import annotations

import numpy as np
from reference_lightfield import apply, sampling_matrix
from reference_optics import Real
from scipy.ndimage import gaussian_filter, uniform_filter


def grid_steps(views: tuple[int, int]) -> Real:
    """-(v - vc), -(u - uc) of a regular grid, shape (V, U, 2)."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    return -np.stack(np.meshgrid(v, u, indexing="ij"), axis=-1)


def moved(view: Real, shift: Real) -> tuple[Real, Real]:
    """(values, share inside) of a view (y, x, c) at (y, x) + shift: linear, edges repeated."""
    values, shares = view.astype(float), []
    for axis in (0, 1):
        n = view.shape[axis]
        places = np.arange(n) + shift[axis]
        values = apply(sampling_matrix(places, n, edge="clamp"), values, axis)
        shares.append(sampling_matrix(places, n).sum(axis=1))
    return values, np.multiply.outer(*shares)


def moments(lf: Real, d: float, weights: Real, steps: Real) -> tuple[Real, Real]:
    """(mean, variance) over the views of the light field sheared by d, shape (y, x, c)."""
    found = [moved(lf[n], d * steps[n]) for n in np.ndindex(weights.shape)]
    values = np.array([value for value, _ in found])
    w = weights.ravel()[:, None, None] * np.array([share for _, share in found])
    total = w.sum(axis=0)
    some = np.where(total > 0, total, 1)[..., None]
    mean = (w[..., None] * values).sum(axis=0) / some
    return mean, (w[..., None] * (values - mean) ** 2).sum(axis=0) / some


def derivative(lf: Real, n: tuple[int, int], shift: Real, axis: int) -> tuple[Real, Real]:
    """(smoothed, slope) along an axis of one view sheared by a constant."""
    unit = np.eye(2)[axis]
    before, at, after = (moved(lf[n], shift + step * unit)[0] for step in (-1, 0, 1))
    return (before + 4 * at + after) / 6, (after - before) / 2


def pairs(weights: Real, along: int) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Views with a weight, half of those in their row (along = 1) or column (0) apart."""
    found = []
    for line in range(weights.shape[1 - along]):
        lit = [
            (line, k) if along else (k, line)
            for k in range(weights.shape[along])
            if (weights[line, k] if along else weights[k, line]) > 0
        ]
        apart = max(len(lit) // 2, 1)
        found += list(zip(lit, lit[apart:], strict=False))
    return found


def epi_tensor(lf: Real, d: float, weights: Real, steps: Real, axis: int) -> Real:
    """Sums of (Lx Lx, Lx Lu, Lu Lu) over pairs of views and colours, shape (3, y, x)."""
    out = np.zeros((3, *lf.shape[2:4]))
    for m, n in pairs(weights, axis):
        (h0, g0), (h1, g1) = (derivative(lf, k, d * steps[k], axis) for k in (m, n))
        share = moved(lf[m], d * steps[m])[1] * moved(lf[n], d * steps[n])[1]
        Lx, Lu = (g0 + g1) / 2, (h1 - h0) / -(steps[n] - steps[m])[axis]
        w = weights[m] * weights[n] * share[..., None]
        out += np.array([(w * a).sum(axis=-1) for a in (Lx * Lx, Lx * Lu, Lu * Lu)])
    return out


def coherence(J: Real) -> Real:
    """((Jxx - Juu)^2 + 4 Jxu^2)/(Jxx + Juu)^2 of tensors (3, ...), 0 where Jxx <= Juu."""
    xx, xu, uu = J
    total = np.where(xx + uu > 0, xx + uu, 1)
    return np.where(xx > uu, ((xx - uu) ** 2 + 4 * xu**2) / total**2, 0)


# Plain forms, as a few lines of numpy have them ----------------------------------------------


def vertex(cost: Real, planes: Real) -> Real:
    """Disparity of the lowest cost (n, y, x), refined by a parabola clipped to half a step."""
    best = np.clip(np.argmin(cost, axis=0), 1, len(planes) - 2)[None]
    a, b, c = (np.take_along_axis(cost, best + k, 0)[0] for k in (-1, 0, 1))
    bend = a - 2 * b + c
    off = np.divide(a - c, 2 * bend, out=np.zeros_like(a), where=bend != 0)
    return planes[best[0]] + (planes[1] - planes[0]) * np.clip(off, -0.5, 0.5)


def plain_depth(lf: Real, planes: Real) -> dict[str, Real]:
    """{"energy": ..., "correspondence": ...} of views (v, u, y, x): Gaussians 1.5 and 4, box 9."""
    energy, variance = [], []
    ones, steps = np.ones(lf.shape[:2]), grid_steps(lf.shape[:2])
    for d in planes:
        mean, spread = (a[..., 0] for a in moments(lf[..., None], d, ones, steps))
        detail = mean - gaussian_filter(mean, 1.5)
        energy.append(-gaussian_filter(detail**2, 4))
        variance.append(uniform_filter(spread, 9))
    found = {"energy": energy, "correspondence": variance}
    return {name: vertex(np.array(cost), planes) for name, cost in found.items()}
