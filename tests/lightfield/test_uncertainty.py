"""What estimate_alpha says of its own errors, and the lenslets of hexagonal arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from accuracy_uncertainty import METHODS, cover, estimates

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, estimate_alpha
from clplen.lightfield.depth.camera_optics import BAND, Pupil
from clplen.lightfield.depth.phase_slope import fit_slope
from clplen.lightfield.depth.spectral_sharpness import find_peak, sharpness
from clplen.lightfield.depth.window_measures import (
    read_lenslets,
    read_window,
    sample_noise,
)
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage


def hexagonal_camera(device, count=35):
    array = MicrolensArray(150e-6, 10e-3, count=count, lattice="hexagonal", fill="full")
    return PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=30, device=device
    )


@pytest.mark.thorough
def test_slope_of_hexagonal_arrays_has_no_bias(device):
    """Corners of the views hold neighbours' spots, and odd rows are interpolated: up to +.35."""
    camera = hexagonal_camera(device)
    random = np.random.default_rng(6)
    errors = {True: [], False: []}
    for _ in range(10):
        alpha = 1 + random.choice([-1, 1]) * random.uniform(0.1, 0.26)
        place = random.uniform(-0.5e-3, 0.5e-3, 2)
        raw = camera.expose(PointSources([(*place, float(camera.dz(alpha)))], diameter=10e-6))
        lf = LightField.from_raw(raw)
        for known in errors:  # with the raw image, and without as of a file
            one = lf if known else replace(lf, raw=None)
            errors[known].append(estimate_alpha(one, method="slope").alpha - alpha)
    # of square arrays .008 and .011 rms (every row, every other row)
    assert np.sqrt(np.mean(np.square(errors[True]))) < 0.011
    assert np.sqrt(np.mean(np.square(errors[False]))) < 0.016
    assert np.abs(errors[True]).max() < 0.03


@pytest.mark.nightly
def test_deviations_are_one_standard_deviation(device):
    """Chi square of 7 points by three methods, as if independent: 1 % outside .62 to 1.40 rms."""
    found = list(estimates(device, 7, 5))
    ratio = np.array([one.error / one.deviation for one in found])
    assert len(found) >= 19
    assert 0.62 < np.sqrt(np.mean(ratio**2)) < 1.40
    inner, outer = cover(found)
    assert 0.37 < inner < 0.98  # 68 % of 21: 3 standard deviations of a binomial are 31 %
    assert outer > 0.8  # 95 %: 14 %


def smooth(y, x):
    """A raw image, so smooth that cubic interpolation is exact to 1e-4."""
    return 3 + np.cos(0.07 * y + 0.3) * np.sin(0.05 * x - 0.2) + 0.01 * x - 0.004 * y


@pytest.mark.parametrize("exchanged", [False, True])
def test_lenslets_of_a_hexagonal_lattice(device, exchanged):
    y, x = np.indices((140, 150))
    image = device.upload(smooth(y, x).astype(np.float32))
    grid = LensletGrid(
        (11, 12), (9, 9), (12.3, 11.9), (8.1, 0.2), (-0.1, 9.4), 0.5, exchanged=exchanged
    )
    raw = RawImage(image, device, 1e-6, grid, grid)
    lf = LightField.from_raw(raw)
    at, size = ((5, 4), 9) if not exchanged else ((4, 5), 9)
    found = read_lenslets(lf, at, size)
    centre = found.samples[0, 4, 4]
    i, k = (found.y, found.x) if not exchanged else (found.x, found.y)
    i, k = np.broadcast_arrays(i, k)
    assert set(np.unique(np.round(2 * k[i % 2 == 1]) % 2)) == {
        1.0
    }  # own places, not those of views
    place = np.array(grid.first)[:, None, None] + np.multiply.outer(grid.row_step, i)
    place = place + np.multiply.outer(grid.column_step, k)
    assert np.abs(centre - smooth(*place)).max() < 2e-3
    assert np.abs(read_window(lf, at, size)[0, 4, 4] - smooth(*place)).max() > 2e-2
    assert not found.samples[0, 0, 0].any()  # a corner of the views lies on another lenslet
    # without the raw image, or with samples that are not those of it, odd rows are left out
    for other in (replace(lf, raw=replace(raw, data=device.upload(2 * image.get()))),):
        own = read_lenslets(other, at, size)
        rows = own.x if exchanged else own.y
        assert (rows % 2 == 0).all()


