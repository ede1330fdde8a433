"""The numbers of a sensor: means and variances of its noise, levels, gains, seeds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clplen import Sensor
from clplen.compute.device import Device
from clplen.lightfield import LensletGrid, Levels, RawImage, demosaic

SHAPE = (211, 307)
LEVEL = 0.37  # units of the raw image
TILE = (("G", "R", "G"), ("B", "G", "R"))


def raw_of(device: Device, values: Any = None, mosaic: Any = None) -> RawImage:
    """A raw image of even light, or of values."""
    data = np.full(SHAPE, LEVEL, np.float32) if values is None else np.asarray(values, np.float32)
    grid = LensletGrid((3, 3), (5, 5), (7.0, 7.0), (5.0, 0.0), (0.0, 5.0))
    return RawImage(device.upload(data), device, 1e-6, grid, grid, mosaic=mosaic)


def recorded(device: Device, mosaic: Any = None, **words: Any) -> np.ndarray[Any, Any]:
    raw = Sensor(**words).record(raw_of(device, mosaic=mosaic))
    return raw.to_numpy().astype(np.float64)


def test_variance_is_that_of_photons_dark_current_and_reading(device: Device) -> None:
    """Mean q = s E + D t, variance q + r^2 (EMVA 1288, release 4.0, eqs 3 and 8)."""
    found = recorded(
        device, exposure=2000.0, shot_noise=True, read_noise=11.0, dark_current=35.0,
        exposure_time=4.0, seed=5,
    )  # fmt: skip
    mean = LEVEL * 2000 + 35 * 4
    variance, n = mean + 11**2, found.size
    assert found.mean() == pytest.approx(mean, abs=5 * np.sqrt(variance / n))
    assert found.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / n))
    assert abs(np.corrcoef(found[:, 1:].ravel(), found[:, :-1].ravel())[0, 1]) < 5 / np.sqrt(n)


def test_sensitivities_of_pixels_stay_from_frame_to_frame(device: Device) -> None:
    words: dict[str, Any] = {"exposure": 3e4, "prnu": 0.02, "seed": 8}
    still = recorded(device, **words)
    mean, n = 3e4 * LEVEL, still.size
    assert still.mean() == pytest.approx(mean, rel=5 * 0.02 / np.sqrt(n))
    assert still.std() == pytest.approx(0.02 * mean, rel=5 / np.sqrt(2 * n))
    first, second = (recorded(device, shot_noise=True, frame=frame, **words) for frame in (0, 7))
    assert (first != second).any()
    together = np.cov((first - still).ravel(), (second - still).ravel())
    np.testing.assert_allclose(np.diag(together), mean, rtol=5 * np.sqrt(2 / n))
    assert abs(together[0, 1]) < 5 * mean / np.sqrt(n)
    again = recorded(device, shot_noise=True, frame=7, **words)
    np.testing.assert_array_equal(again, second)
    other = recorded(device, **(words | {"seed": 9}))
    assert abs(np.corrcoef(other.ravel(), still.ravel())[0, 1]) < 5 / np.sqrt(n)


def test_levels_and_gains_of_filters(device: Device) -> None:
    """black + gain electrons (white - black)/full well, rounded and cut off at the converter."""
    values = np.random.default_rng(2).random(SHAPE) * 1.3
    raw = raw_of(device, values, TILE)
    gains = {"R": 1.9, "G": 1.0, "B": 1.4}
    sensor = Sensor(
        4000.0, full_well=3600.0, bit_depth=10, black_level=64, white_level=1000, gain=gains
    )
    out = sensor.record(raw)
    found = out.to_numpy()
    y, x = np.indices(SHAPE)
    gain = np.vectorize(gains.get)(np.array(TILE)[y % 2, x % 3])
    electrons = np.minimum(raw.to_numpy().astype(np.float64) * 4000, 3600)
    wanted = np.clip(np.rint(64 + gain * electrons * (1000 - 64) / 3600), 0, 1023)
    assert (found != wanted).mean() < 1e-3  # halves that float32 rounds the other way
    assert np.abs(found - wanted).max() <= 1
    assert out.levels == Levels(64.0, 1000.0, 10)
    assert found.max() == 1023
    dark = out.above_black()
    assert dark.levels is None
    np.testing.assert_array_equal(dark.to_numpy(), found - 64)
    assert out.mosaic == dark.mosaic == TILE


def test_reading_goes_below_the_black_level(device: Device) -> None:
    raw = raw_of(device, np.zeros(SHAPE))
    sensor = Sensor(1.0, read_noise=30.0, full_well=4095.0, bit_depth=12, black_level=200, seed=3)
    found = sensor.record(raw).to_numpy()
    assert found.min() < 200 - 60
    scale = (4095 - 200) / 4095
    assert found.mean() == pytest.approx(200, abs=5 * 30 / np.sqrt(found.size))
    assert found.std() == pytest.approx(
        np.hypot(30 * scale, np.sqrt(1 / 12)), rel=5 / np.sqrt(found.size)
    )


def test_what_no_sensor_has(device: Device) -> None:
    lit: dict[str, Any] = {"exposure": 1e3, "full_well": 1e3, "bit_depth": 8}
    for words, said in (
        ({"exposure": 1e3, "prnu": 1.0}, "share of the sensitivity"),
        ({"exposure": 1e3, "dark_current": 3.0}, "requires exposure_time"),
        ({"exposure": 1e3, "dark_current": -3.0}, "electrons a pixel and second"),
        ({"prnu": 0.01}, "require exposure"),
        ({"exposure": 1e3, "black_level": 9}, "black_level is a digital level"),
        ({"exposure": 1e3, "gain": 2.0}, "gain is a digital level"),
        (lit | {"black_level": 255}, "0 <= black_level < white_level <= 255"),
        (lit | {"white_level": 256}, "got 0.0 and 256"),
        (lit | {"gain": 0.0}, "gain must be a positive number"),
        (lit | {"gain": {}}, "gain must be a positive number"),
        (lit | {"gain": {"R": np.nan}}, "gain must be a positive number"),
        (lit | {"frame": -1}, "frame must be a non-negative integer"),
    ):
        with pytest.raises(ValueError, match=said):
            Sensor(**words)
    with pytest.raises(ValueError, match=r"raw image \(none\), got gains for B, R"):
        Sensor(**lit, gain={"R": 1, "B": 2}).record(raw_of(device))
    with pytest.raises(ValueError, match=r"raw image \(B, G, R\)"):
        Sensor(**lit, gain={"R": 1, "B": 2}).record(raw_of(device, mosaic=TILE))


TILES = {
    "bayer": (("R", "G"), ("G", "B")),
    "quad": (("R", "R", "G", "G"),) * 2 + (("G", "G", "B", "B"),) * 2,
    "rows": (("R",), ("B",), ("G",), ("G",)),
    "odd": TILE,
}


@pytest.mark.parametrize("name", TILES)
def test_demosaicing_is_exact_for_ramps(device: Device, name: str) -> None:
    tile = TILES[name]
    y, x = np.indices((41, 53)).astype(float)
    planes = {"R": 5 + 0 * x, "G": 2 + 0 * y, "B": 7 + 0 * y}
    if name == "bayer":  # symmetric about every pixel
        planes = {"R": 5 + 0.1 * x, "G": 2 + 0.2 * y, "B": 7 - 0.05 * x + 0.02 * y}
    names = np.array(tile)[np.indices((41, 53))[0] % len(tile), x.astype(int) % len(tile[0])]
    mosaic = np.select([names == c for c in "RGB"], [planes[c] for c in "RGB"])
    raw = replace(raw_of(device, mosaic + 16, tile), levels=Levels(16.0, 255.0, 8))
    found = demosaic(raw)
    assert found.mosaic is None
    assert found.levels is None
    inside = (slice(4, -4), slice(4, -4))
    for channel, colour in enumerate("RGB"):
        np.testing.assert_allclose(
            found.to_numpy()[(*inside, channel)], planes[colour][inside], rtol=1e-5
        )
        own = names == colour
        np.testing.assert_allclose(found.to_numpy()[..., channel][own], mosaic[own], rtol=1e-5)
    with pytest.raises(ValueError, match="no colour filters"):
        demosaic(found)
