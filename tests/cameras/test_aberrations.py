"""Aberrations: Strehl ratios, rays that turn by the slope of a wavefront, lenslets out of place."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reference_camera as reference
from reference_optics import propagate
from tolerance import relative_max

from clplen import (
    Coherence,
    LightField,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SamplingError,
    SurfaceScene,
)
from clplen.analysis.point.psf import PSF
from clplen.cameras import Plane
from clplen.cameras.exposure.isoplanatic import layout
from clplen.cameras.exposure.slides import slide_field
from clplen.cameras.optics.camera_aberrations import (
    Aberrations,
    LensletScatter,
    correct_aberrations,
)
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.wave.elements.lens import thin_lens
from clplen.wave.elements.zernike import phase_plate

LAM, F, R = 532e-9, 0.24, 1.8e-3
MIDDLE = PointSources((0, 0, 0), diameter=10e-6)


def camera_of(device: Device, *, count: Any = 35, pixels: int = 15, **change: Any) -> Plenoptic1:
    """The thesis' camera, f = 120 mm in 2f-2f with D = 3.6 mm, on a smaller array."""
    f, fill = change.pop("f", 10e-3), change.pop("fill", "full")
    mla = change.pop("mla", MicrolensArray(150e-6, f, count=count, fill=fill))
    values: dict[str, Any] = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 2 * R}
    return PlenopticCamera.type1(
        mla=mla, pixels_per_lenslet=pixels, device=device, **(values | change)
    )


def psf(camera: Plenoptic1) -> PSF:
    """The main lens' image of a point on the axis."""
    at_array = camera.optics.array_field(camera.optics.pupil(np.zeros((1, 3)))).to_numpy()[0]
    intensity = np.abs(at_array).astype(np.float64) ** 2
    return PSF(intensity / intensity.sum(), camera.pixel_pitch, camera.grid.origin)


def test_a_tilt_moves_the_image_by_the_slope(device: Device) -> None:
    """Noll's j = 2 is 2 x/R, j = 3 is 2 y/R: the image lies F dW/du beside its place."""
    tilted = camera_of(device, aberrations=Aberrations(main_lens={2: LAM, 3: -0.5 * LAM}))
    assert tilted.optics.padding(MIDDLE.positions) == (2, 1)
    assert camera_of(device).optics.padding(MIDDLE.positions) == (1, 1)
    y, x = psf(tilted).centroid()
    assert (y, x) == pytest.approx((-F * LAM / R, 2 * F * LAM / R), abs=5e-8)


def test_raw_image_against_the_twin(device: Device, precise: Device) -> None:
    """Coma and a sensor that has moved, off the axis and out of focus."""
    point, shift = (0.3e-3, -0.2e-3, 4e-3), 0.7e-3
    twin = reference.Camera(count=(31, 35), pixels_per_lenslet=15)
    y, x = (axis / R for axis in twin.axes())
    outside = np.maximum(np.hypot(y[:, None], x), 1)  # the rim's cells have the phase of the rim
    y, x = y[:, None] / outside, x / outside
    coma = math.sqrt(8) * (3 * (y**2 + x**2) - 2) * (0.3 * x - 0.2 * y)
    u = reference.field_behind_lens(twin, *point) * np.exp(2j * np.pi * coma)
    u = propagate(u, twin.pixel, F, LAM, method="blas", pad=2, workers=2)
    u *= reference.array_phase(twin)
    u = propagate(u, twin.pixel, twin.f_mu + shift, LAM, method="as", pad=1, workers=2)
    bad = Aberrations(main_lens={7: -0.2 * LAM, 8: 0.3 * LAM}, sensor_shift=shift)
    for where, tolerance in ((device, 1e-5), (precise, 1e-6)):  # as without aberrations, twice
        camera = camera_of(where, count=(31, 35), aberrations=bad)
        assert camera.optics.padding(np.array([point])) == (2, 1)
        got = camera.expose(PointSources(point, diameter=10e-6)).to_numpy()
        assert relative_max(np.abs(u) ** 2, got.astype(np.float64)) <= tolerance


