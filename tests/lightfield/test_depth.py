"""Depth maps of analytic scenes, against a float64 twin, and on a real capture."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from reference_lightfield import keys_kernel, refocus, sampling_matrix
from scipy.ndimage import gaussian_filter

from clplen.errors import DeviceError
from clplen.lightfield.depth import depth_map, sharpness_curve
from clplen.lightfield.interpolation import kept_energy
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.refocus import focal_stack

INSIDE = (slice(15, -15), slice(15, -15))


def texture(y: np.ndarray, x: np.ndarray, seed: int = 0) -> np.ndarray:
    """A sum of waves of mean 0 and variance 1."""
    rng = np.random.default_rng(seed)
    fy, fx = rng.uniform(-0.2, 0.2, (2, 60))
    phase = rng.uniform(0, 2 * np.pi, 60)
    waves = np.cos(2 * np.pi * (np.multiply.outer(y, fy) + np.multiply.outer(x, fx)) + phase)
    return waves.sum(axis=-1) / np.sqrt(30)


def slanted(
    d0: float, gy: float = 0.0, gx: float = 0.0, *, shape: tuple[int, ...] = (9, 7, 72, 81)
) -> tuple[np.ndarray, np.ndarray]:
    """Views of a textured plane of disparity d0 + gy y + gx x, and that disparity."""
    V, U, ny, nx = shape
    y = np.arange(ny)[:, None] - (ny - 1) / 2
    x = np.arange(nx)[None, :] - (nx - 1) / 2
    views = np.empty(shape)
    for v, u in np.ndindex(V, U):
        dv, du = v - (V - 1) / 2, u - (U - 1) / 2
        d = (d0 + gy * y + gx * x) / (1 - gy * dv - gx * du)  # of the point that is seen here
        views[v, u] = texture(y + d * dv, x + d * du)
    return 1 + 0.2 * views, d0 + gy * y + gx * x


def noisy(views: np.ndarray, sigma: float) -> np.ndarray:
    return views + sigma * np.random.default_rng(1).standard_normal(views.shape)


@pytest.mark.parametrize("d", [-1.23, -0.5, 0.0, 0.37, 1.6])
def test_plane_parallel_to_the_sensor(device, d):
    views, _ = slanted(d)
    found = depth_map(LightField.from_array(noisy(views, 0.02), device=device))
    assert found.disparity.dtype == found.confidence.dtype == np.float32
    assert found.disparity.shape == (72, 81)
    assert np.median(np.abs(found.disparity - d)[INSIDE]) < 0.01
    assert np.isnan(found.alpha).all()
    assert np.isnan(found.z).all()


def test_slanted_plane(device):
    views, truth = slanted(0.2, -0.004, 0.008, shape=(9, 9, 72, 81))
    found = depth_map(LightField.from_array(noisy(views, 0.02), device=device))
    error = np.abs(found.disparity - truth)[INSIDE]
    assert np.mean(error > 0.07) < 0.01


def test_planes_need_not_be_even_or_sorted(device):
    views, _ = slanted(0.37)
    lf = LightField.from_array(views, device=device)
    uneven = np.array([1.0, -0.4, 0.3, 0.42, 0.1, 0.75, 0.42, -1.3, 0.2, 0.55, 1.7])
    found = depth_map(lf, disparities=uneven)
    assert np.median(np.abs(found.disparity - 0.37)[INSIDE]) < 0.01
    even = depth_map(lf, disparities=np.sort(uneven))
    np.testing.assert_array_equal(found.disparity, even.disparity)


def twin(views: np.ndarray, planes: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, ...]:
    """(disparity, uncertainty): parabola through the highest of E_d, from the definition."""
    energies = []
    for d, share in zip(planes, kept, strict=True):
        picture = refocus(views, d).reshape(*views.shape[2:4], -1)
        detail = picture - gaussian_filter(picture, (1.5, 1.5, 0), mode="reflect", truncate=4)
        energies.append(
            gaussian_filter((detail**2).sum(axis=-1), 4, mode="reflect", truncate=4) / share
        )
    e = np.array(energies)
    best = np.clip(np.argmax(e, axis=0), 1, len(planes) - 2)[None]
    a, b, c = (np.take_along_axis(e, best + k, 0)[0] for k in (-1, 0, 1))
    step = planes[1] - planes[0]
    # pictures are right to 1e-5 of their largest value (and so a difference of two, squared)
    wrong = 4e-5 * views.max() * np.sqrt(e.max())
    uncertain = np.where(np.argmax(e, axis=0) == best[0], wrong / (2 * b - a - c) * step, np.inf)
    return planes[best[0]] + step * (a - c) / (2 * (a - 2 * b + c)), uncertain


@pytest.mark.parametrize("colours", [0, 3])
@pytest.mark.parametrize("count", [5, 8, 9, 18])  # below, at and above what is refocused at once
def test_against_twin(device, colours, count):
    views, _ = slanted(0.3, 0.01, -0.006, shape=(4, 5, 31, 37))
    if colours:
        views = np.stack([views, views[::-1], 0.5 + views[:, ::-1]], axis=-1)
    planes = np.linspace(-1, 1.5, count)
    shift_y, shift_x = (-np.outer(planes, np.arange(n) - (n - 1) / 2) for n in (4, 5))
    kept = kept_energy(shift_y, shift_x, np.ones((4, 5)), sigma=1.5)
    want, uncertain = twin(views, planes, kept)
    found = depth_map(LightField.from_array(views, device=device), disparities=planes)
    close = uncertain < 1e-2
    assert close.mean() > 0.7
    assert (np.abs(found.disparity - want)[close] <= uncertain[close] + 1e-6).all()


def test_share_of_energy_that_interpolation_keeps():
    weights = np.random.default_rng(2).random((3, 4))
    shift_y, shift_x = np.array([[0.3, -1.2, 2.0]]), np.array([[0.5, 0.25, -3.1, 7.0]])
    k = (np.arange(32) + 0.5) / 64
    total = kept = 0.0
    x = np.arange(-8, 9)
    blur = np.exp(-(np.arange(-6, 7) ** 2) / 2 / 1.5**2)
    blur /= blur.sum()
    spectrum = [np.sum(blur * np.cos(2 * np.pi * f * np.arange(-6, 7))) for f in k]
    for (i, ky), (j, kx) in np.ndindex(32, 32) and [
        ((i, k[i]), (j, k[j])) for i in range(32) for j in range(32)
    ]:
        seen = 0j
        for v, u in np.ndindex(3, 4):
            # the value at 0 of a wave sampled at the moved pixels, interpolated linearly
            axes = []
            for f, shift in ((ky, shift_y[0, v]), (kx, shift_x[0, u])):
                wave = np.exp(2j * np.pi * f * (x - shift))
                at = sampling_matrix(np.array([8 + shift]), 17).toarray()[0]
                axes.append(at @ wave if abs(shift) <= 8 else 0)
            seen += weights[v, u] * axes[0] * axes[1]
        detail = (1 - spectrum[i] * spectrum[j]) ** 2 / (ky**2 + kx**2) ** 2
        total += detail
        kept += detail * abs(seen / weights.sum()) ** 2
    got = kept_energy(shift_y, shift_x, weights, sigma=1.5)
    assert got == pytest.approx(kept / total, rel=1e-12)
    whole = kept_energy(np.zeros((1, 3)), np.ones((1, 4)), weights, sigma=1.5)
    assert whole == pytest.approx(1)
