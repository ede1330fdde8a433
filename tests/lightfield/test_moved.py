"""Views moved by distances of their own."""

import numpy as np
import pytest

from clplen import LightField, ShapeError
from clplen.lightfield.refocusing.phase_ramps import shift_views


def test_each_view_by_its_own_distance(device):
    """What lay at (y + s_y, x + s_x) comes to (y, x); whole pixels on noise, others on waves."""
    random = np.random.default_rng(1)
    data = random.integers(0, 200, (2, 3, 9, 12, 3)).astype(np.uint8)
    whole = random.integers(-4, 5, (2, 3, 2))
    lf = LightField.from_array(data, device=device, spacing=(-1e-3, -2e-3, 1e-4, 1e-4))
    got = shift_views(lf, whole)
    assert got.spacing == lf.spacing
    assert got.shape == lf.shape
    for v, u in np.ndindex(2, 3):
        expected = np.roll(data[v, u].astype(float), tuple(-whole[v, u]), axis=(0, 1))
        np.testing.assert_allclose(got.to_numpy()[v, u], expected, atol=2e-4)  # 200 in float32
    y, x = np.indices((9, 12))
    steps = random.uniform(-2, 2, (2, 3, 2))
    down, right = np.moveaxis(steps, -1, 0)[..., None, None]

    def wave(y, x):
        return (
            2 + np.cos(2 * np.pi * (2 * y / 9 - x / 12)) + np.sin(2 * np.pi * (y / 9 + 5 * x / 12))
        )

    still = np.broadcast_to(wave(y, x), (2, 3, 9, 12)).astype(np.float32)
    got = shift_views(LightField.from_array(still, device=device), steps).to_numpy()
    np.testing.assert_allclose(got, wave(y + down, x + right), atol=5e-6)


def test_refusals(device):
    lf = LightField.from_array(np.ones((2, 3, 4, 5), np.float32), device=device)
    with pytest.raises(ShapeError, match=r"shape \(2, 3, 2\), got \(3, 2, 2\)"):
        shift_views(lf, np.zeros((3, 2, 2)))
    with pytest.raises(ValueError, match="finite"):
        shift_views(lf, np.full((2, 3, 2), np.nan))
