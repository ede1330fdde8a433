"""Richardson and Lucy's iteration on simulated frames with photon noise."""

from dataclasses import replace

import numpy as np
import pytest
import setups_microscope as setups
from scipy.ndimage import gaussian_filter
from setups_microscope import projector_of, voxels

from clplen import DeviceError, ShapeError
from clplen.lightfield import Lattice
from clplen.microscopy.frames.prepare import Preparation
from clplen.microscopy.reconstruction.deconvolution import Acceleration, deconvolve
from clplen.microscopy.reconstruction.priors import noise_level
from clplen.microscopy.reconstruction.projector import Projector

Z = np.arange(-40, 41, 10) * 1e-6


@pytest.fixture(scope="module")
def projector(device):
    """Nine planes, 9 x 9 lenslets, voxels of 1.25 um."""
    return projector_of(device, Z)


@pytest.fixture(scope="module")
def fine(device):
    """Nine planes from -10 to 30 um."""
    return projector_of(device, np.arange(-10, 31, 5) * 1e-6)


def counted(projector, places, photons=2e6):
    return setups.counted(projector, voxels(projector, *places), photons)[0]


def test_residuals(projector):
    frame = counted(projector, [(6, 22, 18), (6, 22, 26), (2, 15, 22)])
    found = deconvolve(frame, projector, iterations=31)
    assert (np.diff(found.residuals) < 0).all()
    # reference of an independent simulation
    assert found.residuals[[10, 20, 30]] == pytest.approx([0.067, 0.025, 0.0135], rel=0.2)
    assert found.volume.sum(dtype=float) == pytest.approx(2e6, rel=0.05)
    assert found.degenerate == (0.0,)
    assert "degenerate near the native plane: z = 0 um" in repr(found)


def test_two_points_five_micrometres_apart(projector):
    frame = counted(projector, [(6, 22, 20), (6, 22, 24)])
    found = deconvolve(frame, projector, iterations=30).volume
    row = found[6, 22] / found[6, 22].max()
    assert row[22] < 0.2  # reference .11
    assert row[20] > 0.9
    assert row[24] > 0.9
    assert found[6].sum() > 0.97 * found.sum()  # reference .986


def test_background_of_each_pixel_and_frame(projector):
    """Haze that falls along x and doubles in the second frame is taken out of both."""
    frame = counted(projector, [(2, 22, 22)])
    haze = np.linspace(30, 0, projector.frame_shape[1], dtype=np.float32)
    haze = np.stack([haze, 2 * haze])[:, None, :] * np.ones(projector.frame_shape, np.float32)
    seen = np.random.default_rng(5).poisson(frame + haze)
    found = deconvolve(seen, projector, iterations=10, background=haze).volume
    even = deconvolve(
        seen, projector, iterations=10, background=haze.mean((1, 2), keepdims=True)
    ).volume
    for known, mean in zip(found, even, strict=True):
        assert known[2].sum() / known.sum() > mean[2].sum() / mean.sum() + 0.04
        assert 0 < known.sum(dtype=float) - 2e6 < 0.5 * (mean.sum(dtype=float) - 2e6)
    for bad, error in ((haze[:, :, :-1], ShapeError), (-haze, ValueError)):
        with pytest.raises(error, match="background"):
            deconvolve(seen, projector, background=bad)


def test_ahead_no_farther_than_the_last_step(device):
    """a = <g, g'>/<g', g'> within 0 and .999, of each frame."""
    g = np.random.default_rng(1).random((3, 1, 2, 5), np.float32)
    start = 10 + g
    volumes = device.upload(start)
    ahead = Acceleration(volumes, device)
    device.copy_into(volumes, device.upload(start + g), 0)
    assert not ahead.move(volumes).any()
    factors = np.array([0.5, 2, -1], np.float32)[:, None, None, None]
    second = start + g + factors * g
    device.copy_into(volumes, device.upload(second), 0)
    a = ahead.move(volumes)
    assert a == pytest.approx([0.5, 0.999, 0], rel=1e-5)
    expected = second + a[:, None, None, None] * factors * g
    assert np.allclose(device.download(volumes), expected, rtol=1e-6)


