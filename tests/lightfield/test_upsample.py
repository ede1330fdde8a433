"""Upsampled refocus resolves what single views alias."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.refocusing.focal_stacks import refocus

FINE = 0.7  # cycles a pixel of the views: above their Nyquist frequency, 0.5


def grating(device, d=0.5, views=(4, 6), size=(9, 32), along_x=True) -> LightField:
    """Sampled at points, at disparity d; in every view it is aliased to 0.3 cycles a pixel."""
    v, u = (np.arange(n) - (n - 1) / 2 for n in views)
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    if along_x:
        places = np.broadcast_to((x + d * u[:, None, None])[None], (*views, *size))
    else:
        places = np.broadcast_to((y + d * v[:, None, None, None]), (*views, *size))
    return LightField.from_array(
        (100 + 50 * np.sin(2 * np.pi * FINE * places)).astype(np.float32), device=device
    )


def amplitude(line: np.ndarray, cycles: float) -> float:
    """Of a wave in samples of a line, its mean taken away."""
    t = np.arange(line.size)
    return float(2 * abs(((line - line.mean()) * np.exp(-2j * np.pi * cycles * t)).mean()))


@pytest.mark.parametrize("along_x", [True, False])
def test_a_grating_that_is_aliased_in_views_is_resolved(device, along_x):
    size = (9, 32) if along_x else (32, 9)
    views = (4, 6) if along_x else (6, 4)
    lf = grating(device, views=views, size=size, along_x=along_x)
    fine = refocus(lf, disparity=0.5, upsample=2).to_numpy()
    plain = refocus(lf, disparity=0.5).to_numpy()
    assert fine.shape == (2 * size[0], 2 * size[1])
    fine, plain = (a[a.shape[0] // 2] if along_x else a[:, a.shape[1] // 2] for a in (fine, plain))
    inside = slice(8, 48)  # of the fine line: 0.35 cycles a sample, 14 periods
    # At d = 1/2 every fine pixel meets samples; the base of 1e-3 is all that is mixed in.
    assert amplitude(fine[inside], FINE / 2) > 0.98 * 50
    assert amplitude(plain[4:24], 1 - FINE) < 0.2 * 50
    twice = np.repeat(plain, 2)
    assert amplitude(twice[inside], FINE / 2) < 0.1 * 50


def test_bad_factors_are_refused(device):
    lf = grating(device, size=(3, 5))
    for n in (0, 17, 1.5):
        with pytest.raises(ValueError, match="an integer from 1 to 16"):
            refocus(lf, disparity=0.5, upsample=n)
