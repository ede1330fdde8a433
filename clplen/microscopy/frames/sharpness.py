"""Largest ratio of a pixel to its neighbours that the light of a microscope can have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from clplen.microscopy.frames.outliers import (
    AROUND,
    MAX_EXCLUDED,
    Step,
    Vector,
    steps_around,
    sums_around,
)
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.frame_projector import FrameProjector

Bounds = tuple[float, float, float]

MAX_PLANES = 9  # evaluated planes, both ends included
MIN_BRIGHTNESS = 1e-3  # over the brightest pixel of an image; below it point images are cropped
HALVES = [  # neighbours above, below, left and right of a pixel, those beside it included
    [step for step in AROUND if sign * step[axis] >= 0] for axis in (0, 1) for sign in (-1, 1)
]
ROUNDS = 3  # point patterns per plane, at different positions within the pixels


def sharpness(images: PointImages | FourierPointImages) -> Bounds:
    """Return the largest ratio of a pixel of the point images to the sum of its neighbours.

    Parameters
    ----------
    images : PointImages or FourierPointImages
        Point images, evaluated on at most nine planes. The rim of a sub-image can cut images of a
        Fourier microscope anywhere, so their pixels are compared with neighbours on one side.

    Returns
    -------
    tuple of float
        Ratios c_0, c_1, c_2 to the sum of the sixteen neighbours without the 0, 1 or 2 brightest;
        for a Fourier microscope, whose sub-images differ, of the eight adjacent pixels.
    """
    chosen = [images.stored[plane] for plane in chosen_planes(len(images.stored))]
    if isinstance(images, FourierPointImages):
        frames = [image for stored in chosen for lenslets in stored for image in lenslets]
        c0, c1, c2 = (
            max(ratios) for ratios in zip(*(_bounds(frames, h) for h in HALVES), strict=True)
        )
        return c0, c1, c2
    steps = steps_around(images.pixels)
    return _bounds((image for stored in chosen for image in stored), steps)


def projected_sharpness(projector: FrameProjector, images: PointImages) -> Bounds:
    """Return the bounds of `sharpness` for point images on raw camera pixels."""
    return _bounds(_points(projector, images), steps_around(projector.lattice))


def chosen_planes(count: int) -> list[int]:
    """Return the indices of at most nine evenly spaced planes, both ends included."""
    return [int(plane) for plane in np.unique(np.linspace(0, count - 1, MAX_PLANES).astype(int))]


def _bounds(frames: Iterable[Vector], steps: list[Step]) -> Bounds:
    """Return the largest ratios over frames of points whose images do not touch."""
    bounds = np.zeros(MAX_EXCLUDED + 1)
    for frame in frames:
        light = np.maximum(frame, 0, dtype=np.float32)
        bright = light > MIN_BRIGHTNESS * light.max()
        sums = (total[bright] for total in sums_around(light, steps, beyond=False))
        ratios = [float((light[bright] / np.maximum(total, 1e-30)).max()) for total in sums]
        bounds = np.maximum(bounds, ratios)
    return (float(bounds[0]), float(bounds[1]), float(bounds[2]))


def _points(projector: FrameProjector, images: PointImages) -> Iterator[Vector]:
    """Yield frames of points in a plane, spaced so that their images do not touch."""
    rng = np.random.default_rng(0)
    (vy, vx), shape = images.cell.voxels, projector.volume_shape
    for plane in chosen_planes(len(images.stored)):
        ry, rx = images.reaches[plane]
        apart = (2 * ry + 2) * vy, (2 * rx + 2) * vx
        for _ in range(ROUNDS):
            volume = np.zeros(shape, np.float32)
            first = [int(rng.integers(min(a, n))) for a, n in zip(apart, shape[1:], strict=True)]
            for y in range(first[0], shape[1], apart[0]):
                for x in range(first[1], shape[2], apart[1]):
                    dy, dx = rng.integers(vy), rng.integers(vx)
                    volume[plane, min(y + dy, shape[1] - 1), min(x + dx, shape[2] - 1)] = 1
            yield projector.forward(volume)
