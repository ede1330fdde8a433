"""Float64 twins of rendering: samples along rays, statistics over views, finer grids, spectra.

Light fields L[v, u, y, x] or L[v, u, y, x, c]. Nothing here imports the package under test.
"""

from __future__ import annotations

import numpy as np
from reference_lightfield import keys_kernel
from reference_optics import Real

REACH = {"nearest": 1, "linear": 1, "cubic": 2}


def steps(views: tuple[int, int], ratio: float = 1.0) -> Real:
    """Pixels (y, x) that a view's sample moves by for disparity 1, shape (V, U, 2)."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    return np.stack(np.broadcast_arrays(-ratio * v[:, None], -u[None, :]), axis=-1)


def taps(t: Real, interpolation: str) -> Real:
    """Weight of a sample at distance t (position minus sample)."""
    if interpolation == "nearest":
        return ((t >= -0.5) & (t < 0.5)).astype(float)
    return np.maximum(1 - np.abs(t), 0) if interpolation == "linear" else keys_kernel(t)


def sample(
    view: Real, y: Real, x: Real, *, interpolation: str = "linear", mask: Real | None = None
) -> tuple[Real, Real]:
    """Values (y, x[, c]) of a view at real places and the weight of their taps (y, x).

    Taps outside the view or its mask weigh nothing and the rest is brought to 1; for "cubic", a
    place outside weighs nothing and inside the edge is repeated.
    """
    ny, nx = view.shape[:2]
    known = np.ones((ny, nx)) if mask is None else mask.astype(float)
    total = np.zeros(y.shape + view.shape[2:])
    used = np.zeros(y.shape)
    first = np.floor(y).astype(int), np.floor(x).astype(int)
    reach = REACH[interpolation]
    for a in range(1 - reach, reach + 1):
        for b in range(1 - reach, reach + 1):
            i, j = first[0] + a, first[1] + b
            w = taps(y - i, interpolation) * taps(x - j, interpolation)
            at = np.clip(i, 0, ny - 1), np.clip(j, 0, nx - 1)
            if interpolation != "cubic":
                w = w * ((i >= 0) & (i < ny) & (j >= 0) & (j < nx)) * known[at]
            total += w.reshape(w.shape + (1,) * (view.ndim - 2)) * view[at]
            used += w
    if interpolation == "cubic":
        inside = (y >= 0) & (y <= ny - 1) & (x >= 0) & (x <= nx - 1)
        return total, inside.astype(float)
    each = used.reshape(used.shape + (1,) * (view.ndim - 2))
    return np.divide(total, each, out=np.zeros_like(total), where=each > 0), used


def along_rays(
    lf: Real,
    disparity: Real | float,
    *,
    weights: Real,
    step: Real,
    interpolation: str = "linear",
    mask: Real | None = None,
) -> tuple[Real, Real]:
    """(values, weights) of every view of a weight, shapes (k, y, x[, c]) and (k, y, x)."""
    ny, nx = lf.shape[2:4]
    y, x = np.mgrid[:ny, :nx].astype(float)
    values, used = [], []
    for v, u in np.argwhere(weights != 0):
        part, w = sample(
            lf[v, u].astype(float),
            y + step[v, u, 0] * disparity,
            x + step[v, u, 1] * disparity,
            interpolation=interpolation,
            mask=None if mask is None else mask[v, u],
        )
        values.append(part)
        used.append(w * weights[v, u])
    return np.array(values), np.array(used)


def statistic(mode: str, values: Real, weights: Real) -> Real:
    """Weighted mean, variance, median, max or min over the first axis; 0 without any weight."""
    w = np.broadcast_to(weights.reshape(weights.shape + (1,) * (values.ndim - 3)), values.shape)
    total = w.sum(axis=0)
    some = total > 0
    safe = np.where(some, total, 1)
    mean = (w * values).sum(axis=0) / safe
    if mode == "mean":
        return np.where(some, mean, 0)
    if mode == "variance":
        return np.where(some, (w * (values - mean) ** 2).sum(axis=0) / safe, 0)
    if mode in ("max", "min"):
        sign = 1 if mode == "max" else -1
        return np.where(some, sign * np.where(w > 0, sign * values, -np.inf).max(axis=0), 0)
    order = np.argsort(np.where(w > 0, values, np.inf), axis=0, kind="stable")
    ranked, below = (np.take_along_axis(a, order, 0) for a in (values, w))
    below = np.cumsum(below, axis=0)
    lower = np.take_along_axis(ranked, (below >= total / 2 - 1e-12).argmax(axis=0)[None], 0)[0]
    upper = np.take_along_axis(ranked, (below > total / 2 + 1e-12).argmax(axis=0)[None], 0)[0]
    return np.where(some, (lower + upper) / 2, 0)


def upsampled(
    lf: Real, disparity: float, n: int, *, weights: Real, step: Real, base: float
) -> Real:
    """Pictures on a grid n times finer: every sample near its true place, shape (n y, n x[, c]).

    A sample at distance t (in pixels of the views, along each axis) weighs
    tent(n ty) tent(n tx) + base tent(ty) tent(tx).
    """
    ny, nx = lf.shape[2:4]
    at_y, at_x = ((np.arange(n * m) + 0.5) / n - 0.5 for m in (ny, nx))
    top = np.zeros((n * ny, n * nx, *lf.shape[4:]))
    used = np.zeros((n * ny, n * nx))

    def tents(at: Real, count: int) -> tuple[Real, Real]:
        t = np.abs(at[:, None] - np.arange(count))
        return np.maximum(1 - n * t, 0), np.maximum(1 - t, 0)

    for v, u in np.argwhere(weights != 0):
        fine_y, wide_y = tents(at_y + step[v, u, 0] * disparity, ny)
        fine_x, wide_x = tents(at_x + step[v, u, 1] * disparity, nx)
        view = lf[v, u].astype(float)
        for my, mx, scale in ((fine_y, fine_x, 1.0), (wide_y, wide_x, base)):
            w = weights[v, u] * scale
            top += w * np.einsum("ij,jk...,lk->il...", my, view, mx)
            used += w * np.outer(my.sum(axis=1), mx.sum(axis=1))
    each = used.reshape(used.shape + (1,) * (top.ndim - 2))
    return np.divide(top, each, out=np.zeros_like(top), where=each > 0)


def phase_ramps(lf: Real, disparity: float, *, weights: Real, step: Real) -> Real:
    """Mean of the views shifted by a phase ramp in their spectra (periodic edges)."""
    ny, nx = lf.shape[2:4]
    fy, fx = np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :]
    total = np.zeros(lf.shape[2:])
    for v, u in np.argwhere(weights != 0):
        sy, sx = step[v, u] * disparity
        ramp = np.exp(2j * np.pi * (fy * sy + fx * sx))
        view = lf[v, u].astype(float).reshape(ny, nx, -1)
        moved = np.fft.ifft2(np.fft.fft2(view, axes=(0, 1)) * ramp[..., None], axes=(0, 1)).real
        total += weights[v, u] * moved.reshape(total.shape)
    return total / weights.sum()


def hyperfan(
    lf: Real, low: float, high: float, *, bandwidth: float, lit: Real, ratio: float = 1.0
) -> Real:
    """A light field of which the disparities from low to high pass, filtered in 4-D.

    Views that are not lit are taken from the nearest that is (the first of equals). All are moved
    by phase ramps so that the middle disparity is the same in all views, mirrored at the edges of
    the aperture, filtered with the gain 2^(-(s/bandwidth)^2/2) at distance s, in cycles a view, of
    (fv, fu) from d (ratio fy, fx), |d| <= (high - low)/2, modulo 1, and moved back.
    """
    V, U, ny, nx = lf.shape[:4]
    middle, reach = (low + high) / 2, (high - low) / 2
    fy, fx = np.fft.fftfreq(ny)[:, None] * ratio, np.fft.fftfreq(nx)[None, :]
    out = np.empty(lf.shape)
    for c in np.ndindex(*lf.shape[4:]):
        part = np.empty((V, U, ny, nx), complex)
        for v, u in np.ndindex(V, U):
            distance = [(i - v) ** 2 + (j - u) ** 2 for i, j in np.argwhere(lit)]
            i, j = np.argwhere(lit)[int(np.argmin(distance))]
            ramp = np.exp(-2j * np.pi * middle * (fy * (i - (V - 1) / 2) + fx * (j - (U - 1) / 2)))
            part[v, u] = np.fft.fft2(lf[(i, j, slice(None), slice(None), *c)].astype(float)) * ramp
        whole = np.concatenate((part, part[::-1]), 0)
        whole = np.fft.fft2(np.concatenate((whole, whole[:, ::-1]), 1), axes=(0, 1))
        fv, fu = (np.fft.fftfreq(2 * n)[:, None, None] for n in (V, U))
        away = np.full(whole.shape, np.inf)
        for m in (-1, 0, 1):
            for n in (-1, 0, 1):
                dv, du = fv[:, None] + m, fu[None] + n
                power = np.maximum(fy**2 + fx**2, 1e-30)
                d = np.clip((dv * fy + du * fx) / power, -reach, reach)
                away = np.minimum(away, (dv - d * fy) ** 2 + (du - d * fx) ** 2)
        part = np.fft.ifft2(whole * 2 ** (-away / bandwidth**2 / 2), axes=(0, 1))[:V, :U]
        for v, u in np.ndindex(V, U):
            ramp = np.exp(2j * np.pi * middle * (fy * (v - (V - 1) / 2) + fx * (u - (U - 1) / 2)))
            out[(v, u, slice(None), slice(None), *c)] = np.fft.ifft2(part[v, u] * ramp).real
    return out


def between_planes(stack: Real, disparities: Real, disparity: Real) -> Real:
    """A stack at real disparities (y, x), linear between neighbouring planes, held at the ends."""
    order = np.argsort(disparities)
    place = np.interp(disparity, disparities[order], np.arange(len(order)))
    below = np.minimum(np.floor(place).astype(int), len(order) - 2)
    part = place - below
    rows, columns = np.indices(disparity.shape)
    part = part.reshape(part.shape + (1,) * (stack.ndim - 3))
    pictures = stack[order].astype(float)
    return (1 - part) * pictures[below, rows, columns] + part * pictures[below + 1, rows, columns]


def blended(stack: Real, energy: Real, power: int) -> Real:
    """Planes weighted with (E / max E)^power, equally where no plane has any energy."""
    top = energy.max(axis=0)
    w = np.where(top > 0, (energy / np.where(top > 0, top, 1)) ** power, 1.0)
    w = w.reshape(w.shape + (1,) * (stack.ndim - 3))
    return (w * stack).sum(axis=0) / w.sum(axis=0)


def covered(inside: Real, fine: int) -> Real:
    """Fraction of every view's cell, from a raster of fine x fine points in each."""
    V, U = inside.shape[0] // fine, inside.shape[1] // fine
    return inside.reshape(V, fine, U, fine).mean(axis=(1, 3))


def raster(views: tuple[int, int], fine: int) -> tuple[Real, Real]:
    """(v, u) of the points of `covered`, as column and row."""
    v, u = ((np.arange(n * fine) + 0.5) / fine - 0.5 for n in views)
    return v[:, None], u[None, :]
