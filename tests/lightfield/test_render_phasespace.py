"""Slices with their axes: metres, radians, signs of slopes, and their figure."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clplen import plot
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.phase_space import phase_space

F = 0.24
SPACING = (-120e-6, -60e-6, 150e-6, 300e-6)
CAMERA = SimpleNamespace(image_distance=F, aperture_diameter=3.6e-3)


def light_field(device, shape=(5, 4, 7, 11), **more) -> LightField:
    a = np.random.default_rng(3).uniform(1, 250, shape).astype(np.float32)
    return LightField.from_array(a, device=device, **more)


def test_axes_in_metres_and_radians(device):
    lf = light_field(device, spacing=SPACING, camera=CAMERA)
    a = lf.to_numpy()
    rows = phase_space(lf, y=2, v=1)
    assert rows.axes == ("u", "x")
    assert rows.units == ("m", "m")
    np.testing.assert_array_equal(rows.values, a[1, :, 2])
    np.testing.assert_allclose(rows.direction, -60e-6 * np.array([-1.5, -0.5, 0.5, 1.5]))
    np.testing.assert_allclose(rows.position, 300e-6 * np.arange(-5, 6))
    u, x = rows.direction[:, None], rows.position[None]
    np.testing.assert_allclose(rows.theta, (x - u) / F)
    columns = phase_space(lf, x=4, u=3)
    assert columns.axes == ("v", "y")
    np.testing.assert_array_equal(columns.values, a[:, 3, :, 4])
    np.testing.assert_allclose(columns.direction, -120e-6 * np.arange(-2, 3))
    np.testing.assert_allclose(columns.position, 150e-6 * np.arange(-3, 4))


@pytest.mark.parametrize("alpha", [0.75])
def test_slopes_of_a_point(device, alpha):
    """dx/du = 1 - alpha and dx/dtheta = F - F' (opposite signs), F' = F/alpha."""
    spacing = (-3e-4, -3e-4, 1.5e-4, 1.5e-4)
    a = np.zeros((1, 5, 1, 41), np.float32)
    d = 2 * (1 - alpha)  # -(1 - alpha) du/dx
    for u in range(5):
        at = 20 - d * (u - 2)
        a[0, u, 0, int(np.floor(at))] = 1 - at % 1
        a[0, u, 0, int(np.floor(at)) + 1] += at % 1
    lf = LightField.from_array(a, device=device, spacing=spacing, camera=CAMERA)
    found = phase_space(lf, y=0, v=0)
    x = (found.values @ found.position) / found.values.sum(axis=1)
    assert np.polyfit(found.direction, x, 1)[0] == pytest.approx(1 - alpha, abs=1e-6)
    theta = (x - found.direction) / F
    assert np.polyfit(theta, x, 1)[0] == pytest.approx(F - F / alpha, abs=1e-6)


def test_directions_are_an_axis_by_themselves(device):
    lf = light_field(device, spacing=SPACING, camera=CAMERA).resample("point-angle")
    found = phase_space(lf, y=2, v=1)
    assert found.axes == ("theta_x", "x")
    assert found.units == ("rad", "m")
    np.testing.assert_allclose(np.diff(found.direction), 60e-6 / F)
    np.testing.assert_array_equal(found.theta[:, 3], found.direction)
    axes = plot.epi(found).axes[0]
    assert axes.get_ylabel() == r"$\theta_x$ / mrad"
    assert not axes.child_axes


def test_scattered_views_have_no_rows(device):
    lf = light_field(device, positions=np.zeros((5, 4, 2)))
    with pytest.raises(ValueError, match="needs views on a regular grid"):
        phase_space(lf, y=0, v=0)


def test_the_figure_says_its_axes(device):
    lf = light_field(device, spacing=SPACING, camera=CAMERA)
    figure = plot.epi(phase_space(lf, y=2, v=1))
    axes = figure.axes[0]
    assert axes.get_xlabel() == "x on the image plane / mm"
    assert axes.get_ylabel() == "u on the main lens / mm"
    # Outer borders: 11 pixels of 0.3 mm; du < 0, so the first row is at the top with u = +90 um.
    np.testing.assert_allclose(axes.images[0].get_extent(), (-1.65, 1.65, -0.12, 0.12))
    (other,) = axes.child_axes
    figure.draw_without_rendering()
    assert r"\theta = -u/F" in other.get_ylabel()
    low, high = other.get_ylim()
    assert sorted(abs(t) for t in (low, high)) == pytest.approx([0.12 / F] * 2)
    pixels = plot.epi(phase_space(light_field(device, (2, 3, 5, 7, 3)), x=1, u=2))
    assert pixels.axes[0].get_ylabel() == "v from the middle / view"
    assert pixels.axes[0].get_xlabel() == "y from the middle / pixel"
    assert not pixels.axes[0].child_axes
