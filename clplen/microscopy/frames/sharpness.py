"""The most that light of a microscope stands out of the pixels around it, by its point images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from clplen.microscopy.frames.outliers import (
    AROUND,
    BRIGHTEST,
    Step,
    Vector,
    steps_around,
    sums_around,
)
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.frame_projector import FrameProjector

Bounds = tuple[float, float, float]

PLANES = 9  # of the point images that are looked at, both ends among them
DIMMEST = 1e-3  # of the brightest pixel of an image: below it point images are cut short
HALVES = [  # of the pixels around one: those above, below, left and right, with those beside it
    [step for step in AROUND if sign * step[axis] >= 0] for axis in (0, 1) for sign in (-1, 1)
]
ROUNDS = 3  # of points at other places, of which the camera's pixels see other parts


def sharpness(images: PointImages | FourierPointImages) -> Bounds:
    """Return the most that a pixel of a point image stands out of those around it.

    Parameters
    ----------
    images : PointImages or FourierPointImages
        Of which nine planes are looked at. The rim of a sub-image may cut those of a Fourier
        microscope anywhere: their pixels are compared with those on one side of them.

    Returns
    -------
    tuple of float
        c_0, c_1, c_2: over the sum of the sixteen pixels around without the 0, 1, 2 brightest; of a
        Fourier microscope, whose sub-images differ, of the eight that touch it.
    """
    chosen = [images.stored[plane] for plane in chosen_planes(len(images.stored))]
    if isinstance(images, FourierPointImages):
        alone = [one for stored in chosen for lenslets in stored for one in lenslets]
        c0, c1, c2 = (
            max(found) for found in zip(*(_most(alone, one) for one in HALVES), strict=True)
        )
        return c0, c1, c2
    steps = steps_around(images.pixels)
    return _most((image for stored in chosen for image in stored), steps)


def projected_sharpness(projector: FrameProjector, images: PointImages) -> Bounds:
    """Return the same of points as the camera's own pixels see them."""
    return _most(_points(projector, images), steps_around(projector.lattice))


def chosen_planes(count: int) -> list[int]:
    """Nine of so many planes at most, both ends among them."""
    return [int(one) for one in np.unique(np.linspace(0, count - 1, PLANES).astype(int))]


def _most(frames: Iterable[Vector], steps: list[Step]) -> Bounds:
    """Over frames of points that do not touch each other."""
    most = np.zeros(BRIGHTEST + 1)
    for frame in frames:
        light = np.maximum(frame, 0, dtype=np.float32)
        seen = light > DIMMEST * light.max()
        around = (one[seen] for one in sums_around(light, steps, beyond=False))
        found = [float((light[seen] / np.maximum(one, 1e-30)).max()) for one in around]
        most = np.maximum(most, found)
    return (float(most[0]), float(most[1]), float(most[2]))


def _points(projector: FrameProjector, images: PointImages) -> Iterator[Vector]:
    """Frames of points of a plane as far apart as their images reach."""
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
