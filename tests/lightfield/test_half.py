"""float16 storage: the same bits as a float32 copy of the same samples, everywhere."""

from __future__ import annotations

import numpy as np
import pytest

import clplen.io
from clplen.lightfield.focus_and_depth import depth_map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus
from clplen.lightfield.stacks import focal_stack

PLANES = np.linspace(-0.6, 0.8, 5)


def samples(*shape: int) -> np.ndarray:
    """Numbers that float16 has and uint8 has not, some of them subnormal."""
    values = np.random.default_rng(7).uniform(-2, 3, shape).astype(np.float16)
    values.ravel()[::7] = np.float16(5e-7)
    return values


@pytest.fixture
def pair(device) -> tuple[LightField, LightField]:
    values = samples(3, 4, 31, 45, 3)
    wide = LightField.from_array(values.astype(np.float32), device=device)
    return LightField.from_array(values, device=device), wide


def same(of, pair):
    half, single = (of(lf).to_numpy() for lf in pair)
    assert half.dtype == np.float32
    assert np.ptp(half) > 0
    np.testing.assert_array_equal(half, single)


def test_pictures(pair):
    for interpolation in ("linear", "nearest", "cubic", "fourier"):
        words = {"disparities": PLANES, "interpolation": interpolation}
        same(lambda lf, words=words: focal_stack(lf, **words), pair)
    same(lambda lf: lf.flatten("median", disparity=0.3), pair)
    same(lambda lf: refocus(lf, disparity=0.5, upsample=2), pair)
    same(lambda lf: lf.view(1, 2.4), pair)
    same(lambda lf: lf.epi(y=3, v=1), pair)
    same(lambda lf: lf.render(aperture=0.7), pair)


@pytest.mark.parametrize(
    "cue",
    [
        "energy",
        "correspondence",
        "structure-tensor",
        pytest.param("combined", marks=pytest.mark.thorough),
    ],
)
def test_depth(pair, cue):
    maps = [depth_map(lf, disparities=PLANES, cue=cue) for lf in pair]
    np.testing.assert_array_equal(maps[0].disparity, maps[1].disparity)
    np.testing.assert_array_equal(maps[0].confidence, maps[1].confidence)


@pytest.mark.parametrize("suffix", ["h5", "npy"])
def test_files_keep_it(pair, device, tmp_path, suffix):
    path = tmp_path / f"half.{suffix}"
    values = pair[0].to_numpy()
    if suffix == "npy":
        np.save(path, values)
    else:
        clplen.io.write_lightfield(path, pair[0])
    found = clplen.io.read_lightfield(path, device=device)
    assert found.dtype == np.float16
    np.testing.assert_array_equal(found.to_numpy(), values)
