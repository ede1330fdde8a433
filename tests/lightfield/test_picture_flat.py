"""Vignetting of sub-images from the picture itself, against what was put in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference_mosaics as mosaics

from clplen.lightfield.calibration.picture_flat import flat_of_picture

ARRAY = replace(mosaics.ARRAYS["hexagonal"], shape=(423, 467))


@pytest.mark.thorough
def test_vignetting_of_a_picture():
    array = ARRAY
    raw, _ = mosaics.captured(array, mosaics.edges(array))
    dark = np.full(array.shape, mosaics.BLACK, np.float32)
    lattice = mosaics.lattice_of(array)
    found = flat_of_picture(raw, lattice, dark=dark, bayer=array.bayer) - dark
    y, x = np.mgrid[: array.shape[0], : array.shape[1]].astype(float)
    r = np.hypot(*array.true.nearest(y, x)[2:]) / array.pitch
    # the fall over the sensor is not known from a picture
    square = ((y / (array.shape[0] - 1) - 0.5) ** 2 + (x / (array.shape[1] - 1) - 0.5) ** 2) / 0.5
    even = mosaics.vignetting(array) / (1 - 0.3 * square)
    inside = (r < 0.42) & (np.minimum(y, array.shape[0] - 1 - y) > 20)
    inside &= np.minimum(x, array.shape[1] - 1 - x) > 20
    error = found[inside] / even[inside]
    assert error.std() / error.mean() < 0.035
    assert even[inside].std() / even[inside].mean() > 0.08
    rim = (r > 0.55) & (found > 0)
    assert np.median(found[rim]) < 0.1 * np.median(found[r < 0.2])


def test_a_dark_picture_tells_nothing():
    array = ARRAY
    dark = np.full(array.shape, 64, np.uint16)
    noise = np.random.default_rng(2).integers(60, 69, array.shape).astype(np.uint16)
    lattice = mosaics.lattice_of(array)
    assert flat_of_picture(noise, lattice, dark=dark, bayer=array.bayer) is None
