"""Richardson and Lucy's iteration on simulated frames with photon noise."""

from dataclasses import replace

import numpy as np
import pytest
import setups_microscope as setups
from scipy.ndimage import gaussian_filter
from setups_microscope import projector_of, voxels, wrong

from clplen import DeviceError, ShapeError
from clplen.lightfield import Lattice
from clplen.microscopy.frames.prepare import Preparation
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.deconvolution import Acceleration, deconvolve
from clplen.microscopy.reconstruction.priors import TotalVariation, blurs, noise_level
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


@pytest.mark.thorough
def test_background_white_and_series(projector):
    voxels = [(2, 22, 22)]
    white = 1 - 0.4 * np.random.default_rng(2).random(projector.frame_shape).astype(np.float32)
    white[100:103, 40] = 0
    frame = counted(projector, voxels)
    seen = np.random.default_rng(3).poisson(white * frame + 5.0)
    seen[100:103, 40] = 65535  # saturated, and left out
    series = np.stack([seen, 2 * seen])
    found = deconvolve(series, projector, iterations=10, background=5, white=white)
    assert found.volume.shape == (2, *projector.volume_shape)
    assert found.volume[0, 2].sum() > 0.93 * found.volume[0].sum()
    assert found.volume[0].sum(dtype=float) == pytest.approx(2e6, rel=0.05)
    series[:, 100:103, 40] = 0  # whatever a pixel that is left out holds
    same = deconvolve(series, projector, iterations=10, background=5, white=white)
    assert np.array_equal(same.residuals, found.residuals)
    assert np.array_equal(same.volume, found.volume)
    without = deconvolve(seen, projector, iterations=10, white=white)
    assert without.volume[2].sum() < 0.9 * without.volume.sum()
    again = deconvolve(
        seen, projector, iterations=9, background=5, white=white, start=found.volume[0],
        residual=1.0,
    )  # fmt: skip
    assert again.iterations == 1


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


@pytest.mark.thorough
def test_two_points_in_the_native_plane(device):
    """References of an independent simulation, to .1: the least between over the lower peak."""
    projector = projector_of(device, [0.0])
    for last, reference in ((22, 0.90), (23, 0.78), (24, 0.15)):
        first = 20
        found = deconvolve(
            counted(projector, [(0, 22, first), (0, 22, last)], 1e6), projector, iterations=60
        ).volume[0]
        row = found[22, first : last + 1]
        assert row.min() / min(row[0], row[-1]) == pytest.approx(reference, abs=0.1)
        assert row[[0, -1]].sum() < 0.4 * found.sum()  # .29 to .37: degenerate


@pytest.mark.thorough
def test_two_points_behind_each_other(fine):
    found = deconvolve(counted(fine, [(5, 22, 22), (7, 22, 22)]), fine, iterations=40).volume
    light = found.sum(axis=(1, 2))
    assert light[6] / min(light[5], light[7]) == pytest.approx(0.5, abs=0.1)  # reference .50


@pytest.mark.thorough
def test_acceleration(projector):
    """Twelve iterations go as far as twenty."""
    frame = counted(projector, [(6, 22, 18), (6, 22, 26), (2, 15, 22)])
    plain = deconvolve(frame, projector, iterations=24)
    quick = deconvolve(np.stack([frame, 2 * frame]), projector, iterations=13, accelerate=True)
    assert quick.residuals[0, 12] < plain.residuals[20]
    assert (np.diff(quick.residuals[0]) < 0).all()
    # every frame has its own step, and that does not depend on how bright it is
    assert quick.residuals[1] == pytest.approx(quick.residuals[0], rel=1e-2)
    assert quick.volume[0].sum(dtype=float) == pytest.approx(2e6, rel=0.05)


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


@pytest.mark.thorough
def test_total_variation_never_doubles_a_step(uneven):
    dark = np.full((1, *uneven.frame_shape), 1e-4)
    (a,) = TotalVariation(uneven, dark, 1.0).weights
    thickness = np.gradient(np.sort(uneven.images.planes)) / setups.SIDE
    assert a == pytest.approx(0.5 / (4 + 2 / thickness.min()))


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


