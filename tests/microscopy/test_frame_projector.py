"""Frames on the pixels of a camera whose lattice is turned, hexagonal or of several kinds."""

import itertools
import math

import numpy as np
import pytest
from reference_lightfield import spline_kernel
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera, PointSources, ShapeError
from clplen.cameras import PixelArray
from clplen.lightfield import Lattice
from clplen.microscopy import FrameProjector, PointImages, Projector, lattice_of, point_images
from clplen.microscopy.model.cells import cell_of
from clplen.microscopy.model.psf import _symmetric

LATTICES = {
    "turned": Lattice("square", (13.2, 17.6), (4.9, -0.8), (0.9, 5.1), shape=(31, 34)),
    "hexagonal": Lattice("hexagonal", (14.0, 11.5), (4.3, 0.3), (-0.4, 5.0), shape=(28, 33)),
    "along y": Lattice("hexagonal", (14.0, 11.5), (5.0, 0.4), (-0.3, 4.3), shape=(28, 33)),
}


def any_images(kind, kinds=1, v=2, n=6):
    """Images of random numbers that keep the mirrors of an array."""
    cell, rng = cell_of(kind, kinds, voxels=v, pixels=n), np.random.default_rng(kinds)
    phases, (ny, nx) = cell.phases(), cell.pixels
    stored = [
        _symmetric(rng.random((len(phases), k * ny, k * nx)), phases, cell).astype(np.float32)
        for k in (1, 3)
    ]
    about = {"lattice": kind, "lenslet_focal_lengths": (1.0,) * kinds}
    return PointImages(about, np.array([0, 1e-6]), v, n, tuple(stored), np.array([1.0, 0.5]))


def lenslet(lattice, cell, i, k):
    """The centre of cell (i, k): of lenslet (i rows, k columns) of the lattice."""
    rows, columns = cell.lenslets
    return (
        lattice.at(columns * k, -rows * i) if lattice.turned else lattice.at(rows * i, columns * k)
    )


def frame_of(image, lattice, cell, at):
    """A point image about a cell, each pixel of the camera by splines through all model pixels."""
    zero, down, right = (lenslet(lattice, cell, *one) for one in ((0, 0), (1, 0), (0, 1)))
    ny, nx = lattice.shape
    y, x = np.indices((ny, nx))
    steps = np.array([down - zero, right - zero])
    places = (np.stack([y, x], -1) - lenslet(lattice, cell, *at)) @ np.linalg.inv(steps)
    weights = []
    for axis in (0, 1):
        samples = (np.arange(image.shape[axis]) - (image.shape[axis] - 1) / 2) / cell.pixels[axis]
        apart = (places[..., axis, None] - samples) * cell.pixels[axis]
        between = np.subtract.outer(np.arange(len(samples)), np.arange(len(samples)))
        weights.append(spline_kernel(apart) @ np.linalg.inv(spline_kernel(between)))
    area = math.prod(cell.pixels) / abs(np.linalg.det(steps))
    return area * np.einsum("yxa,ab,yxb->yx", weights[0], image.astype(float), weights[1])


