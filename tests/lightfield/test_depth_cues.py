"""What every depth cue does: accuracy, sign, confidence, kinds of light fields."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from reference_cues import plain_depth

from clplen.errors import DeviceError
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.stacks import focal_stack

pytestmark = pytest.mark.thorough

CUES = ("energy", "correspondence", "structure-tensor")
PLANES = np.linspace(-1.4, 1.4, 29)
cues = pytest.mark.parametrize("cue", CUES)


def inside(a: np.ndarray, margin: int = 12) -> np.ndarray:
    return a[margin:-margin, margin:-margin]


def texture(y: np.ndarray, x: np.ndarray, seed: int) -> np.ndarray:
    """A sum of waves of mean 0 and variance 1."""
    rng = np.random.default_rng(seed)
    f, g = rng.uniform(-0.2, 0.2, (2, 40))
    phase = 2 * np.pi * (np.multiply.outer(y, f) + np.multiply.outer(x, g))
    return np.cos(phase + rng.uniform(0, 2 * np.pi, 40)).sum(axis=-1) / np.sqrt(20)


@cache
def plain() -> dict[str, np.ndarray]:
    """Disparities of `layers` by the plain forms."""
    return plain_depth(layers()[0], PLANES)


def scene(d0, gy=0.0, gx=0.0, *, shape=(9, 9, 56, 64), places=None, noise=0.02, seed=0):
    """(views, disparity) of a textured plane d0 + gy y + gx x, and Gaussian noise."""
    V, U, ny, nx = shape
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx)[None, :] - (nx - 1) / 2
    views = np.empty(shape)
    for v, u in np.ndindex(V, U):
        a, b = (v - (V - 1) / 2, u - (U - 1) / 2) if places is None else places[v, u]
        d = (d0 + gy * y + gx * x) / (1 - gy * a - gx * b)  # of the point that is seen here
        views[v, u] = texture(y + d * a, x + d * b, seed)
    views = 1 + 0.2 * views + noise * np.random.default_rng(1).standard_normal(shape)
    return views, np.broadcast_to(d0 + gy * y + gx * x, (ny, nx))


@cache
def layers() -> tuple[np.ndarray, np.ndarray]:
    """A near half-plane before a far one, contrast rising downwards, noise."""
    ny, nx = 70, 84
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx)[None, :] - (nx - 1) / 2
    views = np.empty((7, 7, ny, nx))
    for v, u in np.ndindex(7, 7):
        both = []
        for seed, d in enumerate((-0.6, 0.8)):
            Y, X = y + d * (v - 3), x + d * (u - 3)
            both.append(1 + 0.3 * np.clip(Y / ny + 0.5, 0, 1) * texture(Y, X, seed))
        views[v, u] = np.where(x + 0.8 * (u - 3) > 6, both[1], both[0])
    views += 0.02 * np.random.default_rng(2).standard_normal(views.shape)
    return views, np.broadcast_to(np.where(x > 6, 0.8, -0.6), (ny, nx))


@cues
def test_slanted_plane(device, cue):
    views, truth = scene(0.2, -0.004, 0.008)
    found = depth_map(LightField.from_array(views, device=device), disparities=PLANES, cue=cue)
    assert (inside(np.abs(found.disparity - truth)) > 0.07).mean() < 0.01


@cues
def test_not_worse_than_its_plain_form(device, cue):
    views, truth = layers()
    lf = LightField.from_array(views, device=device)
    found = depth_map(lf, disparities=PLANES, cue=cue).disparity
    error = {name: inside(np.abs(a - truth)) for name, a in plain().items()}
    ours = inside(np.abs(found - truth))
    if cue in error:
        assert (ours > 0.07).mean() <= (error[cue] > 0.07).mean() + 0.002
        assert np.median(ours) <= np.median(error[cue]) + 5e-4
    else:
        assert (ours > 0.07).mean() < 0.1


@cues
def test_confidence_ranks(device, cue):
    views, truth = layers()
    found = depth_map(LightField.from_array(views, device=device), disparities=PLANES, cue=cue)
    bad = inside(np.abs(found.disparity - truth) > 0.07).ravel()
    order = np.argsort(-inside(found.confidence).ravel(), kind="stable")
    assert found.confidence.min() >= 0
    assert found.confidence.max() <= 1
    surer = np.array_split(bad[order], 2)[0]
    assert bad.mean() > 0.003
    assert surer.mean() < 0.4 * bad.mean()


@cues
def test_no_texture_no_confidence(device, cue):
    for value, dtype in ((0.3, np.float32), (0, np.float32), (255, np.uint8)):
        views = np.full((5, 5, 30, 40), value, dtype)
        lf = LightField.from_array(views, device=device)
        found = depth_map(lf, disparities=[-0.5, 0.1, 0.7], cue=cue)
        assert not found.confidence.any()
        assert (found.disparity == np.float32(0.1)).all()  # nearest to the focus as recorded


@cues
def test_saturated_views_are_not_sure(device, cue):
    """Bright and flat beside texture: every plane agrees as well until the texture is reached."""
    views, _ = scene(0.4, shape=(5, 5, 40, 90), noise=0)
    views[..., :45] = 1.9
    levels = np.clip(130 * views, 0, 255).astype(np.uint8)
    levels[..., :45] = 255
    lf = LightField.from_array(levels, device=device)
    found = depth_map(lf, disparities=PLANES, cue=cue)
    # no window and no shift, 16 + 8 + 1 and 2 x 1.4 pixels at most, reaches from the texture
    assert not found.confidence[:, :15].any()


@cues
@pytest.mark.parametrize(("dtype", "views_of"), [(np.uint8, (5, 6)), (np.uint16, (1, 7))])
def test_kinds_of_light_fields(device, cue, dtype, views_of):
    """Integers, V != U, even counts, one row or one column of views; colours; a missing view."""
    d = 0.45
    views, _ = scene(d, shape=(*views_of, 50, 60), noise=0)
    levels = np.rint((60 if dtype == np.uint8 else 15000) * views).astype(dtype)
    weights = np.random.default_rng(3).uniform(0.5, 1.5, views_of)
    weights.ravel()[-1] = 0
    levels[-1, -1] = np.random.default_rng(4).integers(0, 250, (50, 60))
    colours = np.stack([levels, levels // 2], axis=-1)
    for samples in (levels, colours) if dtype == np.uint8 else (levels,):
        lf = LightField.from_array(samples, device=device, weights=weights)
        found = depth_map(lf, disparities=PLANES, cue=cue)
        assert np.median(np.abs(inside(found.disparity) - d)) < 0.02
        assert np.median(inside(found.confidence)) > 0.3


@cues
def test_views_on_no_grid(device, cue):
    v, u = np.meshgrid(np.arange(-3.0, 4), np.arange(-3.0, 4), indexing="ij")
    places = np.stack((v, u), axis=-1) + np.random.default_rng(5).uniform(-0.25, 0.25, (7, 7, 2))
    views, _ = scene(0.6, shape=(7, 7, 50, 60), places=places, noise=0)
    lf = LightField.from_array(views, device=device, positions=places)
    found = depth_map(lf, disparities=PLANES, cue=cue)
    assert np.median(np.abs(inside(found.disparity) - 0.6)) < 0.02
    on_a_grid = depth_map(LightField.from_array(views, device=device), disparities=PLANES, cue=cue)
    assert np.median(np.abs(inside(on_a_grid.disparity) - 0.6)) > 2 * np.median(
        np.abs(inside(found.disparity) - 0.6)
    )


def test_one_view_tells_nothing(device):
    views, _ = scene(0.4, shape=(1, 1, 30, 40))
    for cue in CUES:
        found = depth_map(LightField.from_array(views, device=device), disparities=PLANES, cue=cue)
        assert not found.confidence.any()


def test_a_stack_has_no_views_to_compare(device):
    views, _ = scene(0.4, shape=(3, 3, 20, 24))
    stack = focal_stack(LightField.from_array(views, device=device), disparities=[0, 1, 2])
    with pytest.raises(ValueError, match=r"combined.*focal stack.*cue='energy'"):
        depth_map(stack, cue="combined")


def test_default_cue(device):
    views, _ = scene(0.4, shape=(5, 5, 40, 48))
    lf = LightField.from_array(views, device=device)
    planes = np.linspace(-0.2, 1, 7)
    for source, cue, given in (
        (lf, "combined", {"disparities": planes}),
        (focal_stack(lf, disparities=planes), "energy", {}),
    ):
        found, named = depth_map(source, **given), depth_map(source, cue=cue, **given)
        np.testing.assert_array_equal(found.disparity, named.disparity)


@pytest.mark.parametrize("cue", ["correspondence", "structure-tensor"])
def test_too_little_memory(device, monkeypatch, cue):
    views, _ = scene(0.2, shape=(3, 3, 40, 50))
    lf = LightField.from_array(views.astype(np.float32), device=device)
    maps = {"correspondence": 8 + 7 + 2 * 8, "structure-tensor": 9 + 6}[cue]
    needed = 4 * 40 * 50 * maps + lf.data.nbytes
    monkeypatch.setattr(device, "memory_bytes", needed)
    assert depth_map(lf, disparities=np.linspace(-1, 1, 40), cue=cue).disparity.shape == (40, 50)
    monkeypatch.setattr(device, "memory_bytes", needed - 1)
    with pytest.raises(DeviceError, match=f"depth map.* {needed:,} bytes"):
        depth_map(lf, disparities=PLANES, cue=cue)
