"""Depth by energy: analytic scenes, a float64 twin, a real capture."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from reference_lightfield import refocus, sampling_matrix
from scipy.ndimage import correlate1d, gaussian_filter

from clplen.errors import DeviceError
from clplen.lightfield.depth.depth_maps import sharpness_curve
from clplen.lightfield.depth.energy_cue import evening_taps
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.stacks import focal_stack

pytestmark = pytest.mark.thorough

energy_map = partial(depth_map, cue="energy")
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


def evened(picture: np.ndarray, d: float, views: tuple[int, int]) -> np.ndarray:
    """A picture (y, x, c) refocused on d, blurred to what half a pixel loses."""
    for axis, n in enumerate(views):
        taps = evening_taps(d * (np.arange(n) - (n - 1) / 2), np.ones(n))
        picture = correlate1d(picture, taps[[2, 1, 0, 1, 2]], axis=axis, mode="reflect")
    return picture


def twin(views: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, ...]:
    """(disparity, uncertainty): parabola through the highest of E_d, from the definition."""
    energies = []
    for d in planes:
        picture = refocus(views, d).reshape(*views.shape[2:4], -1)
        picture = evened(picture, d, views.shape[:2])
        detail = picture - gaussian_filter(picture, (1.5, 1.5, 0), mode="reflect", truncate=4)
        energies.append(gaussian_filter((detail**2).sum(axis=-1), 4, mode="reflect", truncate=4))
    e = np.array(energies)
    best = np.clip(np.argmax(e, axis=0), 1, len(planes) - 2)[None]
    a, b, c = (np.take_along_axis(e, best + k, 0)[0] for k in (-1, 0, 1))
    step = planes[1] - planes[0]
    # pictures are right to 1e-5 of their largest value (and so a difference of two, squared)
    wrong = 4e-5 * views.max() * np.sqrt(e.max())
    uncertain = np.where(np.argmax(e, axis=0) == best[0], wrong / (2 * b - a - c) * step, np.inf)
    return planes[best[0]] + step * (a - c) / (2 * (a - 2 * b + c)), uncertain


@pytest.mark.parametrize(  # planes below, at and above what is refocused at once
    ("count", "colours"), [(8, 0), (18, 3)]
)
def test_against_twin(device, colours, count):
    views, _ = slanted(0.3, 0.01, -0.006, shape=(4, 5, 31, 37))
    if colours:
        views = np.stack([views, views[::-1], 0.5 + views[:, ::-1]], axis=-1)
    planes = np.linspace(-1, 1.5, count)
    want, uncertain = twin(views, planes)
    found = energy_map(LightField.from_array(views, device=device), disparities=planes)
    close = uncertain < 1e-2
    assert close.mean() > 0.7
    assert (np.abs(found.disparity - want)[close] <= uncertain[close] + 1e-6).all()


def test_interpolation_loses_the_same_at_every_shift():
    def transfer(shift: np.ndarray, weights: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Of the mean over views interpolated linearly, at angular frequencies k, and the taps."""
        rows = sampling_matrix(8 + shift, 17).toarray()
        waves = np.exp(1j * np.multiply.outer(np.arange(-8, 9), k))
        seen = (rows @ waves) * np.exp(-1j * np.outer(shift, k))
        taps = evening_taps(shift, weights)
        blur = taps[0] + 2 * taps[1] * np.cos(k) + 2 * taps[2] * np.cos(2 * k)
        return np.average(seen.real, axis=0, weights=weights) * blur

    k = np.array([0.2, 0.4, 0.8])
    shifts = [[0.0], [2, -3], [0.5, -1.5], [0.3, -0.3], [-1.8, -0.9, 0, 0.9, 1.8]]
    for shift in map(np.array, shifts):
        weights = np.random.default_rng(2).random(shift.size)
        error = np.abs(transfer(shift, weights, k) - np.cos(k / 2))
        # equal moments up to the fifth; the sum of |weight| |x|^6 is below 2 in all these cases
        assert (error <= 2 * k**6 / 720).all()
    np.testing.assert_allclose(evening_taps(np.array([0.5, 2.5]), np.ones(2)), [1, 0, 0])


@pytest.mark.parametrize(("views", "d"), [((8, 8), 0.06), ((4, 6), 0.45)])
def test_a_fine_texture(device, views, d):
    """Noise up to the highest frequencies, moved by phase factors."""
    noise = np.fft.fft2(np.random.default_rng(9).standard_normal((96, 96)))
    ky, kx = np.fft.fftfreq(96)[:, None], np.fft.fftfreq(96)[None, :]
    noise *= 1 / np.maximum(np.hypot(ky, kx), 1 / 96)
    L = np.empty((*views, 96, 96))
    for v, u in np.ndindex(views):
        dv, du = v - (views[0] - 1) / 2, u - (views[1] - 1) / 2
        L[v, u] = np.fft.ifft2(noise * np.exp(2j * np.pi * d * (ky * dv + kx * du))).real
    found = energy_map(LightField.from_array(L, device=device))
    assert abs(np.median((found.disparity - d)[INSIDE])) < (0.02 if min(views) > 4 else 0.04)


def test_a_stack_brings_its_planes(device):
    views, _ = slanted(0.37)
    lf = LightField.from_array(views, device=device, spacing=(-1e-3, -1e-3, 5e-4, 5e-4))
    planes = np.random.default_rng(3).permutation(np.linspace(-1, 1.5, 21))
    found = energy_map(focal_stack(lf, disparities=planes))
    assert np.median(np.abs(found.disparity - 0.37)[INSIDE]) < 0.01
    # alpha = 1 + d dx/du, and a stack knows it at its planes
    np.testing.assert_allclose(found.alpha, 1 - found.disparity / 2, atol=1e-6)
    assert np.isnan(found.z).all()


