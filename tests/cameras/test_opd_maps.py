"""OPD maps: against Zernike terms, closed forms of distortion and vignetting, Seidel's fields."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
from tolerance import relative_max

from clplen import (
    Coherence,
    Grid,
    MicrolensArray,
    PicturePlane,
    PlenopticCamera,
    PointSources,
    SamplingError,
)
from clplen.analysis import PSF
from clplen.cameras import Aberrations, OPDMaps, Plenoptic1
from clplen.cameras.camera_base import scene_energy
from clplen.compute.device import Device
from clplen.wave.elements.hard_apertures import disc_coverage
from clplen.wave.elements.zernike import noll, zernike

LAM, F, R = 532e-9, 0.24, 1.8e-3
RNG = np.random.default_rng(5)


def camera_of(device: Device, *, count: Any = (27, 25), **change: Any) -> Plenoptic1:
    """f = 120 mm in 2f-2f, D = 3.6 mm: an image plane at 240 mm, on a small array."""
    mla = MicrolensArray(150e-6, 10e-3, count=count, fill="full")
    values: dict[str, Any] = {"focal_length": 0.12, "wavelength": LAM, "aperture_diameter": 2 * R}
    return PlenopticCamera.type1(mla=mla, pixels_per_lenslet=15, device=device, **values | change)


def pupil(n_v: int, n_u: int) -> tuple[Any, Any, Any]:
    """Places (v, u) of samples, and 1 on the disc, NaN beyond it."""
    v, u = np.meshgrid(np.linspace(-1, 1, n_v), np.linspace(-1, 1, n_u), indexing="ij")
    return v, u, np.where(np.hypot(v, u) <= 1 + 1e-12, 1.0, np.nan)


def sampled(terms: dict[int, float], n_v: int = 49, n_u: int = 41) -> Any:
    """Zernike terms as a map, NaN beyond the disc."""
    v, u, disc = pupil(n_v, n_u)
    rho, theta = np.hypot(v, u), np.arctan2(v, u)
    return disc * sum(c * zernike(*noll(j), rho, theta) for j, c in terms.items())


BENT = {5: 0.11 * LAM, 7: -0.13 * LAM, 10: 0.05 * LAM, 11: 0.09 * LAM, 22: -0.02 * LAM}
GROWTH = {7: (LAM * 90, 0.0), 8: (0.0, LAM * 90), 4: (LAM * 40, -LAM * 70), 9: (0.0, LAM * 30)}
COMA = {7: (LAM * 150, 0.0), 8: (0.0, LAM * 150)}
POINTS = PointSources([(0.4e-3, -0.7e-3, 4e-3), (-0.9e-3, 0.2e-3, -6e-3), (0, 0, 0)])


def at_field(y: float, x: float, growth: Any = GROWTH, terms: Any = BENT) -> dict[int, float]:
    """What the terms are for an image at (y, x)."""
    found = dict(terms)
    for j, (down, right) in growth.items():
        found[j] = found.get(j, 0.0) + down * y + right * x
    return found


def exposures(camera: Plenoptic1, *both: Aberrations) -> list[Any]:
    """The points' raw images with each."""
    found = [camera.with_aberrations(one).expose(POINTS).to_numpy() for one in both]
    return [image.astype(np.float64) for image in found]


# Maps of Zernike terms against the terms


def test_one_map_is_the_zernike_terms(device: Device) -> None:
    maps = OPDMaps(sampled(BENT)[None, None], fields=[(0, 0)])
    assert (maps.varies, maps.vignettes) == (False, False)
    terms, mapped = exposures(
        camera_of(device), Aberrations(main_lens=BENT), Aberrations(main_lens_opd=maps)
    )
    assert relative_max(terms, mapped) <= 1e-4
    assert relative_max(terms, exposures(camera_of(device), Aberrations())[0]) > 0.02


