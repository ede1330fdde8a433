"""Point images of a Fourier microscope from frames of a bead, against those of its parameters."""

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from setups_fourier import SMALL, camera_of

from clplen import MicrolensArray, PlenopticCamera, PointSources, ShapeError
from clplen.cli import main
from clplen.errors import SamplingWarning
from clplen.microscopy import (
    FourierProjector,
    fourier_point_images,
    measure_point_images,
    read_point_images,
)
from clplen.microscopy.frames.outliers import without_hot_pixels
from clplen.microscopy.frames.sharpness import sharpness

Z = np.array([-20.0, 0.0, 15.0]) * 1e-6
OFFSET = 1.7e-6
AT = np.array([[2.3, -1.1], [2.6, -0.7], [1.9, -1.4]]) * 1e-6  # (y, x) of a stage that wobbles


@pytest.fixture(scope="module")
def camera(device):
    return PlenopticCamera.fourier_microscope(**(SMALL | {"pixel_pitch": 5e-6}), device=device)


@pytest.fixture(scope="module")
def stack(camera):
    points = [PointSources((x, y, z - OFFSET)) for z, (y, x) in zip(Z, AT, strict=True)]
    return np.maximum([camera.expose(one).to_numpy() for one in points], 0)


def errors(found, camera):
    true = fourier_point_images(camera, Z - OFFSET, cut=1e-4)
    for plane in range(len(Z)):
        seen, expected = (one.image(plane, (0, 0)).astype(float) for one in (found, true))
        expected *= np.vdot(seen, expected) / np.vdot(expected, expected)
        yield np.linalg.norm(seen - expected) / np.linalg.norm(expected)


def test_without_noise(camera, stack):
    found = measure_point_images(camera, stack, Z)
    assert found.offset == pytest.approx(OFFSET, abs=0.02e-6)
    assert found.depths == pytest.approx(Z - OFFSET, abs=0.1e-6)
    assert found.positions == pytest.approx(AT, abs=0.01 * camera.side)
    assert found.error < 0.02
    assert max(errors(found.images, camera)) < 0.015
    assert found.images.planes == pytest.approx(Z - found.offset)
    assert found.images.parameters["source"] == "measured"
    shares = [found.images.captured_share(plane) for plane in range(3)]
    assert np.mean(shares) == pytest.approx(1, abs=0.02)


@pytest.mark.thorough
def test_noise_is_left_out(camera, stack):
    """1e5 photons a frame, 5 a pixel besides: less than half of the frames' own noise remains."""
    photons = np.random.default_rng(0).poisson(stack * 1e5 + 5)
    found = measure_point_images(camera, photons, Z)
    assert found.offset == pytest.approx(OFFSET, abs=0.1e-6)
    assert found.positions == pytest.approx(AT, abs=0.05 * camera.side)
    raw = np.linalg.norm(photons - 5 - stack * 1e5) / np.linalg.norm(stack * 1e5)
    assert max(errors(found.images, camera)) < 0.6 * raw
    assert found.images.stored[0].shape[-1] < 25
    projector = FourierProjector(found.images, (31, 31), device=camera.device)
    assert projector.volume_shape == (3, 31, 31)


def test_hot_pixels_of_a_stack_are_replaced(camera, stack):
    rng = np.random.default_rng(2)
    photons = rng.poisson(stack * 1e6 + 5) + 100.0
    sharpest = sharpness(fourier_point_images(camera, Z))
    same, none = without_hot_pixels(photons, sharpest)
    assert none == 0
    assert np.array_equal(same, photons)
    places = rng.choice(photons[0].size, 30, replace=False)
    spoilt = photons.copy()
    spoilt.reshape(3, -1)[:, places] += 0.5 * photons.max()
    found, count = without_hot_pixels(spoilt, sharpest)
    assert count == 90
    changed = np.flatnonzero((found != spoilt).any(axis=0))
    assert set(changed) == set(places)
    assert np.abs(found - photons).max() < 0.1 * photons.max()
    at_all = np.full_like(photons, 100.0)
    at_all[:, ::5, ::5] = 9000.0  # 4 % of the pixels are no hot pixels
    assert without_hot_pixels(at_all, sharpest)[1] == 0


@pytest.mark.thorough
def test_a_stack_becomes_a_file(tmp_path, camera, stack):
    parameters, frames, psf = (tmp_path / name for name in ("camera.toml", "bead.tif", "psf.h5"))
    parameters.write_text(
        '[camera]\nkind = "fourier_microscope"\nmagnification = 20\nna = 0.3\nwavelength_nm = 525\n'
        "relay_mm = 50\npixel_um = 5\n[camera.microlenses]\npitch_um = 500\n"
        "focal_length_mm = 12\ncount = 3\n"
    )
    counts = np.random.default_rng(1).poisson(stack * 1e6 + 20).astype(np.uint16)
    counts[:, 31, 47] = 60000
    tifffile.imwrite(frames, counts, photometric="minisblack")
    words = ["microscope", "psf", parameters, "--beads", frames, "-o", psf]
    words += ["--device", camera.device.place]
    result = CliRunner().invoke(main, [*map(str, words), "--planes-um", "-20:20:3"])
    assert "3 hot pixels in 3 frames are replaced" in result.output
    assert result.exit_code == 0, result.output
    assert "measured. The given z" in result.output
    assert len(read_point_images(psf).planes) == 3
    result = CliRunner().invoke(main, [*map(str, words), "--planes-um", "-20:20:4", "--force"])
    assert result.exit_code == 1
    assert "must have a frame for each of the 4 planes, got 3" in result.output


def test_stacks_that_cannot_be(device, camera, stack):
    few = PlenopticCamera.fourier_microscope(
        **(SMALL | {"mla": MicrolensArray(500e-6, 12e-3, count=1)}), device=device
    )
    for optics, frames, z, other, words in (
        (camera, stack, Z[:2], {}, "a frame of the sensor for each plane"),
        (camera, np.where(stack > 1e-3, np.nan, stack), Z, {}, "not finite"),
        (camera, np.full(stack.shape, 3.0), Z, {}, "No bead detected in frame 0"),
        (camera, stack, Z, {"threshold": -1}, "threshold"),
        (camera, stack, Z, {"cut": 0.6}, "cut"),
        (few, np.ones((3, *few.grid.shape)), Z, {}, "At least 3 lenslets"),
    ):
        with pytest.raises((ShapeError, ValueError), match=words):
            measure_point_images(optics, frames, z, **other)
    coarse = camera_of("small", device)
    with (
        pytest.warns(SamplingWarning, match="undersample"),
        pytest.raises(ValueError, match="No bead"),
    ):
        measure_point_images(coarse, np.ones((3, *coarse.grid.shape)), Z)
