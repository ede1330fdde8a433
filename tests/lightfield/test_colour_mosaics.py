"""Colours of decoded mosaics against the truth, beside bilinear demosaicing of the raw picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_mosaics import ARRAYS, BLACK, SCENES, by_hand, captured, lattice_of, scores, truth

from clplen import decode_raw


def test_colours_are_nearer_to_the_truth_than_bilinear_ones(device):
    """All three scenes and both arrays: python -m benchmarks accuracy/color_mosaics."""
    pytest.importorskip("skimage")
    array = replace(ARRAYS["hexagonal"], shape=(173, 197))
    scene = SCENES["texture"](array)
    raw, white = captured(array, scene)
    lf = decode_raw(
        raw.astype(np.float32) - BLACK, lattice_of(array), device=device, white=white - BLACK,
        bayer=array.bayer, views=(9, 9), step=1,
    )  # fmt: skip
    grid = lf.raw.sub_images
    true = truth(array, scene, grid)
    (linear, srgb, apart), other = (
        scores(views, true, array, grid)
        for views in (lf.to_numpy(), by_hand(raw, white, array, grid, 3))
    )
    assert linear > other[0] + 0.7
    assert srgb > other[1] + 1.3
    assert apart < other[2] - 0.3
    assert srgb > 33
