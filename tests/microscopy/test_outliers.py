"""Hot pixels in frames of point images, and none where there are none."""

import numpy as np
import pytest
from setups_fourier import camera_of

from clplen import (
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    Projector,
    ShapeError,
    point_images,
)
from clplen.lightfield import Lattice
from clplen.microscopy import FourierProjector, fourier_point_images, preparation
from clplen.microscopy.frames.outliers import hot_pixels, noise, steps_around, uneven_pixels
from clplen.microscopy.frames.sharpness import sharpness

N = 11


@pytest.fixture(scope="module")
def images(device):
    camera = PlenopticCamera.microscope(
        magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=33,
        mla=MicrolensArray(125e-6, 2.5e-3, count=5, fill="full"), device=device,
    )  # fmt: skip
    return point_images(camera, [0.0, 12e-6, 30e-6], voxels_per_lenslet=3, binning=3, cut=0.01)


@pytest.fixture(scope="module")
def projector(images, device):
    return Projector(images, (9, 10), device=device)


def volumes(projector):
    """Single beads in each plane, a crowd, even light and noise of every voxel."""
    rng = np.random.default_rng(5)
    for plane in range(3):
        one = np.zeros(projector.volume_shape)
        one[plane, 13, 17] = 1
        yield one
    some = np.zeros(projector.volume_shape)
    for count in (7, 200):
        some[:] = 0
        for _ in range(count):
            some[tuple(rng.integers(0, some.shape))] += rng.uniform(0.1, 1)
        yield some.copy()
    yield np.ones(projector.volume_shape)
    yield rng.random(projector.volume_shape) ** 4


def test_hot_pixels_are_found(images, projector):
    rng, sharpest = np.random.default_rng(8), sharpness(images)
    for number, volume in enumerate(volumes(projector)):
        frame = projector.forward(volume)
        frame = rng.poisson(frame * 1e6 / frame.sum(dtype=float))
        frame = np.maximum(frame + rng.normal(0, 1.5, frame.shape).round(), 0)
        assert not hot_pixels(frame, sharpest, N).any()
        if number < 3:  # single beads leave too few photons beside them
            continue
        places = rng.choice(frame.size, 25, replace=False)
        frame.flat[places] = 40 * np.percentile(frame, 95) + 400
        found = hot_pixels(frame, sharpest, N)
        assert np.isin(np.flatnonzero(found), places).all()
        assert found.sum() >= 22  # not those beside a bright bead
    pair = rng.poisson(50, (9 * N, 10 * N)).astype(float)
    pair[40, 51:53] = pair[41, 51] = 5000
    pair[0, 0] = pair[-1, 60] = 5000
    assert np.argwhere(hot_pixels(pair, sharpest, N)).tolist() == [
        [0, 0], [40, 51], [40, 52], [41, 51], [98, 60],
    ]  # fmt: skip


@pytest.fixture(scope="module")
def fourier(device):
    """A Fourier microscope, its point images, and frames: exposed beads, even light, all voxels."""
    camera, rng = camera_of("small", device), np.random.default_rng(11)
    images = fourier_point_images(camera, [-30e-6, 0.0, 20e-6])
    projector = FourierProjector(images, (61, 61), device=device)
    reach = 0.95 * images.radius * images.side  # also beads that the field stop cuts
    frames = [
        np.maximum(camera.expose(PointSources(places, power=list(power))).to_numpy(), 0)
        for places, power in (
            (rng.uniform(-1, 1, (n, 3)) * (reach, 0.7 * reach, 30e-6), rng.uniform(0.2, 1, n))
            for n in (3,)
        )
    ]
    even = np.ones(projector.volume_shape)
    return images, [
        *frames,
        projector.forward(even),
        projector.forward(rng.random(even.shape) ** 6),
    ]


def test_hot_pixels_of_a_fourier_microscope(fourier):
    images, frames = fourier
    rng, sharpest = np.random.default_rng(12), sharpness(images)
    for mean in frames:
        frame = rng.poisson(mean * (2e4 / mean.sum(dtype=float)))
        frame = np.maximum(frame + rng.normal(0, 1.5, frame.shape).round(), 0)
        assert not hot_pixels(frame, sharpest, None).any()
        places = rng.choice(frame.size, 30, replace=False)
        frame = frame.astype(float)
        frame.flat[places] += 40 * max(frame.mean(), 1) + 100
        found = np.flatnonzero(hot_pixels(frame, sharpest, None))
        assert np.isin(found, places).all()
        assert len(found) >= 24  # not those beside a bright bead