def test_memory_is_asked_for_before_anything_is_allocated(projector, monkeypatch):
    asked = []

    def refuse(nbytes, what):
        asked.append(nbytes)
        raise DeviceError(what)

    monkeypatch.setattr(projector.device, "require_memory", refuse)
    monkeypatch.setattr(projector.device, "upload", None)
    for options in ({}, {"accelerate": True}, {"prior": "gaussian"}):
        with pytest.raises(DeviceError, match="one frame"):
            deconvolve(np.ones(projector.frame_shape), projector, **options)
    volume, frame = (4 * np.prod(n) for n in (projector.volume_shape, projector.frame_shape))
    assert np.diff(asked).tolist() == [4 * volume, -1 * volume]
    with pytest.raises(DeviceError):
        projector.require_memory(1)
    assert asked[0] - asked[-1] == 2 * volume + 4 * frame


@pytest.mark.thorough
def test_stopping_at_the_noise(fine):
    frame, true = setups.counted(fine, setups.shell(fine, 15), 2e4)
    found = deconvolve(frame, fine, iterations=40, residual="noise")
    level = frame.sum() / np.square(frame, dtype=float).sum()
    assert found.residuals[-1] < level <= found.residuals[-2]
    sooner = deconvolve(frame, fine, iterations=40, residual="noise", variance=1.1)
    assert sooner.residuals[-1] < 1.1 * level <= sooner.residuals[-2]
    brighter, _ = setups.counted(fine, setups.shell(fine, 15), 1e5)
    both = deconvolve(np.stack([frame, brighter]), fine, iterations=40, residual="noise")
    later = deconvolve(brighter, fine, iterations=40, residual="noise")
    assert found.iterations < later.iterations == both.iterations < 40  # until the last is there
    # the truth itself: its residual is the sum of so many independent squares
    expected = fine.forward(true).astype(float)
    off = np.square(frame - expected)
    spread = off.std() * np.sqrt(off.size) / off.sum()
    assert off.sum() == pytest.approx(frame.sum(), rel=4 * spread)


def test_noise_of_rectified_photons(device):
    lattice = Lattice("square", (151.3, 149.7), (15.4, 0.03), (-0.03, 15.2), (300, 300))
    prepare = Preparation(16, device, None, lattice, None)
    counts = prepare(np.random.default_rng(0).poisson(20, (300, 300))).counts
    # 300^2 samples, correlated with a few neighbours
    assert counts.var() / counts.mean() == pytest.approx(prepare.variance, rel=0.02)


def twin(frame, projector, prior, accelerate, white, background, iterations=5):
    """Iterations in float64, but for the projections."""
    images = projector.images
    order, side = np.argsort(images.planes), setups.SIDE
    a = noise_level(frame[None], images)[0]
    sigma = images.voxels / np.sqrt(12) * np.maximum(1 - images.blurs, 0)

    def smooth(volume):
        if prior != "gaussian":
            return volume
        planes = (
            gaussian_filter(p, s, truncate=np.ceil(4 * s) / s) if s else p
            for p, s in zip(volume, sigma, strict=True)
        )
        return np.stack(list(planes))

    light = frame[white > 0].sum() / white.mean()
    volume = np.full(projector.volume_shape, light / np.prod(projector.volume_shape))
    e = 1e-3 * frame.sum() / volume.size / np.gradient(images.planes[order] / side).mean()
    seen = smooth(projector.backward(white).astype(float))
    before, steps = volume, []
    for _ in range(iterations):
        ahead = 0.0
        if accelerate and len(steps) > 1:
            ahead = np.vdot(steps[-1], steps[-2]) / np.vdot(steps[-2], steps[-2])
        begun = np.maximum(volume + ahead * (volume - before), 0)
        before, volume = volume, begun
        mean = white * projector.forward(smooth(volume)) + background
        back = projector.backward(white * frame / mean).astype(float)
        back = smooth(back)
        if prior == "tv":
            div = setups.divergence(volume[order], images.planes[order] / side, e)
            back[order] /= 1 - a * div
        volume = volume * back / seen
        steps.append(volume - begun)
    return smooth(volume)


