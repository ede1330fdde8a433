"""The demo's numbers are the same on every device, and on a CPU that PoCL does not know."""


import numpy as np
import pytest

from clplen import Device, LightField, PointSources, estimate_alpha
from clplen.demo import DEPTHS, SOURCE_DIAMETER, camera


@pytest.mark.thorough
def test_same_alphas_and_raw_images_on_every_device(device):
    first = Device.all()[0]
    reference = Device.open(f"{first.platform}") if device.platform != first.platform else None
    if reference is None:
        pytest.skip("the first device is the one that the others are compared with")
    for dz in (DEPTHS[0], DEPTHS[2]):
        raws = [
            camera(d).expose(PointSources((0, 0, dz), diameter=SOURCE_DIAMETER))
            for d in (reference, device)
        ]
        a, b = (raw.to_numpy() for raw in raws)
        assert np.abs(a - b).max() <= 1e-5 * a.max()
        alphas = [estimate_alpha(LightField.from_raw(raw)).alpha for raw in raws]
        assert alphas[0] == pytest.approx(alphas[1], abs=1e-4)
