"""Pictures of several samples through the camera: the rendering's place, blur, and parallax."""

from __future__ import annotations

import numpy as np
import pytest

from clplen import LightField, MicrolensArray, PlenopticCamera
from clplen.cameras.scenes.scene_sources import PicturePlane

PITCH, COUNT = 150e-6, 25


def small(device, pixels=12):
    mla = MicrolensArray(PITCH, 10e-3, count=COUNT, fill="full")
    return PlenopticCamera.type1(
        focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=pixels, device=device
    )


@pytest.mark.parametrize("axis", [0, 1], ids=["top and bottom", "left and right"])
def test_nearer_pictures_move_more_between_the_views(device, axis):
    camera = small(device, pixels=14)
    # a line along the axis, finer than the lenslets, to which the light of few points would snap
    line = np.linspace(1, 0.6, 9)
    depths, places = (-30e-3, 30e-3), (-4, 4)  # lenslets from the axis, across the line
    planes = []
    for dz, place in zip(depths, places, strict=True):
        image = np.zeros((21, 21))
        image[10 - 2 * place, 6:15] = line  # half a lenslet a sample; the lens inverts
        image = image if axis == 1 else image.T
        scale = (camera.object_distance + dz) / camera.image_distance
        planes.append(PicturePlane(image, 10.5 * PITCH * scale, dz))
    lf = LightField.from_raw(camera.expose(planes))
    middle, ends = (lf.shape[0] - 1) / 2, (4, 9)
    views = [
        lf.view(*((n, middle) if axis == 0 else (middle, n))).to_numpy().astype(float) ** 2
        for n in ends
    ]
    for dz, place in zip(depths, places, strict=True):
        half = slice(0, COUNT // 2) if place < 0 else slice(COUNT // 2 + 1, COUNT)
        lines = [np.moveaxis(view, axis, 0)[:, half].sum(axis=1) for view in views]
        first, last = (np.average(np.arange(COUNT), weights=line) for line in lines)
        # u on the lens falls along the pixels: views 4 to 9 go down by 5 of 128.6 um, and
        # a ray from u meets the array at X + u (1 - alpha); diffraction flattens it by some 10 %
        step = camera.pixel_pitch * camera.image_distance / camera.mla.f
        expected = 5 * step * (1 - camera.alpha(dz)) / PITCH
        assert np.sign(expected) == -np.sign(dz)
        assert first - last == pytest.approx(expected, rel=0.25)
