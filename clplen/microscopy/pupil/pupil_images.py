"""Point images of a microscope with their derivatives by the coefficients of its pupil."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.microscopy.model.cells import cell_in
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import described
from clplen.microscopy.pupil.pupil_waves import PupilWaves

Vector = np.ndarray[Any, Any]


def images_and_tangents(
    camera: Microscope,
    planes: Vector,
    terms: Sequence[int],
    *,
    voxels: int,
    binning: int,
    cut: float,
    done: Callable[[], None] | None = None,
) -> tuple[PointImages, tuple[PointImages, ...]]:
    """Point images of all phases, and their derivatives by coefficients, a metre of path."""
    phases = list(np.ndindex(voxels, voxels))
    places = (np.array(phases) - (voxels - 1) / 2) / voxels * camera.mla.pitch
    x, y = places[:, 1] / camera.magnification, places[:, 0] / camera.magnification
    stored: list[list[Vector]] = [[] for _ in range(len(terms) + 1)]
    for z in planes:
        waves = PupilWaves.of(camera, float(z), binning=binning)
        points = PointSources(np.stack([x, y, np.full_like(x, z)], axis=1))
        images, tangents = waves.tangents(points, terms)
        kept = _within(images, waves.lenslets, cut)
        for values, one in zip(stored, (images, *tangents), strict=True):
            values.append(np.ascontiguousarray(one[:, kept, kept], np.float32))
        if done is not None:
            done()
    about = described(camera, planes, voxels, binning, cut, "float32")
    known = about["pupil"] or {}
    n = about["pixels_per_lenslet"]
    made = []
    for values, more in zip(stored, ({}, *({str(j): 0.0} for j in terms)), strict=True):
        of_these = about | {"pupil": known | more}
        which = [phases.index(phase) for phase in cell_in(of_these, voxels, n).phases()]
        z, different = np.asarray(planes, np.float64), tuple(one[which] for one in values)
        made.append(PointImages(of_these, z, voxels, n, different, np.ones(len(planes))))
    return made[0], tuple(made[1:])


def _within(images: Vector, lenslets: int, cut: float) -> slice:
    """Pixels of the fewest lenslets about the middle that leave out no more than a share."""
    n, middle = images.shape[1] // lenslets, lenslets // 2
    total = images.sum(axis=(1, 2))
    for r in range(middle):
        inside = slice((middle - r) * n, (middle + r + 1) * n)
        if (images[:, inside, inside].sum(axis=(1, 2)) >= (1 - cut) * total).all():
            return inside
    return slice(None)