@pytest.mark.parametrize(
    ("origin", "row", "column"),
    [
        ((151.3, 149.7), (15.4, 0.03), (-0.03, 15.2)),
        ((151.5, 149.5), (16.0, 0.0), (0.0, 16.0)),  # on the pixels of the camera
        ((151.9, 149.8), (16.0, 0.0), (0.0, 16.0)),  # always between them
    ],
)
def test_noise_of_rectified_photons(device, origin, row, column):
    lattice = Lattice("square", origin, row, column, (300, 300))
    prepare = Preparation(16, device, None, lattice, None)
    counts = prepare(np.random.default_rng(0).poisson(20, (300, 300))).counts
    # 300^2 samples, correlated with a few neighbours
    assert counts.var() / counts.mean() == pytest.approx(prepare.variance, rel=0.02)


def twin(frame, projector, prior, accelerate, iterations=5):
    """Iterations in float64, but for the projections."""
    images = projector.images
    order, side = np.argsort(images.planes), setups.SIDE
    a = noise_level(frame[None], images)[0]
    sigma = images.voxels / np.sqrt(12) * np.maximum(1 - blurs(images), 0)

    def smooth(volume):
        if prior != "gaussian":
            return volume
        planes = (
            gaussian_filter(p, s, truncate=np.ceil(4 * s) / s) if s else p
            for p, s in zip(volume, sigma, strict=True)
        )
        return np.stack(list(planes))

    volume = np.full(projector.volume_shape, frame.sum() / np.prod(projector.volume_shape))
    e = 1e-3 * volume.flat[0] / np.gradient(images.planes[order] / side).mean()
    seen = smooth(projector.backward(np.ones(projector.frame_shape)).astype(float))
    before, steps = volume, []
    for _ in range(iterations):
        ahead = 0.0
        if accelerate and len(steps) > 1:
            ahead = np.vdot(steps[-1], steps[-2]) / np.vdot(steps[-2], steps[-2])
        begun = np.maximum(volume + ahead * (volume - before), 0)
        before, volume = volume, begun
        back = projector.backward(frame / projector.forward(smooth(volume))).astype(float)
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
    rising = projector_of(device, np.array([-3, 0, 6, 14]) * 1e-6, 5)
    images, order = rising.images, [2, 0, 1, 3]
    stored = tuple(images.stored[k] for k in order)
    mixed = replace(images, planes=images.planes[order], stored=stored, scales=images.scales[order])
    return Projector(mixed, rising.shape, device=device)


@pytest.mark.parametrize(
    ("prior", "accelerate"),
    [
        pytest.param("tv", False, marks=pytest.mark.thorough),
        ("gaussian", False),
        pytest.param(None, True, marks=pytest.mark.thorough),
        ("tv", True),
    ],
)
def test_steps(uneven, prior, accelerate):
    projector = uneven
    rng = np.random.default_rng(4)
    volume = gaussian_filter(rng.random(projector.volume_shape), (0, 2, 2)) ** 4
    frame, _ = setups.counted(projector, volume, 1e5)
    frame = frame + 1
    found = deconvolve(frame, projector, iterations=5, prior=prior, accelerate=accelerate).volume
    # gradients are differences of neighbours, e = 1e-3 of the mean
    expected = twin(frame, projector, prior, accelerate)
    assert np.abs(found - expected).max() < 2e-4 * expected.max()


@pytest.mark.thorough
def test_noise_of_a_step(fine):
    """What voxels see of Poisson counts where the volume is right."""
    bead, _ = setups.counted(fine, voxels(fine, (5, 22, 22)), 1e4)
    few, _ = setups.counted(fine, voxels(fine, (5, 22, 22)), 1e3)
    # the factor of a voxel alone is that of the sum of the counts; planes differ in their images
    level, higher = (noise_level(one[None], fine.images)[0] for one in (bead, few))
    assert level == pytest.approx(0.01, rel=0.2)
    assert higher == pytest.approx(level * np.sqrt(10), rel=0.1)
    frame, true = setups.counted(fine, setups.shell(fine, 15), 2e5)
    expected = fine.forward(true)
    back = fine.backward(np.divide(frame, expected, where=expected > 0, out=0.0 * expected))
    rms = np.sqrt(np.average((back / fine.backward(np.ones(frame.shape)) - 1) ** 2, weights=true))
    # pixels of all levels count alike in the true one, bright ones more in the estimate
    assert 0.6 * rms < noise_level(frame[None], fine.images)[0] < rms


def test_how_far_light_reaches():
    about = {"magnification": 60, "na": 1.2, "medium_index": 1.33, "lenslet_pitch": 1e-4}
    z = np.array([-2e-6, 0, 1e-6])
    found = blurs(PointImages(about, z, 1, 1, (), np.ones(3)))
    assert found == pytest.approx(np.abs(z) * 60 * np.tan(np.arcsin(1.2 / 1.33)) / 1e-4)


