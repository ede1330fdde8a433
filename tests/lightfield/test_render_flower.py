"""Rendering a real capture: what is sharper than what, measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clplen.compute.device import Device
from clplen.io import read_lightfield
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

D = -0.65  # where the scene is sharpest


def detail(picture: np.ndarray) -> float:
    """Mean square of the luma's detail, without a border."""
    luma = picture @ [0.2126, 0.7152, 0.0722]
    return float(((luma - gaussian_filter(luma, 2)) ** 2)[15:-15, 15:-15].mean())


@pytest.fixture
def flower(data_folder: Path, device: Device) -> LightField:
    folder = data_folder / "lytro_f01_flower"
    return read_lightfield(folder, device=device, pattern="IMG_0001_{n}_{u}_{v}.png")


def test_interpolations(flower: LightField):
    linear, cubic, fourier = (
        detail(refocus(flower, disparity=D, interpolation=name).to_numpy())
        for name in ("linear", "cubic", "fourier")
    )
    assert linear < 0.9 * cubic < cubic < fourier
