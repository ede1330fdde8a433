"""Exposures as linear maps: they are what cameras expose, with exact adjoints and gradients."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import lsqr
from tolerance import relative_max

from clplen import (
    Coherence,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    ShapeError,
    Spectrum,
)
from clplen.cameras import (
    Aberrations,
    ColorFilterArray,
    ExposureOperator,
    LensletScatter,
    Occluder,
    PixelArray,
)
from clplen.cameras.exposure import ray_exposure
from clplen.compute.device import Device

POINTS = np.array([(1e-4, -2e-4, -0.02), (0.0, 1e-4, 0.01), (-2e-4, 3e-5, 0.0)])
BENT = Aberrations(
    main_lens={5: 3e-8}, main_lens_field={4: (2e-4, -1e-4)}, lenslets={11: 4e-9},
    lenslet_circle=2.2e-4, scatter=LensletScatter(tilt=1e-4, seed=1),
)  # fmt: skip


def camera_of(device: Device, kind: str = "standard", **change: Any) -> Any:
    """A camera of a few lenslets, on a sensor of unequal sides."""
    array = {"count": (5, 7), "fill": "full"} | change.pop("array", {})
    values: dict[str, Any] = {
        "focal_length": 0.12, "mla": MicrolensArray(150e-6, 10e-3, **array), "wavelength": 532e-9,
        "pixels_per_lenslet": 9, "aperture_diameter": 0.6e-3, "device": device,
    } | ({"m": 0.25} if kind == "focused" else {}) | change  # fmt: skip
    make = PlenopticCamera.type2 if kind == "focused" else PlenopticCamera.type1
    return make(**values)


def fast(device: Device, **change: Any) -> Any:
    """A camera of f/4 and 10 mm, whose windows of single points are small."""
    return PlenopticCamera.type1(
        focal_length=10e-3, object_distance=1.0, aperture_diameter=2.5e-3, wavelength=500e-9,
        mla=MicrolensArray(10e-6, 40e-6, count=(5, 7), lattice="hexagonal"), device=device,
        pixels_per_lenslet=5, **change,
    )  # fmt: skip


def microscope(device: Device, **change: Any) -> Any:
    array = MicrolensArray(60e-6, 1.5e-3, count=(3, 5), fill="full")
    return PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11, mla=array,
        device=device, **change,
    )  # fmt: skip


def colours(device: Device) -> Any:
    """A camera with crosstalk behind a Bayer mosaic."""
    leaks = ((0.0, 0.02, 0.0), (0.01, 0.9, 0.03), (0.0, 0.0, 0.0))
    filters = ColorFilterArray.bayer("RGGB")
    pixels = PixelArray(filters=filters, crosstalk=leaks, pitch=150e-6 / 9)
    return camera_of(device, pixels_per_lenslet=None, pixels=pixels)


def scene_of(name: str) -> Any:
    points = PointSources(POINTS, diameter=2e-5, power=[1.0, 0.3, 2.0])
    image = np.array([[1.0, 0, 0.5], [0.2, 2.0, 0]])
    picture = PicturePlane(image, 3e-4, z=-0.01)
    farther = PointSources(POINTS[:2] * (6, 5, 10), power=[1.0, 0.3])
    red, blue = Spectrum.monochromatic(620e-9), Spectrum.monochromatic(470e-9)
    return {
        "points": points,
        "picture": picture,
        "list": [points, picture],
        "beads": [PointSources([(5e-6, -3e-6, 2e-5), (0, 2e-6, 0)], power=[1.0, 0.3])],
        "far": [farther, PicturePlane(image[:1], 2e-3)],
        "hidden": [farther, Occluder([[0.0, 1.0]], 1e-2, z=-0.5)],
        "channels": [PicturePlane(np.stack([image, image[::-1]], -1), 3e-4, spectra=[red, blue])],
    }[name]


def energies_of(operator: ExposureOperator) -> np.ndarray:
    """The scene's own, as the operator takes them."""
    parts = [s.power if isinstance(s, PointSources) else s.image for s in operator.sources]
    return parts[0] if len(parts) == 1 else np.concatenate([part.ravel() for part in parts])


@pytest.fixture(autouse=True)
def few_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_exposure, "MAX_RAYS", 2**13)


CASES: dict[str, Any] = {
    "even": (lambda d: camera_of(d, array={"count": (4, 6)}, pixels_per_lenslet=8), "list", {}),
    "focused": (lambda d: camera_of(d, "focused"), "points", {}),
    "bent": (lambda d: camera_of(d, field_lens=True).with_aberrations(BENT), "points",
             {"method": "points"}),
    "integrating": (lambda d: camera_of(d, pixels=PixelArray()), "points", {"method": "points"}),
    "windows": (lambda d: fast(d, pixels=PixelArray()), "far", {}),
    "hidden": (lambda d: fast(d, pixels=PixelArray(fill_factor=0.0)), "hidden", {}),
    "colours": (colours, "channels",
                {"method": "points", "coherence": Coherence(None, wavelengths=2)}),
    "microscope": (microscope, "beads", {}),
    "microscope, integrating": (lambda d: microscope(d, pixels=PixelArray()), "beads", {}),
    "rays, focused": (lambda d: camera_of(d, "focused"), "picture",
                      {"model": "rays"}),
}  # fmt: skip