@pytest.mark.thorough
def test_total_variation_against_noise(fine):
    frame, true = setups.counted(fine, setups.shell(fine, 15), 1e4)
    free = wrong(deconvolve(frame, fine, iterations=20).volume, true)
    found = deconvolve(frame, fine, iterations=20, prior="tv", accelerate=True)
    assert wrong(found.volume, true) < 0.85 * free
    less = deconvolve(frame, fine, iterations=20, prior="tv", strength=0.2)
    assert wrong(found.volume, true) < wrong(less.volume, true) < free


@pytest.mark.thorough
def test_gaussian_against_the_native_plane(fine):
    """Nothing lies within 6 um of the native plane."""
    volume, near = setups.filaments(fine), blurs(fine.images) < 0.5
    volume[near] = 0
    frame, true = setups.counted(fine, volume, 2e4)
    free, found = (
        deconvolve(frame, fine, iterations=30, prior=prior).volume for prior in (None, "gaussian")
    )
    assert np.linalg.norm(found[near]) < 0.75 * np.linalg.norm(free[near])
    assert found[near].sum() / found.sum() < 0.9 * free[near].sum() / free.sum()
    assert wrong(found, true) < wrong(free, true)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"iterations": np.nan}, ValueError, "iterations is a whole number from 1 on, not nan"),
        ({"residual": -1}, ValueError, "residual is a positive number"),
        ({"residual": [0.1]}, ValueError, "residual is a positive number"),
        ({"variance": None}, ValueError, "variance is positive and finite, not None"),
        ({"prior": "tv", "strength": "1"}, ValueError, "strength is positive and finite, not '1'"),
        ({"start": 0}, ValueError, "A start is 0 everywhere, and would stay so"),
        ({"start": -1}, ValueError, "not finite samples: a start is 0 or more and finite"),
        ({"white": 0}, ValueError, "The white frame is 0 everywhere"),
        ({"white": np.ones((2, 225, 225))}, ShapeError, "one for all frames, not of shape"),
        ({"background": 1j}, TypeError, "background holds real numbers"),
        ({"frame": np.ones((225, 225), complex)}, TypeError, "A frame holds real numbers, not c"),
        ({"frame": None}, TypeError, "A frame is an array of numbers, not of type NoneType"),
        ({"frame": np.ones((0, 225, 225))}, ShapeError, r"A frame has shape .* not \(0, 225"),
        ({"projector": None}, TypeError, "projector is a Projector, as Projector.* gives it"),
    ],
)
def test_what_is_not_deconvolved(projector, change, error, words):
    given = {"frame": np.ones(projector.frame_shape), "projector": projector} | change
    for name, shape in (("start", projector.volume_shape), ("white", projector.frame_shape)):
        if np.ndim(given.get(name)) == 0 and name in given:
            given[name] = np.full(shape, given[name])
    with pytest.raises(error, match=words):
        deconvolve(**given)


def test_bad_input(device, projector):
    frame = np.ones(projector.frame_shape)
    with pytest.raises(ShapeError, match="A frame has shape"):
        deconvolve(frame[1:], projector)
    frame[3, 4:6] = -1
    with pytest.raises(ValueError, match="A frame has 2 negative or not finite"):
        deconvolve(frame, projector)
    with pytest.raises(ValueError, match="black"):
        deconvolve(0 * np.abs(frame), projector, prior="tv")
    with pytest.raises(ValueError, match="from 1 on"):
        deconvolve(np.abs(frame), projector, iterations=0)
    with pytest.raises(ValueError, match="prior is 'tv', 'gaussian', 'time' or None, not 'TV'"):
        deconvolve(np.abs(frame), projector, prior="TV")
    with pytest.raises(ValueError, match="strength is positive and finite, not 0"):
        deconvolve(np.abs(frame), projector, prior="tv", strength=0)
    for residual in (0, np.nan, "Noise"):
        with pytest.raises(ValueError, match="residual is a positive number, 'noise' or None"):
            deconvolve(np.abs(frame), projector, residual=residual)
    start = np.ones((2, *projector.volume_shape))
    with pytest.raises(ShapeError, match="A start is of one frame or of all 3, not of 2"):
        deconvolve(np.abs([frame] * 3), projector, start=start)
    few = Projector(projector.images, (9, 4), device=device)
    with pytest.raises(ShapeError, match="9 x 4 lenslets; at least 5 x 5"):
        deconvolve(np.ones(few.frame_shape), few)