# Every lenslet is lit: a point 60 mm behind the focused plane, lenslets of 3 mm


def spots(camera: Plenoptic1, raw: Any, power: int) -> tuple[Any, Any]:
    """Light within half a pitch of each lenslet, and its centroid (y, x) by a power of it, metres.

    As (n,) and (n, 2), lenslets row by row.
    """
    image, found = raw.to_numpy().astype(np.float64), []
    half = camera.mla.pitch / 2
    for cy, cx in camera.mla.centres().reshape(-1, 2):
        y, x = camera.grid.y - cy, camera.grid.x - cx
        rows, columns = np.abs(y) < half, np.abs(x) < half
        y, x = y[rows], x[columns]
        part = image[np.ix_(rows, columns)] * (np.hypot(y[:, None], x) < half)
        w = part**power / max((part**power).sum(), 1e-30)  # 0 beyond the sensor
        found.append((part.sum(), w.sum(axis=1) @ y, w.sum(axis=0) @ x))
    energy, *place = np.transpose(found)
    return energy, np.stack(place, axis=-1)


SQUARE = MicrolensArray(150e-6, 3e-3, count=(27, 29), fill="full")
TURNED = MicrolensArray(150e-6, 3e-3, count=(31, 27), lattice="hexagonal", rotation=0.3)


@pytest.mark.parametrize(
    ("bad", "mla"),
    [
        (Aberrations(scatter=LensletScatter(tilt=1e-3, seed=4)), TURNED),
        (Aberrations(scatter=LensletScatter(tilt=5e-4, position=4e-6, seed=5)), SQUARE),
        (Aberrations(lenslets={2: 100e-9, 3: -60e-9}), TURNED),
    ],
    ids=["tilt", "tilt and position", "wavefront of a disc"],
)
def test_lenslets_out_of_place_move_their_sub_images(
    bad: Aberrations, mla: MicrolensArray, device: Device
) -> None:
    """By f times the slope, and by the vertex's distance from its place; no light is lost."""
    point = PointSources((1e-4, -2e-4, 60e-3))
    ideal = camera_of(device, mla=mla, pixels=28)
    camera = ideal.with_aberrations(bad)
    errors = bad.lenslet_errors(mla)
    slope = np.array([-60e-9, 100e-9]) * 4 / errors.circle if bad.lenslets else errors.tilt
    local = np.broadcast_to(mla.f * slope + errors.position, (*mla.count, 2)).reshape(-1, 2)
    cos, sin = math.cos(mla.rotation), math.sin(mla.rotation)
    expected = local @ np.array([[cos, -sin], [sin, cos]])  # +x turns towards +y
    raws = [one.expose(point) for one in (ideal, camera)]
    (energy, before), (_, after) = (spots(camera, raw, 2) for raw in raws)
    lit = energy > 0.5 * energy.max()
    assert lit.sum() >= 12
    assert np.abs(expected[lit]).max() > 0.4 * camera.pixel_pitch
    rms = np.sqrt(np.mean((after - before - expected)[lit] ** 2))
    assert rms <= 0.08 * camera.pixel_pitch
    assert raws[1].to_numpy().sum() == pytest.approx(raws[0].to_numpy().sum(), rel=1e-6)
    traced = [spots(one, one.expose(point, model="rays"), 1)[1] for one in (ideal, camera)]
    by_rays = np.sqrt(np.mean((traced[1] - traced[0] - expected)[lit] ** 2))
    assert by_rays <= 0.08 * camera.pixel_pitch  # rays are few


# The main lens, by rays and in what is made of the raw image


