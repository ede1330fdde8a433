"""Fourier slices against (D3), their edges, and the hyperfan's range of depths."""

from __future__ import annotations

import numpy as np
import pytest
from reference_lightfield import refocus as twin_refocus

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.fourier_slice import fourier_stack
from clplen.lightfield.refocusing.hyperfan_filter import hyperfan

D = (-1.3, -0.65, 0.4, 1.0)


def smooth_texture(seed: int):
    """Waves of 0.1 to 0.2 cycles a pixel, at real places."""
    random = np.random.default_rng(seed)
    waves = []
    for _ in range(12):
        turn, cycles = random.uniform(0, 2 * np.pi), random.uniform(0.1, 0.2)
        waves.append(((cycles * np.sin(turn), cycles * np.cos(turn)), random.uniform(0, 6)))

    def at(y, x):
        return 100 + sum(
            5 * np.cos(2 * np.pi * (fy * y + fx * x) + phase) for (fy, fx), phase in waves
        )

    return at


def plane(views, size, d, seed=1) -> np.ndarray:
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    at = smooth_texture(seed)
    return at(y + d * v[:, None, None, None], x + d * u[None, :, None, None])


@pytest.mark.parametrize("views", [(5, 4)])
def test_slices_are_refocused_pictures_inside_the_edges(device, views):
    """Against (D3): within the blur of linear interpolation, up to half the aperture times d."""
    a = plane(views, (38, 45), 0.4)
    lf = LightField.from_array(a.astype(np.float32), device=device)
    got = fourier_stack(lf, disparities=D).to_numpy()
    margin = 8  # the largest shift is 1.3 x 3 pixels, and the sinc of the edge rings beyond it
    inside = (slice(margin, -margin),) * 2
    for picture, d in zip(got, D, strict=True):
        want = twin_refocus(a, d)
        # Linear interpolation loses up to 1 - cos(2 pi 0.15 / 2) = 11 % of the finest waves (5 of
        # 100 each, 12 of them); the step at the periodic edge rings as 1/distance.
        assert np.abs(picture - want)[inside].max() < 0.05 * np.abs(want).max()
    sharp = [picture[inside].std() for picture in got]
    assert np.argmax(sharp) == D.index(0.4)


def test_every_plane_of_a_periodic_scene_is_exact(device):
    """A wave with whole periods in the picture: no edge; the plane at its own d is the texture."""
    v, u = np.arange(4) - 1.5, np.arange(5) - 2.0
    y, x = np.mgrid[:24, :30].astype(float)

    def at(y, x):
        return 100 + 50 * np.sin(2 * np.pi * (5 * x / 30 + 3 * y / 24))

    a = at(y + 0.7 * v[:, None, None, None], x + 0.7 * u[None, :, None, None])
    lf = LightField.from_array(a.astype(np.float32), device=device)
    for width, error in ((4, 2e-3), (6, 1e-4), (8, 1e-5)):
        got = fourier_stack(lf, disparities=[0.7], width=width).to_numpy()[0]
        assert np.abs(got - at(y, x)).max() <= error * 150


def test_bad_slices_are_refused(device):
    a = plane((2, 3), (5, 7), 0.0).astype(np.float32)
    lf = LightField.from_array(a, device=device)
    for width in (1, 13, 2.5):
        with pytest.raises(ValueError, match="2 to 12 samples"):
            fourier_stack(lf, disparities=[0.0], width=width)
    scattered = LightField.from_array(a, device=device, positions=np.zeros((2, 3, 2)))
    with pytest.raises(ValueError, match="needs views on a regular grid"):
        fourier_stack(scattered, disparities=[0.0])
    with pytest.raises(ValueError, match="needs views on a regular grid"):
        hyperfan(scattered, 0, 1)
    for ends, bandwidth in (((1, 0), 0.05), ((0, 2), 0.05), ((0, np.nan), 0.05)):
        with pytest.raises(ValueError, match="less than 2 apart"):
            hyperfan(lf, *ends, bandwidth=bandwidth)
    with pytest.raises(ValueError, match="above 0 and below"):
        hyperfan(lf, 0, 1, bandwidth=0.25)


def test_a_hyperfan_keeps_what_lies_in_its_range(device):
    """Two textures at d = -0.5 and d = 1: each range keeps one, of which all views stay sharp."""
    size, views = (32, 36), (8, 9)
    near, far = plane(views, size, 1.0, seed=1), plane(views, size, -0.5, seed=2)
    lf = LightField.from_array((near + far).astype(np.float32), device=device)
    inside = (slice(None), slice(None), slice(8, -8), slice(8, -8))
    for low, high, kept, lost in ((0.9, 1.1, near, far), (-0.6, -0.4, far, near)):
        got = hyperfan(lf, low, high).to_numpy() - 100.0

        def share(part, found=got):
            """Of a texture that is left, by projection."""
            t = (part - part.mean())[inside]
            return float((found[inside] * t).sum() / (t**2).sum())

        assert share(kept) > 0.9
        assert abs(share(lost)) < 0.35


def test_a_missing_view_is_filled(device):
    scene = plane((6, 7), (20, 22), 0.0)
    holed = scene.copy()
    holed[2, 3] = 0
    lf = LightField.from_array(holed.astype(np.float32), device=device)
    assert lf.weights[2, 3] == 0
    got = hyperfan(lf, -0.1, 0.1).to_numpy()
    assert np.abs(got[2, 3] - scene[2, 3])[4:-4, 4:-4].max() < 0.03 * scene.max()
