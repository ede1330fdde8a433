"""Checks of the cues of depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.arrays.peaks import PeakTracker
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.correspondence_cue import add_colours, shear_moments
from clplen.lightfield.depth.energy_cue import LocalEnergy
from clplen.lightfield.depth.structure_tensor_cue import epi_tensors
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocus.focal_stack import FocalStack
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs

if TYPE_CHECKING:
    from clplen.compute.device import Device


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
