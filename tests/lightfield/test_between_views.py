"""Views between the recorded ones: against exact truth, and what hides what."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hard_scenes import _plain_scene, _wide

import clplen
from clplen import LightField, ShapeError
from clplen.compute.device import Device
from clplen.lightfield import view_between, views_between
from clplen.lightfield.model.between_views import carried, viewpoint_step

Array = np.ndarray[Any, Any]


def waves(seed: int) -> Any:
    """A smooth texture, a function of (y, x) in pixels."""
    random = np.random.default_rng(seed)
    parts = [(random.uniform(-0.7, 0.7, 2), random.uniform(0, 6)) for _ in range(20)]
    return lambda y, x: 100 + 8 * sum(np.cos(a * y + b * x + phase) for (a, b), phase in parts)


def plane(views: tuple[int, int], size: tuple[int, int], d: float, ratio: float = 1.0) -> Array:
    """Views of a plane of disparity d, by L[v, u, y, x] = T(y + ratio d (v - vc), ...)."""
    V, U = views
    y, x = np.indices(size)
    texture = waves(5)
    made = [
        [texture(y + ratio * d * (v - (V - 1) / 2), x + d * (u - (U - 1) / 2)) for u in range(U)]
        for v in range(V)
    ]
    return np.array(made)


@pytest.mark.parametrize(("dtype", "channels"), [(np.uint8, (3,)), (np.float32, ())])
def test_recorded_views_come_back(device: Device, dtype: Any, channels: tuple[int, ...]) -> None:
    random = np.random.default_rng(2)
    samples = random.uniform(1, 200, (3, 5, 23, 31, *channels)).astype(dtype)
    weights = np.ones((3, 5))
    weights[2, 0] = 0
    lf = LightField.from_array(samples, device=device, weights=weights)
    disparity = random.uniform(-1, 2, (23, 31))
    at = [(0, 4), (2, 1), (1, 2), (2, 0)]
    for (v, u), found in zip(at, views_between(lf, at, disparity), strict=True):
        assert found.data.dtype == np.float32
        np.testing.assert_array_equal(found.to_numpy(), samples[v, u].astype(np.float32))


def test_a_plane(device: Device) -> None:
    views, d, ratio = (4, 3), 0.7, 2.0
    spacing = (-1e-3 * ratio, -1e-3, 2e-5, 2e-5)
    samples = plane(views, (41, 53), d, ratio).astype(np.float32)
    lf = LightField.from_array(samples, device=device, spacing=spacing)
    v, u = 1.25, 0.6
    y, x = np.indices((41, 53))
    want = waves(5)(y + ratio * d * (v - 1.5), x + d * (u - 1))
    for disparity in (d, np.full((41, 53), d)):
        found = view_between(lf, v, u, disparity).to_numpy()
        # cubic splines of waves of at most 0.7 rad a pixel: |h|^4 / 100 of their amplitude
        assert np.abs(found - want)[6:-6, 6:-6].max() < 0.2
    assert np.abs(lf.view(v, u).to_numpy() - want)[6:-6, 6:-6].max() > 2


@pytest.mark.parametrize(("surfaces", "gain"), [(lambda n: _plain_scene(n, 91), 10), (_wide, 17)])
def test_scenes_with_edges(device: Device, surfaces: Any, gain: float) -> None:
    views, shape = (3, 5), (97, 131)
    fine, truth = clplen.SurfaceScene(surfaces(min(shape) / 2)).light_field(
        (2 * views[0] - 1, 2 * views[1] - 1), shape, device=device
    )
    every = fine.to_numpy()
    lf = LightField.from_array(every[::2, ::2], device=device)
    disparity = 2 * truth.disparity

    def psnr(picture: Any, want: Array) -> float:
        error = (np.asarray(picture, np.float64) - want)[8:-8, 8:-8]
        return float(-10 * np.log10(np.mean(error**2)))

    at = [(1, 0.5), (1, 2.5), (0.5, 1.5)]
    for (v, u), found in zip(at, views_between(lf, at, disparity), strict=True):
        want = every[round(2 * v), round(2 * u)]
        ours = psnr(found, want)
        assert ours > psnr(lf.view(v, u), want) + gain, (v, u)
        assert ours > psnr(lf.view(v, u, disparity=disparity), want) + 2, (v, u)


def test_what_is_hidden_is_taken_from_views_that_see_it(device: Device) -> None:
    """A bright bar before a ramp: nothing of the bar is left on the ramp, and the reverse."""
    ny, nx, near, far = 21, 64, 7.0, 0.0
    x = np.indices((ny, nx))[1]

    def seen(u: float) -> Array:
        bar = np.abs(x + near * u - 31.5) < 6
        return np.where(bar, 200.0, 20 + 0.5 * x + far * u)

    lf = LightField.from_array(
        np.stack([[seen(u) for u in (-1, 0, 1)]] * 2).astype(np.float32), device=device
    )
    disparity = np.where(np.abs(x - 31.5) < 6, near, far)
    for u in (0.4, 1.6):
        found = view_between(lf, 0.5, u, disparity).to_numpy()
        want = seen(u - 1)
        bar = np.abs(x + near * (u - 1) - 31.5)
        clear = np.abs(bar - 6) > 3  # but for splines beside an edge,
        clear[[0, 1, 2, 3, -4, -3, -2, -1]] = False  # and what comes in from above and below
        assert np.abs(found - want)[clear].max() < 2, u
        assert np.abs(lf.view(0.5, u).to_numpy() - want)[clear].max() > 25


def test_views_of_no_weight_are_not_mixed_in(device: Device) -> None:
    samples = plane((3, 5), (31, 43), 0.5).astype(np.float32)
    want = view_between(samples, 1, 1.5, 0.5).to_numpy()
    samples[1, 2] = np.random.default_rng(0).uniform(0, 255, (31, 43))
    weights = np.ones((3, 5))
    weights[1, 2] = 0
    lf = LightField.from_array(samples, device=device, weights=weights)
    found = view_between(lf, 1, 1.5, 0.5).to_numpy()
    assert np.abs(found - want)[4:-4, 4:-4].max() < 0.2
    weights[1, 1] = 0  # none of the nearest is left: as they are stored, as `view` does it
    lf = LightField.from_array(samples, device=device, weights=weights)
    assert np.isfinite(view_between(lf, 1, 1.5, 0.5).to_numpy()).all()


def test_maps_are_carried() -> None:
    d = np.zeros((5, 11))
    d[:, 4:6] = 2
    moved = carried(d, np.array([0.0, 1.5]))
    np.testing.assert_array_equal(moved[2], [0, 0, 0, 0, 0, 0, 0, 2, 2, 0, 0])
    moved = carried(d, np.array([0.0, -2.0]))
    np.testing.assert_array_equal(moved[2], [2, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    d = np.zeros((9, 4))
    d[3:5] = 1
    moved = carried(d, np.array([2.0, 0.0]))
    np.testing.assert_array_equal(moved[:, 1], [0, 0, 0, 0, 0, 1, 1, 0, 0])
    slant = np.tile(0.05 * np.arange(40.0), (7, 1))  # grows by 30 %: slits must close
    moved = carried(slant, np.array([0.0, 6.0]))
    x = np.arange(40)
    np.testing.assert_allclose(moved[3], 0.05 * np.minimum(x / 1.3, 39), atol=0.06)


def test_steps_are_between_those_of_views(device: Device) -> None:
    lf = LightField.from_array(np.ones((3, 5, 8, 9), np.float32), device=device)
    np.testing.assert_allclose(viewpoint_step(lf, 0.25, 3.5), (0.75, -1.5), atol=1e-6)


def test_what_is_refused(device: Device) -> None:
    lf = LightField.from_array(np.ones((3, 5, 8, 9), np.float32), device=device)
    for at, disparity, error, said in (
        ((1, 4.5), 0.0, ValueError, "must be inside the views"),
        ((-0.1, 2), 0.0, ValueError, "must be inside the views"),
        ((1, 2.5), np.nan, ValueError, "finite"),
        ((1, 2.5), np.zeros((9, 8)), ShapeError, "shape"),
    ):
        with pytest.raises(error, match=said):
            view_between(lf, *at, disparity)
