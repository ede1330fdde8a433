"""Checks of light fields: views, refocusing, shifts, warps."""

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
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.lightfield.refocusing.fourier_slice import fourier_stack
from clplen.lightfield.refocusing.phase_ramps import fourier_refocus
from clplen.lightfield.refocusing.view_warp import ViewWarp
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

ROUNDING = 1e-5  # sums over views, each term with rounded position and weights


def _views(seed: int, *shape: int, kind: type = np.float32) -> twins.Array:
    return twins.reals(seed, *shape, low=20, high=250).astype(kind)


def _weights(views: tuple[int, int]) -> twins.Array:
    """Return unequal weights of the views, one of them 0."""
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
    """Check shift and add, where taps outside a view count in neither sum nor weight."""
    a, w = _views(2, 3, 4, 9, 43, 3, kind=np.float16), _weights((3, 4))
    planes, steps = np.array([-1.37, 1.0, 0.4]), twins.view_steps((3, 4)) * (1.3, 1)
    down, right = np.outer(planes, steps[:, 0, 0]), np.outer(planes, steps[0, :, 1])
    computed = shear_sum(device.upload(a), w, down, right, device=device)
    expected = np.zeros((3, *a.shape[2:]))
    for p, d in enumerate(planes):
        parts = [twins.moved(a[n], d * steps[n]) for n in np.ndindex(3, 4)]
        total = np.tensordot(w.ravel(), [value for value, _ in parts], 1)
        used = np.tensordot(w.ravel(), [share for _, share in parts], 1)
        expected[p] = total / used[..., None]
    yield expected, device.download(computed)


def _along_rays(device: Device) -> Pairs:
    a, w = _views(3, 3, 3, 7, 37, kind=np.uint16), np.ones((3, 3))
    steps = twins.view_steps((3, 3))
    options: dict[str, Any] = {"device": device, "weights": w, "steps": steps}
    y, x = np.mgrid[:7, :37]
    d = (0.9 * np.sin(0.7 * y) + 0.03 * x - 0.4).astype(np.float32)
    total, used = np.zeros((2, 7, 37))
    for n in np.ndindex(3, 3):
        at_y, at_x = (positions + steps[n][k] * d for k, positions in enumerate((y, x)))
        for i, j in np.ndindex(7, 37):
            share = twins.triangle(at_y - i) * twins.triangle(at_x - j)
            total += share * a[n][i, j]
            used += share
    computed = along_rays(device.upload(a), "mean", disparity=d, **options)
    yield total / used, device.download(computed)
    inner = (slice(2, -2), slice(2, -2))  # inside every view
    samples = [twins.moved(a[n], 0.65 * steps[n])[0][inner] for n in np.ndindex(3, 3)]
    computed = along_rays(device.upload(a), "median", disparity=0.65, **options)
    yield np.median(samples, axis=0), device.download(computed)[inner]


def _ramp(fy: twins.Array, fx: twins.Array, shift: twins.Array) -> twins.Array:
    return np.asarray(np.exp(2j * np.pi * (fy[:, None] * shift[0] + fx * shift[1])))


def _fourier(device: Device) -> Pairs:
    """Check phase ramps, and slices of the 4-D spectrum, which agree to 1e-5."""
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
    peak = energy.max(axis=0)
    share = np.where(peak > 0, (energy / np.where(peak > 0, peak, 1).astype(float)) ** 8, 1)
    computed = _launch("blend", planes, planes.data, device.upload(energy), np.int32(3))
    yield (share * a).sum(axis=0) / share.sum(axis=0), device.download(computed)


def _warped(device: Device) -> Pairs:
    """Check views warped by a disparity, and their gradients, by a matrix for each view."""
    shape, (ny, nx) = (2, 3, 7, 11), (7, 11)
    picture, g = twins.reals(3, ny, nx), twins.reals(4, *shape)
    d = twins.reals(5, ny, nx, low=-2.3, high=1.9)
    model = ViewWarp(shape, device=device)
    y, x = np.mgrid[:ny, :nx]
    views, of_picture, of_disparity = np.zeros(shape), np.zeros(ny * nx), np.zeros((ny, nx))
    for n in np.ndindex(2, 3):
        at = [p + d.astype(float) * s for p, s in zip((y, x), model.steps[n], strict=True)]
        at = [np.clip(p, 0, k - 1).ravel() for p, k in zip(at, (ny, nx), strict=True)]
        my, mx = (twins.interpolation(p, k) for p, k in zip(at, (ny, nx), strict=True))
        views[n] = np.einsum("pi,ij,pj->p", my, picture.astype(float), mx).reshape(ny, nx)
        of_picture += np.einsum("pi,p,pj->ij", my, g[n].ravel().astype(float), mx).ravel()
        for k, size in enumerate((ny, nx)):
            slope = [my, mx]
            inside = (at[k] > 0) & (at[k] < size - 1)
            lower = np.clip(np.floor(at[k]).astype(int), 0, size - 2)
            slope[k] = inside[:, None] * (np.eye(size)[lower + 1] - np.eye(size)[lower])
            change = np.einsum("pi,ij,pj->p", slope[0], picture.astype(float), slope[1])
            of_disparity += g[n] * model.steps[n][k] * change.reshape(ny, nx)
    yield views, model.forward(picture, d).to_numpy()
    gradients = model.vjp(picture, d, g)
    yield of_picture.reshape(ny, nx), gradients[0]
    yield of_disparity, gradients[1]


CHECKS = (
    Check("views", "questions to float16 samples, slices", _samples, 1e-6,
          ("views.cl", "stored.cl")),
    Check("shear", "colours refocused on three planes, float16", _refocus, ROUNDING,
          ("shear.cl", "shear_rows.cl", "shear_norm.cl", "stored.cl")),
    Check("along_rays", "mean on a surface, median on a plane", _along_rays, ROUNDING,
          ("along_rays.cl",)),
    Check("fourier", "refocused by phase ramps and by slices", _fourier, 2e-5, ("fourier.cl",)),
    Check("allinfocus", "between planes, and blended by energy", _all_in_focus, 2e-6,
          ("allinfocus.cl",)),
    Check("warp", "views of a picture, and their gradients", _warped, ROUNDING, ("warp.cl",)),
)  # fmt: skip
