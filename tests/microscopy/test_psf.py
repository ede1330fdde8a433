"""Point images: every voxel phase by its mirror images, cutting, and the file."""

from types import SimpleNamespace

import numpy as np
import pytest
from reference_microscope import Setup, sensor
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera, files
from clplen.cameras.optics.objective import CoverGlass
from clplen.errors import DeviceError, FormatError, SamplingError
from clplen.microscopy.model import point_image_files
from clplen.microscopy.model import psf as module
from clplen.microscopy.model.cells import cell_of
from clplen.microscopy.model.psf import point_images

S = Setup(M=60, na=1.2, p=100e-6, n=15, lam=593e-9, index=1.33)
Z = np.array([-1.5, 0.0, 0.5]) * 1e-6  # not equidistant


def square(v, n):
    return cell_of("square", 1, voxels=v, pixels=n)


def microscope(device, **change):
    values = {"magnification": 60, "na": 1.2, "medium_index": 1.33, "wavelength": 593e-9}
    mla = change.pop("mla", MicrolensArray(100e-6, 2.5e-3, count=9, fill="full"))
    values |= {"pixels_per_lenslet": 15, "mla": mla, "device": device} | change
    return PlenopticCamera.microscope(**values)


def test_each_phase_is_simulated_or_a_mirror_image(device):
    voxels = 4
    images = point_images(microscope(device), Z, voxels_per_lenslet=voxels, cut=5e-3)
    for plane, phase in ((0, (0, voxels - 1)), (2, (voxels - 2, 0)), (1, (2, 1))):
        across, _ = module._window(microscope(device), Z[plane], square(voxels, 15))
        offset = [((s - (voxels - 1) / 2) / voxels) * S.p / S.M for s in phase]
        expected = sensor(S, (offset[1], offset[0], Z[plane]), across)
        r = images.radii[plane]
        kept = slice((across // 2 - r) * S.n, (across // 2 + r + 1) * S.n)
        # complex64 through three transforms, measured 2e-6 of the peak
        assert relative_max(expected[kept, kept], images.image(plane, phase)) < 5e-6
        assert 1 - 5e-3 <= images.captured_share(plane) < 1
        inner = slice((across // 2 - r + 1) * S.n, (across // 2 + r) * S.n)
        assert images.radii[0] > images.radii[1]
        assert expected[inner, inner].sum() < expected[kept, kept].sum()


def test_memory_of_fields_is_given_back(device):
    device.free_spare()
    large = microscope(device, pixels_per_lenslet=45)
    point_images(large, Z[:1], voxels_per_lenslet=2, cut=5e-3)
    assert device._spare.held_blocks == 0
    assert device.workspace.nbytes == 0


def test_cut_holds_for_every_image():
    images = np.zeros((2, 10, 10))
    images[0, 4, 5] = images[1, 5, 4] = 0.9
    images[0, 5, 7] = images[1, 9, 0] = 0.1  # one and two lenslets of 2 x 2 pixels away
    assert module.light_in(images, square(1, 2), 0.05) == (slice(None), slice(None))
    assert module.light_in(0.3 * images, square(1, 2), 0.2) == (slice(4, 6), slice(4, 6))


def test_coarse_pixels_hold_the_sum_of_the_finer_ones(device):
    binning = 7
    camera = microscope(device, pixels_per_lenslet=14)
    fine, coarse = (
        point_images(camera, Z[2:], voxels_per_lenslet=2.0, cut=0.02, binning=float(b))
        for b in (1, binning)
    )
    n = 14 // binning
    assert coarse.pixels == coarse.parameters["pixels_per_lenslet"] == n
    for phase in ((0, 0), (1, 0)):
        whole, found = fine.image(0, phase), coarse.image(0, phase)
        expected = sum(
            whole[y::binning, x::binning] for y in range(binning) for x in range(binning)
        )
        assert relative_max(expected, found) < 1e-6
    with pytest.raises(SamplingError):
        microscope(device, pixels_per_lenslet=n)


def test_parameters_tell_all_that_images_depend_on(device, precise):
    def lenslets(**change):
        return {"mla": MicrolensArray(**({"pitch": 1e-4, "f": 2.5e-3, "count": 9} | change))}

    def told(camera=(), z=Z, voxels=3, binning=1, cut=0.01, store="float32", on=device):
        camera = microscope(on, **({"pixels_per_lenslet": 16} | lenslets() | dict(camera)))
        return module.parameters_of(camera, z, voxels, binning, cut, store)

    cameras = [
        {"magnification": 61}, {"na": 1.19}, {"medium_index": 1.34}, {"wavelength": 594e-9},
        {"cover": CoverGlass(1e-4)}, {"apodisation": -0.5}, {"pixels_per_lenslet": 18},
        lenslets(pitch=1.01e-4), lenslets(f=2.51e-3), lenslets(diameter=0.99e-4),
        lenslets(fill="full"),
    ]  # fmt: skip
    found = [told(camera) for camera in cameras]
    found += [told(), told(z=2 * Z), told(voxels=2), told(binning=2), told(cut=0.02)]
    found += [told(store="float16"), told(on=precise), told({"pixels_per_lenslet": 32}, binning=2)]
    assert all(one != other for i, one in enumerate(found) for other in found[:i])


def test_what_cannot_be_is_said_before_anything_is_simulated(device, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_simulated", None)
    with pytest.raises(FileNotFoundError, match=r"the folder .* does not exist"):
        point_images(microscope(device), Z, path=tmp_path / "none" / "psf.h5")
    with pytest.raises(DeviceError, match="The plane at z = 20000 um needs"):
        point_images(microscope(device), [0.0, 0.02])
    with pytest.raises(DeviceError, match="The plane at z = 0 um needs"):  # 1.25e9 images
        point_images(microscope(device), [0.0], voxels_per_lenslet=100001)
    with pytest.raises(TypeError, match="camera must be a Microscope, as Plen"):
        point_images(None, Z)


def test_file_is_read_when_it_fits(device, tmp_path, monkeypatch):
    camera, path = microscope(device), tmp_path / "psf.h5"
    made = point_images(camera, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    monkeypatch.setattr(module, "_simulated", None)  # not simulated again
    again = point_images(camera, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    assert all(np.array_equal(a, b) for a, b in zip(made.stored, again.stored, strict=True))
    assert np.array_equal(made.scales, again.scales)
    assert again.stored[0].dtype == np.float16
    assert 0.98 <= again.captured_share(0) < 1
    other = microscope(device, na=1.15)
    with pytest.raises(ValueError, match=r"made with na = 1\.2, not 1\.15"):
        point_images(other, Z, voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    with pytest.raises(ValueError, match="made with 3 planes, not 2"):
        point_images(camera, Z[:2], voxels_per_lenslet=3, cut=0.02, store="float16", path=path)
    with monkeypatch.context() as patch:
        patch.setattr(point_image_files, "free_memory", lambda: 1000)
        with pytest.raises(FormatError, match="bytes of memory, 1,000 are free"):
            point_image_files.read_point_images(path)
    good = path.read_bytes()
    text = good.index(b"clplen point images", good.index(b"GCOL")) - 16
    path.write_bytes(good[:text] + bytes(16) + good[text + 16 :])
    with pytest.raises(FormatError, match="the strings at byte"):  # HDF5 would not end
        point_image_files.read_point_images(path)


def test_room_is_looked_for_before_and_after(device, tmp_path, monkeypatch):
    camera, path, least = microscope(device), tmp_path / "psf.h5", []
    monkeypatch.setattr(module, "check_space", lambda path, nbytes: least.append(nbytes))
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: SimpleNamespace(free=10**5))
    with pytest.raises(OSError, match=r"needs [\d,]+ bytes, but the disk has only 100,000 free"):
        point_images(camera, 4 * Z, voxels_per_lenslet=1, path=path)
    monkeypatch.undo()
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(module, "check_space", lambda path, nbytes: least.append(nbytes))
    done = []
    point_images(camera, 4 * Z, voxels_per_lenslet=1, path=path, progress=lambda *a: done.append(a))
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert 0 < least[0] == least[1] < path.stat().st_size
    monkeypatch.undo()
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: SimpleNamespace(free=least[0] - 1))
    monkeypatch.setattr(module, "_simulated", None)
    with pytest.raises(OSError, match="but the disk has only"):
        point_images(camera, 4 * Z, voxels_per_lenslet=1, path=tmp_path / "other.h5")


def test_what_cannot_be(device):
    for camera, options, words in [
        ({"pixels_per_lenslet": 15.4}, {}, "rectify the frame to an integer, such as 16"),
        ({"mla": MicrolensArray(100e-6, 2.5e-3, count=5, rotation=0.1)}, {}, "rectify the frame"),
        ({"mla": MicrolensArray(1e-4, 2.5e-3, count=5, offset=(1e-6, 0))}, {}, r"\(1e-06, 0\) m"),
        ({}, {"binning": 2}, "multiple of binning = 2, got 15"),
        ({}, {"binning": 0}, "binning must be a whole number from 1"),
        ({}, {"planes": [0, 0]}, "different finite numbers"),
        ({}, {"planes": [1e-6, 0]}, "planes must rise"),
        ({}, {"planes": [-40, 0, 40]}, r"got -40 m\..* in metres: did you mean -40e-6\?"),
        ({}, {"voxels_per_lenslet": 0}, "whole number from 1"),
        ({}, {"cut": 0.7}, "between 0 and 0.5"),
        ({}, {"store": "int8"}, "'float32' or 'float16'"),
        ({}, {"planes": np.array([1e-6j])}, "planes must hold real numbers, got complex128"),
    ]:
        options = {"planes": Z} | options
        with pytest.raises((ValueError, TypeError), match=words):
            point_images(microscope(device, **camera), options.pop("planes"), **options)
