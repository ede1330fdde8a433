"""Aberrations over the pupil of a microscope: fields, point images, projection, files."""

import dataclasses

import numpy as np
import pytest
from reference_microscope import Setup, placed, sensor
from tolerance import relative_max

from clplen import LightField, MicrolensArray, PlenopticCamera, PointSources, estimate_alpha
from clplen.cameras import PupilAberration
from clplen.lightfield import focus_ratio
from clplen.microscopy import point_images, read_point_images
from clplen.microscopy.model.cells import cell_in
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.projector import Projector
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


@pytest.mark.parametrize("terms", [TERMS, {6: 50e-9}, {7: 50e-9}, {5: 50e-9}, {10: 50e-9}])
def test_point_images_of_all_phases(device, terms):
    camera = microscope(device, terms)
    images = point_images(camera, [-6e-6], voxels_per_lenslet=3, cut=0.01)
    assert len(images.stored[0]) == images.cell.count > 3
    r, step = images.radii[0], S.p / S.M / 3
    for sy, sx in ((0, 2), (1, 0)):
        seen = camera.expose(PointSources([((sx - 1) * step, (sy - 1) * step, -6e-6)])).to_numpy()
        kept = slice((17 - r) * 15, (18 + r) * 15)
        assert relative_max(seen[kept, kept], images.image(0, (sy, sx))) < 2e-4  # another window
        total = sum(images.part(0, (sy, sx), part) for part in images.cell.parts)
        assert relative_max(images.image(0, (sy, sx)), total) < 1e-4


def test_symmetric_terms_keep_the_mirrors(device):
    images = point_images(microscope(device, {11: 40e-9}), [-6e-6], voxels_per_lenslet=3, cut=0.01)
    assert images.cell.parts == (0,)
    assert len(images.stored[0]) == 3


@pytest.mark.parametrize(
    ("terms", "parts"),
    [({6: 1e-9}, 1), ({5: 1e-9}, 2), ({8: 1e-9}, 2), ({7: 1e-9}, 2), ({7: 1e-9, 6: 1e-9}, 2),
     ({5: 1e-9, 8: 1e-9}, 4)],
)  # fmt: skip
def test_parts_of_mirrors(terms, parts):
    about = {"pupil": {str(j): c for j, c in terms.items()}}
    assert len(cell_in(about, 3, 5).parts) == parts


@pytest.mark.parametrize(
    ("v", "n", "radii", "shape"),
    [(1, 1, (0,), (1, 1)), (1, 2, (3,), (1, 1)), (2, 1, (1, 0), (1, 4)), (3, 2, (2,), (5, 1)),
     (2, 3, (1, 4), (2, 3)), (3, 5, (2, 1, 0), (2, 3)), (1, 7, (1,), (5, 2))],
)  # fmt: skip
def test_projection_of_images_without_mirrors(device, v, n, radii, shape):
    """Every voxel, at borders and in corners too, is its image, and sees frames through it."""
    rng = np.random.default_rng(v * n)
    stored = tuple(rng.random((v * v, *((2 * r + 1) * n,) * 2)).astype(np.float32) for r in radii)
    about = {"pupil": {"5": 1.0, "8": 1.0}}
    images = PointImages(about, np.arange(len(radii)) * 1e-6, v, n, stored, np.ones(len(radii)))
    projector = Projector(images, shape, device=device)
    streamed = Projector(images, shape, device=device, memory=1)
    voxels = list(np.ndindex(projector.volume_shape))
    H = np.array([
        placed(images.image(z, (y % v, x % v)), (y // v, x // v), shape, n) for z, y, x in voxels
    ])  # fmt: skip
    one = np.eye(len(voxels), dtype=np.float32).reshape(-1, *projector.volume_shape)
    frames = rng.random((3, *projector.frame_shape), np.float32)
    seen = (H.reshape(len(H), -1) @ frames.reshape(3, -1).T).T.reshape(3, *projector.volume_shape)
    for each in (projector, streamed):
        assert relative_max(H, each.forward(one)) < 1e-6
        assert relative_max(seen, each.backward(frames)) < 1e-6


def test_file_names_the_pupil(device, tmp_path):
    path = tmp_path / "psf.h5"
    images = point_images(microscope(device), [9e-6], voxels_per_lenslet=1, cut=0.05, path=path)
    again = read_point_images(path)
    assert again.parameters["pupil"] == {str(j): c for j, c in TERMS.items()}
    assert again.cell == images.cell
    other = dataclasses.replace(microscope(device), pupil=PupilAberration({5: 1e-9}))
    with pytest.raises(ValueError, match="were made with pupil = "):
        point_images(other, [9e-6], voxels_per_lenslet=1, cut=0.05, path=path)


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


@pytest.mark.parametrize(
    ("terms", "error", "words"),
    [
        ({1: 1e-9}, ValueError, "no piston"),
        ({5: np.nan}, ValueError, "finite"),
        ({5: 30.0}, ValueError, "metres"),
        ([1, 2], TypeError, "index: metres"),
        ({0: 1e-9}, ValueError, "Noll"),
    ],
)
def test_what_is_no_pupil(device, terms, error, words):
    with pytest.raises(error, match=words):
        microscope(device, terms)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: mismatch(20.0, 1.33, na=1.1, medium_index=1.5), "20 um are 20e-6"),
        (lambda: mismatch(2e-5, 1.0, na=1.1, medium_index=1.5), "above NA"),
        (lambda: mismatch(2e-5, 1.33, na=1.6, medium_index=1.5), "NA lies between"),
        (lambda: tilted(2.0, na=0.8, medium_index=1.0), "1 degree is 0.0175"),
        (lambda: tilted(0.01, na=0.8, medium_index=1.0, thickness=170), "150e-6"),
        (lambda: mismatch(2e-5, 1.3, na=1.1, medium_index=1.5, terms=2), "from 4 to 200"),
    ],
)  # fmt: skip
def test_what_is_no_sample(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize("law", ["paraxial", "sharpest", "marginal"])
def test_laws_of_depth(device, law):
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


def test_no_such_law(device):
    with pytest.raises(ValueError, match="law is one of 'paraxial', 'sharpest', 'marginal', not"):
        microscope(device, None).z(0.1, law="exact")
