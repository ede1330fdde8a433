"""Depth of bright points on black, and of textures beside them, by default."""

from __future__ import annotations

import numpy as np
import pytest

from clplen import LightField, depth_map
from clplen.lightfield.depth.sparse_points import (
    sparse_pixels,
)


def beads(seed, *, count=4, size=(57, 67), views=(5, 7), sigma=1.0, left=13, darkest=1.0):
    """(light field, places, disparities) of Gaussian points on black, at least 16 pixels apart."""
    random = np.random.default_rng(seed)
    places: list[np.ndarray] = []
    while len(places) < count:
        place = random.uniform((13, left), np.array(size) - 13)
        if all(np.hypot(*(place - other)) > 16 for other in places):
            places.append(place)
    d = random.uniform(-1.8, 1.8, count)
    power = np.exp(random.uniform(np.log(darkest), 0, count))
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    total = np.zeros((*views, *size))
    for (y, x), one, light in zip(places, d, power, strict=True):
        down = np.exp(-((np.arange(size[0]) - y + one * v[:, None]) ** 2) / (2 * sigma**2))
        along = np.exp(-((np.arange(size[1]) - x + one * u[:, None]) ** 2) / (2 * sigma**2))
        total += light * np.einsum("vy,ux->vuyx", down, along)
    return total, np.array(places), d


def judged(found, places, d):
    """Errors and confidence on the points; confidence farther than 5 pixels from all of them."""
    y, x = np.round(places).astype(int).T
    rows, columns = np.indices(found.disparity.shape)
    away = np.hypot(rows[..., None] - places[:, 0], columns[..., None] - places[:, 1]).min(-1) > 5
    return found.disparity[y, x] - d, found.confidence[y, x], found.confidence[away]


@pytest.mark.parametrize(
    ("level", "noise", "darkest"),
    [(0.5, 0.1, 1), (0, 0, 0.03)],
)
def test_beads_on_black(device, level, noise, darkest):
    values, places, d = beads(3, darkest=darkest)
    values = values + level + np.random.default_rng(1).normal(0, noise, values.shape)
    found = depth_map(LightField.from_array(values.astype(np.float32), device=device))
    error, sure, black = judged(found, places, d)
    assert np.abs(error).max() < 0.02
    assert sure.min() > 0.8
    assert (black > 0.5).mean() < 0.03
    assert black.mean() < 0.04


def test_few_stars_in_a_large_noisy_picture(device):
    """Their pixels are fewer than outliers, which once set the brightness of everything."""
    values, places, d = beads(4, count=2, size=(150, 171), views=(5, 5))
    values += np.random.default_rng(2).normal(0, 0.02, values.shape)
    found = depth_map(LightField.from_array(values.astype(np.float32), device=device))
    error, sure, black = judged(found, places, d)
    assert np.abs(error).max() < 0.03
    assert sure.min() > 0.8
    assert black.max() < 0.5


def test_texture_beside_points(device):
    """Each half has its own footing; 20 pixels from the border the texture is as it was alone."""
    values, places, d = beads(6, count=2, size=(61, 111), left=76)
    random = np.random.default_rng(8)
    k, phase = random.uniform(-0.16, 0.16, (2, 40)), random.uniform(0, 6, 40)
    v, u = (np.arange(n) - (n - 1) / 2 for n in values.shape[:2])
    y = np.arange(61) + 0.6 * v[:, None]
    x = np.arange(111) + 0.6 * u[:, None]
    waves = [np.exp(2j * np.pi * f * a[..., None]) for f, a in zip(k, (y, x), strict=True)]
    texture = 0.5 + 0.05 * np.einsum("vyk,uxk,k->vuyx", *waves, np.exp(1j * phase)).real
    texture[..., 58:] = 0
    maps = [
        depth_map(LightField.from_array(a.astype(np.float32), device=device))
        for a in (values + texture, texture)
    ]
    error, sure, _ = judged(maps[0], places, d)
    assert np.abs(error).max() < 0.03
    assert sure.min() > 0.6
    inside = (slice(15, -15), slice(15, 38))
    assert np.array_equal(maps[0].disparity[inside], maps[1].disparity[inside])
    assert np.abs(maps[0].disparity[inside] - 0.6).max() < 0.05


def test_a_highlight_on_texture_is_no_point():
    """As bright as ten times the texture's deviation; on a hundredth of it, it is one."""
    random = np.random.default_rng(4)
    texture = random.normal(0, 1, (61, 67))
    for _ in range(2):  # smooth, unlike noise
        texture = sum(np.roll(texture, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 3
    texture /= texture.std()
    y, x = np.indices(texture.shape)
    light = np.exp(-((y - 30) ** 2 + (x - 33) ** 2) / 2)
    assert not sparse_pixels(texture + 10 * light).any()
    found = sparse_pixels(texture + 1000 * light)
    assert found[30, 33]
    assert found[30 + 12, 33 - 12]
    assert not found[30, 33 + 14]
