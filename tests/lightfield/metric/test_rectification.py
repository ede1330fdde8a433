"""Rectified views: beside a scene that is traced through the rectified camera itself."""

from __future__ import annotations

import numpy as np
import pytest
from checkerboards import KnownCamera, Pose, made_camera, photographed

from clplen import LightField, StoredLightField
from clplen.errors import ShapeError
from clplen.lightfield import Intrinsics, rectify_views

POSE = Pose(0.4, (15, -20, 10))
SHAPE = (3, 4, 81, 100)


def known(**words: object) -> KnownCamera:
    return made_camera(
        SHAPE,
        **({"steps": (2e-3, 2e-3), "converge": (-3e-3, -3.2e-3), "pitch": (5e-3, 4.8e-3)} | words),
    )


def of(camera: KnownCamera) -> Intrinsics:
    return Intrinsics(camera.matrix, np.array(camera.distortion), camera.shape)


def both(camera: KnownCamera) -> tuple[LightField, np.ndarray]:
    """The rectified views, and what the rectified camera would have seen."""
    words = {"board": (4, 6), "spacing": 0.02, "noise": 0.0, "blur": 1.2}
    flat = of(camera).rectified
    ideal = KnownCamera(flat.matrix, (0.0,) * 5, SHAPE)
    found = rectify_views(photographed(camera, POSE, **words), of(camera))
    return found, photographed(ideal, POSE, **words)


def inner(values: np.ndarray) -> np.ndarray:
    return values[:, :, 10:-10, 10:-10]


def test_views_are_those_of_the_rectified_camera():
    camera = known(centre=(0.02, -0.03), distortion=(0.01, 0.0, -0.3, 0.1, 0.0))
    found, wanted = both(camera)
    assert found.positions is None
    off = np.abs(inner(found.to_numpy() - wanted))
    assert off.max() < 0.02  # of .8 between black and white
    assert off.mean() < 2.5e-3  # the blur of the lens is that of other pixels
    raw = photographed(camera, POSE, (4, 6), 0.02, noise=0.0, blur=1.2)
    assert np.abs(inner(raw - wanted)).mean() > 0.04


def test_rays_between_views_are_interpolated():
    """Rows and columns of pixels meet 20 mm apart: rays at the rims are those of other views."""
    words = {"converge": (-4.9e-3, -4.9e-3)}
    camera = known(tilt=(0.01 * 5e-3, -0.01 * 4.8e-3), **words)
    found, wanted = both(camera)
    middle = np.s_[1, 1:3, 20:-20, 20:-20]
    off = np.abs(found.to_numpy() - wanted)[middle].mean()
    assert off < 4e-3
    raw = photographed(camera, POSE, (4, 6), 0.02, noise=0.0, blur=1.2)
    ignored = rectify_views(raw, of(known(**words))).to_numpy()
    assert np.abs(ignored - wanted)[middle].mean() > 3 * off


def test_unequal_steps_become_positions():
    found, _ = both(known(steps=(2e-3, 1.6e-3)))
    assert found.positions is not None
    np.testing.assert_allclose(found.positions[:, 0, 0], [-0.8, 0.0, 0.8])
    np.testing.assert_allclose(found.positions[0, :, 1], [-1.5, -0.5, 0.5, 1.5])


def test_types_colours_and_weights_are_kept():
    camera = of(known())
    random = np.random.default_rng(3)
    views = random.integers(0, 256, (*SHAPE, 3), np.uint8)
    weights = np.ones(SHAPE[:2])
    weights[0, 1] = 0
    found = rectify_views(LightField.from_array(views, weights=weights), camera)
    assert found.shape == (*SHAPE, 3)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found.weights, weights)
    single = rectify_views(views[..., 1].astype(np.float32), camera).to_numpy()
    kept = weights > 0
    off = np.abs(found.to_numpy()[..., 1][kept] - np.clip(np.rint(single), 0, 255)[kept])
    assert off.max() <= 1
    assert off.mean() < 0.01


def test_another_camera_is_refused():
    camera = of(known())
    with pytest.raises(ShapeError, match=r"of the intrinsics, \(3, 4, 81, 100\), got \(3, 4,"):
        rectify_views(np.ones((3, 4, 80, 100), np.float32), camera)
    placed = LightField.from_array(np.ones(SHAPE, np.float32), positions=np.zeros((3, 4, 2)))
    with pytest.raises(ValueError, match="these views have positions"):
        rectify_views(placed, camera)
    stored = StoredLightField.from_array(np.ones(SHAPE, np.float32))
    with pytest.raises(TypeError, match="is stored"):
        rectify_views(stored, camera)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="intrinsics must be an Intrinsics"):
        rectify_views(np.ones(SHAPE, np.float32), camera.matrix)  # type: ignore[arg-type]
