"""Where light fields of microscopes are sharpest: rays, their paraxial law, and exposures."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources
from clplen.errors import SamplingWarning
from clplen.lightfield.depth.alpha_estimate import estimate_alpha
from clplen.lightfield.depth.best_focus import (
    farthest_disparity,
    focus_ratio,
    focus_ratio_of_disparity,
    suitable_planes,
)
from clplen.lightfield.focus_and_depth import all_in_focus, depth_map
from clplen.lightfield.stacks import focal_stack

CASES = {  # M, NA, n, wavelength, lenslets, pixels a lenslet; all matched
    "20x": (20, 0.5, 1.0, 525e-9, 125e-6, 25),
    "water": (60, 1.2, 1.33, 593e-9, 100e-6, 15),
    "oil": (63, 1.4, 1.515, 525e-9, 125e-6, 23),
}


def microscope(device, name, count=21, **other):
    magnification, na, n, wavelength, pitch, pixels = CASES[name]
    mla = MicrolensArray(pitch, pitch * magnification / (2 * na), count=count, fill="full")
    words = {
        "magnification": magnification, "na": na, "medium_index": n, "wavelength": wavelength,
        "pixels_per_lenslet": pixels, "mla": mla, "device": device,
    }  # fmt: skip
    return PlenopticCamera.microscope(**(words | other))


def seen(camera, z):
    return LightField.from_raw(camera.expose(PointSources([(0, 0, z)])))


def rays(na, n=1.0, e=0.5, magnification=20, pitch=125e-6):
    mla = SimpleNamespace(pitch=pitch)
    return SimpleNamespace(
        na=na, medium_index=n, apodisation=e, magnification=magnification, mla=mla
    )


def with_half(na):
    """<s^2/c>/<s^2> with weights c s ds: (S^4/4)/int s^3 c ds."""
    c = math.sqrt(1 - na**2)
    return na**4 / 4 / ((1 - c**3) / 3 - (1 - c**5) / 5)


def without(na):
    """The same with weights s ds: int s^3/c ds/(S^4/4)."""
    c = math.sqrt(1 - na**2)
    return ((1 - c) - (1 - c**3) / 3) * 4 / na**4


@pytest.mark.parametrize(("e", "closed"), [(0.5, with_half), (0.0, without)])
def test_small_depths_have_the_closed_form(e, closed):
    for na in (0.3, 0.92):  # steps of r: (1/c - 1)/400, 4e-3 of it at .92
        assert focus_ratio(rays(na, e=e), 1e-9) == pytest.approx(closed(na), rel=3e-3)
        assert focus_ratio(rays(1.33 * na, 1.33, e), 1e-9) == pytest.approx(closed(na), rel=3e-3)


@pytest.mark.parametrize("share", [0.4])
def test_large_depths_are_a_sum_over_rays_one_by_one(device, share):
    camera = microscope(device, "oil", 9)
    z = share * camera.depth_range
    views = (np.arange(35) - 17) / 1.5 * camera.pixel_pitch / camera.mla.f
    y, x = (a * camera.magnification / 1.515 for a in np.meshgrid(views, views, indexing="ij"))
    inside = np.hypot(y, x) <= 1.4 / 1.515
    c = np.sqrt(1 - x[inside] ** 2 - y[inside] ** 2)
    k = np.linspace(-0.45, 0.45, 11)
    pairs = [(a, b) for a in k for b in k if b >= 0 and 0.1 <= math.hypot(a, b) <= 0.45]
    ratios, energy = np.linspace(1.1, 1.6, 51), []
    for r in ratios:
        moved = camera.magnification * z / camera.mla.pitch * (1 / c - r)
        phases = [2 * np.pi * (a * y[inside] + b * x[inside]) * moved for a, b in pairs]
        energy.append(sum(abs((c * np.exp(1j * p)).sum()) ** 2 for p in phases))
    assert focus_ratio(camera, z) == pytest.approx(ratios[np.argmax(energy)], abs=0.015)
    assert focus_ratio(camera, -z) == focus_ratio(camera, z)
    d = camera.disparity(z) * focus_ratio(camera, z)
    assert focus_ratio_of_disparity(camera, d) == pytest.approx(focus_ratio(camera, z), rel=2e-3)


@pytest.mark.parametrize(("name", "z"), [("water", 8e-6)])
def test_high_na_is_said_with_what_rays_make_of_it(device, name, z):
    camera = microscope(device, name, 15)
    with pytest.warns(SamplingWarning, match=r"At NA/n = 0\.9\d+ marginal .* not at the paraxial"):
        found = estimate_alpha(seen(camera, z))
    assert found.z == pytest.approx(camera.z(found.disparity))
    ratio = focus_ratio_of_disparity(camera, found.disparity)
    assert abs(found.z / z - 1) > 0.25
    # rays leave diffraction out: up to 3.6 % (docs/microscope_theory.md)
    assert found.z / ratio == pytest.approx(z, rel=0.05)
    assert abs(found.z - z) < found.z_uncertainty < 0.6 * abs(z)


def test_search_goes_over_the_depth_range_and_says_where_it_ends(device):
    camera = microscope(device, "20x", 15)
    lf = seen(camera, -60e-6)
    assert estimate_alpha(lf).z == pytest.approx(-60e-6, rel=0.12)
    words = (
        r"end of the search, disparity 0\.3 of .* abs\(z\) up to 4\.69e-05 m.* pass c_max=0\.6\."
    )
    for method in ("compensated", "energy"):
        with pytest.warns(SamplingWarning, match=words):
            found = estimate_alpha(lf, c_max=0.3, method=method)
        assert math.isnan(found.uncertainty)
        assert math.isnan(found.z_uncertainty)
    end = camera.depth_range / 2
    assert estimate_alpha(seen(camera, end)).z == pytest.approx(end, rel=0.12)
    beyond = seen(camera, 120e-6)
    with pytest.warns(SamplingWarning, match=r"disparity -0\.\d+ of .* pass c_max=1\.\d+"):
        estimate_alpha(beyond)
    with pytest.warns(SamplingWarning, match=r"at most 0\.75, pass a larger window"):
        estimate_alpha(beyond, window=9, c_max=0.749)


def test_depth_maps_of_microscopes_try_their_depth_range(device):
    camera = microscope(device, "20x", 15)
    lf = seen(camera, -20e-6)
    planes = suitable_planes(lf)["disparities"]
    assert planes[-1] == farthest_disparity(camera)
    found = depth_map(lf)
    assert found.z[7, 5:10] == pytest.approx(-20e-6, rel=0.12)
    assert np.array_equal(found.z, depth_map(focal_stack(lf, disparities=planes)).z)
    sharp = all_in_focus(lf).to_numpy()
    assert np.array_equal(sharp, all_in_focus(lf, disparities=planes).to_numpy())
    water = seen(microscope(device, "water", 9), 2e-6)
    with pytest.warns(SamplingWarning, match=r"1\.51 times near .*: z by the paraxial"):
        depth_map(water)


def test_planes_of_many_views_are_close_enough(device):
    mla = MicrolensArray(720e-6, 28.8e-3, count=9, fill="full")  # N_u = 36
    camera = microscope(device, "20x", na=0.25, pixels_per_lenslet=70, mla=mla)
    lf = SimpleNamespace(camera=camera, alpha=lambda d: math.nan)
    planes = suitable_planes(lf)["disparities"]
    assert len(planes) > 70
    assert np.diff(planes).max() <= 1 / 70
    assert len(suitable_planes(lf, count=5)["disparities"]) == 5
