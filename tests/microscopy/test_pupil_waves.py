"""Derivatives of point images by the pupil and by places against central differences in double."""

from dataclasses import replace

import numpy as np
import pytest

from clplen import Device, MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import PupilAberration
from clplen.microscopy.pupil.pupil_waves import PupilWaves

TERMS = {5: 40e-9, 8: -35e-9, 11: 20e-9}
POINTS = np.array([[1.3e-6, -0.7e-6, 9e-6], [-2.1e-6, 1.1e-6, -6e-6]])
NAMES = (4, 6, 7, 9, 11, 13, "x", "y", "z")


@pytest.fixture(scope="module")
def waves():
    device = Device.open("pocl", precision="double")
    camera = PlenopticCamera.microscope(
        magnification=20, na=0.3, wavelength=600e-9, pixels_per_lenslet=15, pupil=TERMS,
        mla=MicrolensArray(120e-6, 4e-3, count=9, fill="full"), device=device,
    )  # fmt: skip
    return PupilWaves.of(camera, 9e-6, binning=3, margin=4)


def moved(waves, points, name, step):
    """Images with one number changed."""
    if name in ("x", "y", "z"):
        there = points.copy()
        there[:, "xyz".index(name)] += step
        return waves.tangents(PointSources(there), ())[0]
    known = waves.camera.pupil.coefficients
    pupil = PupilAberration(known | {name: known.get(name, 0.0) + step})
    other = replace(waves, camera=replace(waves.camera, pupil=pupil))
    return other.tangents(PointSources(points), ())[0]


def test_tangents(waves):
    _, tangents = waves.tangents(PointSources(POINTS), NAMES)
    for name, found in zip(NAMES, tangents, strict=True):
        step = 2e-11
        slope = (moved(waves, POINTS, name, step) - moved(waves, POINTS, name, -step)) / (2 * step)
        assert np.abs(found - slope).max() < 1e-6 * np.abs(slope).max()
