"""The cue of correspondence against its plain form in float64."""

from __future__ import annotations

import numpy as np
import pytest
from reference_cues import grid_steps, moments, plain_depth
from scipy.ndimage import uniform_filter

from clplen.lightfield.depth.correspondence_cue import correspondence_disparity
from clplen.lightfield.model.light_field import LightField


@pytest.mark.parametrize("count", [5, 18])  # below and above what is looked at at once
def test_against_its_plain_form(device, count):
    random = np.random.default_rng(1)
    L = random.random((3, 4, 31, 37)).astype(np.float32)
    planes = np.linspace(-1, 1.2, count)
    found, confidence = correspondence_disparity(LightField.from_array(L, device=device), planes)
    want = plain_depth(L.astype(np.float64), planes)["correspondence"]
    cost = np.array(
        [
            uniform_filter(
                moments(L[..., None], d, np.ones((3, 4)), grid_steps((3, 4)))[1][..., 0], 9
            )
            for d in planes
        ]
    )
    at_end = np.isin(np.argmin(cost, axis=0), (0, count - 1))
    # Of noise without depth the lowest plane is as good as any; costs are right to 1e-6 of 1/12,
    # and the parabola divides by differences of 1e-3 and more between them.
    low = np.sort(cost, axis=0)
    sure = ~at_end & (low[1] - low[0] > 1e-4)
    assert sure.mean() > 0.2
    assert np.abs(found - want)[sure].max() < 2e-3 * (planes[1] - planes[0])
    ends = planes.astype(np.float32)[np.argmin(cost, axis=0)]
    assert (found != ends)[at_end].sum() <= 0.05 * at_end.sum()
    assert not confidence[at_end].any()
    assert (confidence[sure] > 0).all()
