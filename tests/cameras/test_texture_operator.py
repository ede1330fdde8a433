"""Textures to raw images by rays: what cameras expose, with the exact transpose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera, ShapeError
from clplen.cameras import Plane, Sphere, Spot, SurfaceScene, Texture, TextureOperator, rectangle
from clplen.compute.device import Device


def texture(seed: int, *shape: int) -> Texture:
    return Texture(np.random.default_rng(seed).random(shape), 1.3, centre=(0.4, -1.2))


GREY, COLOUR = texture(1, 5, 7), texture(2, 4, 3, 3)
GROUND = Plane(-0.15, (0.03, -0.02), texture=GREY, shade=(0.02, -0.01))
SCENES: dict[str, Any] = {
    "plane": [GROUND],
    "one texture": [GROUND, Plane(0.1, texture=GREY, outline=rectangle((0.0, 0.0), (2.0, 1.5)))],
    "colours": [GROUND, Sphere((-0.3, 0.6), 0.7, disparity=0.1, height=0.2, texture=COLOUR)],
}


def operator_of(device: Device, scene: str, kind: str, lattice: str) -> TextureOperator:
    mla = MicrolensArray(150e-6, 10e-3, count=(3, 5), lattice=lattice)
    make = PlenopticCamera.type2 if kind == "focused" else PlenopticCamera.type1
    camera = make(
        focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=6.3, device=device,
        aperture_diameter=0.8e-3, **({"m": 0.25} if kind == "focused" else {}),
    )  # fmt: skip
    return TextureOperator(camera, SurfaceScene(SCENES[scene]))


@pytest.mark.parametrize(
    ("scene", "kind", "lattice"),
    [
        ("one texture", "standard", "square"),
        ("plane", "standard", "hexagonal"),
        ("colours", "focused", "square"),
    ],
)
def test_the_adjoint_is_the_transpose(device: Device, scene: str, kind: str, lattice: str) -> None:
    operator = operator_of(device, scene, kind, lattice)
    own = np.concatenate([one.samples.ravel() for one in operator.textures])
    image = operator.forward(own.reshape(operator.in_shape))
    expected = operator.camera.expose(operator.scene, model="rays").to_numpy()
    np.testing.assert_array_equal(image, expected)
    random = np.random.default_rng(3)
    x = random.random((2, *operator.in_shape)).astype(np.float32)
    images = operator.forward(x).astype(np.float64)
    y = (images + 0.3 * random.random(images.shape)).astype(np.float32)
    back = operator.adjoint(y).astype(np.float64)
    assert back.shape == x.shape
    for n in range(2):
        left, right = (images[n] * y[n]).sum(), (x[n] * back[n]).sum()
        assert left > 0
        assert abs(left - right) <= 1e-6 * left


def test_light_that_is_no_texture_does_not_count(device: Device) -> None:
    lamp = Spot((0.0, 0.0), 0.5, strength=3.0)
    camera = operator_of(device, "plane", "standard", "square").camera
    lit = Plane(0.1, texture=GREY, outline=rectangle((0.0, 0.0), (2.0, 1.5)), spots=[lamp])
    dark = Plane(0.1, texture=GREY, outline=rectangle((0.0, 0.0), (2.0, 1.5)))
    operator = TextureOperator(camera, SurfaceScene(lit, background=0.7))
    expected = camera.expose(SurfaceScene(dark), model="rays").to_numpy()
    np.testing.assert_array_equal(operator.forward(GREY.samples), expected)


def test_arguments(device: Device) -> None:
    operator = operator_of(device, "plane", "standard", "square")
    with pytest.raises(TypeError, match="scene must be a SurfaceScene"):
        TextureOperator(operator.camera, GROUND)  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="argument of this map must have shape"):
        operator.forward(np.ones((5, 7)))