def on_grid() -> OPDMaps:
    """Maps on a grid of fields in disorder, at two wavelengths."""
    places = [(y, x) for y in (-1.3e-3, -0.4e-3, 0.7e-3, 1.2e-3) for x in (1.1e-3, -1.2e-3, 0.3e-3)]
    fields = RNG.permutation(places)
    maps = [sampled(at_field(y, x)) for y, x in fields]
    return OPDMaps(np.stack([maps, maps]), fields=fields, wavelengths=(633e-9, 480e-9))


def scattered() -> OPDMaps:
    """Maps of scattered fields: what grows in proportion to the field is flat in triangles."""
    fields = [(-2e-3, -2e-3), (2e-3, -1.9e-3), (0.3e-3, 2.5e-3), (0.1e-3, 0.2e-3)]
    maps = [sampled(at_field(y, x)) for y, x in fields]
    return OPDMaps([maps], fields=fields, wavelengths=[LAM])


@pytest.mark.parametrize("make", [on_grid, pytest.param(scattered, marks=pytest.mark.thorough)])
def test_maps_over_the_field_are_the_zernike_terms(make: Any, device: Device) -> None:
    maps = make()
    terms, mapped = exposures(
        camera_of(device),
        Aberrations(main_lens=BENT, main_lens_field=GROWTH),
        Aberrations(main_lens_opd=maps),
    )
    assert relative_max(terms, mapped) <= 1e-4
    assert relative_max(terms, exposures(camera_of(device), Aberrations(main_lens=BENT))[0]) > 0.02


def test_symmetric_maps_are_turned(device: Device) -> None:
    """Coma that grows with the field; half of it from maps on a slanted radius, half as terms."""
    radii, angle = np.array([0.0, 0.5e-3, 0.9e-3, 1.6e-3]), 2.2
    fields = np.outer(radii, (math.sin(angle), math.cos(angle)))
    half = {j: (a / 2, b / 2) for j, (a, b) in COMA.items()}
    round_ = {4: 0.07 * LAM, 11: -0.05 * LAM}
    maps = OPDMaps(
        [[sampled(at_field(y, x, half, round_)) for y, x in fields]],
        fields=fields, wavelengths=[LAM], symmetric=True,
    )  # fmt: skip
    terms, mapped = exposures(
        camera_of(device),
        Aberrations(main_lens=round_, main_lens_field=COMA),
        Aberrations(main_lens_field=half, main_lens_opd=maps),
    )
    assert relative_max(terms, mapped) <= 1e-4


# Closed forms


def test_seidel_terms_between_fields_and_wavelengths() -> None:
    """W040 + W131 h cos + W222 h^2 cos^2 + W220 h^2 + W311 h^3 cos (Welford 1986, sec. 7.2)."""
    radii, colours = np.array([0.0, 2.1e-3, 4.9e-3, 8e-3, 11e-3]), np.array([450, 500, 600, 690e0])
    size = np.array([0.9, -1.3, 2.0, 0.8, -0.5]) * 1e-6

    def seidel(v: Any, u: Any, y: float, x: float, colour: float) -> Any:
        h, along = math.hypot(y, x) / 11e-3, (v * y + u * x) / max(math.hypot(y, x), 1e-30)
        rho = v**2 + u**2
        parts = (rho**2, h * rho * along, (h * along) ** 2, h**2 * rho, h**3 * along)
        return sum(c * part for c, part in zip(size, parts, strict=True)) * (
            1 + (500 / colour) ** 2 - 2 * (500 / colour) ** 4
        )

    v, u, disc = pupil(65, 53)
    path = [[disc * seidel(v, u, r, 0, c) for r in radii] for c in colours]
    moved = np.stack([-0.02 * radii**3 / 11e-3**2, 0 * radii], axis=-1)
    maps = OPDMaps(path, fields=radii, wavelengths=colours * 1e-9, symmetric=True, distortion=moved)
    v, u = RNG.uniform(-0.7, 0.7, (2, 200))
    for y, x, colour in ((1e-3, 0, 450), (-3.1e-3, 2.2e-3, 532), (4e-3, -10e-3, 647.1)):
        exact = seidel(v, u, y, x, colour)
        found = maps.path(y, x, colour * 1e-9, v, u)
        assert np.abs(found - exact).max() <= 2e-6 * np.abs(exact).max()
        step = 1e-5
        down = (
            seidel(v + step, u, y, x, colour) - seidel(v - step, u, y, x, colour)
        ) / (2 * step)  # fmt: skip
        assert np.abs(maps.slopes(y, x, colour * 1e-9, v, u)[0] - down).max() <= 1e-3 * 1e-6
        r = math.hypot(y, x)
        scale = 1 - 0.02 * (r / 11e-3) ** 2
        assert maps.chief_ray(y, x, colour * 1e-9) == pytest.approx(
            (y * scale, x * scale), rel=1e-9
        )
    # beyond the rim: the rim's
    assert maps.path(2e-3, 0, LAM, 3.0, 4.0) == maps.path(2e-3, 0, LAM, 0.6, 0.8)


