"""The range of disparities that `check_light_field` finds, against exact scenes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clplen
from clplen.cameras import Ellipse, Plane, Sphere, checker, noise, rectangle, uniform
from clplen.compute.device import Device
from clplen.lightfield import check_light_field

Surfaces = Callable[[float], list[Any]]  # of half the width in pixels
SCENES: dict[str, Surfaces] = {
    "wide": lambda unit: [
        Plane(-2.8, (0.2 / unit, 0), texture=noise(41, finest=0.45, exponent=0.5)),
        Plane(
            2.5,
            texture=noise(43),
            outline=rectangle((0.3 * unit, 0.4 * unit), (0.5 * unit, 0.6 * unit), angle=0.4),
        ),
    ],
    "narrow, near": lambda unit: [Plane(0.7, (0.1 / unit, 0.05 / unit), texture=noise(3))],
    "faint and plain": lambda unit: [
        Plane(-0.5, (0.4 / unit, 0), texture=noise(81, contrast=0.02, exponent=1.5)),
        Plane(
            0.6,
            texture=uniform(0.6),
            outline=rectangle((0.3 * unit, -0.4 * unit), (0.4 * unit, 0.5 * unit)),
        ),
    ],
    "sphere": lambda unit: [
        Plane(-0.9, texture=noise(71)),
        Sphere((-5, -4), 0.6 * unit, disparity=-0.3, height=1.2, texture=noise(72, contrast=0.08)),
    ],
    "repeated": lambda unit: [
        Plane(-0.7, (0.3 / unit, 0.2 / unit), texture=checker(11.0, low=0.2, high=0.8)),
        Plane(
            0.8,
            texture=checker(9.0, low=0.3, high=0.7),
            outline=Ellipse((0.1 * unit, -0.2 * unit), (0.5 * unit, 0.6 * unit)),
        ),
    ],
}  # fmt: skip


def light_field(surfaces: list[Any], views: tuple[int, int], size: tuple[int, int], device: Device):
    """With noise of half a per cent, and the truth."""
    lf, truth = clplen.SurfaceScene(surfaces).light_field(views, size, device=device)
    samples = lf.to_numpy()
    samples = samples + np.random.default_rng(1).normal(0, 0.005, samples.shape)
    lf = clplen.LightField.from_array(samples.astype(np.float32), device=device)
    return lf, np.asarray(truth.disparity)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [
        name if name == "wide" else pytest.param(name, marks=pytest.mark.nightly)  # seconds each
        for name in SCENES
    ],
)
def test_the_range_holds_the_scene_by_area(device: Device, name: str):
    """Not by detail; scenes wide and narrow, of both signs; the truth reaches beyond +-2, too."""
    lf, truth = light_field(SCENES[name](80.0), (7, 5), (131, 160), device)
    low, high = check_light_field(lf).disparities
    assert np.mean((truth >= low) & (truth <= high)) >= 0.98
    assert high - low <= 1.5 * np.ptp(truth) + 0.3


def test_the_range_does_not_depend_on_how_views_are_stored(device: Device):
    """Black views, integers, colours, an even number of views and places of their own."""
    lf, truth = light_field(SCENES["sphere"](60.0), (6, 6), (97, 120), device)
    samples = np.round(200 * np.clip(lf.to_numpy(), 0, 1.2)).astype(np.uint8)
    samples = np.stack([samples, samples // 2, samples], axis=-1)
    samples[0, 0], samples[5] = 0, 0
    lf = clplen.LightField.from_array(samples, device=device)
    low, high = check_light_field(lf).disparities
    assert np.mean((truth >= low) & (truth <= high)) >= 0.98
    assert high - low <= 1.5 * np.ptp(truth) + 0.3
    places = np.stack(np.meshgrid(*(2 * (np.arange(6) - 2.5),) * 2, indexing="ij"), axis=-1)
    apart = clplen.LightField.from_array(samples, device=device, positions=places)
    half = check_light_field(apart).disparities
    np.testing.assert_allclose(half, (low / 2, high / 2), atol=0.1)


def test_without_detail_or_in_a_wrong_order_there_is_no_range(device: Device):
    plain = np.full((3, 3, 40, 50), 7, np.uint8)
    assert np.isnan(check_light_field(plain, device=device).disparities).all()
    lf, _ = light_field(SCENES["narrow, near"](60.0), (5, 5), (97, 120), device)
    wrong = check_light_field(np.ascontiguousarray(lf.to_numpy()[::-1]), device=device)
    assert wrong.verdict == "wrong"
    assert np.isnan(wrong.disparities).all()
