"""rays.cl against rays through every lenslet in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import reference_scene as reference

from clplen import MicrolensArray, PlenopticCamera, SurfaceScene
from clplen.cameras import Plane, Sphere, Texture, TextureOperator
from clplen.cameras.exposure.surface_rays import RAYS_PER_PIXEL, sample_rays
from clplen.cameras.scenes.surfaces import Ellipse
from clplen.compute.device import Device
from clplen.compute.drivers import selection

RANDOM = np.random.default_rng(8)
TEXTURE = Texture(RANDOM.random((5, 4)), 1.3, centre=(0.4, -0.2))
COLOUR = Texture(RANDOM.random((3, 3, 3)))
SCENE = SurfaceScene(
    [
        Plane(-0.15, (0.03, -0.02), texture=TEXTURE, outline=Ellipse((0.1, 0.2), (1.2, 1.6))),
        Sphere((-0.3, 0.6), 0.7, disparity=0.1, height=0.2, texture=COLOUR),
    ],
    background=0.2,
)


@pytest.fixture(autouse=True)
def loops_run_to_their_end(device: Device, mapping: str, request: pytest.FixtureRequest) -> None:
    """All rays of a row are too many for a work-item of llvmpipe, which owns a sample by itself."""
    if mapping == "row" and selection.loops_are_cut(device.cl_device):
        reason = "llvmpipe ends the loops of a work-item after 65535 iterations"
        request.applymarker(pytest.mark.xfail(reason=reason, strict=True))


@pytest.mark.parametrize(
    "words",
    [
        {"lattice": "hexagonal", "fill": "full", "rotation": 0.07, "offset": (2e-5, -3e-5)},
        {"fill": "circular", "diameter": 1.2e-4, "rotation": -0.1, "field_lens": True},
    ],
)
def test_a_raw_image_is_that_of_all_rays(words: Any, device: Device) -> None:
    field_lens = words.get("field_lens", False)
    lattice = {name: value for name, value in words.items() if name != "field_lens"}
    mla = MicrolensArray(150e-6, 10e-3, count=(3, 2), **lattice)
    camera = PlenopticCamera.type1(
        focal_length=0.01, mla=mla, wavelength=700e-9, pixels_per_lenslet=6.3, device=device,
        field_lens=field_lens, aperture_diameter=0.26e-3,
    )  # fmt: skip
    check(camera)


@pytest.mark.parametrize(
    ("f", "words"),
    [
        ((10e-3, 12e-3), {"m": -0.4, "fill": "full", "offset": (2e-5, -3e-5)}),
        ((10e-3, 8e-3, 13e-3), {"m": 0.9, "lattice": "hexagonal", "rotation": -0.2}),
    ],
)
def test_a_focused_raw_image_is_that_of_all_rays(f: Any, words: Any, device: Device) -> None:
    mla = MicrolensArray(
        150e-6, f, count=(3, 4), **{name: value for name, value in words.items() if name != "m"}
    )
    check(
        PlenopticCamera.type2(
            focal_length=0.05, mla=mla, wavelength=700e-9, pixels_per_lenslet=6.3, device=device,
            aperture_diameter=0.4e-3, m=words["m"],
        )
    )  # fmt: skip


def check(camera: Any) -> None:
    mla = camera.mla
    raw = camera.expose(SCENE, model="rays").to_numpy()
    assert raw.max() > 0.04
    samples = sample_rays(mla, count=RAYS_PER_PIXEL).astype(np.float64)
    expected = reference.camera_image(camera, SCENE, samples)
    error = np.abs(raw - expected)
    # float32 turns 1e-6 of a lenslet into 1e-6 of brightness; of 40 000 rays on rims a few fall on
    # the other side, each a 64th of a pixel.
    assert np.sort(error.ravel())[-8] < 1e-5
    assert error.max() < 1.5 / 64


def test_the_adjoint_is_the_transpose(device: Device) -> None:
    mla = MicrolensArray(150e-6, 10e-3, count=(2, 3), lattice="hexagonal")
    camera = PlenopticCamera.type1(
        focal_length=0.01, mla=mla, wavelength=700e-9, pixels_per_lenslet=6.3, device=device,
        aperture_diameter=0.26e-3,
    )  # fmt: skip
    operator = TextureOperator(camera, SCENE)
    random = np.random.default_rng(9)
    x, y = (random.random(s).astype(np.float32) for s in (operator.in_shape, operator.out_shape))
    image, back = operator.forward(x), operator.adjoint(y)
    left, right = (float((p * q.astype(float)).sum()) for p, q in ((image, y), (x, back)))
    assert left > 0
    assert abs(left - right) <= 1e-6 * left
