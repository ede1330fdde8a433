"""Float64 twins of the combined depth cue: matching past occlusions, support, least squares.

Views S[k, y, x, c]; the sample of view k that belongs to the place (y, x) of the centre view on a
plane of disparity d lies at (y, x) + d steps[k]. Nothing here imports the package under test.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from reference_optics import Real

HALVES = [(np.sin(a), np.cos(a)) for a in np.arange(8) * np.pi / 4]


def membership(steps: Real, among: Real | None = None) -> Real:
    """Share of every view in the whole aperture and its eight halves, shape (K, 9).

    The aperture, of all views `among`, is scaled to a square first.
    """
    among = steps if among is None else among
    size = np.abs(among).max(axis=0)
    places = -steps / np.where(size > 0, size, 1)
    share = np.ones((len(steps), 9))
    for k, (y, x) in enumerate(places):
        for j, (down, right) in enumerate(HALVES, 1):
            side = round(down * y + right * x, 9)
            share[k, j] = 0.5 if side == 0 else float(side > 0)
        if y == 0 and x == 0:
            share[k, 1:] = 0
    return share


def centre_shares(positions: Real) -> Real:
    """Bilinear shares of the views round the middle; `positions` in view steps."""
    share = np.prod(np.maximum(1 - np.abs(positions), 0), axis=1)
    if not share.any():
        share[np.argmin(np.hypot(*positions.T))] = 1
    return share / share.sum()


def bell_taps(part: float) -> Real:
    """Weights of the samples at -1, 0, 1 and 2 for a place `part` of a sample after the one at 0.

    The bell (1 - t^2/4)^4 about the place, made linear: sum 1, centre of mass at the place.
    """
    t = np.arange(-1.0, 3.0)
    w = np.maximum(1 - (t - part) ** 2 / 4, 0) ** 4
    w /= w.sum()
    mean = w @ t
    return w * (1 + (part - mean) * (t - mean) / (w @ (t - mean) ** 2))


def taps_slope(part: float) -> Real:
    """d bell_taps / d part, by differences of two widths (Richardson)."""
    near, far = ((bell_taps(part + h) - bell_taps(part - h)) / (2 * h) for h in (1e-4, 2e-4))
    return (4 * near - far) / 3


def sampled(view: Real, shift: float, axis: int, taps: Callable[[float], Real]) -> Real:
    """view (y, x, c) at its places + shift along an axis, edges repeated."""
    n, whole = view.shape[axis], int(np.floor(shift))
    index = np.arange(n)[:, None] + whole + np.arange(-1, 3)
    values = np.take(view, np.clip(index, 0, n - 1), axis)
    return np.tensordot(np.moveaxis(values, axis + 1, -1), taps(shift - whole), 1)


def moved(view: Real, shift: Real) -> Real:
    """view (y, x, c) at (y, x) + shift."""
    return sampled(sampled(view, shift[0], 0, bell_taps), shift[1], 1, bell_taps)


def slope(view: Real, shift: Real, step: Real) -> Real:
    """Derivative of `moved` along step."""
    down = sampled(sampled(view, shift[0], 0, taps_slope), shift[1], 1, bell_taps)
    right = sampled(sampled(view, shift[0], 0, bell_taps), shift[1], 1, taps_slope)
    return step[0] * down + step[1] * right


def sees(shape: tuple[int, ...], shift: Real) -> Real:
    """Whether (y, x) + shift lies between the first and the last sample."""
    rows, columns = (
        (np.arange(n) + s >= 0) & (np.arange(n) + s <= n - 1)
        for n, s in zip(shape, shift, strict=False)
    )
    return np.outer(rows, columns)


def group_means(e: Real, seen: Real, share: Real) -> tuple[Real, Real]:
    """(mean of e over the views of each group that see the place, how many), shape (9, ...).

    Infinite for a half of which less than half sees the place.
    """
    count = np.tensordot(share.T, seen.astype(float), 1)
    total = np.tensordot(share.T, seen * e, 1)
    least = np.full(9, 0.5) * share.sum(axis=0)
    least[0] = 0
    use = (count > 0) & (count >= least.reshape(-1, *(1,) * (e.ndim - 1)))
    return np.divide(total, count, out=np.full_like(total, np.inf), where=use), count


def costs(S: Real, steps: Real, share: Real, centre: Real, planes: Real, limits: Real) -> Real:
    """min(m_0, ratio min_j m_j + margin) of the truncated differences, shape (P, y, x)."""
    tau, ratio, margin = limits
    found = []
    for d in planes:
        values = np.array([moved(one, d * step) for one, step in zip(S, steps, strict=True)])
        seen = np.array([sees(S.shape[1:3], d * step) for step in steps])
        C = np.tensordot(centre, values, 1)
        e = np.minimum(np.abs(values - C).sum(axis=-1), tau)
        mean, _ = group_means(e, seen, share)
        mean[0] = np.where(np.isinf(mean[0]), tau, mean[0])
        found.append(np.minimum(mean[0], ratio * mean[1:].min(axis=0) + margin))
    return np.array(found)


def bell(q: Real) -> Real:
    return np.where(q < 8, np.maximum(1 - q / 8, 0) ** 8, 0)


def neighbours(shape: tuple[int, int], y: int, x: int, radius: int) -> tuple[Real, Real]:
    """Rows and columns of the window round (y, x), without what lies outside."""
    i, j = np.indices(shape)
    near = (np.abs(i - y) <= radius) & (np.abs(j - x) <= radius)
    return i[near], j[near]


def gather(cost: Real, picture: Real, near: Real, alike: Real, radius: int) -> Real:
    """Mean of the costs over the neighbours, weighted by nearness and likeness."""
    out = np.empty(cost.shape)
    for y, x in np.ndindex(picture.shape[:2]):
        i, j = neighbours(picture.shape[:2], y, x, radius)
        q = near[y, x] * ((i - y) ** 2 + (j - x) ** 2)
        q = q + alike[y, x] * ((picture[i, j] - picture[y, x]) ** 2).sum(axis=-1)
        w = bell(q)
        out[:, y, x] = cost[:, i, j] @ w / w.sum()
    return out


def valley(cost: Real, planes: Real) -> tuple[Real, Real, Real, Real, Real]:
    """(place, number, least, second lowest valley, mean) of every curve; inf without a second."""
    count, *shape = cost.shape
    place, least, second = (np.full(shape, np.inf) for _ in range(3))
    number = np.zeros(shape, int)
    for n in np.ndindex(*shape):
        e = np.concatenate(([np.inf], cost[(slice(None), *n)], [np.inf]))
        low = sorted((e[p], p - 1) for p in range(1, count + 1) if e[p - 1] >= e[p] < e[p + 1])
        least[n], best = low[0]
        second[n] = low[1][0] if len(low) > 1 else np.inf
        place[n], number[n] = planes[best], best
        if 0 < best < count - 1:
            a, b, _ = np.polyfit(planes[best - 1 : best + 2] - planes[best], e[best : best + 3], 2)
            place[n] -= b / (2 * a)
            least[n] = max(least[n] - abs(e[best] - e[best + 2]) / 2, 0)
    return place, number, least, second, cost.mean(axis=0)


def normal(
    S: Real, start: tuple[Real, Real, Real], steps: Real, share: Real, centre: Real, limits: Real
) -> tuple[Real, Real]:
    """A and B at every pixel, of the group of views of least cost.

    `start`: the disparities, the number of the plane next to each, and the planes.
    """
    tau, ratio, margin = limits
    disparity, nearest, planes = start
    A, B = np.zeros(disparity.shape), np.zeros(disparity.shape)
    for p, d in enumerate(planes):
        r = np.array([moved(one, d * step) for one, step in zip(S, steps, strict=True)])
        g = np.array([slope(one, d * step, step) for one, step in zip(S, steps, strict=True)])
        inside = np.array([sees(S.shape[1:3], d * step) for step in steps])
        r, g = (a - np.tensordot(centre, a, 1) for a in (r, g))
        e = np.abs(r).sum(axis=-1)
        mean, count = group_means(np.minimum(e, tau), inside, share)
        mean[0] = np.where(np.isinf(mean[0]), tau, mean[0])
        best = np.argmin(np.concatenate((mean[:1], ratio * mean[1:] + margin)), axis=0)
        for n in zip(*np.nonzero(nearest == p), strict=True):
            gn, rn, en, seen = (a[(slice(None), *n)] for a in (g, r, e, inside))
            w = share[:, best[n]] * seen * np.maximum(1 - (en / tau) ** 2, 0) ** 2
            if w.sum() > 0:
                gn, rn = (a - w @ a / w.sum() for a in (gn, rn))
                A[n] = w @ (gn * gn).sum(axis=-1) / count[best[n]][n]
                B[n] = w @ (gn * rn).sum(axis=-1) / count[best[n]][n] + A[n] * (disparity[n] - d)
    return A, B


def fit(
    maps: tuple[Real, Real, Real],
    picture: Real,
    scales: tuple[Real, Real, float],
    prior: Real,
    *,
    ridge: float,
    most: float,
    radius: int,
) -> tuple[Real, Real]:
    """(disparity of the plane through the neighbours, what they know of it), from (A, B, d).

    `scales`: (alike, near, level) of bell.
    """
    A, B, d = maps
    alike, near, level = scales
    out, known = np.empty(d.shape), np.empty(d.shape)
    for n in np.ndindex(*d.shape):
        i, j = neighbours(d.shape, *n, radius)
        s, t = i - n[0], j - n[1]
        q = near[n] * (s**2 + t**2) + level * (d[i, j] - d[n]) ** 2
        w = bell(q + alike[n] * ((picture[i, j] - picture[n]) ** 2).sum(axis=-1))
        known[n] = w @ A[i, j]
        weight = w * (A[i, j] + prior[i, j])
        goal = d[i, j] + np.clip(-B[i, j] / (A[i, j] + prior[i, j]), -most, most)
        # rows sqrt(w) (a + by s + bx t - goal), and sqrt(ridge sum w) by and bx
        held = np.sqrt(ridge * weight.sum())
        rows = np.sqrt(weight)[:, None] * np.column_stack((np.ones(len(s)), s, t))
        rows = np.vstack((rows, [(0, held, 0), (0, 0, held)]))
        right = np.concatenate((np.sqrt(weight) * goal, (0, 0)))
        out[n] = np.linalg.lstsq(rows, right, rcond=None)[0][0]
    return out, known
