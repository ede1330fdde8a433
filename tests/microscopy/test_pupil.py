"""Aberrations over the pupil of a microscope: fields, point images, projection, files."""

import dataclasses

import numpy as np
import pytest
from reference_microscope import Setup, sensor
from tolerance import relative_max

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, estimate_alpha
from clplen.cameras import PupilAberration
from clplen.lightfield import focus_ratio
from clplen.microscopy import point_images, read_point_images
from clplen.microscopy.model.cells import cell_in
from clplen.wave import noll, zernike

TERMS = {4: 25e-9, 5: 40e-9, 8: -35e-9, 9: 30e-9, 11: 20e-9}
S = Setup(M=20, na=0.3, p=120e-6, f_mu=4e-3, n=15, lam=600e-9, index=1.0)
mismatch, tilted = PupilAberration.from_index_mismatch, PupilAberration.from_tilted_cover
MLA = MicrolensArray(120e-6, 4e-3, count=35, fill="full")


def microscope(device, pupil=TERMS, **change):
    values = {"magnification": 20, "na": 0.3, "wavelength": 600e-9, "pixels_per_lenslet": 15,
              "mla": MLA, "device": device, "pupil": pupil} | change  # fmt: skip
    return PlenopticCamera.microscope(**values)


def test_exposure_against_sums_over_frequencies(device):
    """The twin multiplies the pupil by exp(2 pi i W/lam), W of Noll's terms, in float64."""
    point = (1.3e-6, -2.1e-6, 7e-6)
    path = lambda rho, theta: sum(c * zernike(*noll(j), rho, theta) for j, c in TERMS.items())  # noqa: E731
    expected = sensor(S, point, 35, path=path)
    found = microscope(device).expose(PointSources([point])).to_numpy()
    assert relative_max(expected, found) < 5e-6
    plain = microscope(device, None).expose(PointSources([point])).to_numpy()
    assert relative_max(expected, plain) > 0.2


def test_point_images_of_all_phases(device, tmp_path):
    camera, path = microscope(device), tmp_path / "psf.h5"
    images = point_images(camera, [-6e-6], voxels_per_lenslet=3, cut=0.01, path=path)
    assert read_point_images(path).cell == images.cell
    other = dataclasses.replace(camera, pupil=PupilAberration({5: 1e-9}))
    with pytest.raises(ValueError, match="were made with pupil = "):
        point_images(other, [-6e-6], voxels_per_lenslet=3, cut=0.01, path=path)
    assert len(images.stored[0]) == images.cell.count > 3
    r, step = images.radii[0], S.p / S.M / 3
    for sy, sx in ((0, 2), (1, 0)):
        seen = camera.expose(PointSources([((sx - 1) * step, (sy - 1) * step, -6e-6)])).to_numpy()
        kept = slice((17 - r) * 15, (18 + r) * 15)
        assert relative_max(seen[kept, kept], images.image(0, (sy, sx))) < 2e-4  # another window
        total = sum(images.part(0, (sy, sx), part) for part in images.cell.parts)
        assert relative_max(images.image(0, (sy, sx)), total) < 1e-4


def test_parts_of_mirrors():
    for terms, parts in [
        ({6: 1e-9, 11: 1e-9}, 1),
        ({8: 1e-9}, 2),
        ({7: 1e-9, 6: 1e-9}, 2),
        ({5: 1e-9, 8: 1e-9}, 4),
    ]:
        about = {"pupil": {str(j): c for j, c in terms.items()}}
        assert len(cell_in(about, 3, 5).parts) == parts


def test_index_mismatch_is_the_closed_path():
    found = mismatch(20e-6, 1.33, na=1.1, medium_index=1.515, terms=79)
    rho = np.linspace(0, 1, 101)
    s2 = (1.1 * rho) ** 2
    path = 20e-6 * (np.sqrt(1.33**2 - s2) - 1.515 / 1.33 * np.sqrt(1.515**2 - s2))
    off = found.path(rho, 0.7) - path
    assert np.ptp(off) < 1e-9
    assert all(noll(j)[1] == 0 for j, _ in found.terms)