def test_slope_with_places_of_the_lenslets():
    """Rows and columns left out, and moved by half, on an exact line."""
    views = np.arange(21) - 10.0
    y, x = np.meshgrid(np.arange(0, 13, 2) - 6.0, np.arange(13) - 6.0, indexing="ij")
    x = x + 0.5 * (np.arange(7) % 2)[:, None]
    spots = [np.exp(-((views[:, None, None] + p / 0.9) ** 2) / 4) for p in (y, x)]
    window = np.einsum("vyx,uyx->vuyx", *spots)[None]
    found = fit_slope(window, y=y, x=x)
    assert found.disparity == pytest.approx(0.9, rel=5e-3)  # sampled spots, cut at half
    assert found.deviation < 1e-2
    assert abs(fit_slope(window).disparity - 0.9) > 0.1


@pytest.mark.parametrize(("disparity", "aspect"), [(-0.23, 1.0), (0.27, 1.155)])
def test_lenslets_that_are_lit_in_part(disparity: float, aspect: float):
    """Rays from all over a pupil of radius 8 views, in cells: no bias once they are known."""
    random = np.random.default_rng(4)
    v, u = random.uniform(-8, 8, (2, 2_000_000))
    inside = np.hypot(v, u) <= 8
    v, u = v[inside], u[inside]
    y, x = 6.3 - disparity * aspect * v, 5.8 - disparity * u
    indices = [np.rint(a).astype(int) for a in (v + 8, u + 8, y, x)]
    window = np.zeros((1, 17, 17, 13, 13))
    np.add.at(window[0], tuple(indices), 1.0)
    plain = fit_slope(window, aspect=aspect).disparity
    known = fit_slope(window, aspect=aspect, pupil=Pupil(8.0)).disparity
    assert abs(plain / disparity - 1) > 0.05
    assert known == pytest.approx(disparity, rel=0.02)
    blurred = fit_slope(window, aspect=aspect, pupil=Pupil(8.0, airy=0.3)).disparity
    assert blurred == plain


def test_noise_of_samples():
    random = np.random.default_rng(9)
    v, u = np.mgrid[:13, :17]
    bent = (0.3 * (v - 6) ** 2 + 0.2 * (u - 5) ** 2 + 2 * u)[None, :, :, None, None]
    window = bent + random.normal(0, 0.7, (1, 13, 17, 6, 7))
    inside = sample_noise(window)[:, 1:-1, 1:-1]
    # 165 views of 42 lenslets, about 9 of them alike: 2 % each way
    assert inside.mean() == pytest.approx(0.49, rel=0.08)
    assert sample_noise(bent * np.ones((1, 1, 1, 2, 2))).max() < 1e-20
    assert not sample_noise(np.ones((1, 2, 9, 3, 3))).any()


def test_deviation_of_a_peak_by_noise():
    """First order against repeated noise: 60 draws know their deviation to 9 %."""
    random = np.random.default_rng(2)
    V, U, ny, nx, d = 5, 7, 15, 19, 0.31
    k = random.uniform(-0.3, 0.3, (2, 30))
    phase = random.uniform(0, 6, 30)
    y = np.arange(ny) + d * (np.arange(V)[:, None] - (V - 1) / 2)
    x = np.arange(nx) + d * (np.arange(U)[:, None] - (U - 1) / 2)
    waves = [np.exp(2j * np.pi * k * a[..., None]) for k, a in zip(k, (y, x), strict=True)]
    clean = np.einsum("vyk,uxk,k->vuyx", *waves, np.exp(1j * phase)).real[None]
    sigma = 0.8

    def peak(window):
        measure = sharpness(window, pad=5, band=BAND)
        return measure, find_peak(measure, 0.6).position

    measure, at = peak(clean)
    stated = measure.deviation(at, np.full(clean.shape, sigma**2), step=0.005)
    drawn = [peak(clean + random.normal(0, sigma, clean.shape))[1] for _ in range(60)]
    assert np.std(drawn) == pytest.approx(stated, rel=0.3)
    assert measure.deviation(0.58, np.ones(clean.shape), step=0.005) > 0


@pytest.mark.nightly
def test_two_hundred_points_are_covered(device):
    """68 and 95 % of each method, within the 99 % limits of a binomial of 200."""
    found = list(estimates(device, 200, 77))
    for method in METHODS:
        inner, outer = cover([one for one in found if one.method == method])
        assert 0.597 < inner < 0.768
        assert 0.916 < outer < 0.993