def test_rays_turn_by_the_slope_of_the_wavefront(device: Device) -> None:
    """Astigmatism c sqrt(6) (x^2 - y^2)/R^2: rms F sqrt(6) c/R on the array along each axis.

    And a tilt t 2 x/R, which moves the middle by 2 F t/R.
    """
    bad = Aberrations(main_lens={2: 0.5 * LAM, 6: LAM})
    camera = camera_of(device, field_lens=True, aberrations=bad)
    raw = camera.expose(MIDDLE, model="rays")  # with a field lens, light stays in its cell
    energy = raw.to_numpy().astype(np.float64).reshape(35, 15, 35, 15).sum(axis=(1, 3))
    place = (np.arange(35) - 17) * 150e-6
    for axis, moved in ((0, 0.0), (1, F * LAM / R)):
        share = energy.sum(axis=1 - axis) / energy.sum()
        assert share @ place == pytest.approx(moved, abs=3e-6)
        variance = share @ (place - share @ place) ** 2 - 150e-6**2 / 12
        assert math.sqrt(variance) == pytest.approx(F * math.sqrt(6) * LAM / R, rel=0.02)


@pytest.mark.parametrize(("j", "peak", "energy"), [(5, 4.0, 1.0), (8, 1.0, 1.5)])
def test_correction_of_one_wave(j: int, peak: float, energy: float, device: Device) -> None:
    """Peak, and energy in 3 x 3 lenslets, of the picture with and without the correction."""
    lf = LightField.from_raw(
        camera_of(device, aberrations=Aberrations(main_lens={j: LAM})).expose(MIDDLE)
    )
    found = [
        one.render(total=True).to_numpy().astype(np.float64)
        for one in (lf, correct_aberrations(lf, {j: LAM}))
    ]
    assert found[1].max() >= peak * found[0].max()
    assert found[1][16:19, 16:19].sum() >= energy * found[0][16:19, 16:19].sum()
    assert found[1].sum() == pytest.approx(found[0].sum(), rel=1e-5)


# Ways into the raw image


@pytest.mark.thorough
def test_wavefronts_of_the_field(device: Device) -> None:
    """Each point has that of its own image, (Y, X) = -(y, x) F/z; in one batch, and by rays."""
    places = [(0.4e-3, -0.3e-3, 5e-3), (-0.2e-3, 0.5e-3, 0.0)]
    camera = camera_of(device, count=27)
    varying = Aberrations(main_lens={6: 0.1 * LAM}, main_lens_field={7: (3e-4, 0), 8: (0, 3e-4)})
    for model in ("waves", "rays"):
        total = np.zeros(camera.grid.shape)
        for x, y, dz in places:
            scale = -F / (F + dz)
            own = {6: 0.1 * LAM, 7: 3e-4 * y * scale, 8: 3e-4 * x * scale}
            one = camera.with_aberrations(Aberrations(main_lens=own))
            total += one.expose(PointSources((x, y, dz)), model=model).to_numpy()
        got = camera.with_aberrations(varying).expose(PointSources(places), model=model)
        if model == "waves":
            assert relative_max(total, got.to_numpy().astype(np.float64)) <= 5e-4  # padding
        else:  # the second point's rays start elsewhere on the lens
            cells = [
                one.reshape(27, 15, 27, 15).sum(axis=(1, 3)) for one in (total, got.to_numpy())
            ]
            assert np.abs(cells[0] - cells[1]).max() <= 0.02 * cells[0].max()


def test_pictures_by_both_routes(device: Device) -> None:
    mla = MicrolensArray(150e-6, 10e-3, count=15, fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.03, mla=mla, wavelength=LAM, pixels_per_lenslet=16, device=device,
        aperture_diameter=0.5e-3,
        aberrations=Aberrations(main_lens={6: 0.2 * LAM, 7: 0.1 * LAM}),
    )  # fmt: skip
    picture = PicturePlane(np.array([[1, 0, 2], [0, 3, 1]]), 6e-4, 1e-3)
    steep = camera.with_aberrations(
        Aberrations(lenslets={2: 0.3 * LAM}, lenslet_circle=213e-6)
    )  # wider patterns, whose intensity the pixels do not sample
    for one, finer in ((camera, 1), (steep, 2)):
        exact, quick = (one.expose(picture, method=way) for way in ("points", "isoplanatic"))
        assert relative_max(exact.to_numpy().astype(float), quick.to_numpy().astype(float)) <= 0.02
        assert quick.exposure is not None
        assert quick.exposure.route == "isoplanatic"
        assert layout(one.optics, picture).finer == finer
    scattered = camera.with_aberrations(Aberrations(scatter=LensletScatter(tilt=1e-4)))
    assert scattered.expose(picture).exposure.route == "points"  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="without scatter"):
        scattered.expose(picture, method="isoplanatic")