def test_distortion_moves_the_image(device: Device) -> None:
    """A chief ray that arrives d beside its place: as the image of a point that is imaged there."""
    camera, d = camera_of(device), np.array([90e-6, -140e-6])
    flat = sampled({4: 0.05 * LAM})
    maps = OPDMaps(
        [[flat] * 4], fields=[(-2e-3, -2e-3), (-2e-3, 2e-3), (2e-3, 2e-3), (2e-3, -2e-3)],
        wavelengths=[LAM], distortion=[d] * 4,
    )  # fmt: skip
    bent = camera.with_aberrations(Aberrations(main_lens_opd=maps))
    straight = camera.with_aberrations(Aberrations(main_lens={4: 0.05 * LAM}))
    point, dz = np.array([0.5e-3, -0.3e-3]), 5e-3
    there = point - d[::-1] * (0.24 + dz) / F  # X = -(x, y) F/z
    for model, tolerance in (("waves", 2e-4), ("rays", 0.06)):
        moved = bent.expose(PointSources((*point, dz)), model=model).to_numpy()
        placed = straight.expose(PointSources((*there, dz)), model=model).to_numpy()
        unmoved = straight.expose(PointSources((*point, dz)), model=model).to_numpy()
        assert relative_max(placed.astype(np.float64), moved) <= tolerance
        assert relative_max(placed.astype(np.float64), unmoved) > 0.3
    before, after = (at_array(one, (*point, 0), 2) for one in (straight, bent))
    assert after - before == pytest.approx(d, abs=2e-9)


def at_array(camera: Plenoptic1, position: Any, power: float) -> Any:
    """Centroid (y, x) of a power of a point's light on the array, in metres."""
    pupil = camera.optics.pupil(np.array([position]))
    field = camera.optics.array_field(pupil, pad=2).to_numpy()[0]
    light = np.abs(field.astype(np.complex128)) ** 2
    return PSF(light / light.sum(), camera.pixel_pitch, camera.grid.origin).centroid(
        power
    ) * np.ones(2)


def lens_area(s: float, r: float = 1.0) -> float:
    """Share of the unit disc inside a disc of radius r whose middle is s away."""
    if s + r <= 1 or r >= 1 + s:
        return min(r, 1.0) ** 2
    a = math.acos((s**2 + 1 - r**2) / (2 * s))
    b = math.acos((s**2 + r**2 - 1) / (2 * s * r))
    root = math.sqrt((-s + 1 + r) * (s + 1 - r) * (s - 1 + r) * (s + 1 + r))
    return (a + r**2 * b - root / 2) / math.pi


