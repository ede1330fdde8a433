"""Windows of single points: the pupil integral, whole cameras, and pixels that integrate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reference_windows as reference

from clplen import MicrolensArray, PicturePlane, PlenopticCamera, PointSources, SamplingError
from clplen.cameras import Aberrations, PixelArray
from clplen.cameras.exposure import local_exposure
from clplen.cameras.optics.local_window import LocalWindows, Region, window_shape
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.compute.device import Device

pytestmark = pytest.mark.thorough

LAM = 532e-9


def slow(device: Device, kind: str) -> Any:
    """Cameras whose pixels sample the light, so that a window as large as the sensor holds it."""
    shared = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 3.6e-3}
    if kind == "hexagonal":
        mla = MicrolensArray(150e-6, 10e-3, count=(37, 33), lattice="hexagonal", rotation=0.07)
        return PlenopticCamera.type1(mla=mla, pixels_per_lenslet=16, device=device, **shared)
    mla = MicrolensArray(150e-6, 3e-3, count=41, fill="full")
    bent = Aberrations(main_lens={5: 4e-8, 8: -3e-8, 11: 3e-8}) if kind == "aberrated" else None
    return PlenopticCamera.type2(
        mla=mla, m=-0.25 if kind == "galilean" else 0.3, pixels_per_lenslet=24, device=device,
        **shared, **({"aberrations": bent} if bent else {}),
    )  # fmt: skip


POINTS = [(6e-4, -9e-4, 0), (-3e-4, 5e-4, -0.05)]


@pytest.mark.parametrize("kind", ["hexagonal", "galilean", "aberrated"])
def test_a_local_window_is_the_whole_window_about_a_point(
    device: Device, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # no light leaves the whole window
    monkeypatch.setattr(WaveOptics, "padding", lambda optics, positions: (2, 2))
    camera = slow(device, kind)
    for position in POINTS:
        scene = PointSources(position, diameter=10e-6)
        whole = camera.expose(scene, method="points").to_numpy().astype(np.float64)
        local = camera.expose(scene, method="local").to_numpy().astype(np.float64)
        # at the pupil's rim the whole window has samples' covered share, which is wrong by up to
        # 4e-4 of the maximum beside the image; the local one is exact there (see below)
        assert np.abs(local - whole).max() <= 5e-4 * whole.max()
        assert np.linalg.norm(local - whole) <= 6e-4 * np.linalg.norm(whole)


def windows_of(camera: Any, position: Any) -> LocalWindows:
    optics, place = camera.optics, np.array([position], float)
    return LocalWindows.of(optics, window_shape(optics, place[0]), place)


def against_quadrature(camera: Any, position: Any, *, thin: bool, reach: float) -> float:
    """Largest difference of abs(U) on the array from direct sums over the pupil, of the peak."""
    made = windows_of(camera, position)
    shape = made.shape
    got = camera.device.download(made.array_fields())[0]
    whole = made.energy[0] / (1 - camera.optics.rim_loss(shape.pitch))  # with the rim's whole light
    got = np.abs(got) / np.sqrt(whole) / shape.pitch
    generator = np.random.default_rng(5)
    limit = int(reach / shape.pitch)
    index = shape.samples // 2 + generator.integers(-limit, limit + 1, (12, 2))
    index[0] = shape.samples // 2
    y, x = (
        np.asarray(camera.grid.origin)
        + (made.centres[0] + index - shape.samples // 2) * shape.pitch
    ).T
    lens = reference.MainLens(
        camera.focal_length,
        camera.aperture_diameter,
        camera.array_distance,
        camera.wavelength,
        thin,
    )
    x0, y0, dz = position
    expected = reference.field_on_plane(lens, (x0, y0, camera.object_distance + dz), y, x)
    return float(np.abs(got[tuple(index.T)] - np.abs(expected)).max() / got.max())


def test_slow_pupils_against_quadrature(device: Device) -> None:
    camera = slow(device, "keplerian")
    for position in POINTS:
        assert against_quadrature(camera, position, thin=True, reach=2e-4) <= 2e-4


def fast(device: Device, f_number: float = 4.0, **change: Any) -> Any:
    """A camera of 10 mm with 10 um lenslets, which no window of its pixels could sample."""
    mla = MicrolensArray(10e-6, 40e-6, count=(29, 31), lattice="hexagonal")
    values: dict[str, Any] = {
        "focal_length": 10e-3, "object_distance": 1.0, "aperture_diameter": 10e-3 / f_number,
        "mla": mla, "wavelength": 500e-9, "pixels": PixelArray(pitch=1.25e-6), "device": device,
        "lens_model": "corrected",
    }  # fmt: skip
    return PlenopticCamera.type1(**(values | change))


@pytest.mark.parametrize(
    ("f_number", "position"), [(2.0, (3e-3, -5e-3, 0)), (8.0, (2e-3, 1e-3, -0.4))]
)
def test_fast_pupils_against_quadrature(device: Device, f_number: float, position: Any) -> None:
    camera = fast(device, f_number)
    # off the image only the light of the rim in the middle of the blur is not exact
    assert against_quadrature(camera, position, thin=False, reach=1.2e-5) <= 1e-3


def binned(image: np.ndarray, times: int) -> np.ndarray:
    ny, nx = (n // times for n in image.shape)
    return np.asarray(image.astype(np.float64).reshape(ny, times, nx, times).sum(axis=(1, 3)))


def test_pixels_integrate(device: Device) -> None:
    """Against the same camera with a fifth of the pixels' pitch, binned."""
    scene = PointSources((3e-4, -2e-4, 0.02), diameter=10e-6)
    mla = MicrolensArray(150e-6, 10e-3, count=25, fill="full")
    shared = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 3e-3, "mla": mla}
    coarse, fine = (
        PlenopticCamera.type1(pixels_per_lenslet=n, pixels=PixelArray(), device=device, **shared)
        for n in (13, 65)
    )
    got = coarse.expose(scene).to_numpy()
    expected = binned(fine.expose(scene).to_numpy(), 5)
    assert np.linalg.norm(got - expected) <= 1e-3 * np.linalg.norm(expected)
    middles = replace(coarse, pixels=None).expose(scene).to_numpy()
    assert np.linalg.norm(middles - expected) > 1e-2 * np.linalg.norm(expected)


