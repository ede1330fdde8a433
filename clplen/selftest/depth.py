"""Checks of depth: cues and matching."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.correspondence_cue import shear_moments
from clplen.lightfield.depth.cue import PeakTracker
from clplen.lightfield.depth.structure_tensor_cue import epi_tensors
from clplen.lightfield.matching.view_detail import all_planes
from clplen.lightfield.matching.view_matching import (
    group_views,
    match_costs,
    shift_tables,
    thresholds,
)
from clplen.lightfield.model.light_field import LightField
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs


def _smooth(device: Device) -> Pairs:
    maps, taps = twins.reals(1, 2, 11, 75), gaussian_taps(1.5)
    out = device.zeros((3, 11, 75), np.float32)
    Smoother(taps, device=device)(out, device.upload(maps), start=1, count=2)
    expected = np.zeros((3, 11, 75))
    expected[1:] = twins.reflected(twins.reflected(maps.astype(float), taps, 1), taps, 2)
    yield expected, device.download(out)


def _peaks(device: Device) -> Pairs:
    """Check the vertex of the parabola through the highest of 5 unevenly spaced planes."""
    values = np.array([-1.7, -1.6, -0.9, 0.0, 0.7])
    vertex = twins.reals(3, 7, 17, low=-1.5, high=-0.1).astype(float)
    curve = (6 - (values[:, None, None] - vertex) ** 2).astype(np.float32)
    tracker = PeakTracker((7, 17), device=device, start=0.0, capacity=5)
    with device.on_host(tracker.curve) as planes:
        planes[: curve.size] = curve.ravel()
    tracker.add(values)
    position, confidence = tracker.finish()
    yield vertex, position
    k = 2 / curve.max(axis=0).astype(float)
    yield k / (1 + k), confidence


def _moments(device: Device) -> Pairs:
    a = twins.reals(4, 3, 2, 6, 37, low=100, high=160).astype(np.uint8)
    w, planes = twins.reals(5, 3, 2, low=0.1), np.array([0.3, -1.75])
    lf = LightField.from_array(a, device=device, weights=w)
    mean_map, variance_map = shear_moments(lf, planes)
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
    yield means, device.download(mean_map)
    yield spreads, device.download(variance_map)


def _tensor(device: Device) -> Pairs:
    """Check products of gradients along x (or y) and across views, summed over pairs."""
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


class _Scene:
    """Views that are smooth enough to match, and the float64 reference of matching.

    The 2 x 2 views around the middle form the centre; half apertures hold two to three views.
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
        """Return (samples, visibility) of every view on a plane, shapes (4, y, x)."""
        values, visible = [], []
        for view, (down, right) in zip(
            self.samples.reshape(4, *self.size), self.steps, strict=True
        ):
            samples, inside = view.astype(float), []
            for axis, unit in enumerate((down, right)):
                n = self.size[axis]
                shift = int(np.floor(d * unit))
                taps = twins.bell_taps((d * unit - shift) + step * unit)
                index = np.arange(n)[:, None] + shift + np.arange(-1, 3)
                part = np.take(samples, np.clip(index, 0, n - 1), axis)
                samples = np.tensordot(np.moveaxis(part, axis + 1, -1), taps, 1)
                at = np.arange(n) + d * unit
                inside.append((at >= 0) & (at <= n - 1))
            values.append(samples)
            visible.append(np.outer(*inside))
        return np.array(values), np.array(visible)

    def groups(self) -> Any:
        """Return the weight of every view in the aperture and its eight halves, shape (9, 4)."""
        angles = np.arange(8) * np.pi / 4
        sides = np.stack((np.sin(angles), np.cos(angles)), axis=1) @ -self.steps.T
        return np.concatenate((np.ones((1, 4)), np.where(np.abs(sides) < 1e-9, 0.5, sides > 0)))

    def means(self, e: Any, visible: Any) -> tuple[Any, Any]:
        """Return means of min(e, tau) per group, infinite with too few views, and their counts."""
        tau, share = thresholds(1)[0], self.groups()
        count = np.tensordot(share, visible.astype(float), 1)
        total = np.tensordot(share, visible * np.minimum(e, tau), 1)
        is_valid = (count > 0) & (count >= 0.5 * share.sum(axis=1)[:, None, None])
        is_valid[0] = count[0] > 0
        mean = np.divide(total, count, out=np.full(total.shape, np.inf), where=is_valid)
        mean[0] = np.where(np.isinf(mean[0]), tau, mean[0])
        return mean, count

    def costs(self) -> Any:
        _, ratio, margin = thresholds(1)
        planes = []
        for d in self.planes:
            values, visible = self.sheared(d)
            mean, _ = self.means(np.abs(values - values.mean(axis=0)), visible)
            planes.append(np.minimum(mean[0], ratio * mean[1:].min(axis=0) + margin))
        return np.array(planes)


def _matching(device: Device) -> Pairs:
    scene = _Scene(device)
    costs = scene.costs()
    for channels, lf in ((1, scene.lf), (2, scene.twice)):
        computed = match_costs(lf, scene.sorted, scene.moved, scene.spans)
        yield channels * costs, device.download(computed)
    plane_range = np.tile(np.array((1, 2), np.int32), (*scene.spans.shape[:2], 1))
    computed = match_costs(scene.lf, scene.sorted, scene.moved, plane_range)
    yield costs[1:3], device.download(computed)[1:3]


CHECKS = (
    Check("smooth", "maps smoothed by a Gaussian", _smooth, 1e-6, ("smooth.cl", "separated.cl")),
    Check("peaks", "highest of 5 uneven planes, by a parabola", _peaks, 1e-4, ("peaks.cl",)),
    Check("moments", "mean and variance over moved views, bytes", _moments, 2e-5,
          ("moments.cl", "sheared.cl")),
    Check("tensor", "slopes of epipolar planes, 16-bit samples", _tensor, 1e-5,
          ("tensor.cl", "sheared.cl")),
    Check("matching", "how well views agree on four planes", _matching, 1e-5,
          ("matching.cl", "match_rows.cl", "spans.cl", "combined.cl", "vectors.cl")),
)  # fmt: skip
