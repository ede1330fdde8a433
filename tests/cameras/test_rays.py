"""A plenoptic 1.0 camera by rays: truth, occlusion, energy, and how far waves are from it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from clplen import (
    Coherence,
    LightField,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SurfaceScene,
)
from clplen.cameras import Plane
from clplen.cameras.exposure.surface_rays import sample_rays
from clplen.cameras.scenes.textures import noise, uniform
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device

SMOOTH = noise(3, 64, finest=0.12, coarsest=0.03)


def camera_of(device: Device, count: Any = 31, pixels: float = 10, **words: Any) -> Plenoptic1:
    """f = 120 mm in 2f-2f with lenslets of 150 um and 10 mm, D = 3.6 mm."""
    field_lens = words.pop("field_lens", False)
    mla = MicrolensArray(150e-6, 10e-3, count=count, **({"fill": "full"} | words))
    return PlenopticCamera.type1(
        focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=pixels, device=device,
        field_lens=field_lens,
    )  # fmt: skip


def inner_views(lf: LightField) -> list[tuple[int, int]]:
    """Views that the rim of the main lens does not cut."""
    V, U = lf.weights.shape
    return [
        (v, u)
        for v, u in np.ndindex(V, U)
        if np.hypot(v - (V - 1) / 2, u - (U - 1) / 2) < V / 2 - 1.7
    ]


def spread(lf: LightField, disparity: Any) -> float:
    """Median standard deviation of the views along a disparity."""
    L, (V, U) = lf.to_numpy().astype(np.float64), lf.weights.shape
    assert lf.spacing is not None
    rows = (lf.spacing[0] / lf.spacing[2]) / (lf.spacing[1] / lf.spacing[3])
    y, x = np.indices(disparity.shape)
    seen = [
        map_coordinates(
            L[v, u],
            [y - disparity * rows * (v - (V - 1) / 2), x - disparity * (u - (U - 1) / 2)],
            order=3,
        )
        for v, u in inner_views(lf)
    ]
    return float(np.median(np.std(seen, axis=0)[7:-7, 7:-7]))


@pytest.mark.parametrize(
    "words",
    [
        pytest.param({"field_lens": True}, marks=pytest.mark.thorough),
        {"rotation": 0.05, "pixels": 9.4},
        {"lattice": "hexagonal"},
    ],
)
def test_the_light_field_obeys_its_truth(words: Any, device: Device) -> None:
    camera = camera_of(device, **words)
    scene = SurfaceScene(Plane(0.1, (0.012, 0.005), texture=SMOOTH))
    raw = camera.expose(scene, model="rays")
    lf, truth = LightField.from_raw(raw), raw.truth
    assert truth is not None
    assert truth.disparity.shape == lf.shape[2:]
    # rays through a lenslet blur all views alike; cubic interpolation of a band below 0.12 is left
    assert spread(lf, truth.disparity) < 3e-4
    assert spread(lf, -truth.disparity) > 5e-3
    alpha = lf.alpha(truth.disparity)
    np.testing.assert_allclose(truth.z, camera.dz(alpha), rtol=1e-4, atol=1e-7)
    clear = np.abs(truth.disparity) > 1e-3
    assert ((truth.z < 0) == (truth.disparity > 0))[clear].all()


def test_white_is_one_within_the_main_lens(device: Device) -> None:
    raw = camera_of(device, 31, 12).expose(
        SurfaceScene(Plane(0.2, texture=uniform(1.0))), model="rays"
    )
    lf = LightField.from_raw(raw).to_numpy()[:, :, 10:-10, 10:-10]
    assert lf[5:7, 5:7] == pytest.approx(1, abs=1e-5)
    assert lf[0, 0].max() < 0.01
    # the main lens' disc, as wide as a lenslet, in 6 x 6 sub-images of 12.5 pixels
    assert raw.to_numpy()[149:224, 149:224].mean() == pytest.approx(
        math.pi / 4 / (1 + 10 / 240) ** 2, rel=0.02
    )


def centroid(picture: Any) -> Any:
    """Of squares, (y, x)."""
    weight = np.asarray(picture, np.float64) ** 2
    y, x = np.indices(weight.shape)
    return np.array([(weight * y).sum(), (weight * x).sum()]) / weight.sum()


def test_a_point_moves_through_the_views(device: Device) -> None:
    for dz in [-0.04, 0.06]:
        camera = camera_of(device, 41)
        x0, y0 = 3e-4, -2e-4
        raw = camera.expose(PointSources([(x0, y0, dz)], power=2.5), model="rays")
        assert raw.to_numpy().sum() == pytest.approx(2.5, rel=1e-6)
        lf = LightField.from_raw(raw)
        X, Y = camera.image_of([(x0, y0, dz)])[0] / 150e-6 + 20
        d = float(lf.disparity(camera.alpha(dz)))
        for v, u in ((3, 4), (5, 6), (6, 3)):
            expected = (Y - d * (v - 4.5), X - d * (u - 4.5))
            # a lenslet catches the light of one point; half of one is the most that it may be off
            assert centroid(lf.to_numpy()[v, u]) == pytest.approx(expected, abs=0.5), (v, u)
        at_focus = camera.expose(PointSources([(x0, y0, 0)]), model="rays").to_numpy()
        lit = np.argwhere(at_focus > 0)
        assert np.ptp(lit, axis=0).max() <= 10  # one sub-image


def test_waves_and_rays_put_the_light_in_the_same_place(device: Device) -> None:
    camera = camera_of(device, 31, 12)
    for scene in (
        PointSources([(2e-4, 3e-4, -0.03)], diameter=1e-5),
        PicturePlane([[1, 0, 2], [0, 3, 0]], 6e-4, -0.03),
    ):
        waves, rays = (camera.expose(scene, model=model) for model in ("waves", "rays"))
        assert rays.to_numpy().sum() == pytest.approx(waves.to_numpy().sum(), rel=3e-3)
        one, two = (LightField.from_raw(raw).render().to_numpy() for raw in (waves, rays))
        assert centroid(one) == pytest.approx(centroid(two), abs=0.1)
        assert np.corrcoef(one.ravel(), two.ravel())[0, 1] > 0.9


def test_lenslets_pass_their_share_of_the_light(device: Device) -> None:
    for words, fill in [
        ({"lattice": "hexagonal", "fill": "circular"}, math.pi / (2 * math.sqrt(3))),
        ({"fill": "circular", "diameter": 120e-6}, math.pi / 4 * 0.8**2),
        ({"diameter": 100e-6, "rotation": -0.3}, 4 / 9),
        ({"lattice": "hexagonal", "diameter": 75e-6}, 0.25),
    ]:
        camera = camera_of(device, 41, **words)
        raw = camera.expose(
            PointSources([(1e-4, 2e-4, 0.15)]), model="rays"
        )  # blurred over 7 lenslets
        assert raw.to_numpy().sum() == pytest.approx(fill, rel=0.03)
        samples = sample_rays(camera.mla, count=64)
        np.testing.assert_array_equal(samples[:32], -samples[32:])
        cos, sin = math.cos(camera.mla.rotation), math.sin(camera.mla.rotation)
        in_pixel = samples[:, 2:] @ [
            [cos, -sin],
            [sin, cos],
        ]  # from the lattice's axes to the sensor's
        assert 0.45 < np.abs(in_pixel).max() < 0.5 + 1e-6
        assert len(np.unique(samples, axis=0)) == 64


def test_bad_input_gets_one_sentence(device: Device) -> None:
    for scene, words, error, says in [
        (SurfaceScene(Plane(0)), {}, ValueError, "must be 'rays' for a SurfaceScene"),
        (PointSources([0, 0, 0]), {"model": "beams"}, ValueError, "'waves' or 'rays'"),
        (SurfaceScene(Plane(0)), {"coherence": Coherence()}, ValueError, "require model='waves'"),
        (SurfaceScene(Plane(0)), {"snapshots": 3}, ValueError, "require model='waves'"),
        (SurfaceScene(Plane(0, (0.2, 0.1))), {}, ValueError, "edge-on"),
        (PicturePlane([[1.0]], 1e-4, mode="transmission"), {}, ValueError, "require model='waves'"),
        (PointSources([0, 0, -1]), {}, ValueError, "behind the main lens"),
        ("a vase", {}, TypeError, "got str"),
    ]:
        model = {} if "for a SurfaceScene" in says else {"model": "rays"}
        with pytest.raises(error, match=says):
            camera_of(device, 25, 9).expose(scene, **(model | words))
