"""Views that lie on no regular grid: refocusing and depth with their positions."""

from __future__ import annotations

import numpy as np
import pytest
from tolerance import relative_max

from clplen.errors import ShapeError
from clplen.lightfield.depth.depth_maps import sharpness_curve
from clplen.lightfield.focus_and_depth import depth_map, focal_stack
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

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


def bilinear(a: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(sum, weight) of the taps of a view at rows y and columns x, in float64."""
    total, used = np.zeros((y.size, x.size)), np.zeros((y.size, x.size))
    rows, columns = np.floor(y).astype(int), np.floor(x).astype(int)
    for i in (0, 1):
        for j in (0, 1):
            wy = np.where(i, y - rows, 1 - y + rows)
            wx = np.where(j, x - columns, 1 - x + columns)
            r, c = rows + i, columns + j
            inside = np.outer((r >= 0) & (r < len(a)), (c >= 0) & (c < a.shape[1]))
            sample = a[np.clip(r, 0, len(a) - 1)][:, np.clip(c, 0, a.shape[1] - 1)]
            used += np.outer(wy, wx) * inside
            total += np.outer(wy, wx) * inside * sample
    return total, used


def test_against_a_twin(device):
    """(D3) with the positions in place of v - vc and u - uc; views spaced unequally along y."""
    a = np.random.default_rng(3).uniform(1, 250, (3, 2, 19, 23))
    places = jittered(views=(3, 2))
    weights = np.random.default_rng(4).random((3, 2)).astype(np.float32)
    spacing = (-90e-6, -120e-6, 150e-6, 150e-6)
    lf = LightField.from_array(a, device=device, positions=places, weights=weights, spacing=spacing)
    a = a.astype(np.float32).astype(float)
    for d in (-1.3, 0.0, 2.0):
        top = used = 0.0
        for v, u in np.ndindex(3, 2):
            y = np.arange(19) - places[v, u, 0] * d * 0.75
            x = np.arange(23) - places[v, u, 1] * d
            total, weight = bilinear(a[v, u], y, x)
            top = top + float(weights[v, u]) * total
            used = used + float(weights[v, u]) * weight
        want = np.divide(top, used, out=np.zeros_like(top), where=used > 0)
        assert relative_max(want, refocus(lf, disparity=d).to_numpy()) <= 1e-5


def test_depth_knows_the_positions(device):
    places = jittered()
    lf = LightField.from_array(taken_from(places), device=device, positions=places)
    error = depth_map(lf, disparities=PLANES).disparity[12:-12, 12:-12] - D
    assert np.abs(error).max() < 0.02
    stack = depth_map(focal_stack(lf, disparities=PLANES)).disparity[12:-12, 12:-12] - D
    assert np.abs(stack).max() < 0.02


def test_wrong_positions_are_refused(device):
    a = np.ones((2, 3, 5, 5), np.float32)
    with pytest.raises(ShapeError, match=r"shape \(2, 3, 2\), not \(3, 2, 2\)"):
        LightField.from_array(a, device=device, positions=grid((3, 2)))
    with pytest.raises(ValueError, match=r"Positions of views are finite"):
        LightField.from_array(a, device=device, positions=grid((2, 3)) * np.nan)
