"""Raw frames that are not rectified: lattice, kinds of lenslets, sensitivity, haze."""

import numpy as np
import pytest
from tifffile import imwrite

from clplen import MicrolensArray, PlenopticCamera, ShapeError
from clplen.lightfield import Lattice
from clplen.microscopy import (
    DeconvolutionSettings,
    Deconvolver,
    FrameProjector,
    point_images,
    raw_preparation,
)
from clplen.microscopy.frames.raw_frames import evenly_lit

PITCH = 7.7
KINDS = {
    "hexagonal": ("hexagonal", 1.5e-3), "three kinds": ("hexagonal", (1.5e-3, 1.42e-3, 1.6e-3)),
    "two kinds": ("square", (1.5e-3, 1.9e-3)),
}  # fmt: skip


MADE = {}


def setup(device, name, voxels=1):
    if (name, voxels, device) not in MADE:
        MADE[name, voxels, device] = make(device, name, voxels)
    return MADE[name, voxels, device]


def make(device, name, voxels):
    kind, focal_length = KINDS[name]
    mla = MicrolensArray(60e-6, focal_length, count=5, fill="full", lattice=kind)
    camera = PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, mla=mla, pixels_per_lenslet=24, device=device
    )
    images = point_images(
        camera, [30e-6, 90e-6], voxels_per_lenslet=voxels, binning=2, sensor_pixels=PITCH, cut=0.02
    )
    row, cos, sin = PITCH * (0.75**0.5 if kind == "hexagonal" else 1), np.cos(0.02), np.sin(0.02)
    steps = (row * cos, -row * sin), (PITCH * sin, PITCH * cos)
    lattice = Lattice(kind, (50.3, 60.9), *steps, shape=(121, 130))
    return images, FrameProjector(images, lattice, device=device)


def white_of(images, projector):
    """Even light, and pixels of unlike sensitivity."""
    even = 1e4 * np.maximum(projector.tiled_frame(evenly_lit(images)), 0)
    rng = np.random.default_rng(3)
    return even, 1 + 0.1 * rng.standard_normal(projector.frame_shape)


@pytest.mark.parametrize("name", ["three kinds", "two kinds"])
def test_lattice_kinds_and_sensitivity(device, name):
    images, true = setup(device, name)
    even, uneven = white_of(images, true)
    found = raw_preparation(images, white=even * uneven, device=device)
    # another lenslet of the first kind is as good an origin
    away = (np.array(found.lattice.origin) - true.lattice.origin) @ np.linalg.inv(true._steps)
    centred = away * 2 % 1 if images.cell.lenslets != (1, 1) else away % 1  # cells have two
    assert np.abs((centred + 0.5) % 1 - 0.5).max() < 0.05
    # local lattices agree to .15 pixels over 16 lenslets, where pixels differ by a tenth
    assert np.abs(np.array(found.lattice.column) - true.lattice.column).max() < 1e-2
    inner = (slice(20, -20), slice(20, -20))
    bright = even[inner] > 0.3 * even[inner].mean()
    ratio = (found.sensitivity / uneven)[inner][bright]
    # 10 % of noise in each pixel, averaged over some hundred cells, and interpolation
    assert abs(ratio.mean() - 1) < 0.01
    assert ratio.std() < 0.05


def test_hot_and_masked_pixels(device):
    images, true = setup(device, "hexagonal")
    even = white_of(images, true)[0]
    rng, mask = np.random.default_rng(4), np.zeros(even.shape, np.uint8)
    mask[7, 9] = mask[100, 31] = 1
    white = even.copy()
    white[60, 71] += 6 * even.max()
    found = raw_preparation(images, white=white, device=device, mask=mask, find_hot=True)
    assert found.sensitivity[60, 71] == found.sensitivity[7, 9] == 0
    volumes = [rng.random(true.volume_shape) ** 8, np.zeros(true.volume_shape)]
    volumes[1][(0, 1, 1, 0), (5, 7, 3, 9), (6, 2, 9, 9)] = 1
    for volume in volumes:
        mean = np.maximum(true.forward(volume), 0)
        for photons in (2e6, 2e4):
            frame = rng.poisson(mean * (photons / mean.sum(dtype=float)) + 1)
            assert found(frame).hot == 0
            places = rng.choice(frame.size, 30, replace=False)
            frame.flat[places] += int(40 * frame.mean() + 200)
            got = found(frame)
            assert got.hot >= 24  # not those beside a bright bead, nor masked ones
            assert got.masked + (mask.ravel()[places] > 0).sum() == 2
            assert np.isin(np.flatnonzero(got.white.ravel() == 0), [
                *places, *np.flatnonzero(found.sensitivity == 0), *np.flatnonzero(mask)
            ]).all()  # fmt: skip


def test_counts_stay_those_of_the_camera(device):
    images, true = setup(device, "hexagonal")
    white = 100 + white_of(images, true)[0]
    dark = np.full(white.shape, 100.0, np.float32)
    preparation = raw_preparation(images, white=white, dark=dark, device=device)
    frame = np.random.default_rng(1).integers(90, 4000, white.shape).astype(np.uint16)
    frame[40, 50] = 65535
    got = preparation(frame)
    known = np.ones(white.shape, bool)
    known[40, 50] = False
    assert np.array_equal(got.counts[known], np.maximum(frame.astype(float) - 100, 0)[known])
    assert got.white[40, 50] == 0
    assert got.left_out == 1
    assert preparation.area == preparation.variance == 1
    with pytest.raises(ShapeError, match="The frame has shape"):
        preparation(frame[1:])
    hazy = 0.25 * preparation.level
    hazy[40:60, 40:60] *= 3
    assert np.abs(preparation.haze(hazy, got.white) - 0.25 * preparation.level).max() < 2


@pytest.mark.thorough
def test_a_volume_without_rectifying(device, tmp_path):
    images, true = setup(device, "three kinds")
    imwrite(tmp_path / "white.tif", white_of(images, true)[0])
    volume = np.zeros(true.volume_shape, np.float32)
    at = (0, volume.shape[1] // 2, volume.shape[2] // 2)
    volume[at] = 1e4
    made = Deconvolver(
        images, DeconvolutionSettings(iterations=8), device=device, white=tmp_path / "white.tif"
    )
    found = made(made.prepared(true.forward(volume)))
    plane, i, k = np.unravel_index(found.volume.argmax(), found.volume.shape)
    seen, known = made.voxel_grid(), true.voxel_grid()
    there = np.array(seen["first"]) + i * np.array(seen["down"]) + k * np.array(seen["right"])
    here = (
        np.array(known["first"])
        + at[1] * np.array(known["down"])
        + at[2] * np.array(known["right"])
    )
    assert plane == 0
    assert np.abs(there - here).max() < 3.9  # half a voxel: the origin may be another lenslet
    assert made.diagnose(made.prepared(true.forward(volume)), found) == []
    with pytest.raises(ValueError, match="requires the lattice of a white frame"):
        Deconvolver(images, DeconvolutionSettings(), device=device)


def test_a_white_frame_of_other_lenslets(device):
    images, _ = setup(device, "hexagonal")
    wave = 1 + np.cos(2 * np.pi * np.arange(120) / 12.9)
    with pytest.raises(ValueError, match="not a reliable white image"):
        raw_preparation(images, white=np.outer(wave, wave) * 1e3, device=device)