def often(cases: Sequence[str], *chosen: str) -> list[Any]:
    """All cases, those that are not chosen among the long tests."""
    rest = pytest.mark.thorough
    return [case if case in chosen else pytest.param(case, marks=rest) for case in cases]


def difference(operator: ExposureOperator, x: np.ndarray, seed: int = 1) -> float:
    """Of <A x, y> from <x, A' y>, relative, for y near A x."""
    image = operator.forward(x).astype(np.float64)
    y = image + 0.5 * image.max() * np.random.default_rng(seed).random(image.shape)
    y = y.astype(operator.dtype).astype(np.float64)
    back = operator.adjoint(y).astype(np.float64)
    left = float((image * y).sum())
    return abs(left - float((x * back).sum())) / abs(left)


@pytest.mark.parametrize(
    "case",
    often(list(CASES), "even", "bent", "windows", "microscope", "rays, focused"),
)
def test_the_map_is_what_the_camera_exposes(device: Device, case: str) -> None:
    make, scene, how = CASES[case]
    camera = make(device)
    operator = ExposureOperator(camera, scene_of(scene), **how)
    x = energies_of(operator)
    expected = camera.expose(scene_of(scene), **how).to_numpy()
    got = operator.forward(x)
    assert got.dtype == operator.dtype
    assert got.shape == camera.grid.shape
    assert relative_max(expected, got.astype(np.float32)) <= 1e-6
    assert difference(operator, x) <= 1e-6


@pytest.mark.parametrize("case", often(list(CASES), "even", "focused", "colours", "rays, focused"))
def test_the_adjoint_is_exact_in_double_precision(precise: Device, case: str) -> None:
    make, scene, how = CASES[case]
    operator = ExposureOperator(make(precise), scene_of(scene), **how)
    assert operator.dtype == np.float64
    random = np.random.default_rng(2)
    x = random.random(operator.in_shape) * (energies_of(operator) > 0)
    assert difference(operator, x) <= 1e-13
    images = operator.forward(np.stack([x, 2 * x]).reshape(2, 1, *x.shape))  # leading axes
    assert images.shape == (2, 1, *operator.out_shape)
    back = operator.adjoint(images)
    np.testing.assert_allclose(back[1], 2 * back[0], rtol=1e-12)
    dark = energies_of(operator) == 0
    assert (back[0, 0][dark.all(axis=-1) if dark.ndim == 3 else dark] == 0).all()


def test_images_that_are_not_kept_are_the_same(device: Device) -> None:
    camera, scene = camera_of(device), scene_of("list")
    kept, anew = ExposureOperator(camera, scene), ExposureOperator(camera, scene, memory=1000)
    x = energies_of(kept)
    for _ in range(2):
        image = kept.forward(x)
        np.testing.assert_array_equal(image, anew.forward(x))
        np.testing.assert_array_equal(kept.adjoint(image), anew.adjoint(image))
    points = len(kept.positions)
    assert kept.nbytes == points * camera.grid.shape[0] * camera.grid.shape[1] * 4
    assert anew.nbytes == 0
    assert pickle.loads(pickle.dumps(kept)).nbytes == 0


def test_powers_of_points_are_found(device: Device) -> None:
    places = [(1e-4, -2e-4, -0.02), (0, 1e-4, 0.01), (-2e-4, 0, 0), (2e-4, 2e-4, 0), (0, -1e-4, 0)]
    power = np.array([1.0, 0.4, 2.0, 0.7, 1.3])
    camera = camera_of(device)
    raw = camera.expose(PointSources(places, power=power))
    operator = ExposureOperator(camera, PointSources(places))
    found = lsqr(operator.as_linear_operator(), raw.to_numpy().ravel(), atol=1e-7, btol=1e-7)[0]
    np.testing.assert_allclose(found, power, rtol=1e-4)


def test_arguments(device: Device) -> None:
    camera, points = camera_of(device), scene_of("points")
    slide = PicturePlane(np.ones((2, 2)), 1e-4, mode="transmission")
    for where, scene, how, error, words in (
        (camera, slide, {}, ValueError, "not linear in its transmittance"),
        (camera, points, {"method": "isoplanatic"}, ValueError, "linear map, got 'isoplanatic'"),
        (camera, scene_of("hidden"), {"model": "rays"}, ValueError, "do not support occluders"),
        (camera, points, {"model": "rays", "method": "points"}, ValueError, "model='waves'"),
        (colours(device), points, {"model": "rays"}, ValueError, "colour filters"),
        (camera, points, {"memory": -1}, ValueError, "number of bytes"),
        (points, points, {}, TypeError, "camera must be a Plenoptic"),
        (microscope(device), scene_of("picture"), {}, ValueError, "exposes PointSources"),
        (microscope(device), scene_of("beads"), {"method": "local"}, ValueError, "to plenoptic"),
    ):
        with pytest.raises(error, match=words):
            ExposureOperator(where, scene, **how)
    operator = ExposureOperator(camera, points)
    with pytest.raises(ShapeError, match="cotangent must have the raw image's shape"):
        operator.gradient(points.power, np.zeros((2, 3)))
    with pytest.raises(ShapeError, match="argument of this map must have shape"):
        operator.forward(np.ones(2))
