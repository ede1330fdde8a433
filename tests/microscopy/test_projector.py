"""The projector against sums over voxels, and its two halves against each other."""

import numpy as np
import pytest
from tolerance import relative_max

from clplen import MicrolensArray, PlenopticCamera, PointSources, ShapeError
from clplen.errors import DeviceError
from clplen.microscopy.model.cells import cell_in
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import _symmetric, point_images
from clplen.microscopy.reconstruction import projector as projectors
from clplen.microscopy.reconstruction.lattice_transform import LatticeTransform
from clplen.microscopy.reconstruction.projector import Projector

Z = np.array([-2.0, 0.5, 1.0]) * 1e-6


@pytest.fixture(scope="module")
def images(device):
    mla = MicrolensArray(100e-6, 2.5e-3, count=35, fill="full")
    camera = PlenopticCamera.microscope(
        magnification=60, na=1.2, medium_index=1.33, wavelength=593e-9, pixels_per_lenslet=15,
        mla=mla, device=device,
    )  # fmt: skip
    return camera, point_images(camera, Z, voxels_per_lenslet=5, cut=5e-3)


def any_images(v, n, reaches, **parameters):
    """Images of random numbers with the mirrors of an array and of its pupil."""
    cell = cell_in(parameters, v, n)
    phases, (ny, nx), rng = cell.phases(), cell.pixels, np.random.default_rng(n)
    planes = []
    for ry, rx in reaches:
        one = rng.random((len(phases), (2 * ry + 1) * ny, (2 * rx + 1) * nx))
        planes.append(_symmetric(one, phases, cell).astype(np.float32))
    z = np.arange(len(reaches)) * 1e-6
    return PointImages(parameters, z, v, n, tuple(planes), np.ones(len(reaches)))


ABERRATED = {"5": 1.0, "8": 1.0}  # without any mirror
SQUARE, NARROW = ((1, 1), (0, 0)), ((1, 0), (0, 2))


