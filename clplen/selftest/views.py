"""Checks of light fields: their views, refocused, filtered, moved."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.ray_samples import along_rays
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.arrays.stored_samples import extremes, lit_views, plane
from clplen.lightfield.depth.all_in_focus import _launch
from clplen.lightfield.focus_and_depth import all_in_focus
from clplen.lightfield.matching.view_matching import row_sums
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import UPSAMPLE_BASE, FocalStack, upsampled
from clplen.lightfield.refocusing.fourier_slice import fourier_stack
from clplen.lightfield.refocusing.hyperfan_filter import hyperfan
from clplen.lightfield.refocusing.magnification import magnify, magnify_adjoint
from clplen.lightfield.refocusing.phase_ramps import fourier_refocus
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

ROUNDING = 1e-5  # sums over the views, each term with the rounding of its place and weights


def _views(seed: int, *shape: int, kind: type = np.float32) -> twins.Array:
    return twins.reals(seed, *shape, low=20, high=250).astype(kind)


def _weights(views: tuple[int, int]) -> twins.Array:
    """Unlike; one view has none."""
    w = twins.reals(7, *views, low=0.2, high=1.7)
    w[0, 1] = 0
    return w


def _samples(device: Device) -> Pairs:
    a = _views(1, 3, 4, 5, 11, 3, kind=np.float16)
    a[1, 2] = 0
    data = device.upload(a)
    lit = a.any(axis=(2, 3, 4))
    yield lit.astype(float), lit_views(data, device).astype(float)
    yield np.array([a.min((2, 3, 4)), a.max((2, 3, 4))], float), extremes(data, device)
    yield a[1, :, 4].astype(float), device.download(plane(data, {2: 4, 0: 1}, (1, 3), device))
    yield a[:, 2, :, 9].astype(float), device.download(plane(data, {3: 9, 1: 2}, (0, 2), device))
    lf = LightField.from_array(a, device=device)
    yield a.reshape(12, 5, -1).sum(axis=2, dtype=float), row_sums(lf)


def _refocus(device: Device) -> Pairs:
    """Shift and add: taps outside a view count neither in the sum nor in its weights."""
    a, w = _views(2, 3, 4, 9, 43, 3, kind=np.float16), _weights((3, 4))
    planes, steps = np.array([-1.37, 1.0, 0.4]), twins.view_steps((3, 4)) * (1.3, 1)
    down, right = np.outer(planes, steps[:, 0, 0]), np.outer(planes, steps[0, :, 1])
    got = shear_sum(device.upload(a), w, down, right, device=device)
    expected = np.zeros((3, *a.shape[2:]))
    for p, d in enumerate(planes):
        parts = [twins.moved(a[n], d * steps[n]) for n in np.ndindex(3, 4)]
        total = np.tensordot(w.ravel(), [value for value, _ in parts], 1)
        used = np.tensordot(w.ravel(), [share for _, share in parts], 1)
        expected[p] = total / used[..., None]
    yield expected, device.download(got)


def _along_rays(device: Device) -> Pairs:
    a, w = _views(3, 3, 3, 7, 37, kind=np.uint16), np.ones((3, 3))
    steps = twins.view_steps((3, 3))
    options: dict[str, Any] = {"device": device, "weights": w, "steps": steps}
    y, x = np.mgrid[:7, :37]
    d = (0.9 * np.sin(0.7 * y) + 0.03 * x - 0.4).astype(np.float32)
    total, used = np.zeros((2, 7, 37))
    for n in np.ndindex(3, 3):
        at_y, at_x = (places + steps[n][k] * d for k, places in enumerate((y, x)))
        for i, j in np.ndindex(7, 37):
            share = twins.triangle(at_y - i) * twins.triangle(at_x - j)
            total += share * a[n][i, j]
            used += share
    got = along_rays(device.upload(a), "mean", disparity=d, **options)
    yield total / used, device.download(got)
    inner = (slice(2, -2), slice(2, -2))  # where all views see the place
    found = [twins.moved(a[n], 0.65 * steps[n])[0][inner] for n in np.ndindex(3, 3)]
    got = along_rays(device.upload(a), "median", disparity=0.65, **options)
    yield np.median(found, axis=0), device.download(got)[inner]


def _ramp(fy: twins.Array, fx: twins.Array, shift: twins.Array) -> twins.Array:
    return np.asarray(np.exp(2j * np.pi * (fy[:, None] * shift[0] + fx * shift[1])))


def _fourier(device: Device) -> Pairs:
    """Views moved by phase ramps; the slice of the 4-D spectrum is the same to 1e-5."""
    a, w = _views(4, 3, 4, 7, 10), _weights((3, 4))
    lf = LightField.from_array(a, device=device, weights=w)
    planes, steps = np.array([0.0, -0.65, 1.9]), twins.view_steps((3, 4))
    fy, fx = np.fft.fftfreq(7), np.fft.fftfreq(10)
    spectra = np.fft.fft2(a.astype(float))
    expected = [
        sum(w[n] * spectra[n] * _ramp(fy, fx, d * steps[n]) for n in np.ndindex(3, 4))
        for d in planes
    ]
    pictures = np.fft.ifft2(expected).real / w.sum()
    yield pictures, device.download(fourier_refocus(lf, planes, lf.weights))
    yield pictures, fourier_stack(lf, disparities=planes, width=8).to_numpy()


def _hyperfan(device: Device) -> Pairs:
    a, (low, high), width = _views(5, 2, 3, 8, 5), (-0.7, 0.9), 0.2
    lf = LightField.from_array(a, device=device)
    middle, reach = (low + high) / 2, (high - low) / 2
    fy, fx = np.fft.fftfreq(8), np.fft.fftfreq(5)
    turn = np.array([[_ramp(fy, fx, middle * s) for s in row] for row in twins.view_steps((2, 3))])
    part = np.fft.fft2(a.astype(float)) * turn
    whole = np.concatenate((part, part[::-1]), 0)  # mirrored at the edges of the aperture
    whole = np.fft.fft2(np.concatenate((whole, whole[:, ::-1]), 1), axes=(0, 1))
    away = np.full(whole.shape, np.inf)
    power = np.maximum(fy[:, None] ** 2 + fx**2, 1e-30)
    for m, n in np.ndindex(3, 3):
        dv = (np.fft.fftfreq(4) + m - 1)[:, None, None, None]
        du = (np.fft.fftfreq(6) + n - 1)[None, :, None, None]
        d = np.clip((dv * fy[:, None] + du * fx) / power, -reach, reach)
        away = np.minimum(away, (dv - d * fy[:, None]) ** 2 + (du - d * fx) ** 2)
    kept = np.fft.ifft2(whole * 2 ** (-away / width**2 / 2), axes=(0, 1))[:2, :3]
    yield np.fft.ifft2(kept * turn.conj()).real, hyperfan(lf, low, high, bandwidth=width).to_numpy()


def _upsampled(device: Device) -> Pairs:
    a, w, d, n = _views(6, 3, 4, 7, 18), _weights((3, 4)), -0.65, 2
    lf = LightField.from_array(a, device=device, weights=w)
    total, used = np.zeros((2, 7 * n, 18 * n))
    for view in np.ndindex(3, 4):
        fine, coarse = [], []
        for k, size in enumerate((7, 18)):
            at = (np.arange(n * size) + 0.5) / n - 0.5 + d * twins.view_steps((3, 4))[view][k]
            t = at[:, None] - np.arange(size)
            fine.append(twins.triangle(n * t))
            coarse.append(twins.triangle(t))
        for (my, mx), share in ((fine, 1.0), (coarse, UPSAMPLE_BASE)):
            total += w[view] * share * (my @ a[view].astype(float) @ mx.T)
            used += w[view] * share * np.outer(my.sum(axis=1), mx.sum(axis=1))
    yield total / used, device.download(upsampled(lf, d, n, lf.weights))


def _magnified(device: Device) -> Pairs:
    a, alpha = twins.reals(8, 7, 12, 3), 1.1724
    my, mx = (
        twins.interpolation((n - 1) / 2 + alpha * (np.arange(n) - (n - 1) / 2), n) for n in (7, 12)
    )
    expected = alpha**2 * np.einsum("ij,jkc,lk->ilc", my, a.astype(float), mx)
    yield expected, device.download(magnify(device.upload(a), alpha, device=device))
    spread = alpha**2 * np.einsum("ij,ikc,kl->jlc", my, a.astype(float), mx)
    yield spread, device.download(magnify_adjoint(device.upload(a), alpha, device=device))


def _parametrised(device: Device) -> Pairs:
    """To directions: the pixel at x sees under theta the view u = x - F theta."""
    a, w, F = _views(9, 3, 4, 5, 7), _weights((3, 4)), 0.2
    spacing = (90e-6, -130e-6, 70e-6, -60e-6)
    lf = LightField.from_array(a, device=device, spacing=spacing, weights=w)
    got = lf.resample(
        "point-angle", image_distance=F, views=(5, 7), interpolation="linear"
    ).to_numpy()
    expected = np.zeros(got.shape)
    for i, j in np.ndindex(5, 7):
        rows = np.arange(5) - 1 + (i - 2) * spacing[2] / spacing[0]
        columns = np.arange(7) - 1.5 + (j - 3) * spacing[3] / spacing[1]
        mv, mu = twins.interpolation(rows, 3), twins.interpolation(columns, 4)
        lit = (w > 0).astype(float)
        used = mv @ lit @ mu.T
        total = mv @ (lit * a[:, :, i, j]) @ mu.T
        expected[:, :, i, j] = np.divide(total, used, out=np.zeros_like(total), where=used > 1e-9)
    yield expected, got


def _all_in_focus(device: Device) -> Pairs:
    order = np.array([0.5, -1.0, 2.0, 0.0])
    a = twins.reals(10, 4, 7, 11, low=1, high=250)
    planes = FocalStack(device.upload(a), device, order, order * np.nan)
    d = twins.reals(11, 7, 11, low=-1.3, high=2.4).astype(float)
    rising = np.argsort(order)
    mix = twins.interpolation(np.interp(d.ravel(), order[rising], np.arange(4)), 4).T
    expected = (mix.reshape(4, 7, 11) * a[rising]).sum(axis=0)
    yield expected, all_in_focus(planes, depth=d).to_numpy()
    energy = twins.reals(12, 4, 7, 11, low=0.2)
    energy[:, 2, 3:5] = 0
    most = energy.max(axis=0)
    share = np.where(most > 0, (energy / np.where(most > 0, most, 1).astype(float)) ** 8, 1)
    got = _launch("blend", planes, planes.data, device.upload(energy), np.int32(3))
    yield (share * a).sum(axis=0) / share.sum(axis=0), device.download(got)


CHECKS = (
    Check("views", "questions to float16 samples, slices", _samples, 1e-6,
          ("views.cl", "stored.cl")),
    Check("shear", "colours refocused on three planes, float16", _refocus, ROUNDING,
          ("shear.cl", "shear_rows.cl", "shear_norm.cl", "stored.cl")),
    Check("along_rays", "mean on a surface, median on a plane", _along_rays, ROUNDING,
          ("along_rays.cl",)),
    Check("fourier", "refocused by phase ramps and by slices", _fourier, 2e-5, ("fourier.cl",)),
    Check("hyperfan", "disparities passed by a 4-D filter", _hyperfan, ROUNDING, ("hyperfan.cl",)),
    Check("upsample", "refocused on a grid twice as fine", _upsampled, ROUNDING, ("upsample.cl",)),
    Check("magnify", "a picture magnified about its middle, and back", _magnified, 1e-6,
          ("magnify.cl",)),
    Check("parametrise", "positions on the lens to directions", _parametrised, ROUNDING,
          ("parametrise.cl",)),
    Check("allinfocus", "between planes, and blended by energy", _all_in_focus, 2e-6,
          ("allinfocus.cl",)),
)  # fmt: skip
