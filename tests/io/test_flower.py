"""A light field of a real camera: its view axes can be told from its sharpness."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clplen.compute.device import Device
from clplen.io import read_lightfield
from clplen.lightfield.depth.depth_maps import sharpness_curve
from clplen.lightfield.stacks import focal_stack

PLANES = np.linspace(-2, 2, 33)


def curve(folder: Path, device: Device, **layout: bool) -> np.ndarray:
    lf = read_lightfield(
        folder / "lytro_f01_flower", device=device, pattern="IMG_0001_{n}_{u}_{v}.png", **layout
    )
    assert lf.shape == (10, 10, 256, 256, 3)
    return sharpness_curve(focal_stack(lf, disparities=PLANES))


@pytest.mark.thorough
def test_wrong_view_axes_lower_the_peak_threefold(data_folder: Path, device: Device):
    right = curve(data_folder, device)
    assert PLANES[right.argmax()] == pytest.approx(-0.65, abs=0.1)
    for wrong in ({"swap_uv": True}, {"flip_v": True}, {"flip_u": True}):
        assert curve(data_folder, device, **wrong).max() < right.max() / 3, wrong
