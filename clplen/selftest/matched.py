"""Checks of the combined cue of depth: matching, support of neighbours, least squares."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.depth import combined_cue
from clplen.lightfield.depth.view_matching import (
    WINDOW,
    group_views,
    match_costs,
    shift_tables,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

if TYPE_CHECKING:
    from clplen.compute.device import Device


class _Scene:
    """Views of the combined cue's checks, smooth enough to match, and its float64 twin.

    The 2 x 2 views about the middle make the centre C, with equal shares. A half of the aperture
    holds two views, or three of which two by one half.
    """

    views, size = (2, 2), (8, 19)
    planes = np.array([-0.9, -0.25, 0.4, 1.0])

    def __init__(self, device: Device) -> None:
        samples = twins.reals(9, *self.views, *self.size, low=20, high=120)
        for axis in (2, 3):
            samples = (samples + np.roll(samples, 1, axis)) / 2
        self.samples = samples.astype(np.float32)
        self.lf = LightField.from_array(self.samples, device=device)
        self.sorted = group_views(self.lf)
        self.moved = shift_tables(self.sorted, self.planes, np.ones(4), device=device)
        self.steps = twins.view_steps(self.views).reshape(-1, 2)

    def sheared(self, d: float, step: float = 0.0) -> tuple[Any, Any]:
        """(samples, what is seen) of every view on a plane, shapes (4, y, x)."""
        values, seen = [], []
        for view, (down, right) in zip(
            self.samples.reshape(4, *self.size), self.steps, strict=True
        ):
            found, inside = view.astype(float), []
            for axis, unit in enumerate((down, right)):
                n = self.size[axis]
                whole = int(np.floor(d * unit))
                taps = twins.bell_taps((d * unit - whole) + step * unit)
                index = np.arange(n)[:, None] + whole + np.arange(-1, 3)
                part = np.take(found, np.clip(index, 0, n - 1), axis)
                found = np.tensordot(np.moveaxis(part, axis + 1, -1), taps, 1)
                at = np.arange(n) + d * unit
                inside.append((at >= 0) & (at <= n - 1))
            values.append(found)
            seen.append(np.outer(*inside))
        return np.array(values), np.array(seen)

    def groups(self) -> Any:
        """Share of every view in the aperture and in its eight halves, shape (9, 4)."""
        angles = np.arange(8) * np.pi / 4
        sides = np.stack((np.sin(angles), np.cos(angles)), axis=1) @ -self.steps.T
        return np.concatenate((np.ones((1, 4)), np.where(np.abs(sides) < 1e-9, 0.5, sides > 0)))

    def means(self, e: Any, seen: Any) -> tuple[Any, Any]:
        """Mean of min(e, tau) over each group, infinite where too few see the place; the counts."""
        tau, share = thresholds(1)[0], self.groups()
        count = np.tensordot(share, seen.astype(float), 1)
        total = np.tensordot(share, seen * np.minimum(e, tau), 1)
        some = (count > 0) & (count >= 0.5 * share.sum(axis=1)[:, None, None])
        some[0] = count[0] > 0
        mean = np.divide(total, count, out=np.full(total.shape, np.inf), where=some)
        mean[0] = np.where(np.isinf(mean[0]), tau, mean[0])
        return mean, count

    def costs(self) -> Any:
        _, ratio, margin = thresholds(1)
        found = []
        for d in self.planes:
            values, seen = self.sheared(d)
            mean, _ = self.means(np.abs(values - values.mean(axis=0)), seen)
            found.append(np.minimum(mean[0], ratio * mean[1:].min(axis=0) + margin))
        return np.array(found)

    def normal(self, disparity: Any, nearest: Any) -> tuple[Any, Any]:
        """A and B: squares and products of the slopes, weighted, means taken out."""
        tau, ratio, margin = thresholds(1)
        A, B = np.zeros((2, *self.size))
        for p, d in enumerate(self.planes):
            r, seen = self.sheared(d)
            h = 1e-4
            g = (self.sheared(d, h)[0] - self.sheared(d, -h)[0]) / (2 * h)
            r, g = r - r.mean(axis=0), g - g.mean(axis=0)
            mean, count = self.means(np.abs(r), seen)
            best = np.argmin(np.concatenate((mean[:1], ratio * mean[1:] + margin)), axis=0)
            w = (
                seen
                * np.maximum(1 - (r / tau) ** 2, 0) ** 2
                * np.moveaxis(self.groups()[best], -1, 0)
            )
            total = np.maximum(w.sum(axis=0), 1e-30)
            g, r = (a - (w * a).sum(axis=0) / total for a in (g, r))
            n = np.take_along_axis(count, best[None], 0)[0]
            n = np.where(n > 0, n, 1)
            a = (w * g * g).sum(axis=0) / n
            here = nearest == p
            A[here] = a[here]
            B[here] = ((w * g * r).sum(axis=0) / n + a * (disparity - d))[here]
        return A, B


def _matching(device: Device) -> Pairs:
    scene = _Scene(device)
    yield scene.costs(), device.download(match_costs(scene.lf, scene.sorted, scene.moved))


def _bell(q: Any) -> Any:
    return np.maximum(1 - q / 8, 0) ** 8


def _neighbours(shape: tuple[int, int], y: int, x: int) -> Any:
    rows = np.arange(max(y - WINDOW, 0), min(y + WINDOW + 1, shape[0]))
    columns = np.arange(max(x - WINDOW, 0), min(x + WINDOW + 1, shape[1]))
    return np.ix_(rows, columns)


def _support(device: Device) -> Pairs:
    """Costs gathered over neighbours that look alike, and the parabola through the least."""
    scene = _Scene(device)
    cost = twins.reals(10, 4, *scene.size, low=1, high=30)
    picture = twins.reals(11, *scene.size, high=40)
    noise = twins.reals(12, *scene.size, low=0.5, high=4)
    out = device.empty(cost.shape, np.float32)
    combined_cue._gather(scene.lf, out, device.upload(cost), device.upload(picture), noise)
    near = combined_cue._distance_scale(noise).astype(float)
    alike = combined_cue._colour_scale(combined_cue._ALIKE, noise, 1).astype(float)
    expected = np.zeros(cost.shape)
    I = picture.astype(float)  # noqa: E741
    for y, x in np.ndindex(*scene.size):
        i, j = _neighbours(scene.size, y, x)
        w = _bell(
            near[y, x] * ((i - y) ** 2 + (j - x) ** 2) + alike[y, x] * (I[i, j] - I[y, x]) ** 2
        )
        expected[:, y, x] = (w * cost[:, i, j]).sum(axis=(1, 2)) / w.sum()
    yield expected, device.download(out)
    vertex = twins.reals(13, *scene.size, low=-0.5, high=0.6).astype(float)
    cost = (2 + (scene.planes[:, None, None] - vertex) ** 2).astype(np.float32)
    place, nearest, _, _ = combined_cue._valley(scene.lf, device.upload(cost), scene.moved)
    lowest = cost.argmin(axis=0)
    yield lowest, device.download(nearest)
    middle = (lowest > 0) & (lowest < 3)
    yield vertex[middle], device.download(place)[middle]


def _fitted(maps: Any, picture: Any, noise: Any) -> Any:
    """Disparity of the plane through the neighbours' steps, and what is known of it."""
    A, B, d = maps
    near = combined_cue._distance_scale(noise).astype(float)
    alike = combined_cue._colour_scale(combined_cue._FIT_ALIKE, noise, 1).astype(float)
    level = 0.5 / combined_cue._SAME_SURFACE**2
    prior = combined_cue._PRIOR * np.maximum(noise, 1).astype(float) ** 2
    out, known = np.zeros((2, *d.shape))
    for y, x in np.ndindex(*d.shape):
        i, j = _neighbours(d.shape, y, x)
        s, t = np.broadcast_arrays(i - y, j - x)
        q = near[y, x] * (s**2 + t**2) + level * (d[i, j] - d[y, x]) ** 2
        share = _bell(q + alike[y, x] * (picture[i, j] - picture[y, x]) ** 2)
        w = share * (A[i, j] + prior[i, j])
        most = combined_cue._MOST_STEP
        goal = d[i, j] + np.clip(-B[i, j] / (A[i, j] + prior[i, j]), -most, most)
        rows = np.stack((np.ones(s.shape), s, t)).reshape(3, -1)
        matrix = (rows * w.ravel()) @ rows.T + combined_cue._RIDGE * w.sum() * np.diag((0, 1, 1))
        out[y, x] = np.linalg.solve(matrix, (rows * w.ravel()) @ goal.ravel())[0]
        known[y, x] = (share * A[i, j]).sum()
    return out, known


