"""Phase space (x, p = n sin theta) of a microscope: refocusing moves light, it keeps areas."""

from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
PLANES = np.array([-30, 0, 20]) * 1e-6


@pytest.fixture
def lfm(monkeypatch):
    """The module of figure 5.2."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return import_module("microscope")


def ratios(lfm, cam, lf, interpolation):
    """Areas refocused to the planes over that as taken."""
    p, x = lfm.axes_of(cam, lf)
    areas = [lfm.area(light, p, x) for light in lfm.refocused(lf, PLANES, interpolation)]
    return np.array(areas) / lfm.area(lfm.summed(lf), p, x)


@pytest.mark.thorough
def test_refocusing_keeps_areas(device, lfm):
    """Samples 1.25 um apart; the camera's own, 6.25 um apart, are too few, so this can fail."""
    cam = lfm.camera(SimpleNamespace(device=device))
    slab = lfm.slab(10e-6, 30e-6, 16e-6, planes=3)
    for places, spread in (([(0, 0, 20e-6)], 1.414), (slab, 1.138)):
        kept = ratios(lfm, cam, lfm.taken(cam, places, steps=5), "cubic")
        assert kept == pytest.approx(1, abs=0.01)
        own = ratios(lfm, cam, lfm.taken(cam, places), "linear")
        assert own[2] == pytest.approx(spread, abs=3e-3)  # float64, shift and add in NumPy


@pytest.mark.parametrize(
    ("z", "expected"), [pytest.param(-20e-6, 1.064, marks=pytest.mark.thorough), (20e-6, 1.065)]
)
def test_points_lie_along_z_p_over_n(device, lfm, z, expected):
    """dx/dp over z/n in a float64 simulation; where the plane is in focus, one less."""
    cam = lfm.camera(SimpleNamespace(device=device))
    lf = lfm.taken(cam, [(0, 0, z)], steps=5)
    p, x = lfm.axes_of(cam, lf)
    slope = import_module("slices").slope
    for light, less in ((lfm.summed(lf), 0), (lfm.refocused(lf, [z], "cubic")[0], 1)):
        found = slope(light, p, x, within=8.5 * (p[1] - p[0]), reach=np.inf) / z
        assert found == pytest.approx(expected - less, abs=5e-3)