@dataclass(frozen=True)
class Lens:
    """A camera of f = 0.1 m focused at 0.3 m."""

    image_distance: float = 0.15

    def alpha(self, dz: float) -> float:
        return 0.15 * (10 - 1 / (0.3 + dz))

    def dz(self, alpha: np.ndarray) -> np.ndarray:
        return 1 / (10 - alpha / 0.15) - 0.3


def test_depth_in_metres(device):
    views, _ = slanted(0.37)
    spacing = (-1e-3, -1e-3, 5e-4, 5e-4)  # kappa = 2: alpha = 1 - d/2
    lf = LightField.from_array(views, device=device, spacing=spacing, camera=Lens())
    for source in (lf, focal_stack(lf, alphas=np.linspace(0.6, 1.2, 25))):
        found = energy_map(source)
        alpha = 1 - found.disparity.astype(np.float64) / 2
        np.testing.assert_allclose(found.alpha, alpha, atol=1e-6)
        np.testing.assert_allclose(found.z, Lens().dz(alpha), atol=1e-6)
        assert found.z.dtype == np.float32
        assert np.median(found.z) < -0.02  # nearer than the focused plane
    by_alpha = energy_map(lf, alphas=np.linspace(0.6, 1.2, 25))
    by_disparity = energy_map(lf, disparities=2 * (1 - np.linspace(0.6, 1.2, 25)))
    np.testing.assert_allclose(by_alpha.disparity, by_disparity.disparity, atol=1e-5)


def test_memory_does_not_grow_with_the_planes(device, monkeypatch):
    views, _ = slanted(0.2, shape=(3, 3, 40, 50))
    lf = LightField.from_array(views.astype(np.float32), device=device)
    needed = 4 * 40 * 50 * (2 * 32 + 8 + 8 + 7) + lf.data.nbytes
    monkeypatch.setattr(device, "memory_bytes", needed)
    assert energy_map(lf, disparities=np.linspace(-1, 1, 99)).disparity.shape == (40, 50)
    monkeypatch.setattr(device, "memory_bytes", needed - 1)
    with pytest.raises(DeviceError, match=f"depth map.* {needed:,} bytes"):
        energy_map(lf, disparities=np.linspace(-1, 1, 99))


def test_bad_input(device):
    lf = LightField.from_array(slanted(0.2, shape=(3, 3, 40, 50))[0], device=device)
    for options, words in (
        ({"cue": "correspondance"}, r"'energy'.*'correspondance'"),
        ({"alphas": [0.9, 1, 1.1], "disparities": [0, 1, 2]}, r"both set the planes"),
        ({"alphas": [0.9, 1, 1.1]}, r"spacing"),
        ({"disparities": []}, r"at least three different"),
        ({"disparities": [0.5, 0.5, 1.0]}, r"at least three different finite planes, got 2"),
        ({"disparities": [0.0, np.nan, 1.0]}, r"finite"),
        ({"disparities": [[0.0, 0.5, 1.0]]}, r"shape \(1, 3\)"),
    ):
        with pytest.raises(ValueError, match=words):
            energy_map(lf, **options)
    stack = focal_stack(lf, disparities=[0, 1, 2])
    with pytest.raises(ValueError, match=r"fixed planes.*disparities"):
        energy_map(stack, disparities=[0, 1, 2])
    with pytest.raises(ValueError, match="at least three"):
        energy_map(replace(stack, disparities=np.zeros(3)))


@pytest.mark.parametrize("shape", [(12, 90, 3), (40, 41, 2)])
def test_sharpness_of_whole_pictures(device, shape):
    views = np.random.default_rng(4).random((3, 2, *shape))
    planes = [0.3, -1.0, 0.0, 1.5]
    stack = focal_stack(LightField.from_array(views, device=device), disparities=planes)
    want = []
    for d, picture in zip(planes, stack.to_numpy().astype(np.float64), strict=True):
        detail = evened(picture.reshape(*shape[:2], -1), d, (3, 2))
        detail = detail - gaussian_filter(detail, (2, 2, 0), mode="reflect", truncate=4)
        if shape[2:] == (3,):
            detail = detail @ np.array([[0.2126], [0.7152], [0.0722]])
        top, left = min(15, shape[0] // 4), min(15, shape[1] // 4)
        inside = detail[top : shape[0] - top, left : shape[1] - left]
        want.append((inside**2).sum(axis=-1).mean())
    np.testing.assert_allclose(sharpness_curve(stack), want, rtol=1e-5)


@pytest.fixture(scope="module")
def flower(data_folder: Path) -> np.ndarray:
    """10 x 10 views of a flower, taken with a real plenoptic camera."""
    files = sorted((data_folder / "lytro_f01_flower").glob("IMG_0001_*.png"))
    assert len(files) == 100
    views = np.zeros((10, 10, 256, 256, 3), np.uint8)
    for file in files:
        u, v = (int(n) - 1 for n in re.findall(r"\d+", file.stem)[-2:])
        views[v, u] = iio.imread(file)
    return views


def test_sharpest_plane_of_a_real_capture(device, flower):
    planes = np.linspace(-1.2, 1.2, 49)

    def sharpest(views: np.ndarray) -> tuple[float, float]:
        lf = LightField.from_array(np.ascontiguousarray(views), device=device)
        curve = sharpness_curve(focal_stack(lf, disparities=planes))
        return planes[np.argmax(curve)], curve.max() / curve[24]

    place, gain = sharpest(flower)
    assert place == pytest.approx(-0.65, abs=0.1)
    assert gain > 8
    for wrong in (flower.transpose(1, 0, 2, 3, 4), flower[::-1], flower[:, ::-1]):
        assert sharpest(wrong)[1] < gain / 3
