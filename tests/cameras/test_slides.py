"""Slides before a plenoptic camera: lit by coherent, partially coherent and incoherent light."""

from dataclasses import replace

import numpy as np
import pytest

from clplen import (
    Coherence,
    Field,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SamplingError,
    Spectrum,
    propagate,
    thin_lens,
)
from clplen.wave import ExtendedSource, IncoherentLight, RandomPhaseMask

COUNT, PIXELS = 15, 13  # an odd grid: samples of a slide lie on those of the grid


@pytest.fixture
def camera(device):
    mla = MicrolensArray(150e-6, 10e-3, count=COUNT, fill="full")
    return PlenopticCamera.type1(
        focal_length=0.03, mla=mla, wavelength=532e-9, pixels_per_lenslet=PIXELS, device=device
    )


def picture(ny=20, nx=24):
    """An L with a dot: no symmetry."""
    t = np.zeros((ny, nx))
    t[2 : ny - 3, 3:8] = 1
    t[ny - 6 : ny - 3, 3 : nx - 4] = 0.6
    t[4:8, nx - 7 : nx - 3] = 0.3
    return t


def slide(camera, dz=0.0, samples=1):
    t = picture()
    return PicturePlane(t, t.shape[1] * samples * camera.pixel_pitch, dz, mode="transmission")