@pytest.mark.parametrize(
    ("lattice", "kinds", "v", "n", "pupil", "reaches", "shape"),
    [
        ("square", 1, 3, 5, None, ((6, 6), (1, 1), (0, 0)), (2, 3)),
        ("square", 1, 2, 3, ABERRATED, NARROW, (3, 2)),
        ("square", 2, 1, 2, None, SQUARE, (3, 2)),
        ("square", 4, 1, 1, None, SQUARE, (3, 2)),
        ("hexagonal", 3, 1, 1, None, NARROW, (3, 2)),
    ],
)
def test_any_array(device, lattice, kinds, v, n, pupil, reaches, shape, monkeypatch):
    """Every voxel, at borders and in corners too, is its image, and sees frames through it."""
    parameters = {"lattice": lattice, "lenslet_focal_lengths": (0.0,) * kinds, "pupil": pupil}
    images = any_images(v, n, reaches, **parameters)
    cell = images.cell
    projector = Projector(images, shape, device=device)
    streamed = Projector(images, shape, device=device, memory=1)
    monkeypatch.setattr(projectors, "PIECE_BYTES", 1)
    monkeypatch.setattr(projectors, "FIELD_BYTES", 1)  # images are transformed one by one
    pieces = Projector(images, shape, device=device, memory=1)
    assert pieces._piece == min(2, np.prod(cell.voxels))
    vy, vx = cell.voxels
    H = np.array([
        placed(images.image(z, (y % vy, x % vx)), (y // vy, x // vx), shape, cell)
        for z, y, x in np.ndindex(projector.volume_shape)
    ])  # fmt: skip
    volumes = np.random.default_rng(2).random((2, *projector.volume_shape), np.float32)
    frames = np.random.default_rng(n).random((3, *projector.frame_shape), np.float32)
    expected = (volumes.reshape(2, -1) @ H.reshape(len(H), -1)).reshape(2, *projector.frame_shape)
    seen = (H.reshape(len(H), -1) @ frames.reshape(3, -1).T).T.reshape(3, *projector.volume_shape)
    for each in (projector, streamed, pieces):
        assert relative_max(expected, each.forward(volumes)) < 1e-6
        assert relative_max(seen, each.backward(frames)) < 1e-6
    assert not streamed.resident
    assert projector.lenslets == tuple(np.multiply(shape, cell.lenslets))


def test_steps_apart_are_those_in_lanes(device):
    """What CPUs do in one step and GPUs in several, in batches that change in between."""
    images = any_images(3, 5, ((6, 6), (1, 1), (0, 0)))
    one, other = (Projector(images, (4, 5), device=device) for _ in range(2))
    one._lanes, other._lanes = None, LatticeTransform(device, one._window)
    rng = np.random.default_rng(0)
    for frames in (3, 1, 3):
        volumes = rng.random((frames, *one.volume_shape), np.float32)
        pictures = rng.random((frames, *one.frame_shape), np.float32)
        assert relative_max(one.forward(volumes), other.forward(volumes)) < 1e-6
        assert relative_max(one.backward(pictures), other.backward(pictures)) < 1e-6


def placed(image, at, shape, cell):
    """A point image about a cell in a frame of (rows, columns) cells."""
    (ny, nx), reach = cell.pixels, [
        (k // n - 1) // 2 for k, n in zip(image.shape, cell.pixels, strict=True)
    ]  # fmt: skip
    whole = np.zeros([
        (k + 2 * r) * n for k, r, n in zip(shape, reach, cell.pixels, strict=True)
    ])  # fmt: skip
    y, x = at[0] * ny, at[1] * nx
    whole[y : y + image.shape[0], x : x + image.shape[1]] = image
    top, left = reach[0] * ny, reach[1] * nx
    return whole[top : top + shape[0] * ny, left : left + shape[1] * nx]


def test_more_memory_than_there_is(device, images, monkeypatch):
    projector = Projector(images[1], (5, 6), device=device)
    monkeypatch.setattr(device, "memory_bytes", projector.nbytes)
    with pytest.raises(DeviceError, match="The projection of 2 frames together needs"):
        projector.forward(volumes(projector, (2,)))
    with pytest.raises(DeviceError, match="The projection of one frame needs"):
        projector.backward(np.zeros(projector.frame_shape))
    with pytest.raises(DeviceError, match="The projection of one frame needs"):
        Projector(images[1], (5, 6), device=device, memory=projector.nbytes)


def volumes(projector, frames=()):
    return np.random.default_rng(5).random((*frames, *projector.volume_shape), np.float32)


def test_one_voxel_is_what_the_camera_sees(device, images):
    camera, kept = images
    projector = Projector(kept, (35, 35), device=device)
    volume = np.zeros(projector.volume_shape, np.float32)
    volume[1, 17 * 5 + 4, 18 * 5 + 1] = 1
    step = camera.mla.pitch / camera.magnification
    point = PointSources([(step * (1 - 0.2), step * 0.4, Z[1])])
    seen, found = camera.expose(point).to_numpy(), projector.forward(volume)
    r = kept.radii[1]
    inside = (slice((17 - r) * 15, (18 + r) * 15), slice((18 - r) * 15, (19 + r) * 15))
    # complex64 through three transforms twice, at two places of the window
    assert relative_max(seen[inside], found[inside]) < 5e-6
    assert 1 - 5e-3 <= found.sum(dtype=float) < 1


def test_forward_is_not_negative(device, images):
    projector = Projector(images[1], (14, 5), device=device)
    volume = np.zeros(projector.volume_shape, np.float32)
    volume[1, 3, 12] = 1  # dark from the fifth row of lenslets on
    assert projector.forward(volume, clamp=False).min() < 0  # rounding
    assert projector.forward(volume).min() == 0


def test_linear_operator(device, images):
    projector = Projector(images[1], (5, 5), device=device)
    H = projector.as_linear_operator()
    f = volumes(projector)
    assert H.shape == (75 * 75, 3 * 25 * 25)
    assert np.array_equal(H @ f.ravel(), projector.forward(f, clamp=False).ravel())
    assert projector.forward(f[None, None]).shape == (1, 1, *projector.frame_shape)
    g = projector.forward(f)
    assert np.array_equal(H.T @ g.ravel(), projector.backward(g).ravel())
    signed = f - 0.5
    on_device = device.download(projector.forward_data(device.upload(signed)))
    assert np.array_equal(on_device, projector.forward(signed, clamp=False))


def test_what_is_not_projected(device, images):
    for change, error, words in [
        ({"shape": (np.nan, 5)}, ShapeError, "rows, columns"),
        ({"memory": -5}, ValueError, "number of bytes or None, got -5"),
        ({"memory": "1e9"}, ValueError, "number of bytes or None, got '1e9'"),
        ({"images": None}, TypeError, "images must be a PointImages, as point_images returns it"),
        ({"volume": None}, TypeError, "A volume must be an array of numbers, got NoneType"),
        ({"volume": np.zeros((0, 3, 25, 30))}, ShapeError, r"got \(0, 3, 25, 30\)"),
    ]:
        given = {"images": images[1], "shape": (5, 6), "volume": 0} | change
        volume = given.pop("volume")
        with pytest.raises(error, match=words):
            Projector(**given, device=device).forward(volume)


def test_memory_holds_pieces_of_a_plane(device, images, monkeypatch):
    """Of less memory than the matrix of a plane takes, no matrix is larger than that memory."""
    whole = Projector(images[1], (5, 5), device=device)
    memory = whole.nbytes // len(Z) // 3
    monkeypatch.setattr(projectors, "PIECE_BYTES", 1)
    pieces = Projector(images[1], (5, 5), device=device, memory=memory)
    plane = pieces._groups[0]
    made = [pieces._assembled(plane, *piece) for piece in pieces._pieces(plane)]
    assert len(made) > 1
    assert max(matrix.nbytes for matrix in made) <= memory
    assert sum(matrix.nbytes for matrix in made) == whole.nbytes // len(Z)
