"""Point images and projector of a Fourier microscope; volumes that come back; files."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from setups_fourier import SMALL, camera_of
from tolerance import relative_max

from clplen import FormatError, PointSources, ShapeError, deconvolve
from clplen.errors import SamplingError
from clplen.microscopy import (
    FourierPointImages,
    FourierProjector,
    fourier_point_images,
    read_point_images,
    write_point_images,
)

Z = np.array([-20.0, 3.0, 14.0]) * 1e-6


@pytest.fixture(scope="module")
def camera(device):
    return camera_of("small", device)


@pytest.fixture(scope="module")
def images(camera):
    return fourier_point_images(camera, Z)


def any_images(b=2, shape=(23, 31)):
    """Random numbers: three lenslets near each other and near the border, two planes."""
    rng = np.random.default_rng(b)
    stored = tuple(rng.random((b * b, 3, k, k)).astype(np.float32) for k in (5, 3))
    corners = np.array([[[8, 9], [10, 13], [19, 27]], [[9, 11], [9, 12], [18, 25]]], np.int32)
    centres = np.array([[10.2, 11.0], [11.4, 14.7], [20.3, 28.1]])
    return FourierPointImages(
        {}, np.array([0.0, 1e-5]), b, 1e-6 / b, shape, centres, 6.3, stored, corners
    )


@pytest.mark.parametrize(("b", "shape"), [(2, (5, 8)), (1, (1, 1))])
def test_sums_over_voxels(device, b, shape):
    """Every voxel is its image moved by whole pixels, cut to the sub-image, and sees through it."""
    images = any_images(b)
    projector = FourierProjector(images, shape, device=device)
    streamed = FourierProjector(images, shape, device=device, memory=1)
    ny, nx = images.shape
    H = np.zeros((*projector.volume_shape, ny + 80, nx + 80))
    for z, y, x in np.ndindex(projector.volume_shape):
        moved = (y // b - shape[0] // 2, x // b - shape[1] // 2)
        for lenslet, one in enumerate(images.stored[z][(y % b) * b + x % b]):
            first = images.corners[z, lenslet] + moved
            t = [f + np.arange(one.shape[0]) - c
                 for f, c in zip(first, images.centres[lenslet], strict=True)]  # fmt: skip
            stop = np.clip(0.5 + images.radius - np.hypot(t[0][:, None], t[1]), 0, 1)
            rows, columns = (slice(f + 40, f + 40 + one.shape[0]) for f in first)
            H[z, y, x, rows, columns] += one * stop
    H = H[..., 40 : 40 + ny, 40 : 40 + nx].reshape(-1, ny * nx)
    rng = np.random.default_rng(3)
    volumes = rng.random((2, *projector.volume_shape))
    frames = rng.random((2, ny, nx))
    for each in (projector, streamed):
        found = each.forward(volumes).reshape(2, -1)
        assert relative_max(volumes.reshape(2, -1) @ H, found) < 1e-6
        found = each.backward(frames).reshape(2, -1)
        assert relative_max(frames.reshape(2, -1) @ H.T, found) < 1e-6
    assert not streamed.resident


def test_voxels_are_what_the_camera_sees(device, camera):
    """Two of them, off the axis and between pixels, beside the exposure of points; by energy.

    Sub-images of one exposure interfere, which shift-invariant images leave out.
    """
    b = 2
    images = fourier_point_images(camera, Z[1:], voxels_per_pixel=b, cut=5e-4)
    projector = FourierProjector(images, device=device)
    volume = np.zeros(projector.volume_shape)
    rows, columns = projector.shape
    points = []
    for plane, (y, x), power in ((0, (9, -6), 1.0), (1, (-4, 3), 2.0)):
        volume[plane, rows // 2 * b + y, columns // 2 * b + x] = power
        at = [(t - (b - 1) / 2) * images.side for t in (x, y)]
        points.append(PointSources((*at, Z[1 + plane]), power=power))
    seen, found = camera.expose(points).to_numpy(), projector.forward(volume)
    assert found.sum(dtype=float) == pytest.approx(seen.sum(dtype=float), rel=0.01)
    assert relative_max(seen, found) < 5e-3


def test_points_come_back(device, images):
    projector = FourierProjector(images, (31, 31), device=device)
    volume = np.zeros(projector.volume_shape)
    at = [(0, 8, 22), (1, 15, 12), (1, 15, 17), (2, 20, 10)]
    volume[tuple(np.transpose(at))] = 1
    frame = projector.forward(volume)
    counts = np.random.default_rng(0).poisson(frame * 1e5 / frame.sum())
    found = deconvolve(counts, projector, iterations=15, prior="tv", strength=0.3)
    assert found.degenerate == ()
    side = SMALL["pixel_pitch"] / (20 * 12e-3 / 0.05)
    assert found.voxel == pytest.approx((side, side))
    assert [tuple(p) for p in np.argwhere(found.volume > 0.4 * found.volume.max())] == at
    share = found.volume[tuple(np.transpose(at))].sum() / found.volume.sum()
    assert share > 0.6
    with pytest.raises(ValueError, match="needs a native plane"):
        deconvolve(counts, projector, prior="gaussian")


def test_files_come_back(tmp_path, camera, images):
    path = tmp_path / "psf.h5"
    write_point_images(path, images)
    again = read_point_images(path)
    assert again.parameters == images.parameters
    assert again.shape == images.shape
    for name in ("planes", "centres", "corners", "side", "radius", "voxels"):
        assert np.array_equal(getattr(again, name), getattr(images, name))
    assert all(map(np.array_equal, again.stored, images.stored))
    assert fourier_point_images(camera, Z, path=path).parameters == images.parameters
    with pytest.raises(ValueError, match=r"na = 0\.3, not 0\.29"):
        fourier_point_images(replace(camera, na=0.29), Z, path=path)
    with pytest.raises(ValueError, match=r"planes\[0\] = "):
        fourier_point_images(camera, Z + 1e-6, path=path)


def test_files_that_are_none(tmp_path, images):
    path = tmp_path / "psf.h5"
    with pytest.raises(FileNotFoundError):
        read_point_images(path)
    path.write_bytes(b"nothing")
    with pytest.raises(FormatError, match="not a complete file"):
        read_point_images(path)
    for number, harm in enumerate((
        lambda f: f["planes/0001"].__setitem__((0, 0, 0, 0), 7),
        lambda f: f.__delitem__("corners"),
        lambda f: f.attrs.__setitem__("parameters", "{"),
        lambda f: f.attrs.__setitem__("radius", 1.0),
        lambda f: f.attrs.__setitem__("shape", (3,)),
    )):  # fmt: skip
        harmed = tmp_path / f"{number}.h5"
        write_point_images(harmed, images)
        with h5py.File(harmed, "r+") as file:
            harm(file)
        with pytest.raises(FormatError):
            read_point_images(harmed)


def test_what_cannot_be(device, camera, images):
    for make, words in (
        (lambda: FourierProjector(images, (3,), device=device), "rows, columns"),
        (lambda: FourierProjector(images, device=device, memory=-1), "memory"),
        (lambda: FourierProjector(np.ones(3), device=device), "fourier_point_images"),
        (lambda: fourier_point_images(camera, [1e-6, 0]), "rise"),
        (lambda: fourier_point_images(camera, Z, cut=0.7), "cut"),
        (lambda: fourier_point_images(camera, Z, voxels_per_pixel=0), "voxels_per_pixel"),
        (lambda: fourier_point_images(camera, [1e-3]), "nearer planes"),
    ):
        with pytest.raises((ShapeError, ValueError, TypeError, SamplingError), match=words):
            make()