@pytest.mark.thorough
def test_vignetting_by_two_circles(device: Device) -> None:
    """Energies of waves and rays are those of the overlap of two circles, by field."""
    radii, r, per_metre = np.array([0.0, 0.8e-3, 1.7e-3]), 1.05, 0.6 / 1.7e-3
    v, u, disc = pupil(65, 57)
    edge = np.stack([r - np.hypot(v + per_metre * one, u) for one in radii])
    path = np.where(edge > 0, disc * 0.1 * LAM * (v**3 - u**2), np.nan)
    maps = OPDMaps(path[None], fields=radii, wavelengths=[LAM], symmetric=True, edge=edge[None])
    assert maps.vignettes
    plain = camera_of(device)
    camera = plain.with_aberrations(Aberrations(main_lens_opd=maps))
    for radius in radii:
        expected = lens_area(per_metre * radius, r)
        assert maps.passed(0, -radius, LAM) == pytest.approx(expected, abs=2e-3)
        point = PointSources((radius * 0.6, radius * 0.8, 0))  # imaged at (-.8, -.6) of it
        for model in ("waves", "rays"):
            light, all_ = (float(c.expose(point, model=model).to_numpy().sum(dtype=np.float64))
                           for c in (camera, plain))  # fmt: skip
            assert light / all_ == pytest.approx(expected, abs=3e-3), (model, radius)
    assert scene_energy(camera, point)[0][1] == pytest.approx(expected, abs=4e-3)
    # between fields rims move straight; rims that are known by their samples only are half as sharp
    assert maps.passed(0, 1.25e-3, LAM) == pytest.approx(
        lens_area(per_metre * 1.25e-3, r), abs=5e-3
    )
    sampled_only = OPDMaps(path[None], fields=radii, wavelengths=[LAM], symmetric=True)
    for radius in radii:
        expected = lens_area(per_metre * radius, r)
        assert sampled_only.passed(-radius, 0, LAM) == pytest.approx(expected, abs=0.015)


def test_cells_on_the_edge_keep_the_covered_part() -> None:
    """Of a disc that is cut out beside the middle, in cells of many sizes."""
    v, u, disc_ = pupil(61, 47)
    centre, r = (0.15, -0.3), 0.6
    edge = r - np.hypot(v - centre[0], u - centre[1])
    maps = OPDMaps([[0 * disc_]], fields=[(0, 0)], edge=[edge], transmission=[0.81 + 0 * v])
    for n in (41, 97, 300):
        grid = Grid((n, n), 2 / n)
        share, covered = maps.share_and_cover(0, 0, LAM, grid.y[:, None], grid.x, 2 / n)
        assert share == pytest.approx(0.81)
        exact = disc_coverage(grid, r, centre)
        # what is bilinear between samples is off by h^2/(8 r) of a circle, h = 2/46
        assert np.abs(covered - exact).max() <= 1e-3 + (2 / 46) ** 2 / (8 * r) * n / 2 * 1.5
        assert covered.mean() == pytest.approx(exact.mean(), rel=1e-3)


def test_the_path_of_the_main_lens(device: Device) -> None:
    """Terms and maps together; distortion as the difference of two spheres."""
    maps, shift = on_grid(), (0.1, 0.05)
    moved = OPDMaps(
        **maps.values() | {"distortion": 0.01 * maps.fields, "pupil_shift": [shift] * 12}
    )
    camera = camera_of(device, count=31).with_aberrations(
        Aberrations(main_lens={6: 0.2 * LAM}, main_lens_opd=moved)
    )
    v, u = RNG.uniform(-0.6, 0.6, (2, 31))
    y, x = 0.4e-3, -0.6e-3
    path, share = camera.optics.main_lens_path(y, x, v, u)
    expected = 0.2 * LAM * zernike(2, 2, np.hypot(v, u), np.arctan2(v, u))
    expected += maps.path(y, x, LAM, v - 0.1, u - 0.05)
    Y, X = 1.01 * y, 1.01 * x
    expected += np.sqrt((R * v - y) ** 2 + (R * u - x) ** 2 + F**2)
    expected -= np.sqrt((R * v - Y) ** 2 + (R * u - X) ** 2 + F**2)
    assert np.abs(path - expected).max() <= 1e-14
    assert (share == 1).all()
    assert camera.optics.main_lens_path(y, x, [-1.0, 1.05], [0.0, 0.1])[1].tolist() == [0, 1]
    plain = camera_of(device).optics
    assert [a.tolist() for a in plain.main_lens_path(y, x, [0.5, 2], 0)] == [[0, 0], [1, 0]]