def test_offset_and_size_of_the_sensor(device: Device) -> None:
    """A smaller sensor beside the axis sees its part of what a large one sees."""
    scene = PointSources([(3e-3, -5e-3, 0), (-2e-3, 1e-3, -0.2)])
    large = fast(device, pixels=PixelArray(pitch=1.25e-6, shape=(201, 241)))
    part = PixelArray(pitch=1.25e-6, shape=(121, 101), offset=(20e-6, -25e-6))
    small = fast(device, pixels=part).expose(scene).to_numpy()
    down, right = 100 + 16 - 60, 120 - 20 - 50
    expected = large.expose(scene).to_numpy()[down : down + 121, right : right + 101]
    np.testing.assert_allclose(small, expected, atol=1e-6 * expected.max())


def test_a_turned_sensor_is_a_turned_array(device: Device) -> None:
    camera = fast(device, pixels=PixelArray(pitch=1.25e-6, rotation=0.02))
    assert camera.mla.rotation == pytest.approx(-0.02)
    mla = MicrolensArray(10e-6, 40e-6, count=(29, 31), lattice="hexagonal", rotation=-0.02)
    other = fast(device, mla=mla)
    scene = PointSources((1e-3, 2e-3, 0))
    np.testing.assert_array_equal(camera.expose(scene).to_numpy(), other.expose(scene).to_numpy())


def test_points_of_many_depths_add_up(device: Device) -> None:
    places = [(0, 0, -0.3), (1e-3, 0, 0.1), (0, 1e-3, -0.3), (0, 0, -0.29), (1e-3, 1e-3, 0.1)]
    power = [1.0, 0.5, 2.0, 1.5, 0.7]
    camera = fast(device)
    calls: list[tuple[int, int]] = []
    together = camera.expose(
        PointSources(places, power=power), progress=lambda done, total: calls.append((done, total))
    ).to_numpy()
    assert calls == sorted(calls)
    assert calls[-1] == (5, 5)
    apart = sum(
        camera.expose(PointSources(place, power=each)).to_numpy()
        for place, each in zip(places, power, strict=True)
    )
    np.testing.assert_allclose(together, apart, atol=1e-6 * together.max())


def test_what_needs_samples_of_the_sensor_says_so(device: Device) -> None:
    slide = PicturePlane(np.ones((3, 3)), 1e-3, mode="transmission")
    from clplen import Coherence

    with pytest.raises(ValueError, match="Slides require pixels that sample the intensity"):
        fast(device).expose(slide, coherence=Coherence())
    with pytest.raises(SamplingError, match="cycles/m"):
        fast(device).expose(PicturePlane(np.ones((3, 3)), 1e-3), method="isoplanatic")
    with pytest.raises(SamplingError, match="beyond the array"):
        fast(device).expose(PointSources((0.5, 0, 0)))


def test_pixels_that_cannot_be(device: Device) -> None:
    for change, message in [
        ({"fill_factor": 1.2}, "0 to 1"),
        ({"pitch": -1e-6}, "pitch must be > 0"),
        ({"shape": (0, 5)}, ">= 1"),
        ({"rotation": float("nan")}, "finite"),
        ({"crosstalk": [[0.5, 0.5]]}, "odd number"),
        ({"crosstalk": [[0.5, 0.9, 0.5]]}, "1 or less"),
    ]:
        with pytest.raises(ValueError, match=message):
            PixelArray(**change)
    with pytest.raises(ValueError, match="contradicts the pixel pitch"):
        fast(device, pixels_per_lenslet=9)
    with pytest.raises(ValueError, match="must have a size"):
        fast(device, pixels=None)
    with pytest.raises(TypeError, match="PixelArray"):
        fast(device, pixels=1.4e-6)


def test_windows_that_share_the_array_are_as_those_of_their_own(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster of points, one far from it, and others of another depth."""
    mla = MicrolensArray(10e-6, 40e-6, count=(29, 31), lattice="hexagonal", rotation=0.03)
    camera = fast(device, mla=mla)
    generator = np.random.default_rng(4)
    places = generator.uniform(-2e-3, 2e-3, (9, 2))
    positions = [(x, y, 0.0) for x, y in places]
    positions += [(9e-3, -9e-3, 0.0), (-8e-3, 8e-3, -0.2), (-8.1e-3, 7.7e-3, -0.2)]
    scene = PointSources(positions, power=generator.uniform(0.2, 1, len(positions)))
    regions: list[Any] = []
    made = Region.of

    def spied(optics: Any, shape: Any, centres: Any) -> Region:
        regions.append(centres)
        return made(optics, shape, centres)

    monkeypatch.setattr(Region, "of", spied)
    shared = camera.expose(scene).to_numpy().astype(np.float64)
    assert len(regions) < len(positions) / 2
    monkeypatch.setattr(local_exposure, "_region", lambda *_: None)
    own = camera.expose(scene).to_numpy()
    assert np.abs(shared - own).max() < 2e-6 * own.max()