def test_the_bound_at_the_rim_of_a_sub_image(fourier):
    # pixels of a point image that the rim cuts anywhere, along y or x
    images, _ = fourier
    found = sharpness(images)
    for stored in images.stored:
        for image in stored.reshape(-1, *stored.shape[2:]):
            for cut in (image[9:], image[:, 9:], image[:13], image[:, :11]):
                wide = np.pad(cut.astype(float), 1)
                beside = [np.roll(wide, step, (0, 1)) for step in steps_around(None)]
                around = np.sort(beside, axis=0)
                seen = wide > 1e-3 * image.max()
                for k in range(3):
                    assert (wide <= 1.0001 * found[k] * around[: 8 - k].sum(axis=0))[seen].all()


def test_steps_of_hexagonal_lattices():
    row, column = (0.75**0.5 * 20, 1.0), (-1.0, 20.0)
    far = steps_around(Lattice("hexagonal", (0, 0), row, column))[8:]
    across = {(18, -9), (17, 11), (-18, 9), (-17, -11)}
    assert set(far) == across | {(1, -20), (-1, 20), (35, 2), (-35, -2)}
    lattice = Lattice("hexagonal", (0, 0), column[::-1], row[::-1])
    assert lattice.turned
    assert {one[::-1] for one in steps_around(lattice)[8:]} == set(far)


def test_noise_of_a_frame():
    floor, gain, rng = 4.0, 2.5, np.random.default_rng(3)
    mean = np.kron(rng.uniform(5, 300, (20, 20)), np.ones((15, 15)))
    frame = rng.poisson(mean / gain) * gain + rng.normal(0, np.sqrt(floor), mean.shape)
    frame[40:60:7, ::31] = 1e5  # hot
    found = noise(frame, 15)
    for level in (150, 300):  # the darkest quarter counts as dark
        assert found[0] + found[1] * level == pytest.approx(floor + gain * level, rel=0.35)


def test_hot_and_dead_pixels_of_a_white_frame():
    y, x = np.indices((90, 104)) * (2 * np.pi / 10)
    white = np.random.default_rng(1).poisson(1000 * (1.05 + np.cos(y)) * (1.05 + np.cos(x)))
    white = white.astype(float)
    lattice = Lattice("square", (0, 0), (10, 0), (0, 10), white.shape)
    assert not uneven_pixels(white, lattice).any()
    white[30, 41], white[51, 60], white[0, 0] = 9000, 100, 60000
    assert np.argwhere(uneven_pixels(white, lattice)).tolist() == [[0, 0], [30, 41], [51, 60]]


def test_hot_and_masked_pixels_of_a_preparation(images, projector, device):
    frame = 1e6 * projector.forward(np.ones(projector.volume_shape)) / 1e3
    frame[20, 31], frame[50, 12] = 50 * frame.max(), 60 * frame.max()
    mask = np.zeros(frame.shape, np.uint8)
    mask[70:72, 5] = 255
    found = preparation(N, device=device, mask=mask, sharpest=sharpness(images))(frame)
    assert (found.hot, found.masked, found.left_out, found.doubtful) == (2, 2, 0, 0)
    assert np.argwhere(found.white == 0).tolist() == [[20, 31], [50, 12], [70, 5], [71, 5]]
    assert (found.counts[found.white == 0] == 0).all()
    frame = np.full((99, 110), 100.0)
    frame[:20:3, ::5] = 1e6
    judged = preparation(N, device=device, sharpest=sharpness(images))(frame)
    assert (judged.hot, judged.doubtful) == (0, np.count_nonzero(frame > 100))
    assert (judged.white > 0).all()


def test_bad_masks(device):
    for mask, error, words in [
        (np.zeros((99, 110, 3)), ShapeError, "mask must have the shape"),
        (np.full((99, 110), np.nan), ValueError, "must be 0 at valid pixels"),
        (np.full((99, 110), -1), ValueError, "must be 0 at valid pixels"),
        (np.ones((99, 110)), ValueError, "excludes every pixel"),
    ]:
        with pytest.raises(error, match=words):
            preparation(N, device=device, mask=mask)(np.ones((99, 110)))
