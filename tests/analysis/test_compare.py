"""Simulated plenoptic cameras measured and compared, against closed forms and their geometry."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from reference_closed import airy

from clplen.analysis.cameras import camera_psf as of_camera
from clplen.analysis.cameras.camera_psf import (
    DepthTransfer,
    camera_psf,
    line_curve,
    object_nyquist,
    psf_exposures,
)
from clplen.analysis.cameras.comparison import (
    ANALYSES,
    Comparison,
    Measured,
    check_analyses,
    compare,
)
from clplen.analysis.cameras.crosstalk import camera_crosstalk, lenslets_in_cone
from clplen.analysis.cameras.depth_scan import (
    DepthErrors,
    default_depths,
    depth_scan,
    measured_depth,
    search_range,
)
from clplen.analysis.cameras.imaging import (
    central_lenslet,
    local_m,
    native_picture,
    point_at_lenslet,
)
from clplen.analysis.cameras.sampling import sampling_of
from clplen.analysis.point.otf import OTF, circular_mtf, square_mtf
from clplen.analysis.point.psf import PSF
from clplen.analysis.report.summary import (
    criteria,
    depth_verdicts,
    judge,
    report,
    usable_limit,
    usable_mtf50,
)
from clplen.analysis.report.tables import tables
from clplen.cameras.focused_camera import Plenoptic2
from clplen.cameras.optics.camera_aberrations import Aberrations
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.standard_camera import Plenoptic1
from clplen.compute.device import Device
from clplen.errors import SamplingError
from clplen.wave.elements.lenslets import MicrolensArray

NEAR = PointSources([(0.0, 0.0, 0.0)])
LAM, PITCH, D = 532e-9, 150e-6, 0.8e-3
OBJECT, IMAGE = 60e-3, 20e-3  # f = 15 mm, magnification 1/3


def standard(device: Device, **more: object) -> Plenoptic1:
    given = {"count": (13, 15), "fill": "full"} | more
    return PlenopticCamera.type1(
        focal_length=0.015,
        object_distance=OBJECT,
        mla=MicrolensArray(PITCH, 3e-3, **given),
        wavelength=LAM,
        pixels_per_lenslet=30,
        aperture_diameter=D,
        device=device,
    )


def focused(device: Device, m: float = 0.2, **more: object) -> Plenoptic2:
    given = {"count": (13, 15), "fill": "full"} | more
    return PlenopticCamera.type2(
        focal_length=0.015,
        object_distance=OBJECT,
        mla=MicrolensArray(PITCH, 3e-3, **given),
        wavelength=LAM,
        pixels_per_lenslet=30,
        aperture_diameter=D,
        m=m,
        device=device,
    )


def box_of_airy(u: np.ndarray) -> np.ndarray:
    """Light of Airy's pattern on a lenslet whose centre lies (0, u) from the pattern's, on 1 um."""
    fine = (np.arange(1201) - 600) * 1e-6
    r = np.hypot(fine[:, None], fine[None, :])
    pattern = airy(np.pi * D * r / (LAM * IMAGE)) ** 2
    rows = pattern[np.abs(fine) <= PITCH / 2].sum(axis=0)
    return np.array([rows[np.abs(fine - one) <= PITCH / 2].sum() for one in u])


def test_psf_of_a_standard_camera_is_the_light_that_falls_on_a_lenslet(device: Device) -> None:
    camera, places = standard(device), 5
    psf = camera_psf(camera, positions=places)
    assert psf.values.shape == (13 * places, 15 * places)
    assert psf.pitch == pytest.approx((PITCH / places, PITCH / places))
    assert psf.centroid() == pytest.approx((0, 0), abs=1e-7)
    f = np.linspace(0, 0.9 / PITCH, 10)
    ideal = np.sinc(f * PITCH) * circular_mtf(f, wavelength=LAM, distance=IMAGE, width=D)
    for axis in (0, 1):
        x, line = psf.profile(axis, centre=(0.0, 0.0))
        middle = np.abs(x) < 2.1 * PITCH
        expected = box_of_airy(x[middle])
        # 30 of a sub-image's 34.5 pixels are decoded, and lenslets pass some of their neighbours'
        # light
        shape = line[middle] / line.max()
        np.testing.assert_allclose(shape, expected / expected.max(), atol=0.03)
        np.testing.assert_allclose(OTF.of(psf).mtf(axis).contrast(f), ideal, atol=0.04)


def test_mirrored_places_stand_for_each_other(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    for count, few in (((9, 9), 3), ((9, 11), 4)):
        camera = standard(device, count=count)
        quick = camera_psf(camera, positions=3, done=made.append)
        assert (sum(made), psf_exposures(camera, 3)) == (few, few)
        with monkeypatch.context() as patch:
            patch.setattr(of_camera, "is_symmetric", lambda _: False)
            whole = camera_psf(camera, positions=3)
            assert psf_exposures(camera, 3) == 9
        np.testing.assert_allclose(quick.values, whole.values, atol=2e-5 * whole.peak)
        made.clear()
    tilted = camera.with_aberrations(Aberrations(main_lens={8: LAM / 8}))
    assert psf_exposures(tilted, 3) == 9


def test_psf_of_a_focused_camera_is_a_lenslet_s_diffraction(device: Device) -> None:
    # Off the axis and with a lattice that the pixels do not fit.
    camera = focused(device, offset=(21e-6, -34e-6))
    psf, unit = camera_psf(camera), LAM * camera.a / PITCH
    assert psf_exposures(camera) == 4
    assert psf.centroid() == pytest.approx((0, 0), abs=2e-6)
    for axis in (0, 1):
        assert psf.fwhm(axis) == pytest.approx(0.886 * unit, rel=0.1)  # the main lens adds 13 um
        mtf, f = OTF.of(psf).mtf(axis), np.linspace(0.1, 0.9, 9) / unit
        ideal = square_mtf(f, wavelength=LAM, distance=camera.a, width=PITCH)
        np.testing.assert_allclose(mtf.contrast(f), ideal, atol=0.08)
        assert mtf.cutoff() == pytest.approx(1 / unit, rel=0.2)


@pytest.mark.thorough
def test_depth_scan(device: Device) -> None:
    shared = {
        "focal_length": 0.030,
        "mla": MicrolensArray(PITCH, 3e-3, count=25, fill="full"),
        "wavelength": LAM,
        "pixels_per_lenslet": 28,
        "aperture_diameter": 2.5e-3,
        "device": device,
    }
    dz = np.array([-9e-3, -1e-3, 9e-3])
    transfer, depth = depth_scan(PlenopticCamera.type1(**shared), dz, positions=3)
    # 1.5 times the error of alpha that `estimate_alpha` says, .1 p/D; p/D in focus
    alpha = np.array([0.15, 1.0, 0.15]) * PITCH / 2.5e-3
    assert (np.abs(depth.errors.T) < alpha * (0.06 + dz) ** 2 / 0.06).all()
    assert (transfer.mtf50 > (3e3, 3.5e3, 2e3)).all()
    transfer, depth = depth_scan(PlenopticCamera.type2(m=0.2, **shared), dz, positions=1)
    assert np.isnan(depth.rms[0])
    assert "too few views: at m = 0.7 a point is seen by 1.4 lenslets a row" in depth.notes[0]
    assert (np.abs(depth.errors[1:, 0]) < 0.4e-3).all()  # 2 % of m at 9 mm
    assert depth.notes[1:] == ("", "")
    assert np.isfinite(transfer.mtf50).all()
    assert transfer.best[0] == -9e-3  # where the image is nearest to the array


def test_depth_beyond_the_search_is_no_depth(device: Device) -> None:
    camera = PlenopticCamera.type1(
        focal_length=0.030, mla=MicrolensArray(PITCH, 3e-3, count=25, fill="full"), wavelength=LAM,
        pixels_per_lenslet=28, aperture_diameter=2.5e-3, device=device,
    )  # fmt: skip
    raw = camera.expose(PointSources([(0.0, 0.0, 9e-3)]))  # .09 pixels a view step
    with pytest.raises(ValueError, match=r"end of the search, 0\.05 pixels a view step"):
        measured_depth(raw, c_max=0.05)
    whole = measured_depth(raw, c_max=50.0)  # more than the light field allows: as far as it does
    assert whole == pytest.approx(9e-3, abs=1e-3)


def test_a_moved_sensor_counts(device: Device) -> None:
    shift, dz = 0.5e-3, 2e-3
    camera = focused(device).with_aberrations(Aberrations(sensor_shift=shift))
    assert local_m(camera, 0.0) == pytest.approx((camera.b + shift) / camera.a)
    a = (camera.b + shift) / local_m(camera, dz)
    image = camera.array_distance - a
    assert image == pytest.approx(1 / (1 / 0.015 - 1 / (OBJECT + dz)))
    expected = (camera.b + shift) / a / (2 * camera.pixel_pitch) * image / (OBJECT + dz)
    assert object_nyquist(camera, dz) == pytest.approx(expected)
    # At the main lens' focus m is 0 and the image infinitely far: z3/z of the pixels
    at_focus = (camera.b + shift) / 0.015 / (2 * camera.pixel_pitch)
    assert object_nyquist(camera, 0.015 - OBJECT) == pytest.approx(at_focus)
    plain = PlenopticCamera.type1(
        focal_length=0.120, mla=MicrolensArray(PITCH, 3e-3, count=25), wavelength=LAM,
        pixels_per_lenslet=28, aperture_diameter=2.5e-3, device=device,
    )  # fmt: skip
    moved = plain.with_aberrations(Aberrations(sensor_shift=shift))
    far = np.array([0.0, 0.1])
    assert search_range(moved, far) / search_range(plain, far) == pytest.approx(3 / 3.5)


def test_crosstalk_counts_the_lenslets_that_the_cone_meets(device: Device) -> None:
    camera = focused(device)
    cells = lenslets_in_cone(camera, (6, 7))
    reach = D * camera.a / IMAGE / 2  # radius of the cone on the array: 2.4 lenslets
    assert len({k for _, k in cells}) == 2 * math.floor(reach / PITCH + 0.5) + 1
    assert (6, 7) in cells
    assert (6 - 3, 7 - 3) not in cells
    turned = MicrolensArray(PITCH, 3e-3, count=9, rotation=math.pi / 4)
    for reach, count in ((0.4, 1), (0.6, 5)):  # in pitches; neighbours' cells are half a one away
        cone = SimpleNamespace(
            mla=turned, a=IMAGE, image_distance=IMAGE, aperture_diameter=2 * reach * PITCH
        )
        assert len(lenslets_in_cone(cone, (4, 4))) == count
    assert 0.005 < camera_crosstalk(camera) < 0.06
    wide = standard(device, count=51, fill="circular")
    assert 0 < camera_crosstalk(wide) < 0.1


@pytest.mark.parametrize(
    ("width", "fill", "expected"),
    [(70e-6, "full", 0.514), (150e-6, "circular", 0.086)],
)
def test_crosstalk_over_the_width_of_lenslets(
    device: Device, width: float, fill: str, expected: float
) -> None:
    # f_mu = 10 mm, matched f-numbers; a float64 simulation with Airy's closed form on the array.
    camera = PlenopticCamera.type1(
        focal_length=0.120,
        mla=MicrolensArray(width, 0.010, count=51, fill=fill),
        wavelength=LAM,
        pixels_per_lenslet=14,
        device=device,
    )
    assert camera_crosstalk(camera) == pytest.approx(expected, abs=0.02)


def test_compare_measures_what_is_asked_for(device: Device, tmp_path: Path) -> None:
    cameras = {"one": standard(device, count=(9, 11)), "two": focused(device, count=(11, 13))}
    points = PointSources([(0.2e-3, 0.0, 0.0)])
    steps: list[tuple[int, int]] = []
    found = compare(
        cameras,
        only=["crosstalk", "pictures", "sampling"],
        scenes=dict.fromkeys(cameras, points),
        progress=lambda done, total: steps.append((done, total)),
    )
    assert found.analyses == ("sampling", "crosstalk", "pictures")
    assert steps == [(n, 4) for n in (1, 2, 3, 4)]
    assert found["one"].psf is None
    assert found["two"].transfer is None
    for one in found.cameras:
        picture = one.picture
        _, x = np.unravel_index(np.argmax(picture.values), picture.values.shape)
        place = (x - picture.values.shape[1] // 2) * picture.pitch[1] + picture.origin[1]
        assert place == pytest.approx(-0.2e-3 / 3, abs=picture.pitch[1])  # inverted
    assert set(tables(found)) == {"summary", "sampling"}
    with pytest.raises(ValueError, match="was not measured: add 'psf'"):
        found["one"].mtf()
    with pytest.raises(KeyError, match="choose among one, two"):
        found["three"]


def test_a_picture_lies_where_its_lenslets_do(device: Device) -> None:
    rotation, offset = 0.2, (25e-6, -40e-6)
    camera = standard(device, count=(10, 13), offset=offset, rotation=rotation)
    seen = native_picture(camera.expose(point_at_lenslet(camera, (0.0, 0.0), 0.0)))
    i, k = np.unravel_index(np.argmax(seen.values), seen.values.shape)
    y, x = (
        (n - size // 2) * d + at
        for n, size, d, at in zip((i, k), seen.values.shape, seen.pitch, seen.origin, strict=True)
    )
    cos, sin = math.cos(rotation), math.sin(rotation)
    place = camera.mla.centres()[central_lenslet(camera)]
    assert (y * cos + x * sin, x * cos - y * sin) == pytest.approx(tuple(place), abs=1e-9)


def test_bad_comparisons_are_told(device: Device) -> None:
    camera, far = standard(device, count=9), PointSources([(0.1, 0.0, 0.0)])
    two, scenes = {"one": camera, "two": camera}, {"one": NEAR, "two": far}
    for call, error, words in (
        (lambda: compare({"a": 3}), TypeError, r"a: the camera must be .* got int"),
        (lambda: compare([3]), TypeError, r"must be .* got list"),
        (lambda: compare({}), ValueError, "at least one camera"),
        (lambda: compare({"one": camera}, only=["mft"]), ValueError, r"'mft'.* mean 'mtf'"),
        (lambda: check_analyses([]), ValueError, "Name at least one analysis"),
        (lambda: compare({"one": camera}, only=["pictures"]), ValueError, "every camera; 'one'"),
        (lambda: depth_scan(camera, [0.0, math.nan]), ValueError, "finite numbers"),
        (lambda: depth_scan(camera, [0.0, -0.07]), ValueError, r"of the lens, got -0\.07 m"),
        (lambda: compare(two, only=["pictures"], scenes=scenes), SamplingError, "two: The point"),
        (lambda: camera_psf(camera, positions=4), ValueError, "must be odd"),
    ):
        with pytest.raises(error, match=words):
            call()
    assert check_analyses(reversed(ANALYSES)) == ANALYSES
    assert default_depths(camera, quick=True) == pytest.approx([-9e-3, 0, 9e-3])


def gaussian(width: float, pitch: float) -> PSF:
    x = (np.arange(101) - 50) * pitch
    line = np.exp(-((x / width) ** 2))
    return PSF(np.outer(line, line), pitch)


def test_verdicts_follow_from_the_numbers(device: Device, tmp_path: Path) -> None:
    one, two = standard(device, count=9), focused(device, count=9)
    dz = np.array([-1e-3, 0.0])
    curves = [line_curve(np.exp(-((np.arange(99) - 49) ** 2) / w), 10e-6) for w in (8, 2)]
    known = (
        Measured("wide", one, sampling_of(one), gaussian(100e-6, 12e-6), 0.10,
                 DepthTransfer(dz, (curves[0], curves[1]), ("", ""))),
        Measured("narrow", two, sampling_of(two), gaussian(30e-6, 6e-6), 0.03,
                 DepthTransfer(dz, (None, curves[0]), ("too near", ""))),
    )  # fmt: skip
    names = ("sampling", "psf", "mtf", "two-points", "strehl", "energy", "crosstalk", "transfer")
    found = Comparison(known, names)
    said = {c.name: judge(c, known) for c in criteria(found)}
    assert "`narrow` wins by a factor of 3.33:" in said["crosstalk"]
    # exp(-(pi f w)^2) = .5
    assert usable_mtf50(known[1]) == pytest.approx(math.sqrt(math.log(2)) / (math.pi * 30e-6), 1e-2)
    assert usable_limit(known[0]) == 2 * PITCH
    assert "two samples; its blur alone would allow" in said["two-point limit"]
    assert "diffraction by a lenslet" in said["usable MTF50"]
    assert "`wide` wins" in said["independent directions"]
    assert "meets D abs(a)/(F p) lenslets" in said["independent directions"]
    assert "aberrations" not in said["usable MTF50"]
    thrice = (known[0], known[1], replace(known[1], name="same"))
    by_name = {c.name: judge(c, thrice) for c in criteria(found)}
    assert "`narrow`, `same` are equally good:" in by_name["crosstalk"]
    assert (
        "`narrow`, `same`: the tails of a lenslet's diffraction, 3.4 % at" in by_name["crosstalk"]
    )
    assert "no difference" in judge(criteria(found)[0], thrice[1:])
    none = DepthErrors(dz, np.full((2, 1), math.nan), ("dark", "dark"))
    some = DepthErrors(dz, np.array([[1e-3], [math.nan]]), ("", "dark"))
    deep = Comparison((replace(known[0], depth=some), replace(known[1], depth=none)), ("depth",))
    count, error = (judge(c, deep.cameras) for c in criteria(deep))
    assert "`wide` wins: 1 of `wide`; 0 of `narrow`" in count
    assert "no camera has one" in error
    assert "no difference" in judge(criteria(deep)[0], deep.cameras[1:] * 2)
    lines = depth_verdicts(found)
    assert lines[0].startswith("at dz -1 mm: `wide`")
    assert "`narrow` none" in lines[0]
    equal = replace(known[0], name="equal")
    ties = depth_verdicts(Comparison((known[0], equal, known[1]), ("transfer",)))
    assert ties[0].startswith("at dz -1 mm: `wide`, `equal` are equally good (`wide` ")
    dark = replace(known[1], transfer=DepthTransfer(dz, (None, None), ("too near", "too near")))
    assert depth_verdicts(Comparison((dark,), ("transfer",))) == [
        "at dz -1 to 0 mm: none (`narrow` none cycles/mm of the object)"
    ]
    text = report(found)
    assert "| crosstalk | 0.1 | 0.03 |  |" in text
    made = tables(found)
    made["transfer"].write(tmp_path / "transfer.csv")
    rows = list(csv.DictReader((tmp_path / "transfer.csv").read_text().splitlines()))
    assert {row["camera"] for row in rows} == {"wide", "narrow"}
    assert float(rows[0]["contrast"]) == 1
    assert {row[2] for row in made["summary"].rows if row[1] == "crosstalk"} == {0.1, 0.03}


def test_a_cutoff_beyond_diffraction_s_is_none(device: Device) -> None:
    camera = focused(device, count=9)  # d/(lam a) = 15.7 cycles/mm
    one = Measured("one", camera, sampling_of(camera), gaussian(45e-6, 6e-6))
    assert one.mtf_cutoff() == pytest.approx(one.mtf().cutoff())
    wide = replace(one, psf=gaussian(30e-6, 6e-6))  # 22.8 cycles/mm
    assert math.isnan(wide.mtf_cutoff())
    turned = focused(device, count=9, rotation=0.7)  # by its corners up to 22.2
    assert math.isfinite(replace(wide, camera=turned).mtf_cutoff())
    assert "No MTF cut-off is given" in report(Comparison((one,), ("mtf",)))
