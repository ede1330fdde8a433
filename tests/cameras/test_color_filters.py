"""Colour filters and spectra: raw images beside sums of those of single wavelengths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from accuracy_color import (
    apart,
    by_wavelengths,
    dispersive,
    focal_length_in_image,
    focal_length_of,
    place_in_image,
    white_cameras,
)

from clplen import (
    Coherence,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SamplingError,
    Spectrum,
)
from clplen.cameras import ColorFilterArray, PixelArray
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.wave import SpectralDistribution

pytestmark = pytest.mark.thorough

LAM = 500e-9
LINES = (430e-9, 520e-9, 655e-9)
SHARES = (0.5, 0.2, 0.3)
LIGHT = Spectrum.lines(LINES, SHARES)
CURVES = {
    "R": SpectralDistribution([420e-9, 560e-9, 690e-9], [0.02, 0.1, 0.8]),
    "G": SpectralDistribution([400e-9, 540e-9, 700e-9], [0.05, 0.6, 0.1]),
    "B": SpectralDistribution([390e-9, 450e-9, 660e-9], [0.3, 0.7, 0.01]),
    "clear": SpectralDistribution([380e-9, 750e-9], [0.9, 0.5]),
}
TILES = {
    "bayer": ColorFilterArray.bayer("GBRG", CURVES),
    "quad": ColorFilterArray.quad_bayer("RGGB", CURVES, per="energy"),
    "five": ColorFilterArray([["B", "clear", "R", "G", "B"]] * 2 + [["clear"] * 5], CURVES),
}


def camera_of(device: Device, **change: Any) -> Any:
    """A camera of f/4 with lenslets of 10 um, whose sensor has an odd shape."""
    mla = MicrolensArray(10e-6, 40e-6, count=(13, 15), lattice="hexagonal")
    values: dict[str, Any] = {
        "focal_length": 10e-3, "object_distance": 1.0, "aperture_diameter": 2.5e-3, "mla": mla,
        "wavelength": LAM, "device": device,
        "pixels": PixelArray(pitch=1.25e-6, shape=(93, 101), offset=(2e-6, -3e-6)),
    }  # fmt: skip
    return PlenopticCamera.type1(**(values | change))


def with_filters(camera: Any, filters: ColorFilterArray | None, **change: Any) -> Any:
    return replace(camera, pixels=replace(camera.pixels, filters=filters, **change))


def single(camera: Any, scene: Any, wavelength: float) -> np.ndarray[Any, Any]:
    """The raw image at one wavelength without filters, float64."""
    return replace(camera, wavelength=wavelength).expose(scene).to_numpy().astype(np.float64)


def expected_of(camera: Any, scene: Any, filters: ColorFilterArray) -> np.ndarray[Any, Any]:
    """Sums over the lines of the light, by pixel, in float64."""
    parts = [single(camera, scene, lam) for lam in LINES]
    ny, nx = parts[0].shape
    total = np.zeros((ny, nx))
    for y in range(ny):
        for x in range(nx):
            name = filters.tile[y % len(filters.tile)][x % len(filters.tile[0])]
            for lam, share, part in zip(LINES, SHARES, parts, strict=True):
                photons = lam / LAM if filters.per == "photon" else 1.0
                total[y, x] += share * CURVES[name](lam) * photons * part[y, x]
    return total


def integral(values: Any, lam: Any) -> Any:
    """Over the wavelength, by the trapezoidal rule along the first axis."""
    return np.tensordot(np.diff(lam), (values[1:] + values[:-1]) / 2, (0, 0))


POINT = (3e-4, -5e-4, 0.1)


@pytest.mark.parametrize("name", ["quad", "five"])
def test_a_mosaic_is_the_sum_of_its_wavelengths(device: Device, name: str) -> None:
    camera, filters = camera_of(device), TILES[name]
    raw = with_filters(camera, filters).expose(PointSources(POINT, power=2.5, spectrum=LIGHT))
    wanted = expected_of(camera, PointSources(POINT, power=2.5), filters)
    np.testing.assert_allclose(raw.to_numpy(), wanted, atol=2e-6 * wanted.max())
    assert raw.mosaic == filters.tile
    assert raw.exposure is not None
    assert raw.exposure.wavelengths == 3


def test_a_monochrome_sensor_and_a_spectrum_of_the_scene(device: Device) -> None:
    camera = camera_of(device)
    grey = ColorFilterArray.monochrome(CURVES["G"])
    coherent = with_filters(camera, grey).expose(
        PointSources(POINT), coherence=Coherence(None, LIGHT)
    )
    own = with_filters(camera, grey).expose(PointSources(POINT, spectrum=LIGHT))
    np.testing.assert_array_equal(own.to_numpy(), coherent.to_numpy())
    parts = [single(camera, PointSources(POINT), lam) for lam in LINES]
    factors = [s * CURVES["G"](lam) * lam / LAM for s, lam in zip(SHARES, LINES, strict=True)]
    wanted = np.tensordot(factors, parts, (0, 0))
    np.testing.assert_allclose(own.to_numpy(), wanted, atol=2e-6 * wanted.max())
    assert own.mosaic is None
    # without filters: the energy of all wavelengths
    bare = camera.expose(PointSources(POINT, spectrum=LIGHT)).to_numpy()
    wanted = np.tensordot(SHARES, parts, (0, 0))
    np.testing.assert_allclose(bare, wanted, atol=2e-6 * wanted.max())
    # one wavelength, that of the camera: the image times the sensitivity
    plain = with_filters(camera, grey).expose(PointSources(POINT)).to_numpy()
    wanted = CURVES["G"](LAM) * single(camera, PointSources(POINT), LAM)
    np.testing.assert_allclose(plain, wanted, atol=2e-6 * wanted.max())


def test_crosstalk_leaks_between_colours_after_the_filters(device: Device) -> None:
    kernel = ((0.01, 0.03, 0.0), (0.05, 0.8, 0.02), (0.0, 0.06, 0.02))
    camera, scene = with_filters(camera_of(device), TILES["bayer"]), PointSources(POINT)
    clean = camera.expose(scene).to_numpy().astype(np.float64)
    mixed = with_filters(camera, TILES["bayer"], crosstalk=kernel).expose(scene).to_numpy()
    wide = np.pad(clean, 1)
    ny, nx = clean.shape
    # kernel[1 + j, 1 + i] is what pixel (y, x) gives to (y + j, x + i)
    wanted = sum(
        kernel[1 + j][1 + i] * wide[1 - j : 1 - j + ny, 1 - i : 1 - i + nx]
        for j in (-1, 0, 1)
        for i in (-1, 0, 1)
    )
    np.testing.assert_allclose(mixed, wanted, atol=2e-6 * clean.max())


PICTURE = np.array([[[0.7, 0.1], [0.0, 0.9]], [[0.0, 0.0], [0.4, 0.0]], [[0.0, 0.0], [0.2, 0.3]]])


def test_a_picture_is_the_sum_of_its_points_and_channels(device: Device) -> None:
    camera = with_filters(camera_of(device), TILES["five"])
    lights = [LIGHT, Spectrum.lines([470e-9, 640e-9], [0.3, 0.7])]
    plane = PicturePlane(PICTURE, 1.1e-3, 0.05, spectra=lights)
    found = camera.expose(plane).to_numpy()
    wanted = np.zeros(found.shape)
    for channel, light in enumerate(lights):
        energies = PICTURE[..., channel].ravel()
        lit = energies > 0
        points = PointSources(plane.positions()[lit], power=energies[lit], spectrum=light)
        wanted += camera.expose(points).to_numpy()
    np.testing.assert_allclose(found, wanted, atol=3e-6 * wanted.max())


def test_all_methods_put_the_same_colours_on_the_same_pixels(device: Device) -> None:
    mla = MicrolensArray(150e-6, 10e-3, count=9, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.12, wavelength=LAM, aperture_diameter=1.2e-3, mla=mla,
        pixels_per_lenslet=15, pixels=PixelArray(fill_factor=0.7, filters=TILES["bayer"]),
        device=device,
    )  # fmt: skip
    scene = PicturePlane(PICTURE.sum(axis=2), 4e-4, 0.01, spectra=Spectrum.monochromatic(600e-9))
    found = {
        method: camera.expose(scene, method=method).to_numpy().astype(np.float64)
        for method in ("points", "local", "isoplanatic")
    }
    assert apart(found["local"], found["points"]) < 3e-2  # light that leaves the whole window
    assert apart(found["isoplanatic"], found["points"]) < 3e-2
    shifted = np.roll(found["points"], 1, axis=1)
    assert apart(shifted, found["points"]) > 0.1


def test_white_balance_makes_white_grey() -> None:
    daylight = SpectralDistribution.illuminant("D65")
    for filters in (ColorFilterArray.bayer(), TILES["bayer"]):
        factors = filters.white_balance(daylight)
        lam = np.linspace(380e-9, 760e-9, 76001)
        seen = filters.response(lam, 600e-9) * daylight(lam)[:, None]
        signals = integral(seen, lam)
        balanced = [factors[n] * s for n, s in zip(filters.names, signals, strict=True)]
        np.testing.assert_allclose(balanced, balanced[0], rtol=1e-4)
        assert min(factors.values()) == 1
    with pytest.raises(ValueError, match="The filter 'B' transmits nothing of this light"):
        TILES["bayer"].white_balance(Spectrum.monochromatic(680e-9))


def test_tiles_of_two_sizes() -> None:
    assert ColorFilterArray.bayer("grbg").tile == (("G", "R"), ("B", "G"))
    quad = ColorFilterArray.quad_bayer("GRBG")
    assert ["".join(row) for row in quad.tile] == ["GGRR", "GGRR", "BBGG", "BBGG"]
    assert quad.shape == (4, 4)
    assert ColorFilterArray.monochrome().mosaic is None
    for filters in (*TILES.values(), quad):
        assert ColorFilterArray.from_json(filters.to_json()) == filters
        pixels = PixelArray(filters=filters, crosstalk=((0.1, 0.8, 0.1),))
        assert PixelArray.from_json(pixels.to_json()) == pixels


def test_built_in_sensitivities_are_the_fit_that_they_say() -> None:
    """Peaks of a Nikon D5100 (Darrodi et al. 2015): blue 470, green 520 to 530, red 590 nm."""
    filters = ColorFilterArray.bayer()
    assert filters.per == "energy"
    for name, low, high in (("B", 440, 480), ("G", 510, 540), ("R", 580, 610)):
        curve = filters.sensitivities[filters.names.index(name)]
        peak = curve.wavelengths[int(np.argmax(curve.values))]
        assert low <= 1e9 * peak <= high
        assert max(curve.values) == pytest.approx(1, abs=0.05)
        assert curve(399e-9) == curve(701e-9) == 0


WRONG: list[tuple[Any, type[Exception], str]] = [
    (lambda: ColorFilterArray.bayer("RGBG"), ValueError, "RGGB, GRBG, GBRG, BGGR"),
    (lambda: ColorFilterArray([[]], {}), ValueError, "tile must not be empty"),
    (lambda: ColorFilterArray("RGGB", CURVES), TypeError, "rows of names"),
    (lambda: ColorFilterArray(["RG", "B"], CURVES), ValueError, r"\[2, 1\]"),
    (lambda: ColorFilterArray(["RX"], CURVES), ValueError, "but 'X' is missing"),
    (lambda: ColorFilterArray(["R"], {"R": 0.5}), TypeError, "got float"),
    (lambda: ColorFilterArray(["R"], CURVES, per="watt"), ValueError, "'photon' or"),
    (lambda: PixelArray(filters="RGGB"), TypeError, r"ColorFilterArray.bayer\('RGGB'\)"),
    (lambda: PointSources((0, 0, 0), spectrum=5e-7), TypeError, "got float"),
    (lambda: PicturePlane(np.ones((2, 2, 3)), 1e-3), ShapeError, "has 3 channels"),
    (
        lambda: PicturePlane(np.ones((2, 2, 3)), 1e-3, spectra=[LIGHT]),
        ShapeError,
        "3 elements .* got 1",
    ),
    (
        lambda: PicturePlane(np.ones((2, 2)), 1e-3, mode="transmission", spectra=LIGHT),
        ValueError,
        "spectra must be None for a slide",
    ),
]  # fmt: skip


def test_what_is_refused() -> None:
    for make, error, words in WRONG:
        with pytest.raises(error, match=words):
            make()


def test_scenes_that_are_refused(device: Device) -> None:
    camera = with_filters(camera_of(device), TILES["bayer"])
    with pytest.raises(ValueError, match="filter transmits the light of this source, about 780 nm"):
        camera.expose(PointSources((0, 0, 0), spectrum=Spectrum.monochromatic(780e-9)))
    blind = [LIGHT, Spectrum.monochromatic(900e-9)]
    with pytest.raises(ValueError, match="channel 1 of the picture, about 900 nm"):
        camera.expose(PicturePlane(PICTURE, 1e-4, spectra=blind))
    with pytest.raises(ValueError, match="does not support colour filters"):
        camera.expose(PointSources((0, 0, 0)), model="rays")
    for behind in (-1.0, -1.5):
        with pytest.raises(ValueError, match="behind the main lens"):
            camera.expose(PointSources((0, 0, behind), spectrum=LIGHT))
    with pytest.raises(SamplingError, match="field of view"):
        camera.expose(PointSources((0.1, 0, 0), spectrum=LIGHT))


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["f/5, SF11", "f/8, 40 um"])
def test_the_plan_takes_enough_wavelengths_and_not_many_more(device: Device, name: str) -> None:
    camera, light = white_cameras(device)[name], SpectralDistribution.illuminant("D65")
    point = (2e-4, -1e-4, 0.0)
    wanted, most = by_wavelengths(camera, point, light, 41)
    assert most == 41
    found, n = by_wavelengths(camera, point, light, None)
    assert apart(found, wanted) < 1e-3
    assert n < 25
    assert apart(by_wavelengths(camera, point, light, n // 3)[0], wanted) > 1e-3


@pytest.mark.parametrize("wavelength", [450e-9, 650e-9])
def test_a_lenslet_of_glass_has_its_focal_length_in_the_raw_image(
    device: Device, wavelength: float
) -> None:
    wanted = focal_length_of(2e-3, wavelength)
    camera = dispersive(
        device, wavelength, pitch=150e-6, focal_length=2e-3, shift=0.2, aperture=0.012, count=1
    )
    assert focal_length_in_image(camera, 0.06, wanted) == pytest.approx(wanted, rel=2e-3)


def test_lateral_colour_of_a_point_beside_the_middle_of_a_lenslet(device: Device) -> None:
    X, places, laws = -50e-6, [], []
    for wavelength in (450e-9, 650e-9):
        camera = dispersive(
            device, wavelength, pitch=200e-6, focal_length=2e-3, shift=0.0, aperture=0.012, count=3
        )
        places.append(place_in_image(camera, X))
        z2, z3 = camera.array_distance, camera.sensor_distance
        laws.append(X * (1 - z3 / focal_length_of(2e-3, wavelength)) + z3 * X / z2)
    assert places[1] - places[0] == pytest.approx(laws[1] - laws[0], rel=0.02)
    assert places == pytest.approx(laws, abs=1e-7)