def test_a_slide_step_by_step(device: Device) -> None:
    camera = camera_of(device, count=27, aberrations=Aberrations(main_lens={8: 0.4 * LAM}))
    values = np.zeros((9, 11))
    values[2:7, 3:5] = 1
    plane = PicturePlane(values, 11 * 4 * camera.pixel_pitch, mode="transmission")
    got = camera.expose(plane, coherence=Coherence()).to_numpy()
    lit = thin_lens(slide_field(camera.optics, plane), camera.object_distance)
    pupil = thin_lens(
        camera.optics.propagator(camera.object_distance, "blas", 1)(lit), 0.12, diameter=2 * R
    )
    bent = phase_plate(pupil, {8: 0.4 * LAM}, diameter=2 * R)
    pads = camera.optics.padding(plane.corners().positions)
    at_array = camera.optics.array_field(bent, pad=pads[0])
    expected = camera.optics.sensor_field(at_array, pad=pads[1])
    assert relative_max(np.abs(expected.to_numpy().astype(np.complex128)) ** 2, got) <= 1e-5
    assert relative_max(np.abs(expected.to_numpy()) ** 2, camera_of(device, count=27).expose(
        plane, coherence=Coherence()).to_numpy()) > 0.1  # fmt: skip
    varying = camera.with_aberrations(Aberrations(main_lens_field={4: (1e-4, 0)}))
    with pytest.raises(ValueError, match="slide's light is one field"):
        varying.expose(plane, coherence=Coherence())


# What is kept, said and refused


def test_what_is_kept(device: Device) -> None:
    scatter = LensletScatter(focal_length=0.02, tilt=1e-3, position=1e-6, seed=7)
    bad = Aberrations(main_lens={8: 2e-8, 5: 1e-8}, scatter=scatter, sensor_shift=1e-4)
    assert bad.main_lens == ((5, 1e-8), (8, 2e-8))
    assert replace(bad) == bad
    bad = replace(bad, main_lens_field={7: (1e-4, -0.1)}, lenslets={4: 1e-9}, lenslet_circle=2.2e-4)
    assert Aberrations.from_json(bad.to_json()) == bad
    assert hash(replace(bad)) == hash(bad)
    errors = bad.lenslet_errors(SQUARE)
    np.testing.assert_allclose(errors.focal_lengths, 3e-3 * scatter.draw(SQUARE.count)[0])
    factor, tilt, position = scatter.draw((200, 201))
    assert factor.std() == pytest.approx(0.02, rel=0.02)  # 1/sqrt(2 x 40200) is .0035
    assert factor.mean() == pytest.approx(1, abs=5e-4)
    for found, rms in ((tilt, 1e-3), (position, 1e-6)):
        assert found.std(axis=(0, 1)) == pytest.approx([rms, rms], rel=0.02)
    assert abs(np.corrcoef(tilt[..., 0].ravel(), position[..., 0].ravel())[0, 1]) < 0.02
    text = str(camera_of(device, aberrations=bad).describe())
    for line in ("wavefront of main lens", "scatter of tilt", "sensor shift"):
        assert line in text
    coma = Aberrations(main_lens_field={7: (LAM * 300, 0), 8: (0, LAM * 400)})
    assert "0.5 waves per mm of the image" in str(camera_of(device, aberrations=coma).describe())
    assert "sensor shift" not in str(camera_of(device).describe())


