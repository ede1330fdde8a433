"""Checks of depth: every cue, matching, and the maps that are combined of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.peaks import PeakTracker
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth import combined_cue
from clplen.lightfield.depth.correspondence_cue import shear_moments
from clplen.lightfield.depth.energy_cue import LocalEnergy
from clplen.lightfield.depth.sheared_views import add_colours
from clplen.lightfield.depth.structure_tensor_cue import epi_tensors
from clplen.lightfield.matching.plane_spans import all_planes
from clplen.lightfield.matching.support_windows import (
    gather_costs,
    lowest_valley,
    normal_equations,
)
from clplen.lightfield.matching.view_detail import STEPS, view_detail
from clplen.lightfield.matching.view_matching import (
    WINDOW,
    group_views,
    match_costs,
    shift_tables,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs


def _smooth(device: Device) -> Pairs:
    maps, taps = twins.reals(1, 2, 11, 75), gaussian_taps(1.5)
    out = device.zeros((3, 11, 75), np.float32)
    Smoother(taps, device=device)(out, device.upload(maps), start=1, count=2)
    expected = np.zeros((3, 11, 75))
    expected[1:] = twins.reflected(twins.reflected(maps.astype(float), taps, 1), taps, 2)
    yield expected, device.download(out)


def _detail(device: Device) -> Pairs:
    a = twins.reals(2, 2, 13, 29, 3, low=1, high=2)
    planes = np.array([0.0, 0.5])
    stack = FocalStack(device.upload(a), device, planes, planes)
    out = device.empty((2, 13, 29), np.float32)
    LocalEnergy(1.5, (13, 29, 3), device=device)(out, stack, start=0, count=2)
    taps = gaussian_taps(1.5)
    low = twins.reflected(twins.reflected(a.astype(float), taps, 1), taps, 2)
    yield ((a - low) ** 2).sum(axis=-1), device.download(out)


def _peaks(device: Device) -> Pairs:
    """The vertex of the parabola through the highest of 5 planes that are unevenly spaced."""
    values = np.array([-1.7, -1.6, -0.9, 0.0, 0.7])
    vertex = twins.reals(3, 7, 17, low=-1.5, high=-0.1).astype(float)
    curve = (6 - (values[:, None, None] - vertex) ** 2).astype(np.float32)
    tracker = PeakTracker((7, 17), device=device, start=0.0, most=5)
    with device.on_host(tracker.curve) as planes:
        planes[: curve.size] = curve.ravel()
    tracker.add(values)
    place, sure = tracker.finish()
    yield vertex, place
    k = 2 / curve.max(axis=0).astype(float)
    yield k / (1 + k), sure


def _moments(device: Device) -> Pairs:
    a = twins.reals(4, 3, 2, 6, 37, low=100, high=160).astype(np.uint8)
    w, planes = twins.reals(5, 3, 2, low=0.1), np.array([0.3, -1.75])
    lf = LightField.from_array(a, device=device, weights=w)
    found = shear_moments(lf, planes)
    means, spreads = np.zeros((2, 2, 6, 37))
    for p, d in enumerate(planes):
        steps = d * twins.view_steps((3, 2)).reshape(-1, 2)
        pairs = [
            twins.moved(a[n], s, clamp=True) for n, s in zip(np.ndindex(3, 2), steps, strict=True)
        ]
        share = w.ravel()[:, None, None] * np.array([inside for _, inside in pairs])
        values = np.array([value for value, _ in pairs])
        share /= share.sum(axis=0)
        means[p] = (share * values).sum(axis=0)
        spreads[p] = (share * (values - means[p]) ** 2).sum(axis=0)
    yield means, device.download(found.mean)
    yield spreads, device.download(found.variance)


def _colours(device: Device) -> Pairs:
    maps = twins.reals(6, 2, 3, 37, 3)
    yield maps.sum(axis=-1, dtype=float), device.download(add_colours(device.upload(maps), device))


def _tensor(device: Device) -> Pairs:
    """Gradients along x (or y) and across neighbouring views, their products summed over pairs."""
    a = (200 * twins.reals(7, 2, 3, 6, 37)).astype(np.uint16)
    lf = LightField.from_array(a, device=device)
    d, steps = 0.35, twins.view_steps((2, 3))
    expected = np.zeros((6, 6, 37))
    for k, axis in enumerate((1, 0)):
        unit = np.eye(2)[axis]

        def gradients(n: Any, unit: Any = unit) -> Any:
            before, at, after = (
                twins.moved(a[n], d * steps[n] + t * unit, clamp=True)[0] for t in (-1, 0, 1)
            )
            return (before + 4 * at + after) / 6, (after - before) / 2

        for n in np.ndindex(2, 3):
            other = (n[0] + 1 - axis, n[1] + axis)
            if other[0] < 2 and other[1] < 3:
                (h0, g0), (h1, g1) = gradients(n), gradients(other)
                share = (
                    twins.moved(a[n], d * steps[n])[1] * twins.moved(a[other], d * steps[other])[1]
                )
                Lx, Lu = (g0 + g1) / 2, h1 - h0
                expected[3 * k : 3 * k + 3] += share * np.array([Lx * Lx, Lx * Lu, Lu * Lu])
    yield expected, device.download(epi_tensors(lf, d))


def _coherence_of(J: Any) -> Any:
    xx, xu, uu = J
    return np.where(xx > uu, ((xx - uu) ** 2 + 4 * xu**2) / (xx + uu) ** 2, 0)


def _coherence(device: Device) -> Pairs:
    shears, reach, shape = (-0.25, 0.0, 0.25), 0.1875, (5, 37)
    random = np.random.default_rng(8)
    g, e = random.normal(size=(2, 3, 2, 4, *shape))
    u = 0.15 * g + 0.3 * e
    tensors = np.stack([(p * q).sum(axis=2) for p, q in ((g, g), (g, u), (u, u))], axis=2)
    tensors = tensors.reshape(3, 6, *shape).astype(np.float32)
    state = [device.upload(np.full(shape, v, np.float32)) for v in (0, 0, 0.5)]
    best, second, place = np.zeros(shape), np.zeros(shape), np.full(shape, 0.5)
    kernel = device.kernel("coherence.cl", "most_coherent")
    for J, d0 in zip(tensors, shears, strict=True):
        numbers = (np.float32(d0), np.float32(reach), np.int32(5), np.int32(37))
        device.launch_rows(kernel, shape, *state, device.upload(J), *numbers)
        wide = J.astype(float)
        both = _coherence_of(wide[:3]) * wide[:3] + _coherence_of(wide[3:]) * wide[3:]
        off = np.divide(both[1], both[0], out=np.zeros(shape), where=both[0] > 0)
        c = np.where(np.abs(off) <= reach, _coherence_of(both), 0)
        far = np.abs(d0 + off - place) > reach
        second = np.where(far, np.maximum(second, np.minimum(best, c)), second)
        place, best = np.where(c > best, d0 + off, place), np.maximum(best, c)
    for expected, got in zip((best, second, place), state, strict=True):
        yield expected, device.download(got)


CHECKS = (
    Check("smooth", "maps smoothed by a Gaussian", _smooth, 1e-6,
          ("smooth.cl", "separated.cl")),
    Check("detail", "energy of detail of coloured pictures", _detail, 1e-5, ("detail.cl",)),
    Check("peaks", "highest of 5 uneven planes, by a parabola", _peaks, 1e-4, ("peaks.cl",)),
    Check("moments", "mean and variance over moved views, bytes", _moments, 2e-5,
          ("moments.cl", "sheared.cl")),
    Check("colours", "colours added", _colours, 4 * EPS, ("colours.cl",)),
    Check("tensor", "slopes of epipolar planes, 16-bit samples", _tensor, 1e-5,
          ("tensor.cl", "sheared.cl")),
    Check("coherence", "the most coherent of three slopes", _coherence, 64 * EPS,
          ("coherence.cl",)),
)  # fmt: skip


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
        twice = np.repeat(self.samples[..., None], 2, axis=-1)
        self.twice = LightField.from_array(twice, device=device)  # in the form of any channels
        self.sorted = group_views(self.lf)
        self.moved = shift_tables(self.sorted, self.planes, np.ones(4), device=device)
        self.spans = all_planes(self.size, self.planes.size)
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
    costs = scene.costs()
    for channels, lf in ((1, scene.lf), (2, scene.twice)):
        found = match_costs(lf, scene.sorted, scene.moved, scene.spans)
        yield channels * costs, device.download(found)
    few = np.tile(np.array((1, 2), np.int32), (*scene.spans.shape[:2], 1))
    found = match_costs(scene.lf, scene.sorted, scene.moved, few)
    yield costs[1:3], device.download(found)[1:3]


def _view_detail(device: Device) -> Pairs:
    """Views less their Gaussian, in 64ths, reflected at the edges."""
    scene = _Scene(device)
    gains = np.array([[1.0, 0.5], [0.25, 1.0]])
    taps = gaussian_taps(2.0)
    window = np.concatenate((taps[:0:-1], taps))
    low = scene.samples.astype(float)
    for axis in (2, 3):
        n, reach = low.shape[axis], taps.size - 1
        index = np.arange(-reach, n + reach) % (2 * n)
        wide = np.take(low, np.where(index < n, index, 2 * n - 1 - index), axis)
        parts = (w * np.take(wide, np.arange(n) + k, axis) for k, w in enumerate(window))
        low = sum(parts, start=np.zeros(low.shape))
    expected = 2**15 + np.rint(STEPS * gains[..., None, None] * (scene.samples - low))
    yield expected, view_detail(scene.lf, gains).to_numpy().astype(float)


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
    for lf, guide in ((scene.lf, picture), (scene.twice, np.repeat(picture[None], 2, 0))):
        out = device.empty(cost.shape, np.float32)
        alike = combined_cue._colour_scale(combined_cue._ALIKE, noise, (*lf.shape, 1)[4])
        scales = (combined_cue._distance_scale(noise), alike)
        gather_costs(lf, out, device.upload(cost), device.upload(guide), scales, scene.spans)
        yield expected, device.download(out)
    vertex = twins.reals(13, *scene.size, low=-0.5, high=0.6).astype(float)
    cost = (2 + (scene.planes[:, None, None] - vertex) ** 2).astype(np.float32)
    args = (scene.lf, device.upload(cost), scene.moved)
    every = np.tile(scene.spans[:1, :1], (*scene.size, 1))
    place, nearest, _, _ = lowest_valley(*args, every)
    lowest = cost.argmin(axis=0)
    yield lowest, nearest
    middle = (lowest > 0) & (lowest < 3)
    yield vertex[middle], place[middle]


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
    wanted = scene.normal(disparity.astype(float), nearest)
    every = np.ones(scene.size, bool)
    args = (scene.sorted, scene.moved, disparity, nearest, every)
    for channels, lf in ((2, scene.twice), (1, scene.lf)):
        found = device.empty(scene.size, np.float32), device.empty(scene.size, np.float32)
        normal_equations(lf, *args, found)
        for expected, got in zip(wanted, found, strict=True):
            yield channels * expected, device.download(got)
    picture = twins.reals(16, *scene.size, high=40)
    noise = twins.reals(17, *scene.size, low=0.5, high=4)
    plane, known = combined_cue._refined(scene.lf, disparity, device.upload(picture), noise, found)
    maps = (*wanted, disparity.astype(float))
    fitted = _fitted(maps, picture.astype(float), noise)
    yield fitted[0], plane
    yield fitted[1], known


MATCHING_CHECKS = (
    Check("matching", "how well views agree on four planes", _matching, 1e-5,
          ("matching.cl", "match_rows.cl", "strips.cl", "spans.cl", "combined.cl", "vectors.cl")),
    Check("view detail", "views less their Gaussian", _view_detail, 2e-5, ("view_detail.cl",)),
    Check("support", "costs of neighbours that look alike", _support, 2e-5,
          ("support.cl", "gather_rows.cl", "valley_rows.cl", "bell.cl")),
    Check("refine", "least squares over views and neighbours", _refine, 5e-5,
          ("refine.cl", "normal_rows.cl", "fit_rows.cl")),
)  # fmt: skip
