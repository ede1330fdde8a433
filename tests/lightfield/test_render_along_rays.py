"""Views between views along rays: against a twin, without ghosts, with maps and positions."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.errors import ShapeError
from clplen.lightfield.model.light_field import LightField


def light_field(device, shape=(5, 4, 7, 11), dtype=np.float32, **more):
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(dtype)
    return a, LightField.from_array(a, device=device, **more)


def plane_scene(views, size, d, cycles=0.17) -> np.ndarray:
    """A smooth wave on a plane (or surface) of disparity d: (D1)."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    v, u = v[:, None, None, None], u[None, :, None, None]
    return wave(y + d * v, x + d * u, cycles).astype(np.float32)


def wave(y, x, cycles=0.17) -> np.ndarray:
    return 100 + 40 * np.sin(2 * np.pi * cycles * x) + 40 * np.cos(2 * np.pi * 0.8 * cycles * y)


def test_no_ghosts(device):
    """A fine grating at d = 2.5: its contrast is kept along rays and lost without."""
    a = plane_scene((3, 4), (24, 31), 2.5, cycles=0.2)
    lf = LightField.from_array(a, device=device)
    y, x = np.mgrid[:24, :31].astype(float)
    want = wave(y + 2.5 * (0.5 - 1), x + 2.5 * (1.5 - 1.5), 0.2)
    inside = (slice(4, -4), slice(4, -4))
    errors = [
        np.abs(picture.to_numpy() - want)[inside].max()
        for picture in (lf.view(0.5, 1.5), lf.view(0.5, 1.5, disparity=2.5))
    ]
    assert errors[0] > 40
    assert errors[1] < 4  # Keys' cubic at 5 samples a period: 5 % of the amplitude


def test_at_a_view_nothing_is_interpolated(device):
    a, lf = light_field(device)
    np.testing.assert_array_equal(lf.view(3, 1, disparity=0.7).to_numpy(), a[3, 1])
    weights = np.ones((5, 4))
    weights[3, 1] = 0
    a, lf = light_field(device, weights=weights)
    np.testing.assert_array_equal(lf.view(3, 1, disparity=0.7).to_numpy(), a[3, 1])


def test_a_map_of_the_centre_view_is_carried_to_the_viewpoint(device):
    """A slanted plane: d = 1 + 0.02 x, of which the picture at (v, u) has a shifted map."""
    views, size = (3, 5), (16, 64)
    slope, d0 = 0.02, 0.8
    u = np.arange(5) - 2.0
    x = np.arange(64.0)
    a = np.empty((*views, *size), np.float32)
    for j, at in enumerate(u):
        seen = (x + d0 * at) / (1 - slope * at)  # X with X - at (d0 + slope X) = x
        for i in range(3):
            a[i, j] = 100 + 50 * np.sin(2 * np.pi * 0.06 * seen)
    lf = LightField.from_array(a, device=device)
    there = 3.5
    got = lf.view(1, there, disparity=np.tile(d0 + slope * x, (16, 1))).to_numpy()
    seen = (x + d0 * (there - 2)) / (1 - slope * (there - 2))
    want = np.tile(100 + 50 * np.sin(2 * np.pi * 0.06 * seen), (16, 1))
    inside = (slice(None), slice(6, -6))
    assert np.abs(got - want)[inside].max() < 0.3  # cubic; the map not carried: 1.1
    not_carried = lf.view(1, there, disparity=np.tile(d0 + slope * seen, (16, 1))).to_numpy()
    assert np.abs(not_carried - want)[inside].max() > np.abs(got - want)[inside].max()


def test_bad_disparities_are_refused(device):
    _, lf = light_field(device)
    with pytest.raises(ShapeError, match=r"shape \(7, 11\), got shape \(11, 7\)"):
        lf.view(1, 1, disparity=np.zeros((11, 7)))
    with pytest.raises(ValueError, match="finite; fill the pixels"):
        lf.view(1, 1, disparity=np.nan)
    with pytest.raises(ValueError, match="'linear', 'nearest', 'cubic', got 'sinc'"):
        lf.view(1, 1, disparity=0.5, interpolation="sinc")
