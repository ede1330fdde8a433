"""refocus and focal_stack against the float64 form of their definition."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from reference_lightfield import apply, sampling_matrix
from reference_lightfield import refocus as twin
from tolerance import relative_max

import clplen
from clplen.errors import DeviceError
from clplen.lightfield.model.alpha_law import overlap_limit
from clplen.lightfield.model.apertures import aperture_weights
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

SAMPLES = [
    (np.uint8, (5, 2, 31, 7)), (np.uint16, (4, 3, 13, 11, 3)), (np.float32, (1, 6, 5, 19)),
]  # fmt: skip
DISPARITIES = [-2.0, -1.3, 0.0, 0.21, 1.77]
SPACING = (-120e-6, -120e-6, 150e-6, 150e-6)  # du/dx = -0.8
UNEQUAL = (90e-6, -120e-6, 130e-6, -150e-6)
LIMIT = 1e-5  # of the maximum: what is promised for linear interpolation in float32


def values(dtype=np.float32, shape=(3, 4, 17, 23)) -> np.ndarray:
    return np.random.default_rng(29).integers(1, 250, shape).astype(dtype)


def light_field(device, a=None, **more) -> LightField:
    return LightField.from_array(values() if a is None else a, device=device, **more)


@pytest.mark.parametrize(("dtype", "shape"), SAMPLES)
def test_focal_stack_against_twin(device, dtype, shape):
    a = values(dtype, shape)
    weights = np.random.default_rng(31).random(shape[:2])
    lf = light_field(device, a, weights=weights)
    stack = focal_stack(lf, disparities=DISPARITIES)
    assert stack.shape == (len(DISPARITIES), *shape[2:])
    assert stack.to_numpy().dtype == np.float32
    for d, got in zip(DISPARITIES, stack.to_numpy(), strict=True):
        assert relative_max(twin(a, d, weights=weights), got) <= LIMIT
        np.testing.assert_array_equal(refocus(lf, disparity=d).to_numpy(), got)


def test_a_plane_comes_into_focus(device):
    """L[v, u, y, x] = T(y + d (v - vc), x + d (u - uc)): nearer moves towards smaller x."""
    texture = np.random.default_rng(37).random((60, 60))
    V, U, ny, nx, d = 3, 5, 31, 29, -2
    a = np.empty((V, U, ny, nx), np.float32)
    for v in range(V):
        for u in range(U):
            top, left = 15 + d * (v - 1), 15 + d * (u - 2)
            a[v, u] = texture[top : top + ny, left : left + nx]
    got = refocus(light_field(device, a), disparity=d).to_numpy()
    want = texture[15 : 15 + ny, 15 : 15 + nx]
    inner = (slice(4, -4), slice(4, -4))
    assert relative_max(want[inner], got[inner].astype(float)) <= LIMIT


def test_alpha_is_disparity(device):
    lf = light_field(device, spacing=SPACING)
    for alpha in (0.7368421, 1.0, 1.1724138):
        by_alpha = refocus(lf, alpha=alpha).to_numpy()
        by_disparity = refocus(lf, disparity=0.8 * (1 - alpha)).to_numpy()
        assert relative_max(by_disparity, by_alpha) <= LIMIT


def sheared(a: np.ndarray, d_y: float, d_x: float) -> np.ndarray:
    """The plain mean of views that are moved by different steps along y and x."""
    (V, U), (ny, nx) = a.shape[:2], a.shape[2:]
    total = used = 0.0
    for v in range(V):
        for u in range(U):
            my = sampling_matrix(np.arange(ny) - (v - (V - 1) / 2) * d_y, ny)
            mx = sampling_matrix(np.arange(nx) - (u - (U - 1) / 2) * d_x, nx)
            total = total + apply(mx, apply(my, a[v, u].astype(float), 0), 1)
            used = used + np.outer(my.sum(axis=1), mx.sum(axis=1))
    return total / used


@pytest.mark.parametrize(
    ("spacing", "ratio"),
    [
        (SPACING, 1.0),
        (UNEQUAL, (90 / 130) / (120 / 150)),
        ((np.inf, np.inf, 130e-6, 150e-6), 150 / 130),
    ],
)
def test_shift_along_y_follows_its_own_spacing(device, spacing, ratio):
    lf = light_field(device, spacing=spacing)
    got = refocus(lf, disparity=0.9).to_numpy()
    assert relative_max(sheared(values(), 0.9 * ratio, 0.9), got) <= LIMIT


def test_rescale_keeps_the_sum(device):
    y, x = np.mgrid[-20:21, -20:21]
    spot = np.exp(-(x**2 + (y - 3) ** 2) / 18).astype(np.float32)
    lf = light_field(device, np.tile(spot, (3, 3, 1, 1)), spacing=SPACING)
    for alpha in (0.8, 1.2):
        plain, scaled = (refocus(lf, alpha=alpha, rescale=r).to_numpy() for r in (False, True))
        assert abs(scaled.sum() / plain.sum() - 1) < 0.01
        row = np.argmax(scaled.max(axis=1)) - 20
        assert row == round(3 / alpha)


def spaced(lf):
    return replace(lf, spacing=SPACING)


RESCALE = "rescale=True needs a positive alpha"
REFUSED = [
    (lambda lf: refocus(lf, disparity=0.5, rescale=True), RESCALE),
    (lambda lf: refocus(spaced(lf), disparity=1.0, rescale=True), r"got alpha -0\.25"),
    (lambda lf: refocus(lf), "exactly one of alpha and disparity, got neither"),
    (lambda lf: refocus(lf, alpha=1, disparity=1), "alpha and disparity, got both"),
    (lambda lf: refocus(spaced(lf), alpha=np.nan), "Planes must be finite numbers"),
    (lambda lf: refocus(lf, disparity=np.inf), "Planes must be finite numbers"),
    (lambda lf: focal_stack(lf, disparities=[0.0, np.nan]), "disparities must be START"),
    (lambda lf: refocus(lf, alpha=1.1), "alpha needs the spacing"),
    (lambda lf: focal_stack(spaced(lf), alphas=[1.0, 0.0]), "positive and finite"),
    (lambda lf: refocus(lf, disparity=[0.0, 1.0]), "pass one number, or call focal_stack"),
    (lambda lf: focal_stack(lf, disparities=[]), "a list of at least one plane, got shape"),
    (lambda lf: focal_stack(lf, disparities=0.5), "a list of at least one plane, got shape"),
    (lambda lf: focal_stack(lf, disparities=[[0.0, 1.0]]), "a list of at least one plane, got"),
]


def test_what_is_refused(device):
    for call, message in REFUSED:
        with pytest.raises((TypeError, ValueError), match=message):
            call(light_field(device))


def test_what_a_stack_knows(device):
    camera = SimpleNamespace(image_distance=0.24, aperture_diameter=0.0036)
    lf = light_field(device, spacing=SPACING, camera=camera)
    stack = focal_stack(lf, alphas=np.linspace(0.8, 1.2, 5))
    np.testing.assert_allclose(stack.alphas, [0.8, 0.9, 1.0, 1.1, 1.2])
    np.testing.assert_allclose(stack.disparities, [0.16, 0.08, 0, -0.08, -0.16], atol=1e-12)
    assert stack.spacing == SPACING
    assert stack.camera is camera
    assert stack.device is device
    by_disparity = focal_stack(light_field(device), disparities=[1.5, -0.5])
    np.testing.assert_array_equal(by_disparity.disparities, [1.5, -0.5])
    assert np.isnan(by_disparity.alphas).all()


def test_aperture_of_a_stack(device):
    aperture = np.arange(12).reshape(3, 4)
    own = np.random.default_rng(41).random((3, 4))
    lf = light_field(device, weights=own)
    weights = aperture_weights(lf, aperture, None) * own
    got = focal_stack(lf, disparities=[-0.7, 1.0], aperture=aperture).to_numpy()
    for d, picture in zip([-0.7, 1.0], got, strict=True):
        assert relative_max(twin(values(), d, weights=weights), picture) <= LIMIT


def test_a_stack_that_does_not_fit_is_refused(device, monkeypatch):
    lf = light_field(device, values(np.uint8))
    needed = 1000 * 17 * 23 * 4 + 3 * 4 * 17 * 23
    monkeypatch.setattr(device, "memory_bytes", needed - 1)
    message = f"This focal stack with its light field needs {needed:,} bytes .* fewer planes"
    with pytest.raises(DeviceError, match=message):
        focal_stack(lf, disparities=np.linspace(-2, 2, 1000))


APART = 23.0  # pixels a view step: the width of the views, from which neighbours share nothing
OPPOSITE = np.pad([[1.0]], ((0, 2), (0, 3))) + np.pad([[1.0]], ((2, 0), (3, 0)))
SURFACE = np.full((17, 23), APART)
BEYOND = {
    "refocus": lambda lf: refocus(lf, disparity=APART),
    "alpha": lambda lf: refocus(replace(lf, spacing=SPACING), alpha=1 + APART / 0.8),
    "cubic": lambda lf: refocus(lf, disparity=-1e6, interpolation="cubic"),
    "fourier": lambda lf: refocus(lf, disparity=1e6, interpolation="fourier"),
    "upsample": lambda lf: refocus(lf, disparity=1e6, upsample=2),
    "surface": lambda lf: refocus(lf, disparity=SURFACE),
    "focal_stack": lambda lf: focal_stack(lf, disparities=[0, -APART]),
    "aperture": lambda lf: focal_stack(lf, disparities=[7.7], aperture=OPPOSITE),
    "fourier_stack": lambda lf: clplen.lightfield.fourier_stack(lf, disparities=[APART]),
    "depth_map": lambda lf: clplen.depth_map(lf, disparities=[0, 1, APART]),
    "all_in_focus": lambda lf: clplen.all_in_focus(lf, disparities=[0, APART]),
    "depth=": lambda lf: clplen.all_in_focus(lf, depth=SURFACE),
    "flatten": lambda lf: lf.flatten("median", disparity=APART),
    "view": lambda lf: lf.view(1.5, 1.5, disparity=APART),
    "view_between": lambda lf: clplen.lightfield.view_between(lf, 1.5, 1.5, APART),
    "hyperfan": lambda lf: clplen.lightfield.hyperfan(lf, APART, APART + 1),
    "stored stack": lambda lf: focal_stack(stored(lf), disparities=[0, APART]),
    "stored depth": lambda lf: clplen.depth_map(stored(lf), disparities=[0, 1, APART]),
    "stored picture": lambda lf: clplen.all_in_focus(stored(lf), disparities=[0, APART]),
    "stored depth=": lambda lf: clplen.all_in_focus(stored(lf), depth=SURFACE),
}


def stored(lf):
    return clplen.StoredLightField.from_light_field(lf)


def test_a_plane_on_which_no_two_views_overlap_is_refused(device):
    for call in BEYOND.values():
        with pytest.raises(ValueError, match="no two views overlap in pictures of 17 x 23 pixels"):
            call(light_field(device))


def test_planes_on_which_some_views_overlap_are_taken(device):
    lf = light_field(device)
    assert refocus(lf, disparity=APART - 0.5).to_numpy().any()
    assert refocus(lf, disparity=np.where(np.eye(17, 23) > 0, 0, 1e6)).to_numpy().any()
    one = LightField.from_array(values()[:1, :1], device=device)
    np.testing.assert_array_equal(refocus(one, disparity=1e6), one.view(0, 0))
    assert focal_stack(lf, disparities=[7.6], aperture=OPPOSITE).to_numpy().any()
    few = LightField.from_array(values()[..., :2, :1], device=device)
    assert np.abs(clplen.depth_map(few).disparity).max() < 2


def test_the_limit_of_overlap_is_that_of_the_best_pair():
    rng = np.random.default_rng(5)
    for count in (1, 2, 3, 30):
        steps = rng.normal(size=(count, 2)).round(1)
        places = steps / (17, 23)
        pairs = combinations(places, 2) if count > 1 else [2 * [places[0]]]
        least = min(np.abs([a, b, a - b]).max() for a, b in pairs)
        assert overlap_limit(steps, (1, count, 17, 23)) == pytest.approx(1 / least)
