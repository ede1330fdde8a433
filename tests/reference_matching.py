"""Float64 twins of the combined depth cue: matching past occlusions, support, least squares.

Views L[k, y, x, c]; the sample of view k that belongs to the place (y, x) of the centre view on a
plane of disparity d lies at (y, x) + d steps[k]. Nothing here imports the package under test.
"""

from __future__ import annotations

import numpy as np
from reference_lightfield import apply, sampling_matrix
from reference_optics import Real

HALVES = [(np.sin(a), np.cos(a)) for a in np.arange(8) * np.pi / 4]


def smooth(views: Real, gain: float, b: float) -> Real:
    """gain times the views, filtered by (b, 1 - 2b, b) along y and x, edges repeated."""
    values = np.pad(views.astype(float), ((0, 0), (1, 1), (1, 1), (0, 0)), mode="edge")
    values = b * (values[:, :-2] + values[:, 2:]) + (1 - 2 * b) * values[:, 1:-1]
    return gain * (b * (values[:, :, :-2] + values[:, :, 2:]) + (1 - 2 * b) * values[:, :, 1:-1])


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


def moved(view: Real, shift: Real, kernel: str = "cubic") -> Real:
    """view (y, x, c) at (y, x) + shift, edges repeated."""
    for axis in (0, 1):
        n = view.shape[axis]
        view = apply(sampling_matrix(np.arange(n) + shift[axis], n, kernel=kernel, edge="clamp"),
                     view, axis)  # fmt: skip
    return view


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


def valley(cost: Real, planes: Real) -> tuple[Real, Real, Real, Real]:
    """(place, least, second lowest valley, mean) of every curve; inf without a second valley."""
    count, *shape = cost.shape
    place, least, second = (np.full(shape, np.inf) for _ in range(3))
    for n in np.ndindex(*shape):
        e = np.concatenate(([np.inf], cost[(slice(None), *n)], [np.inf]))
        low = sorted((e[p], p - 1) for p in range(1, count + 1) if e[p - 1] >= e[p] < e[p + 1])
        least[n], best = low[0]
        second[n] = low[1][0] if len(low) > 1 else np.inf
        place[n] = planes[best]
        if 0 < best < count - 1:
            a, b, _ = np.polyfit(planes[best - 1 : best + 2] - planes[best], e[best : best + 3], 2)
            place[n] -= b / (2 * a)
    return place, least, second, cost.mean(axis=0)


def along(view: Real, y: float, x: float, step: Real) -> tuple[Real, Real]:
    """(value, slope along step) of one view (y, x, c) at a place inside it; linear."""
    i, j = (min(int(p), max(n - 2, 0)) for p, n in zip((y, x), view.shape, strict=False))
    i1, j1 = min(i + 1, view.shape[0] - 1), min(j + 1, view.shape[1] - 1)
    t, s = y - i, x - j
    left, right = (view[i, k] * (1 - t) + view[i1, k] * t for k in (j, j1))
    top, bottom = (view[k, j] * (1 - s) + view[k, j1] * s for k in (i, i1))
    return left * (1 - s) + right * s, step[0] * (bottom - top) + step[1] * (right - left)


def normal(
    S: Real, disparity: Real, steps: Real, share: Real, centre: Real, limits: Real
) -> tuple[Real, Real]:
    """A and B at every pixel, of the group of views of least cost."""
    tau, ratio, margin = limits
    ny, nx = disparity.shape
    A, B = np.zeros((ny, nx)), np.zeros((ny, nx))
    for n in np.ndindex(ny, nx):
        places = np.array(n) + disparity[n] * steps
        inside = ((places >= 0) & (places <= (ny - 1, nx - 1))).all(axis=1)
        clamped = np.clip(places, 0, (ny - 1, nx - 1))
        values, slopes = np.moveaxis(
            [along(S[k], *clamped[k], steps[k]) for k in range(len(S))], 1, 0
        )
        r = values - centre @ values
        g = slopes - centre @ slopes
        e = np.abs(r).sum(axis=-1)
        mean, count = group_means(np.minimum(e, tau), inside, share)
        mean[0] = tau if np.isinf(mean[0]) else mean[0]
        cost = np.concatenate((mean[:1], ratio * mean[1:] + margin))
        best = int(np.argmin(cost))
        w = share[:, best] * inside * np.maximum(1 - (e / tau) ** 2, 0) ** 2
        if w.sum() == 0:
            continue
        g, r = (a - w @ a / w.sum() for a in (g, r))
        A[n] = w @ (g * g).sum(axis=-1) / count[best]
        B[n] = w @ (g * r).sum(axis=-1) / count[best]
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
        weight = w * (A[i, j] + prior[n])
        goal = d[i, j] + np.clip(-B[i, j] / (A[i, j] + prior[n]), -most, most)
        # rows sqrt(w) (a + by s + bx t - goal), and sqrt(ridge sum w) by and bx
        held = np.sqrt(ridge * weight.sum())
        rows = np.sqrt(weight)[:, None] * np.column_stack((np.ones(len(s)), s, t))
        rows = np.vstack((rows, [(0, held, 0), (0, 0, held)]))
        right = np.concatenate((np.sqrt(weight) * goal, (0, 0)))
        out[n] = np.linalg.lstsq(rows, right, rcond=None)[0][0]
    return out, known
