"""Series of frames: batches against frames one by one, starts and background against NumPy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from setups_microscope import any_projector
from tolerance import relative_max

from clplen.errors import ShapeError
from clplen.microscopy import deconvolve, deconvolve_series
from clplen.microscopy.reconstruction.projector import Projector
from clplen.microscopy.series.preview import disparities, preview
from clplen.microscopy.series.series import (
    BATCH,
    SeriesFrame,
    batch_for,
    deconvolve_batches,
    rolling_minimum,
)
from clplen.microscopy.series.starts import FLOOR, Start

FRAMES = 5


@pytest.fixture(scope="module")
def projector(device):
    return any_projector(device, (5, 6))


@pytest.fixture(scope="module")
def counts(projector):
    volumes = np.random.default_rng(2).random((FRAMES, *projector.volume_shape))
    return projector.forward(volumes**4)


def one_by_one(counts, projector, **options):
    return [deconvolve(one, projector, **options) for one in counts]


def test_batches_are_frames_one_by_one(projector, counts):
    found = list(deconvolve_series(iter(counts), projector, batch=2, iterations=3))
    assert len(found) == FRAMES
    for one, expected in zip(found, one_by_one(counts, projector, iterations=3), strict=True):
        assert one.volume.shape == projector.volume_shape
        assert relative_max(expected.volume, one.volume) < 1e-5
        assert np.allclose(one.residuals, expected.residuals, rtol=1e-5)


def test_a_batch_begins_with_the_last_volume_of_the_one_before(projector, counts):
    options = {"iterations": 2}
    found = list(deconvolve_series(counts, projector, batch=2, start="previous", **options))
    before = None
    for t in range(FRAMES):
        if t and t % 2 == 0:
            before = np.maximum(found[t - 1].volume, FLOOR * found[t - 1].volume.mean())
        expected = deconvolve(counts[t], projector, start=before, **options)
        assert relative_max(expected.volume, found[t].volume) < 1e-5


def test_starts_are_what_they_say(projector):
    images = projector.images
    volume = np.random.default_rng(3).random(projector.volume_shape).astype(np.float32)
    volume[0, 2, 3] = 0
    mean = volume.mean(dtype=np.float64)
    assert Start(None, images).volumes(volume, 2) is None
    (previous,) = Start("previous", images).volumes(volume, 2)
    assert np.allclose(previous, np.maximum(volume, FLOOR * mean))
    (decayed,) = Start("decayed", images, decay=0.3).volumes(volume, 2)
    power = volume.astype(float) ** 0.3
    assert np.allclose(decayed, np.maximum(power * mean / power.mean(), FLOOR * mean), rtol=1e-5)
    motion = 0.7 * images.side
    limited = Start("limited", images, motion=motion).volumes(volume, 2)
    assert len(limited) == 2
    step = images.planes[1] - images.planes[0]
    for frame, one in enumerate(limited, start=1):
        sigma = (frame * motion / step, frame * 0.7, frame * 0.7)
        expected = gaussian_filter(volume.astype(float), sigma, mode="nearest")
        assert np.allclose(one, expected, rtol=1e-4)


def test_what_does_not_change_has_less_noise_in_time(projector):
    volume = np.zeros(projector.volume_shape)
    volume[:, 5:8, 4:9] = 3.0
    volumes = np.repeat(volume[None], FRAMES, axis=0)
    volumes[FRAMES // 2 :, 1, 6, 6] *= 5  # one voxel changes once
    counts = np.random.default_rng(3).poisson(projector.forward(volumes)).astype(float)
    plain, smooth = (
        np.stack([
            one.volume
            for one in deconvolve_series(counts, projector, batch=3, iterations=30, prior=prior)
        ])
        for prior in (None, "time")
    )  # fmt: skip
    still = np.ones(volume.shape, bool)
    still[1, 6, 6] = False
    flicker = [np.diff(one[:, still], axis=0).std() for one in (plain, smooth)]
    assert flicker[1] < 0.7 * flicker[0]
    after, until = smooth[FRAMES // 2 :, 1, 6, 6].mean(), smooth[: FRAMES // 2, 1, 6, 6].mean()
    assert after > 2.5 * until
    errors = [np.square(one - volumes).sum() for one in (plain, smooth)]
    assert errors[1] < errors[0]


def test_batches_compare_with_the_volume_before(projector, counts):
    found = list(deconvolve_series(counts, projector, batch=2, iterations=4, prior="time"))
    begun = deconvolve(counts[:2], projector, iterations=4, prior="time").volume
    then = deconvolve(counts[2:4], projector, iterations=4, prior="time", before=begun[1]).volume
    apart = deconvolve(counts[2:4], projector, iterations=4, prior="time").volume
    for one, expected in zip(found, [*begun, *then], strict=False):
        assert relative_max(expected, one.volume) < 1e-5
    assert relative_max(apart, then) > 1e-3
    (first, *_) = deconvolve_series(counts, projector, batch=1, iterations=4, prior="time")
    alone = deconvolve(counts[0], projector, iterations=4).volume
    assert relative_max(alone, first.volume) < 1e-5


def test_what_is_not_compared_in_time(projector, counts):
    with pytest.raises(ValueError, match="compares the frames of a series, got a single frame"):
        deconvolve(counts[0], projector, prior="time")
    volume = np.ones(projector.volume_shape)
    with pytest.raises(ValueError, match="before needs prior='time'"):
        deconvolve(counts[:2], projector, before=volume)
    with pytest.raises(ShapeError, match="before must be a single volume"):
        deconvolve(counts[:2], projector, prior="time", before=volume[None])
    volume[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="The volume before has 1 negative"):
        deconvolve(counts[:2], projector, prior="time", before=volume)


def test_frames_with_other_pixels_left_out_are_found_apart(projector, counts):
    whites = [np.ones(projector.frame_shape, np.float32) for _ in range(FRAMES)]
    whites[2][3, 4] = 0
    frames = [
        SeriesFrame(one, 0.1 * t, w) for t, (one, w) in enumerate(zip(counts, whites, strict=True))
    ]
    start = Start(None, projector.images)
    found = deconvolve_batches(frames, projector, 4, start, iterations=2)
    for t, one in enumerate(found):
        expected = deconvolve(
            counts[t], projector, iterations=2, white=whites[t], background=0.1 * t
        )
        assert relative_max(expected.volume, one.volume) < 1e-5


def test_rolling_minimum():
    for window in [2, 3, 9]:
        frames = np.random.default_rng(window).random((7, 2, 3))
        found = list(rolling_minimum(iter(frames), window))
        assert len(found) == 7
        for t, (frame, low) in enumerate(found):
            about = frames[max(t - window // 2, 0) : t + (window - 1) // 2 + 1]
            assert np.array_equal(frame, frames[t])
            assert np.array_equal(low, about.min(axis=0))


def test_background_that_changes_in_time_is_left_out(projector, counts):
    haze = 3 + np.sin(np.arange(FRAMES))[:, None, None] * np.ones(projector.frame_shape)
    lit = counts.copy()
    lit[[0, 2, 4]] = 0  # dark frames between
    found = deconvolve_series(
        lit + haze, projector, rolling=3, background=0.5, iterations=2, batch=5
    )
    low = [one for _, one in rolling_minimum((lit + haze).astype(np.float32), 3)]
    for t, one in enumerate(found):
        expected = deconvolve(lit[t] + haze[t], projector, iterations=2, background=low[t] + 0.5)
        assert relative_max(expected.volume, one.volume) < 1e-4


def test_batches_fit_the_memory(projector, monkeypatch):
    assert batch_for(projector) == BATCH
    assert batch_for(projector, 11) == 11
    asked = Projector.require_memory

    def scarce(self, frames, **kept):
        asked(self, frames * (10**9 if frames > 3 else 1), **kept)

    monkeypatch.setattr(Projector, "require_memory", scarce)
    assert batch_for(projector) == 3


def test_what_is_no_series(projector, counts):
    for change, error, words in [
        ({"batch": 0}, ValueError, "batch"),
        ({"rolling": 0}, ValueError, "window"),
        ({"start": "warm"}, ValueError, "start must be 'previous', 'decayed', 'limited' or None"),
        ({"decay": 1.5}, ValueError, "decay must be a number from 0 to 1"),
        ({"motion": np.nan}, ValueError, "motion must be a positive length"),
        ({"before": 1.0}, ValueError, "before requires a start or prior='time'"),
        ({"whites": 1}, TypeError, "no keyword 'whites': did you mean white="),
        ({"projector": None}, TypeError, "projector"),
        ({"frames": np.ones((1, 3, 3))}, ShapeError, "A frame must have shape"),
        ({"frames": -np.ones((1, 15, 18))}, ValueError, "negative"),
    ]:
        given = {"frames": counts, "projector": projector} | change
        with pytest.raises(error, match=words):
            list(deconvolve_series(**given))


def test_preview_is_sharp_on_the_plane_of_a_point(device):
    from clplen import MicrolensArray, PlenopticCamera, PointSources, point_images

    camera = PlenopticCamera.microscope(
        magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=25,
        mla=MicrolensArray(125e-6, 2.5e-3, count=9, fill="full"), device=device,
    )  # fmt: skip
    images = point_images(camera, [-40e-6, 0.0, 40e-6], voxels_per_lenslet=1, cut=0.05)
    assert np.allclose(disparities(images.planes, images), camera.disparity(images.planes))
    for z, plane in ((-40e-6, 0), (40e-6, 2)):
        counts = camera.expose(PointSources([(0, 0, z)], power=1e6)).to_numpy()
        picture = preview(counts, images, device)
        parts = [
            picture[:, k * picture.shape[1] // 3 :][:, : picture.shape[1] // 3] for k in range(3)
        ]
        light = [float(np.square(one / max(one.sum(), 1)).sum()) for one in parts]
        assert picture.dtype == np.uint8
        assert int(np.argmax(light)) == plane
