"""Depth from the slope of a point in phase space, on analytic light fields."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clplen.lightfield.depth.alpha_estimate import estimate_alpha
from clplen.lightfield.depth.phase_slope import fit_slope
from clplen.lightfield.model.light_field import LightField


def point(d, views=(13, 14), size=(25, 27), at=(11.8, 13.3), aspect=1.0, scatter=1.2):
    """L: at the pixel x the point is seen at u = (X - x)/d, blurred by `scatter` views."""
    parts = []
    for axis, of in ((0, d * aspect), (1, d)):
        u = np.arange(views[axis]) - (views[axis] - 1) / 2
        x = np.arange(size[axis]) - at[axis]
        seen = -x / of
        inside = np.abs(seen) <= views[axis] / 2 - 2.5 * scatter
        parts.append(inside * np.exp(-((u[:, None] - seen) ** 2) / (2 * scatter**2)))
    return np.einsum("vy,ux->vuyx", *parts).astype(np.float32)


@pytest.mark.parametrize(("d", "aspect"), [(-1.9, 1.0), (0.6, 1.25)])
def test_a_line(device, d, aspect):
    """Spots that are whole have their centroid on the line; sampled Gaussians leave 1e-2."""
    spacing = (-1e-4 * aspect, -1e-4, 1.5e-4, 1.5e-4)
    lf = LightField.from_array(point(d, aspect=aspect), device=device, spacing=spacing)
    found = estimate_alpha(lf, method="slope", at=(12, 13), window=23)
    assert found.disparity == pytest.approx(d, rel=0.01)
    assert found.alpha == pytest.approx(1 - d * 1.5, rel=0.02, abs=0.02)
    assert found.confidence > 0.95
    assert found.method == "slope"
    assert math.isnan(found.uncertainty)
    assert math.isnan(found.z)
    assert math.isnan(found.blur)
    assert found.curve[0].size == found.disparities.size == 0


def test_scatter_of_the_spots_does_not_flatten_the_line():
    """Spots off the line by 1.5 views rms: regressing x on u would lose the share 1 - R^2."""
    rng = np.random.default_rng(8)
    u = np.arange(20) - 9.5
    seen = -(np.arange(21) - 10) / 1.5 + rng.normal(0, 1.5, (21, 21))  # (y, x)
    spots = np.exp(-((u[:, None, None] - seen) ** 2) / 2)
    window = np.einsum("v,uyx->vuyx", np.exp(-(u**2) / 2), spots)[None]
    tall = np.concatenate([window, window.transpose(0, 2, 1, 4, 3)])  # the same along y
    found = [fit_slope(one) for one in (tall[:1] + 0, tall[1:])]
    assert found[0].disparity == pytest.approx(found[1].disparity)
    # v is the same for every y, so that the line of both axes together is half as steep
    assert found[0].disparity == pytest.approx(2 * 1.5, rel=0.05)
    assert found[0].confidence < 0.5


def test_nothing_to_see(device):
    lf = LightField.from_array(np.zeros((3, 3, 21, 21)), device=device)
    with pytest.raises(ValueError, match=r"lenslets around .* have no light"):
        estimate_alpha(lf, method="slope", at=(10, 10))
