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
from clplen.microscopy.pupil.pupil_images import images_and_tangents
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

Vector = np.ndarray[Any, Any]

STEP = 5e-9  # metres of path that the two volumes of a derivative are apart from the model
LONGEST = 60e-9  # metres, rms, of one step
_FLOOR = 0.02  # of the mean count: weights of darker pixels end there


@dataclass(frozen=True)
class Sampling:
    """How a volume is sampled and found.

    Attributes
    ----------
    planes : numpy.ndarray
        z in metres, rising.
    voxels, binning : int
    cut : float
    iterations : int
        Of Richardson and Lucy.
    """

    planes: Vector
    voxels: int
    binning: int
    cut: float
    iterations: int


@dataclass(frozen=True)
class Observed:
    """A frame with what is known of it.

    Attributes
    ----------
    counts : numpy.ndarray
        Photons, shape (rows n, columns n).
    white, background : numpy.ndarray
        Sensitivity, 0 where pixels are left out, and counts from elsewhere, same shape.
    variance : float
        Of a count over its mean.
    """

    counts: Vector
    white: Vector
    background: Vector
    variance: float


@dataclass(frozen=True)
class State:
    """What a pupil leaves of a frame, and how it changes.

    Attributes
    ----------
    volume : numpy.ndarray
    left : numpy.ndarray
        e over the standard deviations of pixels.
    slopes : numpy.ndarray
        E over the standard deviations, shape (terms, pixels).
    residual : float
        sum e^2/sum F^2.
    chi2 : float
        Mean square of ``left`` over the pixels that count.
    """

    volume: Vector
    left: Vector
    slopes: Vector
    residual: float
    chi2: float


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
    counted = seen.white > 0
    spread = np.sqrt(seen.variance * np.maximum(mean, _FLOOR * mean[counted].mean()))
    weight = np.where(counted, 1 / spread, 0)
    left = (seen.counts - mean) * weight
    slopes = ((changes - made_up / (2 * STEP)) * weight).reshape(half, -1)
    residual = np.square(left * spread).sum() / np.square(seen.counts[counted]).sum()
    chi2 = float(np.square(left).sum() / np.count_nonzero(counted))
    return State(volume, left.ravel(), slopes, float(residual), chi2)


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
