"""Depth of points in the section 1.5 camera, simulated by the package: plenoptic acceptance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clplen import LightField, PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.lightfield.depth.alpha_estimate import AlphaEstimate, estimate_alpha
from clplen.lightfield.focus_and_depth import depth_map

DEPTHS = (-50e-3, -25e-3, 25e-3, 50e-3)
ON_AXIS = [(0.0, 0.0, dz) for dz in DEPTHS]
AT_THREE = [(3e-3, 3e-3, dz) for dz in DEPTHS]
ELSEWHERE = [
    (-1.371e-3, 2.278e-3, -21.9e-3),
    (-2.676e-3, -0.7e-3, -32.3e-3),
    (0.038e-3, -1.583e-3, 20.4e-3),
    (2.386e-3, 2.065e-3, 31.8e-3),
]
DISC = 10e-6

Measure = Callable[[tuple[float, float, float]], dict[str, AlphaEstimate]]


@pytest.fixture(scope="session")
def measure(camera: Plenoptic1) -> Measure:
    """Estimates of one point, made once; by every method on the axis."""
    kept: dict[tuple[float, float, float], dict[str, AlphaEstimate]] = {}

    def estimates(point: tuple[float, float, float]) -> dict[str, AlphaEstimate]:
        if point not in kept:
            lf = LightField.from_raw(camera.expose(PointSources([point], diameter=DISC)))
            at = lenslet(camera, point)
            # dz = .25 lies beyond the search of the others
            methods = ("compensated", "slope") if point[2] < 0.2 else ("slope",)
            if point in ON_AXIS:
                methods = (*methods, "energy", "thesis")
            kept[point] = {m: estimate_alpha(lf, at=at, method=m) for m in methods}
        return kept[point]

    return estimates


def lenslet(camera: Plenoptic1, point: tuple[float, float, float]) -> tuple[int, int]:
    """The lenslet (y, x) that a point is imaged on."""
    image = camera.image_of([point])[0] / camera.mla.pitch
    centre = (np.array(camera.mla.count[::-1]) - 1) / 2
    x, y = np.round(centre + image).astype(int)
    return int(y), int(x)


def errors(camera: Plenoptic1, measure: Measure, points: list, method: str) -> np.ndarray:
    return np.array([measure(p)[method].alpha - camera.alpha(p[2]) for p in points])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("points", "reference"),
    [
        (ON_AXIS, (0.0025, -0.0041, 0.0052, -0.0030)),
        (AT_THREE, (-0.0001, 0.0020, 0.0042, 0.0040)),
    ],
)
def test_compensated(camera, measure, points, reference):
    error = errors(camera, measure, points, "compensated")
    assert (np.abs(error) <= 0.010).all()
    assert np.sqrt(np.mean(error**2)) <= 0.006
    # the algorithm's own errors, by an independent simulation, which round to these figures
    np.testing.assert_allclose(error, reference, atol=2e-4)


@pytest.mark.thorough
def test_compensated_elsewhere(camera, measure):
    error = errors(camera, measure, ELSEWHERE, "compensated")
    assert (np.abs(error) <= 0.010).all()
    assert np.sqrt(np.mean(error**2)) <= 0.006


@pytest.mark.thorough
def test_energy(camera, measure):
    error = errors(camera, measure, ON_AXIS, "energy")
    assert (np.abs(error) <= 0.030).all()
    np.testing.assert_allclose(error, (0.028, 0.011, -0.011, -0.024), atol=6e-4)
    truth = camera.alpha(np.array(DEPTHS)) - 1
    pooled = np.sum(truth * (truth + error)) / np.sum(truth**2)
    assert 0.86 <= pooled <= 0.91


@pytest.mark.thorough
def test_thesis(measure):
    found = [measure(p)["thesis"].alpha for p in ON_AXIS]
    np.testing.assert_allclose(found, (0.82, 0.92, 1.08, 1.12), atol=0.02)


@pytest.mark.thorough
def test_slope(camera, measure):
    """The line in phase space: sign, depth and blur; .0114 on the axis and .0097 off it, rms."""
    for points in (ON_AXIS, AT_THREE + ELSEWHERE):
        error = errors(camera, measure, points, "slope")
        assert np.sqrt(np.mean(error**2)) <= 0.012
        assert (np.abs(error) <= 0.022).all()
        for point in points:
            found = measure(point)["slope"]
            assert np.sign(found.disparity) == -np.sign(point[2])
            assert found.confidence > 0.7
            assert abs(found.alpha - camera.alpha(point[2])) < 3 * found.uncertainty


@pytest.mark.thorough
@pytest.mark.parametrize(("dz", "blur"), [(0.125, 8.2), (0.25, 12.2)])
def test_slope_far_beyond_the_focus(measure, dz, blur):
    """Figure 3.12."""
    found = measure((0.0, 0.0, dz))["slope"]
    assert found.disparity < 0
    assert found.blur == pytest.approx(blur, rel=0.05)


@pytest.mark.thorough
def test_depth_in_metres_and_uncertainty(camera, measure):
    for point in ON_AXIS + AT_THREE:
        found = measure(point)["compensated"]
        assert not found.in_focus
        assert abs(found.alpha - camera.alpha(point[2])) < 3 * found.uncertainty
        assert found.uncertainty < 0.125 * 150e-6 / 3.6e-3
        # delta z = delta alpha (z_obj + dz)^2 / F
        allowed = 0.010 * (0.24 + point[2]) ** 2 / 0.24
        assert found.z == pytest.approx(point[2], abs=1.1 * allowed)


def test_in_focus(measure):
    found = measure((0.0, 0.0, 0.0))["compensated"]
    assert found.in_focus
    assert found.alpha == pytest.approx(1, abs=0.005)
    assert found.uncertainty == pytest.approx(0.54 * 0.0417, rel=0.01)


@pytest.mark.thorough
def test_default_depth_of_the_summed_scene(camera, scene):
    """Points on black: each at its own depth, and no confidence in the black between them."""
    found = depth_map(scene)
    is_far = np.ones(found.disparity.shape, bool)
    y, x = np.indices(is_far.shape)
    for point in ((-3e-3, -3e-3, -0.05), (0.0, 0.0, 0.0), (3e-3, 3e-3, 0.05)):
        at = lenslet(camera, point)
        assert found.alpha[at] == pytest.approx(camera.alpha(point[2]), abs=0.006)
        assert found.confidence[at] > 0.9
        is_far &= np.hypot(y - at[0], x - at[1]) > 6
    assert found.confidence[is_far].mean() < 0.02
    assert (found.confidence[is_far] > 0.5).mean() < 0.001