def by_hand(camera, plane, *, koehler=True, wavelength=532e-9):
    """The raw image of a slide in a plane wave, step by step, everything padded."""
    grid, device = camera.grid, camera.device
    ny, nx = plane.image.shape
    # the middle of sample (ny//2, nx//2) lies on the axis
    size = round(plane.pitch / grid.pitch[1])
    big = np.kron(np.sqrt(plane.image), np.ones((2 * size, 2 * size)))  # half samples
    fine = np.zeros((2 * grid.shape[0], 2 * grid.shape[1]))
    y0 = grid.shape[0] - (2 * (ny // 2) + 1) * size
    x0 = grid.shape[1] - (2 * (nx // 2) + 1) * size
    fine[y0 : y0 + big.shape[0], x0 : x0 + big.shape[1]] = big
    t = fine.reshape(grid.shape[0], 2, grid.shape[1], 2).mean(axis=(1, 3)) / size
    field = Field.from_array(t, grid, wavelength=wavelength, device=device)
    z = camera.object_distance + plane.z
    if koehler:
        field = thin_lens(field, z)
    field = thin_lens(propagate(field, z), camera.focal_length, diameter=camera.aperture_diameter)
    field = camera.mla.apply(propagate(field, camera.image_distance))
    return propagate(field, camera.mla.f).intensity().to_numpy().astype(float)


@pytest.mark.parametrize(("dz", "koehler"), [(-4e-3, True), (5e-3, False)])
def test_a_coherent_slide_step_by_step(camera, dz, koehler):
    plane = slide(camera, dz, samples=2)
    raw = camera.expose(plane, coherence=Coherence(), koehler=koehler)
    expected = by_hand(camera, plane, koehler=koehler)
    # what the camera's band limit and its windows without padding leave out
    assert np.abs(raw.to_numpy() - expected).max() <= 0.01 * expected.max()
    assert raw.exposure.snapshots is None
    assert np.abs(expected - expected[::-1]).max() > 0.2 * expected.max()
    assert np.abs(expected - expected.T).max() > 0.2 * expected.max()


@pytest.mark.thorough
def test_incoherent_light_makes_a_slide_shine(camera):
    plane = slide(camera)
    shining = PicturePlane(plane.image, plane.width)
    expected = camera.expose(shining, method="points").to_numpy().astype(float)
    snapshots = 60
    raw = camera.expose(plane, coherence=Coherence(IncoherentLight(), seed=1), snapshots=snapshots)
    found = raw.to_numpy().astype(float)
    found *= expected.sum() / found.sum()  # a slide's light spreads beside the aperture too
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error <= 1.5 / np.sqrt(snapshots)
    assert raw.exposure.snapshots == snapshots
    reported = raw.exposure.standard_error.to_numpy()
    ratio = np.linalg.norm(reported) / np.linalg.norm(raw.to_numpy())
    assert 0.5 / np.sqrt(snapshots) <= ratio <= 1.5 / np.sqrt(snapshots)


def test_wavelengths_of_points_add(camera):
    points = PointSources([(1e-4, -5e-5, 0.0)])
    lines = Spectrum.lines([500e-9, 560e-9], [1, 3])
    raw = camera.expose(points, coherence=Coherence(None, lines)).to_numpy().astype(float)
    expected = sum(
        share * replace(camera, wavelength=lam).expose(points).to_numpy().astype(float)
        for lam, share in ((500e-9, 0.25), (560e-9, 0.75))
    )
    assert np.abs(raw - expected).max() <= 1e-5 * expected.max()


def test_light_on_two_slides_is_independent(camera):
    light, plane = Coherence(IncoherentLight(), seed=4), slide(camera)
    one = camera.expose(plane, coherence=light, snapshots=30)
    two = camera.expose([plane, plane], coherence=light, snapshots=30)
    scatter = np.linalg.norm(two.to_numpy() - 2 * one.to_numpy())
    assert scatter > 0.5 * np.linalg.norm(two.exposure.standard_error.to_numpy())
    ratio = np.linalg.norm(two.exposure.standard_error.to_numpy()) / np.linalg.norm(
        one.exposure.standard_error.to_numpy()
    )
    assert ratio == pytest.approx(np.sqrt(2), rel=0.1)


def test_light_that_misses_the_lens_is_refused(camera):
    camera = replace(camera, aperture_diameter=5e-4)
    plane = slide(camera, samples=4)
    light = Coherence(ExtendedSource(5e-6, 0.1))
    with pytest.raises(SamplingError, match="misses the pupil"):
        camera.expose(plane, coherence=light, koehler=False, snapshots=1)
    assert camera.expose(plane, coherence=light, snapshots=1).exposure.snapshots == 1


def test_a_checkpoint_of_a_slide(camera, tmp_path):
    file, plane = tmp_path / "slide.npz", slide(camera)
    light = Coherence(RandomPhaseMask(camera.grid.extent[1] / 30))
    camera.expose(plane, coherence=light, snapshots=3, checkpoint=file)
    resumed = camera.expose(plane, coherence=light, snapshots=8, checkpoint=file)
    whole = camera.expose(plane, coherence=light, snapshots=8)
    assert np.array_equal(resumed.to_numpy(), whole.to_numpy())


def test_what_does_not_fit_together(camera):
    for scene, options, words in [
        ("slide", {}, "coherence must be given"),
        ("points", {"coherence": Coherence(IncoherentLight())}, "are incoherent"),
        ("points", {"coherence": Coherence(), "snapshots": 5}, "leave them out for this scene"),
        ("slide", {"coherence": Coherence(), "method": "banana"}, "method must be"),
        ("slides", {"coherence": Coherence(), "checkpoint": "x.npz"}, "one slide"),
    ]:
        scenes = {
            "slide": slide(camera),
            "slides": [slide(camera), slide(camera, 1e-3)],
            "points": PointSources([(0, 0, 0)]),
        }
        with pytest.raises(ValueError, match=words):
            camera.expose(scenes[scene], **options)
    with pytest.raises(TypeError, match="coherence must be a Coherence"):
        camera.expose(slide(camera), coherence=RandomPhaseMask(1e-4))
    with pytest.raises(SamplingError, match="imaged at"):
        camera.expose(slide(camera, samples=12), coherence=Coherence())


def test_a_slide_is_judged_before_anything_is_exposed(camera):
    seen = []
    shining = PicturePlane(picture(), slide(camera).width)
    with pytest.raises(SamplingError, match="use "):
        camera.expose(
            [shining, slide(camera)],
            coherence=Coherence(RandomPhaseMask(1.01e-4)),
            progress=lambda *_: seen.append(1),
        )
    assert not seen
