"""All-in-focus pictures of a scene with two depths."""

from __future__ import annotations

import numpy as np
import pytest
from reference_lightfield import refocus as twin_refocus

from clplen.errors import ShapeError
from clplen.lightfield.depth.depth_maps import DepthMap
from clplen.lightfield.focus_and_depth import all_in_focus
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.stacks import focal_stack

NEAR, FAR, SIZE = 1.0, -1.0, (30, 64)


def texture() -> np.ndarray:
    """Of the centre view, with margins of 10 pixels."""
    values = np.random.default_rng(2).uniform(0, 250, (SIZE[0] + 20, SIZE[1] + 20))
    return np.round(values)


def two_depths(device, views=(3, 5)) -> LightField:
    """Left half at d = 1, right half at d = -1: whole pixels, so that nothing is interpolated."""
    t = texture()
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    a = np.empty((*views, *SIZE), np.float32)
    for v, u in np.ndindex(views):
        dv, du = v - (views[0] - 1) // 2, u - (views[1] - 1) // 2
        near = t[10 + y + dv, 10 + x + du]
        far = t[10 + y - dv, 10 + x - du]
        a[v, u] = np.where(x + du < SIZE[1] // 2, near, far)
    return LightField.from_array(a, device=device)


def truth() -> np.ndarray:
    return np.where(np.arange(SIZE[1]) < SIZE[1] // 2, NEAR, FAR) * np.ones((SIZE[0], 1))


LEFT, RIGHT = (slice(6, -6), slice(6, 26)), (slice(6, -6), slice(38, 58))
INSIDE = (LEFT, RIGHT)


def test_both_halves_are_sharp_by_energy(device):
    lf = two_depths(device)
    want = texture()[10:-10, 10:-10]
    got = all_in_focus(lf, disparities=np.linspace(-1.5, 1.5, 13)).to_numpy()
    for part in INSIDE:
        assert np.abs(got - want)[part].std() < 0.1 * want.std()
    one = twin_refocus(lf.to_numpy().astype(float), NEAR)
    assert np.abs(one - want)[RIGHT].std() > 0.4 * want.std()


def test_both_halves_are_exact_by_depth(device):
    lf = two_depths(device)
    want = texture()[10:-10, 10:-10]
    stack = focal_stack(lf, disparities=[1.0, 0.0, -1.0])  # falling: put in order
    nothing = np.zeros(SIZE, np.float32)
    depth = DepthMap(truth().astype(np.float32), nothing, nothing, nothing)
    for source, given in ((lf, depth), (lf, truth()), (stack, depth)):
        got = all_in_focus(source, depth=given).to_numpy()
        for part in INSIDE:
            assert np.abs(got - want)[part].max() <= 1e-4 * want.max()


def test_values_stay_linear(device):
    """Twice the light is twice the picture, and a uniform scene is itself."""
    lf = two_depths(device)
    twice = LightField.from_array(2 * lf.to_numpy(), device=device)
    planes = np.linspace(-1, 1, 5)
    one, two = (all_in_focus(one, disparities=planes).to_numpy() for one in (lf, twice))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-5)
    plain = LightField.from_array(np.full((2, 3, 9, 12, 3), 37, np.uint8), device=device)
    np.testing.assert_allclose(all_in_focus(plain).to_numpy(), 37, rtol=1e-6)


def test_bad_depths_are_refused(device):
    lf = two_depths(device)
    stack = focal_stack(lf, disparities=[0.0, 1.0])
    with pytest.raises(ShapeError, match=r"shape \(30, 64\), got shape \(64, 30\)"):
        all_in_focus(lf, depth=truth().T)
    with pytest.raises(ShapeError, match="for one plane call refocus"):
        all_in_focus(stack, depth=0.5)
    with pytest.raises(ValueError, match="fill the pixels that are NaN"):
        all_in_focus(lf, depth=np.full(SIZE, np.nan))
    for more in ({"source": stack}, {"source": lf, "depth": truth()}):
        with pytest.raises(ValueError, match="omit disparities"):
            all_in_focus(**more, disparities=[0.0, 1.0])
