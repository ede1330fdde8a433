"""Points in stacks: Gaussians, and points of a simulated microscope."""

import numpy as np
import pytest

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, ShapeError
from clplen.lightfield.stacks import focal_stack
from clplen.microscopy.objects.points import find_points, match_points

SHAPE = (23, 31, 40)
SIGMA = (2.1, 0.9, 1.3)  # planes, rows, columns
CENTRES = np.array([(7.3, 8.8, 9.4), (15.1, 21.25, 30.7), (6.2, 20.6, 21.45), (16.6, 7.5, 27.2)])
HEIGHTS = np.array([90.0, 70.0, 50.0, 30.0])


def gaussians(noise=0.0):
    """Points on a slanted background."""
    index = np.indices(SHAPE)
    stack = 40 + 0.3 * index[2] - 0.2 * index[1]
    for centre, height in zip(CENTRES, HEIGHTS, strict=True):
        far = [((i - c) / s) ** 2 / 2 for i, c, s in zip(index, centre, SIGMA, strict=True)]
        stack += height * np.exp(-sum(far))
    return stack + noise * np.random.default_rng(3).standard_normal(SHAPE)


def test_gaussians_between_the_samples():
    planes = np.linspace(4e-5, -3e-5, SHAPE[0])  # falling, as depths of rising disparities
    axes = (planes, 2e-6 * np.arange(SHAPE[1]) - 1e-5, None)
    found = find_points(gaussians(0.3), axes=axes, size=(2, 1))
    steps = np.array([planes[1] - planes[0], 2e-6, 1.0])
    expected = np.array([planes[0], -1e-5, 0]) + steps * CENTRES
    assert len(found) == 4
    assert (np.diff(found.peaks) < 0).all()
    assert (found.snr > 20).all()
    # sigma/snr is the standard error of a place (Thompson et al. 2002): .1 planes, .05 samples; the
    # background that is taken off bends the parabola by .02
    assert (np.abs(found.positions - expected) < np.abs(steps) * (0.1, 0.06, 0.06)).all()
    widths = np.abs(steps) * np.array(SIGMA) * np.sqrt(8 * np.log(2))
    assert found.widths == pytest.approx(
        np.tile(widths, (4, 1)), rel=0.08
    )  # linear between samples


def test_one_picture_and_unequal_planes():
    picture = gaussians()[7:8]
    (first,) = find_points(picture, axes=([0.3], None, None), snr=50).positions[:1]
    assert first == pytest.approx((0.3, *CENTRES[0, 1:]), abs=0.05)
    far = np.arange(33.0)[None, :, None], np.arange(33.0) - np.array([8, 16, 24])[:, None, None]
    row = (
        np.array([3, 2, 1])[:, None, None] * np.exp(-((far[0] - 16) ** 2 + far[1] ** 2) / 2)
    ).sum(0)
    found = find_points(
        row[None] + 1e-3 * np.random.default_rng(0).random(row.shape), distance=(1, 9)
    )
    assert found.positions[:, 2] == pytest.approx([8, 24], abs=0.05)  # one left out hides no other
    planes = np.arange(SHAPE[0]) ** 1.3
    found = find_points(gaussians(), axes=(planes, None, None), size=(0, 1), distance=(4, 4))
    expected = np.interp(CENTRES[:, 0], np.arange(SHAPE[0]), planes)
    assert found.positions[:4, 0] == pytest.approx(expected, abs=0.15 * np.diff(planes).max())


def test_noise_has_no_points_and_less_bright_ones_beside_another_are_left():
    noise = np.random.default_rng(5).poisson(100, SHAPE)
    assert len(find_points(noise)) == 0
    found = find_points(gaussians(0.3), size=(2, 1), distance=(9.5, 15))
    pairs = match_points(found.positions, CENTRES, tolerance=(1, 1, 1))
    assert pairs[:, 1].tolist() == [0, 1, 2]  # the last is (1.5, 13.75, 3.5) from the second


def test_points_of_a_microscope(device):
    mla = MicrolensArray(125e-6, 2.5e-3, count=21, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=20, na=0.5, mla=mla, wavelength=525e-9, pixels_per_lenslet=25, device=device
    )
    p = 125e-6 / 20
    places = np.array(
        [(-4.3 * p, -3.2 * p, -30e-6), (3.1 * p, -4.6 * p, 18e-6), (-0.4 * p, 0.35 * p, -12e-6),
         (4.6 * p, 3.8 * p, 25e-6), (-4.9 * p, 4.2 * p, 40e-6)]
    )  # fmt: skip
    lf = LightField.from_raw(camera.expose(PointSources(places)))
    planes = np.arange(-0.45, 0.451, 0.01)
    stack = focal_stack(lf, disparities=planes, interpolation="fourier")
    side = p * (np.arange(21) - 10)
    found = find_points(
        stack.to_numpy(), axes=(camera.z(planes), side, side), size=(8, 0.8), snr=10
    )
    pairs = match_points(found.positions, places[:, ::-1], tolerance=(10e-6, 0.3 * p, 0.3 * p))
    assert len(pairs) == len(places)
    z, y, x = found.positions[pairs[:, 0]].T
    expected = places[pairs[:, 1]]
    # sharpest up to 12 % off in d, by diffraction at the lenslets; a tenth of a lenslet laterally
    assert np.abs(z / expected[:, 2] - 1).max() < 0.12
    assert np.hypot(x - expected[:, 0], y - expected[:, 1]).max() < 0.1 * p
    rough = find_points(stack, size=(0, 0.7))  # maxima of points out of focus, too
    assert len(rough) > len(places)
    assert rough.peaks[len(places) :].max() < 0.3 * rough.peaks[: len(places)].min()
    of_stack = find_points(stack, size=(8, 0.8), snr=10)
    assert of_stack.positions[:, 0] == pytest.approx(camera.disparity(found.positions[:, 0]))


def test_matching():
    first = np.array(
        [(0, 0, 0), (1, 5, 5), (2, 9, 1), (3, 3, 9), (1.2, 5, 5.2), (9, 9, 8)], float
    )  # the last but one is farther from the second's than another is, the last too far
    second = np.array([(3, 3.2, 9), (1.4, 5, 4.8), (0, 0.4, 0), (0, 0.1, 0), (9, 9, 9)], float)
    pairs = match_points(first, second, tolerance=(1, 0.5, 0.5))
    assert pairs.tolist() == [[0, 3], [1, 1], [3, 0]]
    assert match_points(first, first[:0], tolerance=(1, 1, 1)).shape == (0, 2)


def test_what_holds_no_points():
    for stack, options, words in [
        (np.ones((2, 9, 9)), {}, "1 or at least 3 planes"),
        (np.ones((9, 9)), {}, "1 or at least 3 planes"),
        (np.ones((3, 9, 9)) * 1j, {}, "must be real"),
        (np.full((3, 9, 9), np.nan), {}, "243 samples are NaN"),
        (np.ones((3, 9, 9)), {"axes": (None, None)}, "planes, y and x, got 2"),
        (np.ones((3, 9, 9)), {"axes": ([1, 2], None, None)}, "3 samples must have shape"),
        (np.ones((3, 9, 9)), {"axes": ([1, 2, 1], None, None)}, "rise or fall"),
        (np.ones((3, 9, 9)), {"size": (1, 0.1)}, "at least 0 planes and 0.5 samples"),
    ]:
        with pytest.raises((ShapeError, ValueError), match=words):
            find_points(stack, **options)
