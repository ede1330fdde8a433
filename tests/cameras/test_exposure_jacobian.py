"""Derivatives of every pixel: against central differences, and against gradients, the transpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
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
    PixelArray,
)
from clplen.cameras.exposure import exposure_jacobian
from clplen.compute.device import Device

PLACES = np.array([(1e-4, -2e-4, -0.02), (-3e-5, 1e-4, 0.01)])
ENERGIES = np.array([1.0, 0.3])
TILT = (0.021, -0.034)
ARRAY: dict[str, Any] = {
    "pitch": 150e-6, "focal_length": 10e-3, "count": (5, 7), "fill": "full", "diameter": 140e-6,
    "offset": (2e-6, -3e-6), "rotation": 0.01,
}  # fmt: skip
LEAKS = ((0.0, 0.02, 0.0), (0.01, 0.9, 0.03), (0.0, 0.0, 0.0))
FIELD = {"main_lens": {5: 3e-8}, "main_lens_field": {4: (2e-4, -1e-4), 8: (1e-4, 0)}}


def camera_of(device: Device, array: Any, aberrations: dict[str, Any], **change: Any) -> Any:
    """A camera of a few lenslets, its sensor where it was designed, and tilted."""
    mla = MicrolensArray(**(ARRAY | array))
    first = MicrolensArray(**ARRAY)
    kind = change.pop("kind", "type1")
    given: dict[str, Any] = {"pixels_per_lenslet": 9} | change
    camera = getattr(PlenopticCamera, kind)(
        focal_length=0.12, mla=first, wavelength=532e-9, aperture_diameter=0.6e-3, device=device,
        **given,
    )  # fmt: skip
    shift = aberrations.get("sensor_shift", 0.0)
    if kind == "type1":
        shift += first.focal_length - mla.focal_length
    bent = Aberrations(**(aberrations | {"sensor_shift": shift}))
    return replace(camera, mla=mla, aberrations=bent)


CASES: dict[str, dict[str, Any]] = {
    "plain": {"aberrations": {"sensor_tilt": (0.0, 0.0)}, "field_lens": True},
    "tilted": {},
    "focused": {"kind": "type2", "m": 0.25, "array": {"focal_length": 9e-3}},
    "integrating": {"pixels": PixelArray(), "aberrations": FIELD | {"sensor_tilt": TILT}},
    "colours": {
        "pixels_per_lenslet": None,
        "pixels": PixelArray(
            filters=ColorFilterArray.bayer("RGGB"), crosstalk=LEAKS, pitch=150e-6 / 9
        ),
    },
}
SHORT = ["tilted", "integrating"]
LONG = [pytest.param(c, marks=pytest.mark.thorough) for c in CASES if c not in SHORT]


def maker(device: Device, case: str) -> Callable[..., ExposureOperator]:
    """The operator of a case, with an array, a sensor or places beside the usual ones."""
    given = {"array": {}, "aberrations": {"sensor_tilt": TILT}} | CASES[case]
    lit = Spectrum.lines([500e-9, 600e-9], [1, 2]) if case == "colours" else None

    def make(places: Any = PLACES, array: Any = None, sensor: Any = None) -> ExposureOperator:
        changed = {
            "array": given["array"] | (array or {}),
            "aberrations": given["aberrations"] | (sensor or {}),
        }
        camera = camera_of(device, **(given | changed))
        points = PointSources(places, diameter=6e-5, spectrum=lit)
        return ExposureOperator(camera, points, method="points")

    return make


def difference(image: Callable[[float], Any], step: float) -> np.ndarray:
    """Central differences of an image, extrapolated (Richardson)."""
    steps = [(image(h) - image(-h)) / (2 * h) for h in (step, step / 2)]
    return np.asarray((4 * steps[1] - steps[0]) / 3)


@pytest.mark.parametrize("case", [*SHORT, *LONG])
def test_by_places_and_the_sensor(precise: Device, case: str) -> None:
    make = maker(precise, case)
    operator = make()
    found = operator.jacobian(ENERGIES, by=("values", "positions", "sensor"))
    assert found.values is not None
    assert found.positions is not None
    image = operator.forward(ENERGIES)
    assert relative_max(image, found.image) <= 1e-12
    for n, one in enumerate(np.eye(2)):
        assert relative_max(operator.forward(one), found.values[n]) <= 1e-12
    for n, axis in np.ndindex(2, 3):

        def moved(h: float, n: int = n, axis: int = axis) -> Any:
            places = PLACES.copy()
            places[n, axis] += h
            return make(places).forward(ENERGIES)

        expected = difference(moved, (2e-6, 2e-6, 2e-4)[axis])
        assert relative_max(expected, found.positions[n, axis]) <= 1e-6
    tilt = operator.camera.aberrations.sensor_tilt
    for axis, unit in enumerate(np.eye(2)):

        def tilted(h: float, unit: np.ndarray = unit) -> Any:
            return make(sensor={"sensor_tilt": tuple(tilt + h * unit)}).forward(ENERGIES)

        expected = difference(tilted, 5e-3)
        assert relative_max(expected, found.sensor["tilt"][axis]) <= 1e-6
    shift = difference(lambda h: make(sensor={"sensor_shift": h}).forward(ENERGIES), 5e-6)
    assert relative_max(shift, found.sensor["shift"]) <= 1e-6


@pytest.mark.parametrize("case", [*SHORT, *LONG])
def test_by_the_lenslets(precise: Device, case: str) -> None:
    make, given = maker(precise, case), ARRAY | CASES[case].get("array", {})
    found = make().jacobian(ENERGIES, by="lenslets").lenslets
    # rims have kinks every 1e-10 m
    steps = {"pitch": 1e-12, "diameter": 1e-12, "rotation": 1e-8, "focal_length": 1e-6}
    if case == "focused":
        del steps["focal_length"]  # its sensor moves with the focal length
    for name, step in steps.items():
        expected = difference(
            lambda h, name=name: make(array={name: given[name] + h}).forward(ENERGIES), step
        )
        assert relative_max(expected, found[name]) <= 1e-6, name
    for axis, unit in enumerate(np.eye(2)):

        def moved(h: float, unit: np.ndarray = unit) -> Any:
            return make(array={"offset": given["offset"] + h * unit}).forward(ENERGIES)

        expected = difference(moved, 1e-12)
        assert relative_max(expected, found["offset"][axis]) <= 1e-6
    np.testing.assert_array_equal(found["focal_lengths"][0], found["focal_length"])


@pytest.mark.parametrize("case", [*SHORT, *LONG])
def test_it_is_the_transpose_of_the_gradients(device: Device, precise: Device, case: str) -> None:
    # gradients take the slope of the discs' pattern from a table, right to 1e-9 of that small part
    for where, tolerance in ((precise, 1e-11), (device, 1e-4)):
        operator = maker(where, case)()
        found = operator.jacobian(ENERGIES, by=exposure_jacobian.GROUPS)
        assert found.values is not None
        assert found.positions is not None
        cotangent = found.image - 0.5 * found.image.max() * np.random.default_rng(3).random(
            found.image.shape
        )
        gradient = operator.gradient(ENERGIES, cotangent)
        raw, pull = operator.vjp(ENERGIES)
        assert relative_max(found.image, raw) <= tolerance
        assert relative_max(gradient.positions, pull(cotangent).positions) <= tolerance
        by_array = operator.lenslet_gradient(ENERGIES, cotangent)
        by_sensor = operator.sensor_gradient(ENERGIES, cotangent)
        pairs = [(found.values, gradient.values), (found.positions, gradient.positions)]
        pairs += [(found.lenslets[name], by_array[name]) for name in found.lenslets]
        pairs += [(found.sensor[name], by_sensor[name]) for name in found.sensor]
        for columns, expected in pairs:
            got = (columns * cotangent).sum(axis=(-2, -1))
            scale = np.abs(columns * cotangent).sum(axis=(-2, -1))
            assert (np.abs(got - expected) <= tolerance * scale).all()
        assert {"pitch", "diameter", "rotation", "offset"} < set(found.lenslets)


@pytest.mark.thorough
def test_pictures_and_several_wavelengths(precise: Device) -> None:
    camera = camera_of(precise, {}, {"sensor_tilt": TILT})
    image = np.array([[1.0, 0, 0.5], [0.2, 2.0, 0]])
    scene = [PicturePlane(image, 3e-4, z=-0.01), PointSources(PLACES)]
    lit = Coherence(None, Spectrum.lines([500e-9, 600e-9], [1, 2]))
    operator = ExposureOperator(camera, scene, method="points", coherence=lit)
    energies = np.r_[image.ravel(), ENERGIES]
    found = operator.jacobian(energies)
    assert found.values is not None
    assert found.positions is not None
    assert found.values.shape == (8, *operator.out_shape)
    assert not found.values[[1, 5]].any()  # samples that are dark
    assert relative_max(found.image, np.tensordot(energies, found.values, 1)) <= 1e-12
    assert found.positions.shape == (6, 3, *operator.out_shape)
    cotangent = np.random.default_rng(4).random(operator.out_shape)
    expected = operator.gradient(energies, cotangent)
    got = (found.positions * cotangent).sum(axis=(-2, -1))
    assert relative_max(expected.positions, got) <= 1e-9
    assert found.lenslets == found.sensor == {}


def test_arguments(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    operator, points = maker(device, "plain")(), PointSources(PLACES)
    flat = camera_of(device, {}, {})
    scattered = camera_of(device, {}, {"scatter": LensletScatter(tilt=1e-4)})
    bent = ExposureOperator(scattered, points, method="points")
    local = ExposureOperator(flat, points, method="local")
    rays = ExposureOperator(flat, points, model="rays")
    for one, energies, by, error, words in (
        (operator, ENERGIES, ("values", "tilt"), ValueError, r"one of 'values'.*'tilt' is none"),
        (operator, ENERGIES, (), ValueError, "got \\(\\)"),
        (operator, np.ones(3), "values", ShapeError, "Energies of a gradient must have shape"),
        (bent, ENERGIES, "lenslets", ValueError, "Gradients by the array require thin"),
        (local, ENERGIES, "values", ValueError, "with method='points', got 'local'"),
        (rays, ENERGIES, "values", ValueError, "with method='points', got 'rays'"),
    ):
        with pytest.raises(error, match=words):
            one.jacobian(energies, by=by)
    with pytest.raises(ShapeError, match="cotangent must have the raw image's shape"):
        operator.sensor_gradient(ENERGIES, np.ones((2, 2)))
    monkeypatch.setattr(exposure_jacobian, "free_memory", lambda: 10_000)
    with pytest.raises(MemoryError, match=r"A Jacobian of 9 images .* are free: use fewer points"):
        operator.jacobian(ENERGIES)
