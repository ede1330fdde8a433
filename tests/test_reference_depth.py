"""The plain baselines find what a scene has: sign, size, and their known weakness at edges."""

from __future__ import annotations

import numpy as np
import pytest
from reference_depth import depth

from clplen import SurfaceScene
from clplen.analysis.quality import score
from clplen.cameras import Plane
from clplen.cameras.scenes.textures import noise
from clplen.compute.device import Device

pytestmark = pytest.mark.nightly


@pytest.mark.parametrize("cue", ["energy", "variance"])
def test_a_baseline_finds_a_plane(cue: str, device: Device) -> None:
    scene = SurfaceScene(Plane(0.63, texture=noise(1, 64, colour=True)))
    lf, truth = scene.light_field((7, 7), (48, 56), device=device, noise=0.01)
    found = depth(lf.to_numpy(), cue, np.arange(0, 1.25, 0.1))
    scores = score(found, truth)
    # a fifth of the distance between planes; measured 0.004 (energy with few views is worse: what
    # linear interpolation blurs depends on the plane)
    assert scores.median < 0.02
    assert scores.badpix_07 < 1