def test_tilted_cover_by_refraction():
    """W(tilted) - W(flat) of plates by Snell's law along rays, up to piston and movement."""
    angle, azimuth, t, g, na = 0.03, 0.7, 170e-6, 1.5255, 0.8
    found = tilted(angle, azimuth=azimuth, na=na, medium_index=1.0, terms=105)
    rng = np.random.default_rng(1)
    rho, theta = np.sqrt(rng.random(400)), 2 * np.pi * rng.random(400)
    ray = np.stack(
        [na * rho * np.cos(theta), na * rho * np.sin(theta), np.sqrt(1 - (na * rho) ** 2)]
    )
    normal = np.array(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
    )
    slanted, flat = (t * (np.sqrt(g**2 - 1 + c**2) - c) for c in (normal @ ray, ray[2]))
    left = slanted - flat - found.path(rho, theta)
    plane = np.stack([np.ones(400), ray[0], ray[1]], axis=1)
    left -= plane @ np.linalg.lstsq(plane, left, rcond=None)[0]
    assert np.abs(left).max() < 1e-10
    assert np.abs(slanted - flat).max() > 1e-7


def test_what_is_no_pupil(device):
    for terms, error, words in [
        ({1: 1e-9}, ValueError, "a piston does not"),
        ({5: np.nan}, ValueError, "finite"),
        ({5: 30.0}, ValueError, "metres"),
        ([1, 2], TypeError, "index: metres"),
        ({0: 1e-9}, ValueError, "Noll"),
    ]:
        with pytest.raises(error, match=words):
            microscope(device, terms)


def test_what_is_no_sample():
    for call, words in [
        (lambda: mismatch(20.0, 1.33, na=1.1, medium_index=1.5), "20 um are 20e-6"),
        (lambda: mismatch(2e-5, 1.0, na=1.1, medium_index=1.5), "above NA"),
        (lambda: mismatch(2e-5, 1.33, na=1.6, medium_index=1.5), "na must be between"),
        (lambda: tilted(2.0, na=0.8, medium_index=1.0), "1 degree is 0.0175"),
        (lambda: tilted(0.01, na=0.8, medium_index=1.0, thickness=170), "150e-6"),
        (lambda: mismatch(2e-5, 1.3, na=1.1, medium_index=1.5, terms=2), "4 to 200"),
    ]:
        with pytest.raises(ValueError, match=words):
            call()


def test_laws_of_depth(device):
    for law in ["paraxial", "sharpest", "marginal"]:
        camera = microscope(device, None)
        z = np.array([[-20e-6, 0.0, 35e-6]])
        d = camera.disparity(z, law=law)
        assert np.allclose(camera.z(d, law=law), z, rtol=2e-3, atol=0)
        expected = {"paraxial": 1.0, "sharpest": focus_ratio(camera, 35e-6), "marginal": 0.91**-0.5}
        assert d[0, 2] == pytest.approx(expected[law] * camera.disparity(35e-6), rel=1e-9)
        assert isinstance(camera.z(0.1, law=law), float)


def test_sharpest_plane_of_a_point(device):
    """20x/0.5: a point is found where the law of the sharpest plane says, and not by the others."""
    camera = microscope(
        device, None, na=0.5, pixels_per_lenslet=27, wavelength=525e-9,
        mla=MicrolensArray(125e-6, 2.5e-3, count=21, fill="full"),
    )  # fmt: skip
    z = -0.25 * camera.depth_range
    lf = LightField.from_raw(camera.expose(PointSources([(0, 0, z)])))
    found = estimate_alpha(lf, at=(10, 10)).disparity
    assert camera.z(found, law="sharpest") == pytest.approx(z, rel=0.02)
    assert abs(camera.z(found) / z - 1) > 0.05
    assert abs(camera.z(found, law="marginal") / z - 1) > 0.03
