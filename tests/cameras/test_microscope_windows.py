"""Windows of points before a light-field microscope, and its pixels that integrate."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import PixelArray
from clplen.compute.device import Device


def microscope(device: Device, across: int, **change: Any) -> Any:
    mla = MicrolensArray(125e-6, 2.5e-3, count=(9, 7), fill="full")
    values: dict[str, Any] = {"magnification": 40, "na": 0.95, "wavelength": 520e-9, "mla": mla}
    return PlenopticCamera.microscope(pixels_per_lenslet=across, device=device, **(values | change))


def test_pixels_integrate(device: Device) -> None:
    """Against pixels a fifth as wide that take the intensity in their middle, binned."""
    scene = PointSources((4e-6, -7e-6, 6e-6))
    got = microscope(device, 9, pixels=PixelArray()).expose(scene)
    fine = microscope(device, 81).expose(scene).to_numpy().astype(np.float64)
    expected = fine.reshape(81, 9, 63, 9).sum(axis=(1, 3))
    assert got.exposure is not None
    assert got.exposure.route == "local"
    assert np.linalg.norm(got.to_numpy() - expected) <= 0.01 * np.linalg.norm(expected)
