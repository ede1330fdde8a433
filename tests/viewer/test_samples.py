"""What a page keeps of samples is what was given, to its levels."""

from __future__ import annotations

import gzip
import io

import numpy as np
from PIL import Image as Pillow

from clplen.io.page.samples import MAX_LEVEL, Levels, downscaled, jpeg, packed_floats, png


def unpacked(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """Levels of `Levels.packed`, by the description of its format."""
    split = np.frombuffer(gzip.decompress(data), np.uint8).astype(np.uint16)
    low, high = split[: split.size // 2], split[split.size // 2 :]
    rows = (low + 256 * high).astype(np.uint16).reshape(shape[0], -1)
    return np.cumsum(rows, axis=1, dtype=np.uint16).reshape(shape)


def test_floats_come_back_to_half_a_level():
    for shape in [(5, 7), (4, 3, 3), (1, 1), (2, 301)]:
        values = np.random.default_rng(3).normal(-2, 7, shape).astype(np.float32)
        levels = Levels.of(values)
        q = unpacked(levels.packed(values), shape)
        assert q.max() <= MAX_LEVEL
        assert (
            np.abs(levels.low + levels.step * q.astype(float) - values).max() <= 0.51 * levels.step
        )
        assert levels.step <= 1.001 * np.ptp(values) / MAX_LEVEL or np.ptp(values) == 0


def test_whole_numbers_stay_as_they_are():
    values = np.array([[0, 1, 513], [4095, 7, 60000]], np.uint16)
    levels = Levels.of(values)
    assert (levels.low, levels.step) == (0.0, 1.0)
    assert np.array_equal(unpacked(levels.packed(values), (2, 3)), values)


def test_the_highest_whole_number_is_not_taken_for_nan():
    values = np.array([[0, 65535]], np.uint16)
    q = unpacked(Levels.of(values).packed(values), (1, 2))
    assert q.tolist() == [[0, MAX_LEVEL]]


def test_nan_has_a_level_of_its_own():
    values = np.array([[1.0, np.nan], [np.inf, -3.0]])
    q = unpacked(Levels.of(values).packed(values), (2, 2))
    assert (q > MAX_LEVEL).tolist() == [[False, True], [True, False]]


def test_nothing_but_nan_and_nothing_but_one_value():
    assert Levels.of(np.full((2, 2), np.nan)) == Levels(0.0, 1.0)
    one = Levels.of(np.full((2, 2), 7.5))
    assert one.low + one.step * one.sixteen(np.full(3, 7.5))[0] == 7.5


def test_maps_are_exact_floats():
    values = np.array([[1.5, np.nan, -2e-7], [3e8, 0.1, -0.0]], np.float32)
    bytes_ = np.frombuffer(gzip.decompress(packed_floats(values)), np.uint8).reshape(4, -1)
    back = np.ascontiguousarray(bytes_.T).view("<f4").reshape(2, 3)
    assert back.tobytes() == values.tobytes()


def test_pictures_are_kept_without_loss_and_by_jpeg_nearly():
    for shape in [(6, 9), (6, 9, 3)]:
        y, x = np.indices((6, 9))
        grey = (10 * y + 13 * x).astype(np.uint8)
        values = np.stack([grey, 255 - grey, grey // 2], -1) if len(shape) == 3 else grey
        assert np.array_equal(np.asarray(Pillow.open(io.BytesIO(png(values)))), values)
        lossy = np.asarray(Pillow.open(io.BytesIO(jpeg(values, 95))), float)
        assert np.abs(lossy - values).mean() < 3


def test_downscaling_takes_means_and_leaves_out_the_rest():
    values = np.arange(35, dtype=np.float32).reshape(5, 7)
    small = downscaled(values, 2)
    assert small.shape == (2, 3)
    assert small[1, 2] == values[2:4, 4:6].mean()
    assert downscaled(values.astype(np.uint8), 2).dtype == np.uint8
    assert downscaled(np.full((4, 4, 3), 255, np.uint8), 4).tolist() == [[[255, 255, 255]]]
    assert downscaled(values, 1) is values