# Pictures, slides, samples


def test_slopes_count_in_the_sampling(device: Device) -> None:
    steep = OPDMaps(sampled({11: 3 * LAM})[None, None], fields=[(0, 0)])
    coarse = camera_of(device, aberrations=Aberrations(main_lens_opd=steep))
    with pytest.raises(SamplingError, match=r"aberrations 0\.0\d+ rad"):
        coarse.expose(POINTS, method="points")
    bent = Aberrations(main_lens_opd=OPDMaps(sampled(BENT, 65, 65)[None, None], fields=[(0, 0)]))
    same = Aberrations(main_lens=BENT)
    near, exact = (
        camera_of(device).with_aberrations(one).optics.main_slope() for one in (bent, same)
    )
    assert 0.7 * exact <= near <= exact * 1.01  # of all terms together, not one by one
    moved = OPDMaps([[sampled({})+pupil(49, 41)[2]*0]*2], fields=[0, 2e-3], wavelengths=[LAM],
                    symmetric=True, distortion=[(0, 0), (0.3e-3, 0.4e-3)])  # fmt: skip
    camera = camera_of(device).with_aberrations(Aberrations(main_lens_opd=moved))
    assert camera.optics.main_slope() == pytest.approx(0.5e-3 / F)


def test_what_is_said_and_kept(device: Device) -> None:
    maps = on_grid()
    again = OPDMaps(**maps.values())
    assert again == maps
    assert hash(again) == hash(maps)
    assert pickle.loads(pickle.dumps(maps)) == maps
    other = OPDMaps(**maps.values() | {"path": maps.paths * (1 + 1e-15 * 8)})
    assert other != maps
    bad = Aberrations(main_lens={4: 1e-8}, main_lens_opd=maps)
    assert Aberrations.from_json(bad.to_json(), main_lens_opd=again) == bad
    for kept in ({}, {"main_lens_opd": other}):
        with pytest.raises(ValueError, match="must be the OPD maps"):
            Aberrations.from_json(bad.to_json(), **kept)
    assert "main_lens_opd" not in Aberrations().to_json()
    assert "OPDMaps(paths=<float64 (2, 12, 49, 41)>" in repr(maps)
    with pytest.raises(ValueError, match="read-only"):
        maps.paths[0] = 1
    with pytest.raises(TypeError, match="OPDMaps, got an object of type ndarray"):
        Aberrations(main_lens_opd=maps.paths)  # type: ignore[arg-type]
    share = np.clip(1.2 - np.abs(pupil(41, 37)[0]), 0, 1)
    values = {"transmission": [[share, 1 + 0 * share]], "distortion": [(0, 0), (3e-5, 4e-5)]}
    two = OPDMaps([[sampled(BENT, 41, 37), sampled({4: LAM}, 41, 37)]], fields=[0, 2e-3],
                  wavelengths=[LAM], symmetric=True, pupil_distance=0.24, pupil_diameter=3.6e-3,
                  **values)  # fmt: skip
    text = str(camera_of(device, count=31, aberrations=Aberrations(main_lens_opd=two)).describe())
    for line in ("wavefront of", "0.9915 waves; nearest", "f/66.67", "distortion of", "vignetting"):
        assert line in text
    rms, passed = two.rms(LAM)
    assert rms[1] == pytest.approx(LAM, rel=0.03)
    assert passed[0] == pytest.approx(two.passed(0, 0, LAM), abs=0.01)


# What is refused

FLAT = np.zeros((1, 2, 9, 7))
ON_AXIS: dict[str, Any] = {"fields": [(0, 0), (0, 1e-3)], "wavelengths": [LAM]}
HOLE = np.where(np.arange(9)[:, None] == 4, np.nan, FLAT)
DARK = np.concatenate([FLAT[:, :1], FLAT[:, :1] * np.nan], axis=1)


