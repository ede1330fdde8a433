"""Views that lie on no regular grid: refocusing and depth with their positions."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.errors import ShapeError
from clplen.lightfield.depth.depth_maps import sharpness_curve
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.stacks import focal_stack

D = 1.9  # of the textured plane
VIEWS = (5, 4)
PLANES = np.linspace(1, 2.8, 19)


def grid(views=VIEWS) -> np.ndarray:
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    return np.stack(np.meshgrid(v, u, indexing="ij"), axis=-1)


def jittered(step=0.3, views=VIEWS) -> np.ndarray:
    return grid(views) + np.random.default_rng(5).uniform(-step, step, (*views, 2))


def texture(y, x):
    """Waves of 4 to 20 pixels in all directions."""
    rng = np.random.default_rng(11)
    total = np.zeros(np.broadcast(y, x).shape)
    for _ in range(60):
        k = 2 * np.pi / rng.uniform(4, 20)
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        total += np.cos(k * (np.cos(angle) * y + np.sin(angle) * x) + phase)
    return 100 + 8 * total


def taken_from(places: np.ndarray, size=(56, 72), d=D) -> np.ndarray:
    """L[v, u, y, x] = T(y + d p_y, x + d p_x): a plane of disparity d seen from the places."""
    y, x = (np.arange(n, dtype=float) for n in size)
    shift = d * places[..., None, None, :]
    return texture(y[:, None] + shift[..., 0], x + shift[..., 1]).astype(np.float32)


def peak(device, places, **more) -> tuple[float, float]:
    lf = LightField.from_array(taken_from(places), device=device, **more)
    curve = sharpness_curve(focal_stack(lf, disparities=PLANES))
    return float(curve.max()), float(PLANES[curve.argmax()])


def test_the_peak_is_that_of_a_regular_grid(device):
    """The same plane, other viewpoints."""
    regular, at = peak(device, grid())
    assert at == pytest.approx(D)
    places = jittered()
    known, at = peak(device, places, positions=places)
    assert known >= 0.98 * regular
    assert at == pytest.approx(D)
    assert peak(device, places)[0] < 0.9 * regular


def test_depth_knows_the_positions(device):
    places = jittered()
    lf = LightField.from_array(taken_from(places), device=device, positions=places)
    error = depth_map(lf, disparities=PLANES).disparity[12:-12, 12:-12] - D
    assert np.abs(error).max() < 0.02
    stack = depth_map(focal_stack(lf, disparities=PLANES)).disparity[12:-12, 12:-12] - D
    assert np.abs(stack).max() < 0.02


def test_wrong_positions_are_refused(device):
    a = np.ones((2, 3, 5, 5), np.float32)
    with pytest.raises(ShapeError, match=r"shape \(2, 3, 2\), got \(3, 2, 2\)"):
        LightField.from_array(a, device=device, positions=grid((3, 2)))
    with pytest.raises(ValueError, match=r"positions must be finite"):
        LightField.from_array(a, device=device, positions=grid((2, 3)) * np.nan)
