"""The convention checker: which order of the view axes fits, and what the samples are."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from clplen.io import read_lightfield
from clplen.io.lightfields.layout import Layout
from clplen.lightfield.arrays.stored_samples import extremes
from clplen.lightfield.axis_check.lightfield_report import check_light_field, combine_layout_words
from clplen.lightfield.model.light_field import LightField

WORDS = ("swap_uv", "flip_v", "flip_u")
ORDERS = [
    tuple(word for word, holds in zip(WORDS, held, strict=True) if holds)
    for held in product((False, True), repeat=3)
]
DISTINCT = [(), ("flip_u",), ("swap_uv",), ("swap_uv", "flip_v")]  # but for mirrored ones
PATTERN = "IMG_0001_{n}_{u}_{v}.png"


def layout(words) -> Layout:
    return Layout(**dict.fromkeys(words, True))


def scene(views, d=(-0.9, 0.6), size=(72, 90)) -> np.ndarray:
    """L[v, u, y, x] = T(y + d (v - vc), x + d (u - uc)): two textured halves of two disparities."""
    rng = np.random.default_rng(7)
    k = 2 * np.pi / rng.uniform(5, 16, 40)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 40))
    y, x = np.arange(size[0])[:, None, None], np.arange(size[1])[None, :, None]
    a = np.empty((*views, *size), np.float32)
    for v, u in np.ndindex(*views):
        for half, of in zip((slice(None, 45), slice(45, None)), d, strict=True):
            at_y, at_x = (of * (i - (n - 1) / 2) for i, n in zip((v, u), views, strict=True))
            waves = np.cos(k * (np.sin(angle) * (y + at_y) + np.cos(angle) * (x + at_x)) + phase)
            a[v, u, :, half] = (100 + 5 * waves.sum(axis=-1))[:, half]
    return a


def checked(device, a, **more):
    return check_light_field(LightField.from_array(a, device=device, **more))


def mends(words, wrong, right) -> bool:
    """Whether the words make the right light field, or its mirror image in both view axes."""
    made = layout(words).oriented(wrong)
    return any(np.array_equal(made, a) for a in (right, right[::-1, ::-1]))


@pytest.mark.parametrize("views", [pytest.param((5, 5), marks=pytest.mark.thorough), (2, 3)])
def test_every_wrong_order_is_named(device, views):
    right = scene(views)
    for words in DISTINCT if views == (5, 5) else ORDERS:
        wrong = layout(words).stored(right)
        report = checked(device, wrong)
        assert report.verdict == ("fits" if mends((), wrong, right) else "wrong"), words
        assert len(report.best) == 2
        assert all(mends(order.keywords, wrong, right) for order in report.best), words
        assert report.factor > 1.05
        assert report.factor_as_read == pytest.approx(
            report.best[0].sharpness / report.orders[0].sharpness
        )
        for order in report.best:
            said = ", ".join(f"{word}=True" for word in order.keywords)
            assert report.verdict == "fits" or said in str(report)


def test_disparities_of_an_order_and_its_mirror(device):
    """Both halves count, the peak is the larger half's."""
    report = checked(device, scene((5, 5)))
    found = {order.keywords: order for order in report.orders}
    assert found[()].span == (-0.875, 0.625)
    assert found["flip_v", "flip_u"].span == (-0.625, 0.875)
    mirrored = found["flip_v", "flip_u"].disparity
    assert found[()].disparity == -mirrored
    assert min(abs(found[()].disparity - d) for d in (-0.9, 0.6)) < 0.1
    assert "exchanges near and far" in str(report)
    assert "check an object that is known to be nearer" in str(report)


def test_no_evidence(device):
    rng = np.random.default_rng(3)
    focused = scene((4, 5), d=(0.0, 0.0))
    report = checked(device, focused)
    assert (report.verdict, report.reason) == ("none", "in focus")
    report = checked(device, focused + rng.normal(0, 4, focused.shape))
    assert (report.verdict, report.reason) == ("none", "in focus")
    report = checked(device, rng.normal(100, 9, focused.shape))
    assert (report.verdict, report.reason) == ("none", "not in focus")
    right = scene((5, 5)).reshape(25, 72, 90)
    report = checked(device, rng.permutation(right).reshape(5, 5, 72, 90))
    assert (report.verdict, report.reason) == ("none", "not in focus")
    assert "lawnmower" in str(report)
    for flat in (0, 7):
        report = checked(device, np.full((3, 3, 40, 40), flat, np.uint8))
        assert (report.verdict, report.reason) == ("none", "no detail")
        assert report.orders == ()
    report = checked(device, focused[:1, :1])
    assert (report.verdict, report.reason) == ("none", "one view")