def test_numbers_out_of_range() -> None:
    round_ = {"symmetric": True}
    huge = np.broadcast_to(FLAT[:, :1, :1, :1], (1, 2, 10**6, 10**7))
    for path, change, error, said in [
        (FLAT[0, 0], {}, ValueError, r"shape \(n_wavelengths, n_fields, n_v, n_u\), got \(9, 7\)"),
        (FLAT * 1j, {}, TypeError, "real numbers"),
        (FLAT, {}, ValueError, "lie on one line"),
        (FLAT, {"fields": [(0, 0), (0, 12)]}, ValueError, "did you mean 0.012"),
        (FLAT, {"wavelengths": [LAM, 2 * LAM]}, ValueError, "as path, 1, got 2"),
        (FLAT + 0.25, round_, ValueError, "multiply waves by the wavelength"),
        (DARK, round_, ValueError, "got 0 in field 1, wavelength 0"),
        (HOLE, round_ | {"transmission": np.ones((2, 9, 7))}, ValueError, "NaN at 7 samples of"),
        (FLAT, round_ | {"transmission": FLAT + 1.2}, ValueError, "0 to 1.*got 1.2"),
        (FLAT, round_ | {"distortion": [(0, 0), (0, 2.0)]}, ValueError, "multiply fractions by"),
        (FLAT, round_ | {"pupil_shift": [(0, 0), (0, 0.6)]}, ValueError, "at most 0.5 .* got 0.6"),
        (FLAT, round_ | {"pupil_diameter": 200}, ValueError, "did you mean 0.2"),
        (huge, round_, MemoryError, "use fewer fields"),
    ]:
        with pytest.raises(error, match=said):
            OPDMaps(path, **ON_AXIS | change)


def test_places_and_wavelengths_beyond_the_maps(device: Device) -> None:
    flat = np.zeros((1, 3, 9, 9))
    near = OPDMaps(flat, fields=[0, 0.5e-3, 1.2e-3], wavelengths=[LAM], symmetric=True)
    ring = OPDMaps(flat, fields=[0.2e-3, 0.5e-3, 1.2e-3], wavelengths=[LAM], symmetric=True)
    three = OPDMaps(flat, fields=[(-1e-3, 0), (1e-3, 0), (0, 1e-3)], wavelengths=[LAM])
    camera = camera_of(device)
    far = PointSources((1.3e-3, 0.4e-3, 0))
    with pytest.raises(ValueError, match=r"reach 1\.2 mm"):
        camera.with_aberrations(Aberrations(main_lens_opd=near)).check_scene(far)
    for maps, said in (
        (near, r"reach 1.2 mm from the axis, .* is imaged at \(-400 um, -1.3 mm\), 1.36015"),
        (on_grid(), r"from \(y, x\) = \(-1.3 mm, -1.2 mm\) to \(1.2 mm, 1.1 mm\)"),
        (three, "add maps of fields there"),
    ):
        for model in ("waves", "rays"):
            with pytest.raises(ValueError, match=said):
                camera.with_aberrations(Aberrations(main_lens_opd=maps)).expose(far, model=model)
    with pytest.raises(ValueError, match=r"from 200 um to 1\.2 mm from"):
        ring.path(0.1e-3, 0, LAM, 0, 0)
    assert ring.path(0, -1.2e-3 * (1 + 1e-12), LAM, 0, 0) == 0
    with pytest.raises(ValueError, match="must be 532 nm for these OPD maps, got 550 nm"):
        camera_of(device, wavelength=550e-9, aberrations=Aberrations(main_lens_opd=near))
    everywhere = OPDMaps(flat[:, :1], fields=[(0, 0)])
    assert everywhere.path(1, 2, 1e-6, 0, 0) == 0  # any wavelength, all of the image
    several = camera.with_aberrations(Aberrations(main_lens_opd=on_grid()))
    plane = PicturePlane(np.ones((3, 3)), width=0.3e-3)
    slide = PicturePlane(plane.image, plane.width, mode="transmission")
    with pytest.raises(ValueError, match="OPD maps of several fields, or"):
        several.expose(slide, coherence=Coherence())
    with pytest.raises(ValueError, match="constant over the field"):
        several.expose(plane, method="isoplanatic")
