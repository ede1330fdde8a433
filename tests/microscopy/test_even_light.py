"""Even light behind lenslets, and the pupil of a white frame: beside other ways to compute them."""

from dataclasses import replace

import numpy as np
import pytest

from clplen import MicrolensArray, PlenopticCamera, point_images
from clplen.microscopy import PointImages, Preparation, check_pupil, corrected, preparation
from clplen.microscopy.pupil.even_light import EvenLight
from clplen.microscopy.pupil.pupil_check import mean_lenslet

ABOUT = {
    "magnification": 20.0, "na": 0.5, "medium_index": 1.0, "wavelength": 525e-9,
    "apodisation": 0.5, "lenslet_pitch": 125e-6, "lenslet_focal_length": 2.5e-3,
    "lenslet_diameter": 125e-6, "lenslet_fill": "full", "binning": 3,
}  # fmt: skip
ROWS, COLUMNS, N = 11, 13, 15


def white_of(na, apodisation, rng=None, pitch=float(N)):
    """A white frame by the pupil's disc alone: rays, smeared by the lenslet's diffraction."""
    step, fine = 125e-6 / pitch, 5
    ny, nx = round(ROWS * pitch), round(COLUMNS * pitch)
    width = 525e-9 * 2.5e-3 / 125e-6  # of the lenslet's image of a point
    away = []
    for size in (ny, nx):
        x = (np.arange(size * fine) + 0.5) / fine - 0.5  # parts of pixels
        centre = (pitch - 1) / 2
        away.append(((x - centre + pitch / 2) % pitch - pitch / 2) * step)
    frequencies = np.linspace(-1, 1, 161) * 0.5 * 1.02 / 20 / 525e-9
    sine2 = (frequencies[:, None] ** 2 + frequencies**2) * (20 * 525e-9) ** 2
    weight = (sine2 <= na**2) * np.maximum(1 - sine2, 1e-9) ** apodisation
    tables = []
    for x in away:
        table = 0
        for k in (-2, -1, 0, 1, 2):  # light of lenslets beside, without interference
            table = (
                table
                + np.sinc((x[:, None] + k * 125e-6 - frequencies * 525e-9 * 2.5e-3) / width) ** 2
            )
        tables.append(table)
    found = tables[0] @ weight @ tables[1].T
    found = found.reshape(ny, fine, nx, fine).mean(axis=(1, 3))
    found *= 400 / found.mean()
    return found if rng is None else rng.poisson(found).astype(float)


def images_of(**change):
    """Point images of these optics, of which no more is asked for."""
    spots = (np.full((1, 3 * N, 3 * N), 1 / (9 * N**2), np.float32),)
    return PointImages(ABOUT | change, np.array([20e-6]), 1, N, spots, np.ones(1))


def test_even_light_is_what_point_images_add_up_to(device):
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, pixels_per_lenslet=30,
        mla=MicrolensArray(100e-6, 2.5e-3, count=5, fill="full"), device=device,
    )  # fmt: skip
    images = point_images(camera, [3e-6], voxels_per_lenslet=3, binning=3, cut=2e-3)
    total, n = 0, images.pixels
    for phase in ((a, b) for a in range(3) for b in range(3)):
        image = images.image(0, phase).astype(float)
        total = total + image.reshape(len(image) // n, n, len(image) // n, n).sum(axis=(0, 2))
    light = EvenLight(images.parameters)
    m = light.samples
    spectrum = np.fft.fft2(light.cell(1.2, 0.5))
    k = np.fft.fftfreq(m, 1 / m)
    x = ((np.arange(n) + 0.5) / n - 0.5 / m)[:, None]  # middles of pixels, in cells
    table = np.exp(2j * np.pi * k * x) * np.sinc(k / n)
    expected = (table @ spectrum @ table.T).real
    total, expected = total / total.mean(), expected / expected.mean()
    assert np.linalg.norm(total - expected) < 0.015 * np.linalg.norm(expected)
    smaller = light.cell(1.14, 0.5)
    assert np.linalg.norm(smaller - light.cell(1.2, 0.5)) > 0.05 * np.linalg.norm(smaller)


def test_a_pupil_that_fits(device):
    white = white_of(0.5, 0.5, np.random.default_rng(1))
    found = check_pupil(images_of(), preparation(N, white=white, device=device))
    # rays leave the interference of adjacent lenslets out
    assert found.misfit < 0.015
    assert found.fits
    assert (found.na, found.apodisation, found.share) == (0.5, 0.5, 0)


@pytest.mark.thorough
def test_a_smaller_pupil_is_found_and_corrected(device):
    pitch = 14.62
    white = white_of(0.475, 0.5, pitch=pitch)
    prepare = preparation(N, white=white, device=device)
    found = check_pupil(images_of(), prepare)
    assert found.misfit > 0.1
    assert not found.fits
    assert found.na == pytest.approx(0.475, abs=0.005)
    assert "NA 0.4" in found.sentence()
    right = check_pupil(images_of(na=0.475), prepare)
    assert right.fits
    ratio = found.white / found.model
    made = corrected(prepare, found)
    cell = mean_lenslet(made.sensitivity, N)[0]
    lit = found.model > 0.1 * found.model.max()
    np.testing.assert_allclose(
        (cell / cell[lit].mean())[lit], (ratio / ratio[lit].mean())[lit], atol=0.02
    )
    assert corrected(Preparation(N, device, None, None, None), found).sensitivity is None


@pytest.mark.thorough
def test_a_pupil_is_not_asked_for_without_a_white_frame(device):
    assert check_pupil(images_of(), preparation(N, device=device)) is None
    white = white_of(0.5, 0.5)
    prepare = preparation(N, white=white, device=device)
    about = {name: one for name, one in ABOUT.items() if name != "lenslet_fill"}
    bare = replace(images_of(), parameters=about)
    assert check_pupil(bare, prepare) is None
    with pytest.raises(ValueError, match="must contain lenslet_fill"):
        EvenLight(about)
    with pytest.raises(ValueError, match="15 pixels per lenslet, as the point images, got 16"):
        check_pupil(images_of(), preparation(16, white=white, device=device))
    for na in (0.0, 0.9, float("nan")):
        with pytest.raises(ValueError, match="na must be between 0 and"):
            EvenLight(ABOUT).cell(na, 0.5)
    with pytest.raises(TypeError, match="images"):
        check_pupil(None, prepare)


def test_the_mean_lenslet_and_its_noise():
    rng = np.random.default_rng(2)
    cell = rng.uniform(0.5, 1.5, (5, 5))
    light = rng.uniform(1, 3, (12, 14))
    level = np.kron(light, cell) * rng.normal(1, 0.02, (60, 70))
    level[7, 8] = 0  # left out, with its lenslet
    mean, noise = mean_lenslet(level, 5)
    assert np.allclose(mean, cell / cell.mean(), rtol=0.01)
    assert noise == pytest.approx(0.02 / np.sqrt(167), rel=0.1)