def test_numbers_out_of_range() -> None:
    for given, error, said in [
        ({"main_lens": {0: 1e-8}}, ValueError, "at least 1"),
        ({"main_lens": {math.nan: 1e-8}}, ValueError, "at least 1, got nan"),
        ({"main_lens": {"4": 1e-8}}, ValueError, "at least 1, got '4'"),
        ({"main_lens": {4: math.nan}}, ValueError, r"main_lens\[4\] must be finite"),
        ({"main_lens": 3.0}, TypeError, "Noll's index"),
        ({"main_lens_field": {4: 1e-8}}, ValueError, "two finite numbers"),
        ({"lenslets": {46: 1e-8}}, ValueError, "at most 8, got 9"),
        ({"lenslet_circle": 0.0}, ValueError, "lenslet_circle must be > 0"),
        ({"sensor_shift": math.inf}, ValueError, "sensor_shift must be finite"),
        ({"scatter": 0.1}, TypeError, "LensletScatter"),
    ]:
        with pytest.raises(error, match=said):
            Aberrations(**given)
    for words, said in (
        ({"tilt": -1e-3}, "rms"),
        ({"focal_length": 0.3}, "0.2"),
        ({"seed": -1}, "seed"),
    ):
        with pytest.raises(ValueError, match=said):
            LensletScatter(**words)


def test_aberrations_that_do_not_fit(device: Device) -> None:
    square, round_ = camera_of(device, count=25), camera_of(device, count=25, fill="circular")
    spherical = Aberrations(lenslets={11: 1e-8})
    round_.with_aberrations(spherical)
    for bad in (spherical, replace(spherical, lenslet_circle=200e-6)):
        with pytest.raises(ValueError, match=r"at least 0\.000212132 m|use 0\.000212132 m or more"):
            square.with_aberrations(bad)
    square.with_aberrations(replace(spherical, lenslet_circle=212.14e-6))
    with pytest.raises(ValueError, match="keep the sensor behind the array"):
        square.with_aberrations(Aberrations(sensor_shift=-10e-3))
    strong = camera_of(device, count=25, aberrations=Aberrations(main_lens={11: 3 * LAM}))
    with pytest.raises(SamplingError, match=r"aberrations 0\.0\d+ rad"):
        strong.expose(MIDDLE, method="points")
    with pytest.raises(TypeError, match="of type dict"):
        square.with_aberrations({4: 1e-8})  # type: ignore[arg-type]
    steep = square.with_aberrations(Aberrations(main_lens_field={2: (0, 5e-3)}))
    with pytest.raises(SamplingError, match="smaller aberrations"):
        steep.expose(PointSources((-1.5e-3, 0, 0)))
    bent = square.with_aberrations(Aberrations(main_lens={4: 1e-8}))
    with pytest.raises(ValueError, match="keep only sensor_shift"):
        bent.expose(SurfaceScene(Plane(0.0)), model="rays")


def test_a_correction_needs_metres(device: Device) -> None:
    lf = LightField.from_array(np.ones((3, 3, 8, 8), np.float32), device=device)
    with pytest.raises(ValueError, match="give camera="):
        correct_aberrations(lf, {4: 1e-8})
    naive = LightField.from_raw(camera_of(device, count=25).expose(MIDDLE), decode="naive")
    with pytest.raises(ValueError, match="decode with 'calibrated'"):
        correct_aberrations(naive, {4: 1e-8})


@pytest.mark.thorough
def test_strehl_ratio_of_each_low_term(device: Device) -> None:
    camera = camera_of(device)
    ideal = psf(camera)
    for j, sigma in (*((j, 0.5) for j in range(4, 12)), (11, 0.25)):
        wavefront = Aberrations(main_lens={j: sigma * LAM / (2 * np.pi)})
        found = psf(camera.with_aberrations(wavefront)).strehl(ideal)
        assert found == pytest.approx(math.exp(-(sigma**2)), abs=0.01), (sigma, j)