@pytest.fixture(scope="module")
def uneven(device):
    """Planes in any order and at any distance."""
    rising = projector_of(device, np.array([-3, 0, 8]) * 1e-6, 5)
    images, order = rising.images, [2, 0, 1]
    stored = tuple(images.stored[k] for k in order)
    mixed = replace(images, planes=images.planes[order], stored=stored, scales=images.scales[order])
    return Projector(mixed, rising.shape, device=device)


@pytest.mark.parametrize(
    ("prior", "accelerate"),
    [
        ("gaussian", False),
        ("tv", True),
    ],
)
def test_steps(uneven, prior, accelerate):
    projector = uneven
    rng = np.random.default_rng(4)
    volume = gaussian_filter(rng.random(projector.volume_shape), (0, 2, 2)) ** 4
    frame, _ = setups.counted(projector, volume, 1e5)
    white = 1 - 0.4 * rng.random(frame.shape).astype(np.float32)
    white[10:13, 40] = 0
    frame = np.where(white > 0, white * frame, 0) + 3
    seen = np.where(white > 0, frame, 65535)  # saturated, and left out
    found = deconvolve(
        np.stack([seen, 2 * seen]), projector, iterations=5, prior=prior, accelerate=accelerate,
        white=white, background=np.array([3.0, 6.0])[:, None, None],
    ).volume[0]  # fmt: skip
    # gradients are differences of neighbours, e = 1e-3 of the mean
    expected = twin(frame, projector, prior, accelerate, white, 3.0)
    assert np.abs(found - expected).max() < 2e-4 * expected.max()


def test_how_far_light_reaches(uneven):
    z = np.abs(uneven.images.planes)
    assert uneven.images.blurs == pytest.approx(z * 20 * np.tan(np.arcsin(0.5)) / 125e-6)


def test_what_is_not_deconvolved(projector):
    for change, error, words in [
        ({"residual": -1}, ValueError, "residual must be a positive number"),
        ({"variance": None}, ValueError, "variance must be positive and finite, got None"),
        ({"prior": "tv", "strength": "1"}, ValueError, r"strength must be .* got '1'"),
        ({"start": 0}, ValueError, "A start is 0 everywhere and would stay 0"),
        ({"start": -1}, ValueError, "non-finite samples: set these voxels to 0 or more"),
        ({"white": 0}, ValueError, "The white frame is 0 everywhere"),
        ({"white": np.ones((2, 225, 225))}, ShapeError, "common to all frames, got shape"),
        ({"background": 1j}, TypeError, "background must hold real numbers"),
        ({"frame": np.ones((0, 225, 225))}, ShapeError, r"A frame must have shape .* got \(0, 225"),
        ({"projector": None}, TypeError, "projector must be a VolumeProjector, as Projector"),
        ({"frame": np.full((225, 225), -1)}, ValueError, "A frame has 50625 negative or non-fin"),
        ({"frame": np.zeros((225, 225))}, ValueError, "black"),
        ({"prior": "TV"}, ValueError, "prior must be 'tv', 'gaussian', 'time' or None, got 'TV'"),
        ({"residual": "Noise"}, ValueError, "residual must be a positive number, 'noise' or None"),
    ]:
        given = {"frame": np.ones(projector.frame_shape), "projector": projector} | change
        for name, shape in (("start", projector.volume_shape), ("white", projector.frame_shape)):
            if np.ndim(given.get(name)) == 0 and name in given:
                given[name] = np.full(shape, given[name])
        with pytest.raises(error, match=words):
            deconvolve(**given)
    few = Projector(projector.images, (9, 4), device=projector.device)
    with pytest.raises(ShapeError, match=r"at least 5 x 5 lenslets .* got 9 x 4"):
        deconvolve(np.ones(few.frame_shape), few)


@pytest.mark.thorough
def test_two_points_behind_each_other(fine):
    found = deconvolve(counted(fine, [(5, 22, 22), (7, 22, 22)]), fine, iterations=40).volume
    light = found.sum(axis=(1, 2))
    assert light[6] / min(light[5], light[7]) == pytest.approx(0.5, abs=0.1)  # reference .50