def test_stripes_leave_some_orders_open(device):
    """Nothing varies along y: only d along x counts, so flip_v cannot be told."""
    stripes = np.broadcast_to(scene((5, 5))[:1, :, :1], (5, 5, 72, 90))
    report = checked(device, stripes)
    assert report.verdict == "unclear"
    assert "flip_v=True (at " in str(report)


def test_positions_spacing_weights_and_colour(device):
    """Scattered views are checked where they lie; a view that is left out does not count."""
    a = scene((4, 5))
    a[0, 1] = np.random.default_rng(1).uniform(0, 255, a.shape[2:])
    weights = np.ones((4, 5))
    weights[0, 1] = 0
    colours = np.repeat(a[..., None], 3, axis=-1).astype(np.uint8)
    colours[..., 1] = colours[..., 1] // 2 + 90
    grid = np.stack(np.meshgrid(np.arange(4) - 1.5, np.arange(5) - 2.0, indexing="ij"), axis=-1)
    for positions, verdict in ((grid, "fits"), (grid * (1, -1), "wrong")):
        report = checked(device, colours, weights=weights, positions=positions)
        assert report.verdict == verdict
        assert report.scattered
        assert report.left_out == 1
    # the same by the sign of a spacing
    for dv, verdict in ((1, "fits"), (-1, "wrong")):
        assert checked(device, a, weights=weights, spacing=(dv, 1, 1, 1)).verdict == verdict


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_range_and_flat_views(device, dtype):
    a = np.random.default_rng(2).integers(1, 250, (2, 3, 19, 23, 3)).astype(dtype)
    a[0, 1], a[1, 2] = 0, 33
    a[1, 1, 18, 22, 2], a[0, 0, 0, 0, 0] = 255, 251
    report = checked(device, a)
    assert (report.dark, report.constant) == (((0, 1),), ((1, 2),))
    assert (report.low, report.high) == (0, 255)
    assert (report.shape, report.dtype) == (a.shape, np.dtype(dtype).name)
    low, high = extremes(device.upload(a), device)
    np.testing.assert_array_equal(low, a.min(axis=(2, 3, 4)))
    np.testing.assert_array_equal(high, a.max(axis=(2, 3, 4)))


def test_two_sets_of_words_as_one():
    a = np.arange(12).reshape(3, 4)
    for first, then in product(ORDERS, ORDERS):
        one = layout(combine_layout_words(first, then)).oriented(a)
        np.testing.assert_array_equal(one, layout(then).oriented(layout(first).oriented(a)))


@pytest.fixture(scope="module")
def flower(data_folder: Path, device) -> np.ndarray:
    folder = data_folder / "lytro_f01_flower"
    return read_lightfield(folder, device=device, pattern=PATTERN).to_numpy()


@pytest.mark.thorough
def test_flower(device, flower):
    """A real camera: d = -0.65; every wrong order is named."""
    for words in DISTINCT:
        wrong = layout(words).stored(flower)
        report = checked(device, wrong)
        assert report.verdict == ("wrong" if words else "fits")
        assert all(mends(order.keywords, wrong, flower) for order in report.best)
        right = [
            order
            for order in report.best
            if np.array_equal(layout(order.keywords).oriented(wrong), flower)
        ]
        assert right[0].disparity == pytest.approx(-0.65, abs=0.02)
        assert report.factor > 3


@pytest.mark.thorough
def test_nearly_black_views_and_the_brightness_of_the_others(device):
    """Below 2 % of the median of the views that count; a black view and one without weight do
    not."""
    a = scene((5, 7), size=(40, 90))
    gain = np.ones((5, 7))
    gain[0, 0], gain[0, 6], gain[4, 6], gain[2, 2], gain[1, 1] = 0.015, 0, 0.025, 0.7, 0.001
    weights = np.ones((5, 7))
    weights[0, 6] = weights[1, 1] = 0
    found = checked(device, a * gain[..., None, None].astype(np.float32), weights=weights)
    assert found.nearly_black == ((0, 0),)
    means = a.mean(axis=(2, 3), dtype=np.float64) * gain
    median = np.median(means[weights > 0])
    np.testing.assert_allclose(found.brightness, (means[4, 6] / median, means.max() / median), 1e-4)
    assert not checked(device, a).nearly_black
    assert np.isnan(checked(device, np.zeros((3, 3, 20, 20), np.uint8)).brightness).all()
