"""Positions on the main lens against directions: (x, u) and (x, theta)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from clplen.io import read_lightfield, write_lightfield
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

F, DU, DX = 0.24, 120e-6, 150e-6  # section 1.5: raw pixel order has du < 0
SPACING = (-DU, -DU, DX, DX)
OPTIONS = {"image_distance": F}


@dataclass(frozen=True)
class Camera:
    """What resample asks of a camera."""

    image_distance: float = F


def axes(n: int, step: float) -> np.ndarray:
    return (np.arange(n) - (n - 1) / 2) * step


def point(alpha: float, X=(0.3e-3, -0.5e-3), views=(19, 22), size=(31, 33), spacing=SPACING):
    """L = a spot of .8 pixels at x = X + u (1 - alpha): thesis eq. 3.7, aperture round."""
    parts = []
    for axis in (0, 1):
        u = axes(views[axis], spacing[axis])
        x = axes(size[axis], spacing[2 + axis])
        distance = x[None, :] - X[axis] - u[:, None] * (1 - alpha)
        parts.append(np.exp(-(distance**2) / (2 * (0.8 * DX) ** 2)))
    return np.einsum("vy,ux->vuyx", *parts).astype(np.float32)


def slope(lf: LightField, axis: int) -> float:
    """dx/du or dx/dtheta: of the centroids of the views that the whole spot is seen in."""
    seen = lf.to_numpy().astype(float).sum(axis=(1, 3) if axis == 0 else (0, 2))
    x = axes(lf.shape[2 + axis], lf.spacing[2 + axis])
    light = seen.sum(axis=1)
    whole = np.abs(light / np.median(light[light > light.max() / 2]) - 1) < 0.02
    centroids = (seen @ x)[whole] / light[whole]
    views = axes(lf.shape[axis], lf.spacing[axis])[whole]
    assert views.size >= 5
    return float(np.polyfit(views, centroids, 1)[0])


@pytest.mark.parametrize(
    ("alpha", "spacing"), [(0.7368, SPACING), (1.1724, (-2 * DU, DU, DX, 1.5 * DX))]
)
def test_slopes_of_a_point(device, alpha, spacing):
    """1 - alpha in (x, u), positive when nearer; F - F' in (x, theta), of the other sign.

    Interpolation moves no centroid of a view; samples of .8 pixels and cut rims leave 1 %.
    """
    lf = LightField.from_array(point(alpha, spacing=spacing), device=device, spacing=spacing)
    angles = lf.resample("point-angle", **OPTIONS)
    for axis in (0, 1):
        assert slope(lf, axis) == pytest.approx(1 - alpha, rel=0.01)
        assert slope(angles, axis) == pytest.approx(F - F / alpha, rel=0.01)
    assert (slope(lf, 1) > 0) == (alpha < 1)
    assert (slope(angles, 1) < 0) == (alpha < 1)


def smooth(views, size, period=10.0) -> np.ndarray:
    """Views that vary by waves of 10 steps and longer."""
    rng = np.random.default_rng(4)
    v, u = (np.arange(n)[:, None] for n in views)
    a = np.zeros((*views, *size))
    for _ in range(6):
        kv, ku = 2 * np.pi / rng.uniform(period, 3 * period, 2)
        picture = rng.uniform(-1, 1, size)
        wave = np.cos(kv * v + rng.uniform(0, 6)) @ np.cos(ku * u + rng.uniform(0, 6)).T
        a += wave[..., None, None] * picture
    return (100 + 10 * a).astype(np.float32)


@pytest.mark.parametrize(("kind", "limit"), [("linear", 0.06), ("cubic", 0.004)])
def test_there_and_back(device, kind, limit):
    """Band-limited in the views: linear loses up to f (1 - f) k^2 of a wave an axis, a tenth of
    k = 2 pi/10 and f = 1/2; .048 (cubic .002) is measured."""
    a = smooth((14, 15), (6, 7))
    lf = LightField.from_array(a, device=device, spacing=SPACING)
    angles = lf.resample("point-angle", interpolation=kind, **OPTIONS)
    assert angles.shape == (14 + 8, 15 + 8, 6, 7)
    assert angles.parametrisation == "point-angle"
    back = angles.resample("two-plane", interpolation=kind, **OPTIONS)
    assert back.parametrisation == "two-plane"
    assert back.shape == lf.shape
    np.testing.assert_allclose(back.spacing, SPACING)
    np.testing.assert_allclose(back.weights, 1, rtol=1e-6)
    error = np.abs(back.to_numpy() - a)[3:-3, 3:-3].max() / np.abs(a - 100).max()
    assert 1e-6 < error < limit


def test_weights_are_of_the_rays_that_were_seen(device):
    weights = np.array([[1.0, 0.5, 0.0, 0.25]])
    lf = LightField.from_array(
        np.ones((1, 4, 1, 3)), device=device, weights=weights, spacing=(DU, DU, DU, DU)
    )
    found = lf.resample("point-angle", **OPTIONS)
    # view j of pixel x is view j - 1 + (x - 1), so that three views meet in one direction
    want = [1, 0.75, 0.75, 0.375, 0.25, 0.25]
    np.testing.assert_allclose(found.weights[0], want)
    np.testing.assert_allclose(found.to_numpy()[0, 0, 0], [0, 0, 1])


def test_the_camera_gives_f_and_everything_else_stays(device):
    a = point(0.9)
    lf = LightField.from_array(a, device=device, spacing=SPACING, camera=Camera())
    angles = lf.resample("point-angle")
    assert angles.camera is lf.camera
    assert angles.spacing[1] == pytest.approx(DU / F)
    assert lf.resample("two-plane") is lf
    fewer = lf.resample("point-angle", views=(3, 5))
    middle = angles.to_numpy()
    rows, columns = ((n - k) // 2 for n, k in zip(angles.shape, (3, 5), strict=False))
    assert (angles.shape[0] - 3) % 2 == 0
    if (angles.shape[1] - 5) % 2 == 0:
        np.testing.assert_array_equal(
            fewer.to_numpy(), middle[rows : rows + 3, columns : columns + 5]
        )


@pytest.mark.parametrize("name", ["angles.h5"])
def test_a_file_keeps_the_parametrisation(device, tmp_path, name):
    lf = LightField.from_array(point(0.9), device=device, spacing=SPACING)
    angles = lf.resample("point-angle", **OPTIONS)
    write_lightfield(tmp_path / name, angles)
    found = read_lightfield(tmp_path / name, device=device)
    assert found.parametrisation == "point-angle"
    np.testing.assert_allclose(found.spacing, angles.spacing)


def test_focusing_refuses_directions(device):
    lf = LightField.from_array(point(0.9), device=device, spacing=SPACING, camera=Camera())
    angles = lf.resample("point-angle")
    for call in (
        lambda: refocus(angles, disparity=0.1),
        lambda: refocus(angles, alpha=0.9),
        lambda: focal_stack(angles, disparities=[0, 1]),
        lambda: depth_map(angles, disparities=[0, 0.1, 0.2]),
        lambda: angles.alpha(0.1),
    ):
        with pytest.raises(ValueError, match=r"are directions; call lf.resample\('two-plane'\)"):
            call()


def test_what_cannot_be_resampled(device):
    a = np.ones((2, 2, 3, 3))
    plain = LightField.from_array(a, device=device)
    spaced = LightField.from_array(a, device=device, spacing=SPACING)
    scattered = LightField.from_array(
        a, device=device, spacing=SPACING, positions=np.zeros((2, 2, 2))
    )
    telecentric = LightField.from_array(a, device=device, spacing=(np.nan, np.nan, DX, DX))
    for lf, options, said in (
        (plain, OPTIONS, "needs the spacing of views and pixels"),
        (telecentric, OPTIONS, "needs the spacing of views and pixels"),
        (spaced, {}, "needs F > 0"),
        (spaced, {"image_distance": -1.0}, "needs F > 0"),
        (scattered, OPTIONS, "views with positions"),
        (spaced, OPTIONS | {"interpolation": "nearest"}, "'linear' or 'cubic'"),
        (spaced, OPTIONS | {"views": (0, 3)}, "at least 1 along each axis"),
    ):
        with pytest.raises(ValueError, match=said):
            lf.resample("point-angle", **options)
    with pytest.raises(ValueError, match="parametrisation must be 'two-plane' or 'point-angle'"):
        spaced.resample("spherical")
