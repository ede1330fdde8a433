"""source_images.cl: sums of images, their transpose, and derivatives of fields by places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera
from clplen.cameras import Aberrations
from clplen.cameras.exposure.local_exposure import pixel_samples, transposed_samples
from clplen.cameras.exposure.point_gradients import point_rows, put_cotangents
from clplen.cameras.exposure.source_images import DeviceImages
from clplen.compute.device import Device
from clplen.wave.field.field import Field, Grid

BOTH = pytest.mark.parametrize("wave", ["single", "double"], indirect=True)
PLACES = np.array([(0, 0), (0, 0), (3, 1), (7, 9), (2, 2)])
SHAPES = np.array([(11, 13), (11, 13), (5, 7), (4, 4), (0, 3)])


def patches(wave: Device) -> tuple[DeviceImages, np.ndarray]:
    """Images on patches, one of them empty, and the same as large as the sensor."""
    random = np.random.default_rng(2)
    data, gains = random.random((5, 11, 13)).astype(wave.real), random.random(5) + 0.5
    whole = np.zeros((5, 11, 13))
    for n, ((y, x), (down, across)) in enumerate(zip(PLACES, SHAPES, strict=True)):
        whole[n, y : y + down, x : x + across] = gains[n] * data[n, :down, :across]
    return DeviceImages(np.arange(5), wave.upload(data), gains, PLACES, SHAPES, wave), whole


@BOTH
def test_images_add_up(wave: Device) -> None:
    images, whole = patches(wave)
    random, batch = np.random.default_rng(3), 3
    start, energies = random.random((batch, 11, 13)), random.normal(size=(batch, 5))
    totals = wave.upload(start.astype(wave.real))
    images.add(totals, energies)
    expected = start + np.einsum("bn,nyx->byx", energies, whole)
    assert relative_max(expected, wave.download(totals)) <= 8 * np.finfo(wave.real).eps


@BOTH
def test_inner_products_are_the_transpose(wave: Device) -> None:
    images, whole = patches(wave)
    pictures = np.random.default_rng(4).random((3, 11, 13))
    got = images.inner(wave.upload(pictures.astype(wave.real)))
    expected = np.einsum("byx,nyx->bn", pictures, whole)
    assert relative_max(expected, got) <= 4 * np.finfo(wave.real).eps


@BOTH
def test_cotangents_of_intensities(wave: Device) -> None:
    random = np.random.default_rng(5)
    u = (random.normal(size=(3, 7, 9, 2)) @ (1, 1j)).astype(wave.complex)
    pictures, weights = random.normal(size=(2, 7, 9)), random.random((2, 3))
    h = wave.empty(u.shape, wave.complex)
    put_cotangents(h, wave.upload(u), wave.upload(pictures.astype(wave.real)), weights, wave)
    expected = 2 * u.conj() * np.einsum("fn,fyx->nyx", weights, pictures)
    assert relative_max(expected, wave.download(h)) <= 8 * np.finfo(wave.real).eps


@BOTH
def test_transposed_samples_of_pixels(wave: Device) -> None:
    """sum(h fine(u)) = sum(transposed(h) u), no conjugates."""
    random, shape = np.random.default_rng(6), (9, 14)
    u = (random.normal(size=(2, *shape, 2)) @ (1, 1j)).astype(wave.complex)
    field = Field.from_array(u, Grid(shape, 5e-6), wavelength=5e-7, device=wave)
    fine, sums, _ = pixel_samples(field, 0.8)
    values = wave.download(fine)
    h = values.conj() + random.normal(size=values.shape)
    back = transposed_samples(wave.upload(h.astype(wave.complex)), 0.8, shape, wave)
    left, right = (h * values).sum(), (wave.download(back) * u.astype(complex)).sum()
    assert abs(left - right) <= 50 * np.finfo(wave.real).eps * abs(left)
    picture = random.random(shape)
    total = wave.zeros(shape, wave.real)
    sums.put(total, fine, 1, 1.0, wave)
    inner = (picture * wave.download(total)).sum()
    spread = sums.spread(picture, (int(fine.shape[-2]), int(fine.shape[-1])))
    assert inner == pytest.approx((spread * np.abs(values[1]) ** 2).sum(), rel=1e-5)


@pytest.mark.parametrize(
    ("wave", "diameter", "terms"),
    [("single", 60e-6, {5: (0.3e-3, -0.2e-3)}), ("double", 0.0, ()), ("double", 60e-6, ())],
    indirect=["wave"],
)
def test_derivatives_by_places(wave: Device, diameter: float, terms: object) -> None:
    """Beside central differences of the fields of points in float64."""
    camera = PlenopticCamera.type1(
        focal_length=0.12, mla=MicrolensArray(150e-6, 10e-3, count=(7, 9)), wavelength=532e-9,
        pixels_per_lenslet=9, aperture_diameter=0.5e-3, device=wave,
    ).with_aberrations(Aberrations(main_lens_field=terms))  # fmt: skip
    places, lost = np.array([(2e-4, -3e-4, -0.05), (0.0, 1e-4, 0.04)]), np.array([0.3, -0.2])
    e0 = camera.optics.spherical_waves(places, full_grid=False)
    h = np.random.default_rng(7).normal(size=(*e0.shape, 2)) @ (1, 1j)
    given = wave.upload(h.astype(wave.complex))
    got = point_rows(camera.optics, e0, given, places, diameter, lost)
    if not wave.has_fp64:
        pytest.skip("no double precision to compare with")
    exact = replace(camera.optics, device=Device.open(wave.place, precision="double"))
    tolerance = 1e-6 if wave.precision == "double" else 1e-4
    for axis, step in enumerate((1e-8, 1e-8, 1e-6)):
        sums = []
        for sign in (1, -1):
            moved = places.copy()
            moved[:, axis] += sign * step
            e = exact.spherical_waves(moved, diameter, full_grid=False).to_numpy()
            sums.append((h * e).real.sum(axis=(1, 2)) - lost * (abs(e) ** 2).sum(axis=(1, 2)))
        assert relative_max((sums[0] - sums[1]) / (2 * step), got[:, axis]) <= tolerance
    if terms:
        e = exact.spherical_waves(places, diameter, full_grid=False)
        turned = -2 * np.pi * (h * e.to_numpy()).imag
        for axis, turns in enumerate(exact.field_turns(e)[1:], start=3):
            slope = (turned * turns).sum(axis=(1, 2))
            assert relative_max(slope, got[:, axis]) <= tolerance
