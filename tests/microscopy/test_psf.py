"""Point images: every voxel phase by its mirror images, cutting, and the file."""

import h5py
import numpy as np
import pytest
from reference_microscope import Setup, sensor
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera
from clplen.errors import FormatError
from clplen.microscopy import psf as module
from clplen.microscopy import psffile
from clplen.microscopy.psf import point_images

S = Setup(M=60, na=1.2, p=100e-6, n=15, lam=593e-9, index=1.33)
Z = np.array([-1.5, 0.0, 0.5]) * 1e-6  # not equidistant


def microscope(device, **change):
    values = {"magnification": 60, "na": 1.2, "medium_index": 1.33, "wavelength": 593e-9}
    mla = change.pop("mla", MicrolensArray(100e-6, 2.5e-3, count=9, fill="full"))
    values |= {"pixels_per_lenslet": 15, "mla": mla, "device": device} | change
    return PlenopticCamera.microscope(**values)


@pytest.mark.parametrize("voxels", [3, 4])
def test_each_phase_is_simulated_or_a_mirror_image(device, voxels):
    images = point_images(microscope(device), Z, voxels_per_lenslet=voxels, cut=5e-3)
    for plane, phase in ((0, (0, voxels - 1)), (2, (voxels - 2, 0)), (1, (2, 1))):
        across = module._lenslets_across(microscope(device), Z[plane])
        offset = [((s - (voxels - 1) / 2) / voxels) * S.p / S.M for s in phase]
        expected = sensor(S, (offset[1], offset[0], Z[plane]), across)
        r = images.radii[plane]
        kept = slice((across // 2 - r) * S.n, (across // 2 + r + 1) * S.n)
        # complex64 through three transforms, measured 2e-6 of the peak
        assert relative_max(expected[kept, kept], images.image(plane, phase)) < 5e-6
        assert 1 - 5e-3 <= images.kept(plane) < 1
        inner = slice((across // 2 - r + 1) * S.n, (across // 2 + r) * S.n)
        assert images.radii[0] > images.radii[1]
        assert expected[inner, inner].sum() < expected[kept, kept].sum()


def test_cut_holds_for_every_image():
    images = np.zeros((2, 10, 10))
    images[0, 4, 5] = images[1, 5, 4] = 0.9
    images[0, 5, 7] = images[1, 9, 0] = 0.1  # one and two lenslets of 2 x 2 pixels away
    assert module._cut(images, 2, 0.05).shape == (2, 10, 10)
    assert module._cut(images[:1], 2, 0.05).shape == (1, 6, 6)
    assert np.array_equal(module._cut(images, 2, 0.2), images[:, 4:6, 4:6])


def test_file_is_read_when_it_fits(device, tmp_path, monkeypatch):
    camera, path = microscope(device), tmp_path / "psf.h5"
    made = point_images(camera, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    monkeypatch.setattr(module, "_simulated", None)  # not simulated again
    again = point_images(camera, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    assert all(np.array_equal(a, b) for a, b in zip(made.stored, again.stored, strict=True))
    assert np.array_equal(made.scales, again.scales)
    assert again.stored[0].dtype == np.float16
    other = microscope(device, na=1.15)
    with pytest.raises(ValueError, match=r"made with na = 1\.2, not 1\.15"):
        point_images(other, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    with pytest.raises(ValueError, match="made with planes = "):
        point_images(camera, Z[:2], voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    with h5py.File(path, "r+") as file:
        file["planes/0001"][0, 3, 4] += np.float16(0.5)
    with pytest.raises(FormatError, match="damaged"):
        psffile.read(path)
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(FormatError, match="no whole file"):
        psffile.read(path)


def test_half_precision_is_near(device):
    whole, half = (
        point_images(microscope(device), Z[:1], voxels_per_lenslet=2, cut=0.01, store=store)
        for store in ("float32", "float16")
    )
    difference = np.abs(half.image(0, (0, 1)) - whole.image(0, (0, 1)))
    assert (difference <= 5e-4 * whole.image(0, (0, 1)) + 4e-8 * whole.stored[0].max()).all()


@pytest.mark.parametrize(
    ("camera", "options", "words"),
    [
        ({"pixels_per_lenslet": 15.4}, {}, "rectify the frame to a whole number, such as 16"),
        ({"mla": MicrolensArray(100e-6, 2.5e-3, count=5, rotation=0.1)}, {}, "rectify the frame"),
        ({}, {"planes": [0, 0]}, "different finite numbers"),
        ({}, {"voxels_per_lenslet": 0}, "whole number from 1"),
        ({}, {"cut": 0.7}, "between 0 and 0.5"),
        ({}, {"store": "int8"}, "'float32' or 'float16'"),
    ],
)
def test_what_cannot_be(device, camera, options, words):
    options = {"planes": Z} | options
    with pytest.raises(ValueError, match=words):
        point_images(microscope(device, **camera), options.pop("planes"), **options)
