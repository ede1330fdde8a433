"""Every camera says its kind, and is a `PlenopticCamera`."""

from __future__ import annotations

import pytest

from clplen import Device, MicrolensArray, PlenopticCamera

LENSLETS = MicrolensArray(150e-6, 10e-3, count=25)


@pytest.mark.parametrize("kind", ["standard", "focused", "microscope"])
def test_every_camera_is_a_plenoptic_camera_and_says_its_kind(device: Device, kind: str) -> None:
    shared = {"mla": LENSLETS, "wavelength": 532e-9, "pixels_per_lenslet": 30, "device": device}
    camera: PlenopticCamera = {
        "standard": lambda: PlenopticCamera.type1(focal_length=0.12, **shared),
        "focused": lambda: PlenopticCamera.type2(focal_length=0.12, m=0.3, **shared),
        "microscope": lambda: PlenopticCamera.microscope(magnification=20, na=0.15, **shared),
    }[kind]()
    assert isinstance(camera, PlenopticCamera)
    assert camera.kind == kind
    assert not isinstance(LENSLETS, PlenopticCamera)


def test_a_camera_is_made_by_its_kind() -> None:
    with pytest.raises(TypeError, match="type1"):
        PlenopticCamera()
