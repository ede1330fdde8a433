"""Fit of the pupil of a microscope to a frame of any object: Gauss-Newton steps about a volume.

For a pupil c, Richardson-Lucy iterations give a volume V(c) of the frame F with the residual
e = F - H V. A change of the pupil changes the frame by J = (dH/dc) V, which a change R J of the
volume partly compensates: de/dc = -(J - H R J) = -E (variable projection: Golub and Pereyra 1973).
R J is computed as the difference of the volumes of M + s J and M - s J about the model M = H V.
Steps are (E' W E)^-1 E' W e with the weights W = 1/(M + b) of Poisson counts.
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
from clplen.microscopy.model.psf import light_in, parameters_of
from clplen.microscopy.pupil.pupil_waves import PupilWaves
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector

Vector = np.ndarray[Any, Any]

DIFFERENCE_STEP = 5e-9  # metres of path, step s of the central difference
MAX_STEP = 60e-9  # metres, rms, of a Gauss-Newton step
_MIN_MEAN = 0.02  # of the mean count; limits the weights of darker pixels


@dataclass(frozen=True)
class Sampling:
    """Sampling of a volume, and iterations of its deconvolution."""

    planes: Vector  # z in metres, rising
    voxels: int
    binning: int
    cut: float
    iterations: int  # Richardson-Lucy


@dataclass(frozen=True)
class Observed:
    """Frame in photons with sensitivity, background and variance; arrays have its shape."""

    counts: Vector
    white: Vector  # sensitivity, 0 at excluded pixels
    background: Vector  # photons that are not from the volume
    variance: float  # of a count over its mean

    @property
    def valid(self) -> Vector:
        """Mask of the pixels that are not excluded."""
        return np.asarray(self.white > 0)

    def spread(self, mean: Vector) -> Vector:
        """Return the standard deviations of the counts, infinite at excluded pixels."""
        level = np.maximum(mean, _MIN_MEAN * mean[self.valid].mean())
        return np.where(self.valid, np.sqrt(self.variance * level), np.inf)

    def residual(self, mean: Vector) -> float:
        """Return the sum of squared residuals over the sum of squared counts."""
        counts = self.counts[self.valid]
        return float(np.square(counts - mean[self.valid]).sum() / np.square(counts).sum())


@dataclass(frozen=True)
class State:
    """Residuals of a pupil, and their derivatives by the coefficients."""

    volume: Vector
    residuals: Vector  # e over the standard deviations of pixels
    slopes: Vector  # E over the standard deviations, shape (terms, pixels)
    residual: float  # sum e^2/sum F^2
    chi2: float  # mean square of ``residuals`` over the valid pixels


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
    """Simulate point images, and their derivatives by coefficients in metres of path."""
    phases = list(np.ndindex(voxels, voxels))
    offsets = (np.array(phases) - (voxels - 1) / 2) / voxels * camera.mla.pitch
    x, y = offsets[:, 1] / camera.magnification, offsets[:, 0] / camera.magnification
    stored: list[list[Vector]] = [[] for _ in range(len(terms) + 1)]
    for z in planes:
        waves = PupilWaves.of(camera, float(z), binning=binning)
        points = PointSources(np.stack([x, y, np.full_like(x, z)], axis=1))
        images, tangents = waves.tangents(points, terms)
        lenslet = cell_of("square", 1, voxels=1, pixels=images.shape[1] // waves.lenslets)
        rows, columns = light_in(images, lenslet, cut)
        for values, pictures in zip(stored, (images, *tangents), strict=True):
            values.append(np.ascontiguousarray(pictures[:, rows, columns], np.float32))
        if done is not None:
            done()
    about = parameters_of(camera, planes, voxels, binning, cut, "float32")
    coefficients = about["pupil"] or {}
    n = about["pixels_per_lenslet"]
    results = []
    for values, more in zip(stored, ({}, *({str(j): 0.0} for j in terms)), strict=True):
        parameters = about | {"pupil": coefficients | more}
        numbers = [phases.index(phase) for phase in cell_in(parameters, voxels, n).phases()]
        z, different = np.asarray(planes, np.float64), tuple(v[numbers] for v in values)
        results.append(PointImages(parameters, z, voxels, n, different, np.ones(len(planes))))
    return results[0], tuple(results[1:])


def state_of(
    camera: Microscope, observed: Observed, terms: Sequence[int], sampling: Sampling,
    done: Callable[[], None] | None = None,
) -> State:  # fmt: skip
    """Estimate the volume of a frame for a pupil, and the derivatives of the residuals."""
    images, tangents = images_and_tangents(
        camera, sampling.planes, terms, voxels=sampling.voxels, binning=sampling.binning,
        cut=sampling.cut, done=done,
    )  # fmt: skip
    n, white = images.pixels, observed.white
    shape = (observed.counts.shape[0] // n, observed.counts.shape[1] // n)
    projector = Projector(images, shape, device=camera.device)

    def reconstructed(frames: Vector) -> Vector:
        return deconvolve(
            frames, projector, iterations=sampling.iterations, white=white,
            background=observed.background,
        ).volume  # fmt: skip

    def model(volume: Vector) -> Vector:
        return white * projector.forward(volume).astype(np.float64)

    volume = reconstructed(observed.counts)
    light = model(volume)
    changes = np.stack([
        white * Projector(tangent, shape, device=camera.device).forward(volume, clamp=False)
        for tangent in tangents
    ])  # fmt: skip
    shifted = np.concatenate([light + DIFFERENCE_STEP * changes, light - DIFFERENCE_STEP * changes])
    volumes = reconstructed(np.maximum(shifted + observed.background, 0).astype(np.float32))
    half = len(terms)
    compensation = np.stack([
        white * projector.forward(volumes[k] - volumes[half + k], clamp=False)
        for k in range(half)
    ])  # fmt: skip
    mean = light + observed.background
    weight = 1 / observed.spread(mean)
    residuals = (observed.counts - mean) * weight
    slopes = ((changes - compensation / (2 * DIFFERENCE_STEP)) * weight).reshape(half, -1)
    chi2 = float(np.square(residuals).sum() / np.count_nonzero(observed.valid))
    return State(volume, residuals.ravel(), slopes, observed.residual(mean), chi2)


def step_of(state: State) -> tuple[Vector, Vector]:
    """Return a step of the coefficients in metres, and their covariance."""
    normal = state.slopes @ state.slopes.T
    covariance = np.linalg.pinv(normal, hermitian=True)
    step = covariance @ (state.slopes @ state.residuals)
    size = float(np.linalg.norm(step))
    return step * min(1.0, MAX_STEP / max(size, 1e-300)), covariance


def with_coefficients(camera: Microscope, terms: Sequence[int], values: Vector) -> Microscope:
    """Return the camera with new coefficients of the terms."""
    coefficients = {} if camera.pupil is None else camera.pupil.coefficients
    pupil = PupilAberration(coefficients | dict(zip(terms, map(float, values), strict=True)))
    return replace(camera, pupil=pupil)
