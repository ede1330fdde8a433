"""The pupil of a microscope from a frame of anything: Gauss and Newton's steps about a volume.

For a pupil c Richardson and Lucy's iteration gives a volume V(c) of the frame F, and e = F - H V is
left. The volume makes up for a part of what a change of the pupil does to the frame, J = (dH/dc) V:
a frame that changes by J changes the volume by R J, so that de/dc = -(J - H R J) = -E (variable
projection: Golub and Pereyra 1973). R J is the difference of two volumes, of M + s J and M - s J
about the model M = H V. Steps are (E' W E)^-1 E' W e with W = 1/(M + b), the weights of Poisson
counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.microscopy.model.cells import cell_in, cell_of
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.model.psf import described, light_in
from clplen.microscopy.pupil.pupil_waves import PupilWaves
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

Vector = np.ndarray[Any, Any]

STEP = 5e-9  # metres of path that the two volumes of a derivative are apart from the model
LONGEST = 60e-9  # metres, rms, of one step
_FLOOR = 0.02  # of the mean count: weights of darker pixels end there


@dataclass(frozen=True)
class Sampling:
    """How a volume is sampled and found."""

    planes: Vector  # z in metres, rising
    voxels: int
    binning: int
    cut: float
    iterations: int  # Richardson-Lucy


@dataclass(frozen=True)
class Observed:
    """A frame in photons with what is known of it; arrays have its shape."""

    counts: Vector
    white: Vector  # sensitivity, 0 where pixels are left out
    background: Vector  # photons from elsewhere
    variance: float  # of a count over its mean

    @property
    def counted(self) -> Vector:
        """Whether a pixel counts."""
        return np.asarray(self.white > 0)

    def spread(self, mean: Vector) -> Vector:
        """Standard deviations of counts, infinite where pixels are left out."""
        level = np.maximum(mean, _FLOOR * mean[self.counted].mean())
        return np.where(self.counted, np.sqrt(self.variance * level), np.inf)

    def residual(self, mean: Vector) -> float:
        """Sum of squares of what mean counts leave, over that of the counts."""
        counts = self.counts[self.counted]
        return float(np.square(counts - mean[self.counted]).sum() / np.square(counts).sum())


@dataclass(frozen=True)
class State:
    """What a pupil leaves of a frame, and how it changes."""

    volume: Vector
    left: Vector  # e over the standard deviations of pixels
    slopes: Vector  # E over the standard deviations, shape (terms, pixels)
    residual: float  # sum e^2/sum F^2
    chi2: float  # mean square of ``left`` over the pixels that count


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
        lenslet = cell_of("square", 1, voxels=1, pixels=images.shape[1] // waves.lenslets)
        rows, columns = light_in(images, lenslet, cut)
        for values, one in zip(stored, (images, *tangents), strict=True):
            values.append(np.ascontiguousarray(one[:, rows, columns], np.float32))
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


def state_of(
    camera: Microscope, seen: Observed, terms: Sequence[int], how: Sampling,
    done: Callable[[], None] | None = None,
) -> State:  # fmt: skip
    """The volume of a frame behind a pupil, and the derivatives of what is left."""
    images, tangents = images_and_tangents(
        camera, how.planes, terms, voxels=how.voxels, binning=how.binning, cut=how.cut, done=done
    )
    n = images.pixels
    shape = (seen.counts.shape[0] // n, seen.counts.shape[1] // n)
    projector = Projector(images, shape, device=camera.device)

    def found(frames: Vector) -> Vector:
        return deconvolve(
            frames, projector, iterations=how.iterations, white=seen.white,
            background=seen.background,
        ).volume  # fmt: skip

    def model(volume: Vector) -> Vector:
        return seen.white * projector.forward(volume).astype(np.float64)

    volume = found(seen.counts)
    light = model(volume)
    changes = np.stack([
        seen.white * Projector(one, shape, device=camera.device).forward(volume, clamp=False)
        for one in tangents
    ])  # fmt: skip
    moved = np.concatenate([light + STEP * changes, light - STEP * changes])
    volumes = found(np.maximum(moved + seen.background, 0).astype(np.float32))
    half = len(terms)
    made_up = np.stack([
        seen.white * projector.forward(volumes[k] - volumes[half + k], clamp=False)
        for k in range(half)
    ])  # fmt: skip
    mean = light + seen.background
    weight = 1 / seen.spread(mean)
    left = (seen.counts - mean) * weight
    slopes = ((changes - made_up / (2 * STEP)) * weight).reshape(half, -1)
    chi2 = float(np.square(left).sum() / np.count_nonzero(seen.counted))
    return State(volume, left.ravel(), slopes, seen.residual(mean), chi2)


def step_of(state: State) -> tuple[Vector, Vector]:
    """A step of the coefficients, and the covariance of where it leads, both in metres."""
    normal = state.slopes @ state.slopes.T
    covariance = np.linalg.pinv(normal, hermitian=True)
    step = covariance @ (state.slopes @ state.left)
    size = float(np.linalg.norm(step))
    return step * min(1.0, LONGEST / max(size, 1e-300)), covariance


def with_coefficients(camera: Microscope, terms: Sequence[int], values: Vector) -> Microscope:
    """The same optics with these coefficients in place of those of the terms."""
    known = {} if camera.pupil is None else camera.pupil.coefficients
    pupil = PupilAberration(known | dict(zip(terms, map(float, values), strict=True)))
    return replace(camera, pupil=pupil)