def _refine(device: Device) -> Pairs:
    """One step of least squares over the views, and the plane through the neighbours' steps."""
    scene = _Scene(device)
    nearest = np.random.default_rng(14).integers(0, 4, scene.size).astype(np.int32)
    off = twins.reals(15, *scene.size, low=-0.1, high=0.1)
    disparity = (scene.planes[nearest] * 0.1 + off).astype(np.float32)
    given = (device.upload(disparity), device.upload(nearest))
    wanted = scene.normal(disparity.astype(float), nearest)
    found = combined_cue._normal(scene.lf, scene.sorted, scene.moved, *given)
    for expected, got in zip(wanted, found, strict=True):
        yield expected, device.download(got)
    picture = twins.reals(16, *scene.size, high=40)
    noise = twins.reals(17, *scene.size, low=0.5, high=4)
    args = (scene.sorted, scene.moved, *given, device.upload(picture), noise)
    plane, known = combined_cue._refined(scene.lf, *args)
    maps = (*wanted, disparity.astype(float))
    wanted = _fitted(maps, picture.astype(float), noise)
    yield wanted[0], plane
    yield wanted[1], known


CHECKS = (
    Check("matching", "how well views agree on four planes", _matching, 1e-5,
          ("matching.cl", "combined.cl")),
    Check("support", "costs of neighbours that look alike", _support, 2e-5,
          ("support.cl", "bell.cl")),
    Check("refine", "least squares over views and neighbours", _refine, 5e-5, ("refine.cl",)),
)  # fmt: skip