@pytest.mark.parametrize(("name", "kinds"), [("turned", 2), ("hexagonal", 3), ("along y", 1)])
def test_one_voxel_is_its_image_where_it_lies(device, name, kinds):
    lattice = LATTICES[name]
    images = any_images(lattice.kind, kinds)
    projector, cell = FrameProjector(images, lattice, device=device), images.cell
    (vy, vx), (planes, rows, columns) = cell.voxels, projector.volume_shape
    place = projector.voxel_grid()
    zero = lenslet(lattice, cell, 0, 0)
    steps = np.array([lenslet(lattice, cell, *one) - zero for one in ((1, 0), (0, 1))])
    for z, i, k in ((0, rows // 2, columns // 2), (1, rows // 2 + 1, columns // 2 - 1), (1, 1, 2)):
        volume = np.zeros((planes, rows, columns), np.float32)
        volume[z, i, k] = 2
        at = np.array(place["first"]) + i * np.array(place["down"]) + k * np.array(place["right"])
        phase = (i % vy, k % vx)
        inside = (np.array(phase) - (np.array(cell.voxels) - 1) / 2) / cell.voxels
        number = (at - zero) @ np.linalg.inv(steps) - inside
        # place is rounded to 1e-4 of a pixel
        assert np.abs(number - np.round(number)).max() < 1e-3
        expected = frame_of(2 * images.image(z, phase), lattice, cell, np.round(number).astype(int))
        # positions of samples are multiples of 2^-24 pixel, weights float32
        assert relative_max(expected, projector.forward(volume, clamp=False)) < 5e-6


def test_voxels_are_no_higher_than_wide():
    for kinds, voxels in itertools.product((1, 3), range(1, 12)):
        cell = cell_of("hexagonal", kinds, voxels=voxels, pixels=7)
        (height, width), (vy, vx) = cell.size, cell.voxels
        assert height == pytest.approx(math.sqrt(3))
        assert vx == kinds * voxels
        assert height / vy <= width / vx < height / (vy - 1)


def test_backward_is_the_adjoint(device):
    for name in LATTICES:
        projector = FrameProjector(any_images(LATTICES[name].kind), LATTICES[name], device=device)
        rng = np.random.default_rng(1)
        volumes = rng.random((2, *projector.volume_shape), np.float32) - 0.5
        frames = rng.random((2, *projector.frame_shape), np.float32) - 0.5
        seen, back = projector.forward(volumes, clamp=False), projector.backward(frames)
        for k in range(2):
            scale = np.linalg.norm(seen[k]) * np.linalg.norm(frames[k])
            left, right = np.vdot(seen[k].astype(float), frames[k]), np.vdot(volumes[k], back[k])
            assert abs(left - right) < 1e-6 * scale
        assert (projector.forward(np.abs(volumes)) >= 0).all()
        alone = projector.forward(np.abs(volumes)[1])
        assert relative_max(alone, projector.forward(np.abs(volumes))[1]) < 1e-6


def microscope(device, across, **change):
    array = {"pitch": 60e-6, "focal_length": 1.5e-3, "count": 9, "fill": "full"} | change
    of_sensor = array.pop("pixels", None)
    return PlenopticCamera.microscope(
        magnification=10, na=0.2, wavelength=525e-9, mla=MicrolensArray(**array), device=device,
        pixels_per_lenslet=across, pixels=of_sensor,
    )  # fmt: skip


@pytest.mark.parametrize(
    "array",
    [
        {"rotation": 0.2, "offset": (5e-6, -9e-6)},
        {"lattice": "hexagonal", "focal_length": (1.5e-3, 1.4e-3, 1.7e-3)},
    ],
)  # fmt: skip
def test_frame_is_what_the_camera_sees(device, array):
    straight = {name: array[name] for name in ("lattice", "focal_length") if name in array}
    images = point_images(
        microscope(device, 24, **straight), [30e-6], voxels_per_lenslet=1, binning=2,
        sensor_pixels=7.7, cut=5e-3,
    )  # fmt: skip
    camera = microscope(device, None, pixels=PixelArray(pitch=60e-6 / 7.7), **array)
    projector = FrameProjector(images, lattice_of(camera), device=device)
    volume = np.zeros(projector.volume_shape, np.float32)
    i, k = volume.shape[1] // 2, volume.shape[2] // 2 + 1
    volume[0, i, k] = 1
    place = projector.voxel_grid()
    at = np.array(place["first"]) + i * np.array(place["down"]) + k * np.array(place["right"])
    grid = camera.grid
    y, x = ((at - np.array(grid.shape) // 2) * grid.pitch + np.array(grid.origin)) / 10
    seen = camera.expose(PointSources([(x, y, 30e-6)])).to_numpy().astype(float)
    found = projector.forward(volume).astype(float)
    # interpolation of 12 pixels to 7.7, and .5 % of the light that was cut; cubic convolution: .030
    assert np.linalg.norm(found - seen) < 0.02 * np.linalg.norm(seen)
    # a lenslet, or kind, beside the right one is far off
    moved = np.roll(found, 4, axis=1)
    assert np.linalg.norm(moved - seen) > 0.5 * np.linalg.norm(seen)


def test_what_cannot_be(device):
    for change, error, words in [
        ({"lattice": None}, TypeError, "lattice must be a Lattice, as estimate_lattice returns it"),
        ({"images": 3}, TypeError, "images must be a PointImages"),
        ({"lattice": LATTICES["hexagonal"]}, ValueError, "hexagonal and the lattice of the point"),
        ({"shape": (3, 0)}, ShapeError, "shape must be .ny, nx. of frames"),
        ({"shape": 4}, ShapeError, "shape must be .ny, nx. of frames"),
        ({"lattice": Lattice("square", (5, 5), (9, 0), (0, 9))}, ShapeError, "got None"),
        (
            {"lattice": Lattice("square", (5, 5), (9, 0), (0, 9), (20, 20))},
            ValueError,
            r"only 0\.444 pixels per camera pixel .* at least 9 pixels per lenslet",
        ),
    ]:
        given = {"images": any_images("square"), "lattice": LATTICES["turned"]} | change
        with pytest.raises(error, match=words):
            FrameProjector(given.pop("images"), given.pop("lattice"), **given, device=device)


def test_memory_of_frames_is_counted(device, monkeypatch):
    projector = FrameProjector(any_images("square"), LATTICES["turned"], device=device)
    asked = []
    monkeypatch.setattr(device, "require_memory", lambda nbytes, what: asked.append(nbytes))
    projector.require_memory(1)
    Projector(projector.images, projector.shape, device=device)
    assert asked[0] > asked[1]  # the frame besides that of the model


def test_other_pixels_than_those_integrated_over(device):
    images = any_images("square")
    images.parameters["sensor_pixels"] = 6.0
    with pytest.raises(ValueError, match=r"give point_images sensor_pixels=4.9649"):
        FrameProjector(images, LATTICES["turned"], device=device)
