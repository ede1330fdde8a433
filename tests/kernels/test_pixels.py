"""pixels.cl: sums of abs(U)^2 over pixels, beside plain float64 sums."""

from __future__ import annotations

import numpy as np
import pytest

from clplen.cameras.optics.pixel_array import PixelSums, pixel_weights
from clplen.compute.device import Device


@pytest.mark.parametrize(
    ("width", "tile"), [(0.0, (1, 4)), (1.7, (1, 1)), (3.0, (3, 5)), (6.0, (2, 2))]
)
def test_sums_over_pixels(device: Device, width: float, tile: tuple[int, int]) -> None:
    generator = np.random.default_rng(11)
    field = generator.normal(size=(2, 61, 73, 2)) @ (1, 1j)
    start = generator.random((9, 12))
    total = device.upload(start.astype(device.real))
    sums = PixelSums(first=(17, 20), step=4, width=width, pixel=(2, 3), shape=(5, 7))
    gain = 0.3 * generator.random(tile) if tile != (1, 1) else np.array([[0.3]])
    given = gain if tile != (1, 1) else 0.3
    sums.put(total, device.upload(field.astype(device.complex)), 1, given, device)
    weights = pixel_weights(width)
    reach = len(weights) // 2
    expected = start.copy()
    for q in range(5):
        for p in range(7):
            part = np.abs(field[1, 17 + 4 * q - reach :][: len(weights), 20 + 4 * p - reach :]) ** 2
            own = gain[(2 + q) % tile[0], (3 + p) % tile[1]]
            expected[2 + q, 3 + p] += own * (weights @ part[:, : len(weights)] @ weights)
    np.testing.assert_allclose(device.download(total), expected, rtol=1e-5)


def test_weights_integrate_waves() -> None:
    """Their sum over samples of a wave up to .35 cycles a sample is its integral over the width."""
    for width in [0.7, 2.0, 5.3]:
        weights = pixel_weights(width)
        x = np.arange(len(weights)) - len(weights) // 2
        for cycles in (0.0, 0.11, 0.29, 0.35):
            got = weights @ np.cos(2 * np.pi * cycles * x)
            assert got == pytest.approx(width * np.sinc(cycles * width), abs=1e-3 * width)
        assert pixel_weights(0.0) == pytest.approx([1.0])
