"""Windows of points before a light-field microscope, and its pixels that integrate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera, PointSources
from clplen.cameras import PixelArray
from clplen.compute.device import Device


def microscope(device: Device, across: int, **change: Any) -> Any:
    mla = MicrolensArray(125e-6, 2.5e-3, count=(13, 11), fill="full")
    values: dict[str, Any] = {"magnification": 40, "na": 0.95, "wavelength": 520e-9, "mla": mla}
    return PlenopticCamera.microscope(pixels_per_lenslet=across, device=device, **(values | change))


@pytest.mark.parametrize(
    "place",
    [
        (0, 0, 0),
        (4e-6, -7e-6, 6e-6),
        pytest.param((-2e-6, 1e-6, -9e-6), marks=pytest.mark.nightly),
    ],
)
def test_pixels_integrate(device: Device, place: Any) -> None:
    """Against pixels a fifth as wide that take the intensity in their middle, binned."""
    scene = PointSources(place)
    got = microscope(device, 9, pixels=PixelArray()).expose(scene)
    fine = microscope(device, 81).expose(scene).to_numpy().astype(np.float64)
    expected = fine.reshape(117, 9, 99, 9).sum(axis=(1, 3))
    assert got.exposure is not None
    assert got.exposure.route == "local"
    assert np.linalg.norm(got.to_numpy() - expected) <= 0.01 * np.linalg.norm(expected)


@pytest.mark.thorough
def test_beads_of_many_depths_add_up(device: Device) -> None:
    places, power = [(0, 0, 3e-6), (5e-6, 0, -4e-6), (0, 4e-6, 3e-6)], [1.0, 0.5, 2.0]
    camera = microscope(device, 9, pixels=PixelArray(fill_factor=0.6))
    together = camera.expose(PointSources(places, power=power)).to_numpy()
    apart = sum(
        camera.expose(PointSources(place, power=each)).to_numpy()
        for place, each in zip(places, power, strict=True)
    )
    np.testing.assert_allclose(together, apart, atol=1e-6 * together.max())
