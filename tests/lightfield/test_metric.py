"""Disparity to distance in metres."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.lightfield.depth.depth_maps import metric_depth
from clplen.wave.elements.lenslets import MicrolensArray

RIG = {"baseline": 0.05, "focal_length": 0.1, "pixel_pitch": 35e-3 / 512}


def test_the_form_of_the_benchmark():
    """d = (b f W/Z - b f W/Z0)/s with W pixels across a sensor of s (Honauer et al. 2016)."""
    Z = np.array([[6.5, 8.0], [10.0, 31.0]])
    d = (50 * 100 * 512 / (1e3 * Z) - 50 * 100 * 512 / (1e3 * 8)) / 35
    np.testing.assert_allclose(metric_depth(d, **RIG, focus_distance=8.0), Z, rtol=1e-12)


def test_at_infinity_and_behind_it():
    found = metric_depth([0.25, 0.0, -0.25, np.nan], **RIG)
    assert found[0] > 0
    assert found[1] == np.inf
    assert np.isnan(found[2:]).all()
    beyond = -RIG["baseline"] * RIG["focal_length"] / RIG["pixel_pitch"] / 4
    assert np.isnan(metric_depth(1.001 * beyond, **RIG, focus_distance=4.0))
    assert metric_depth(0.999 * beyond, **RIG, focus_distance=4.0) > 1e3
    assert metric_depth(0.0, **RIG, focus_distance=4.0) == pytest.approx(4)


def test_a_lens_with_microlenses_is_the_same(device):
    """(A3): 1/z = 1/f - alpha/F with alpha = 1 - d/kappa, against b = du, f = F, p = dx."""
    camera = PlenopticCamera.type1(
        focal_length=0.12,
        mla=MicrolensArray(150e-6, 10e-3, count=31),
        wavelength=532e-9,
        pixels_per_lenslet=30,
        object_distance=0.3,
        device=device,
    )
    kappa = camera.image_distance / (30 * 10e-3)
    d = np.linspace(-0.2, 0.4, 13)
    z = 0.3 + camera.dz(1 - d / kappa)
    found = metric_depth(
        d,
        baseline=kappa * 150e-6,
        focal_length=camera.image_distance,
        pixel_pitch=150e-6,
        focus_distance=0.3,
    )
    np.testing.assert_allclose(found, z, rtol=1e-4)


def test_lengths_are_positive():
    for name, value in (("baseline", 0), ("pixel_pitch", np.nan), ("focus_distance", -1)):
        with pytest.raises(ValueError, match=f"{name} must be positive and finite, in metres"):
            metric_depth([1.0], **(RIG | {name: value}))
