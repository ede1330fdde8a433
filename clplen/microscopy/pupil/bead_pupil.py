"""Fit of the pupil of a microscope to a frame of beads with unknown positions and energies.

The model is w (sum_i E_i h(x_i, y_i, z_i; c)) + b. Levenberg-Marquardt steps (Marquardt 1963) fit
(x, y, z, E) of all beads, the background and the coefficients c, with the weights 1/mean of Poisson
counts (Fisher scoring): the covariance of the parameters is the inverse of the normal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.errors import ShapeError
from clplen.microscopy.model.psf import point_images
from clplen.microscopy.objects.points import find_points
from clplen.microscopy.pupil.pupil_waves import PupilWaves
from clplen.microscopy.pupil.volume_pupil import Observed, with_coefficients
from clplen.microscopy.reconstruction.deconvolution import deconvolve
from clplen.microscopy.reconstruction.projector import Projector
from clplen.wave.coherence.averaging import Progress

Vector = np.ndarray[Any, Any]

AXES = ("x", "y", "z")
MIN_PLANES = 3  # planes for the detection of beads: a maximum has neighbours on both sides
MIN_PEAK = 0.05  # over the brightest bead; dimmer maxima are likely parts of another bead's image
ITERATIONS = 15  # Richardson-Lucy iterations of the volume in which beads are detected
MAX_STEPS = 30  # Levenberg-Marquardt steps
_MIN_GAIN = 1e-4  # decrease of the loss, over the loss, below which the fit stops
_UNIT = {"position": 1e-6, "path": 1e-8}  # metres of a parameter of 1
_MAX_STEP_UM = 2.0  # along an axis; beads farther away are other beads


@dataclass(frozen=True)
class Beads:
    """Parameters that fit a frame of beads best, in metres and photons."""

    positions: Vector  # (x, y, z) from the middle of the frame, shape (n, 3)
    energies: Vector  # photons in the pupil
    background: float  # photons per pixel, added to the given background
    coefficients: Vector
    covariance: Vector  # of the coefficients
    residual: float  # sum e^2/sum F^2
    residual_before: float  # with the initial coefficients
    chi2: float  # mean square of e over its standard deviation
    mean: Vector  # photons of each pixel, background included


@dataclass(frozen=True)
class _Model:
    """Mean counts, and their derivatives by every parameter."""

    mean: Vector
    columns: sparse.csc_matrix


def find_beads(
    camera: Microscope, observed: Observed, planes: Vector, *, voxels: int, binning: int, cut: float
) -> Vector:
    """Detect beads as maxima of the volume of their frame; return positions, brightest first."""
    if len(planes) < MIN_PLANES:
        raise ShapeError(
            f"The detection of beads needs at least {MIN_PLANES} planes, got {len(planes)}: give "
            "planes on both sides of the beads."
        )
    images = point_images(camera, planes, voxels_per_lenslet=voxels, binning=binning, cut=cut)
    rows, columns = (size // images.pixels for size in observed.counts.shape)
    projector = Projector(images, (rows, columns), device=camera.device)
    volume = deconvolve(
        observed.counts, projector, iterations=ITERATIONS, background=observed.background,
        white=observed.white, accelerate=True,
    ).volume  # fmt: skip
    y, x = ((np.arange(k) - (k - 1) / 2) * images.side for k in volume.shape[1:])
    points = find_points(volume, axes=(images.planes, y, x), size=(0.5, 1.0))
    bright = points.peaks > MIN_PEAK * points.peaks.max(initial=0.0)
    if not bright.any():
        raise ValueError(
            "No bead detected in the frame: give planes that reach beyond the beads on both sides, "
            "or fit it without beads."
        )
    return np.ascontiguousarray(points.positions[bright][:, ::-1])


class BeadFrame:
    """Frame of beads and its model."""

    def __init__(
        self, camera: Microscope, observed: Observed, terms: Sequence[int], binning: int
    ) -> None:
        self.camera, self.observed = camera, observed
        self.terms, self.binning = tuple(terms), binning
        self.n = round(camera.pixels_per_lenslet) // binning
        self.shape = tuple(size // self.n for size in observed.counts.shape)
        self.side = camera.mla.pitch / camera.magnification

    def local_point(self, position: Vector) -> tuple[PointSources, tuple[int, int]]:
        """Return a bead relative to the centre of its lenslet, and the lenslet (row, column)."""
        middle = (np.array(self.shape) - 1) / 2
        lenslet = np.rint(position[1::-1] / self.side + middle).astype(int)
        y, x = position[1::-1] - (lenslet - middle) * self.side
        return PointSources([(x, y, position[2])]), (int(lenslet[0]), int(lenslet[1]))

    def model(
        self, positions: Vector, energies: Vector, background: float, coefficients: Vector
    ) -> _Model:
        """Return the mean frame, with derivatives by x, y, z, E of beads, background and terms."""
        camera = with_coefficients(self.camera, self.terms, coefficients)
        white = self.observed.white
        mean = white * background + self.observed.background
        by_terms = np.zeros((len(self.terms), *white.shape))
        rows, columns, values = [], [], []
        pixels = np.arange(white.size).reshape(white.shape)
        for number, (position, energy) in enumerate(zip(positions, energies, strict=True)):
            waves = PupilWaves.of(camera, float(position[2]), binning=self.binning)
            point, lenslet = self.local_point(position)
            image, tangents = waves.tangents(point, (*AXES, *self.terms))
            part, window = self._overlap(waves.lenslets, lenslet)
            w, image = white[part], image[0][window]
            mean[part] += energy * w * image
            for total, tangent in zip(by_terms, tangents[3:], strict=True):
                total[part] += energy * w * tangent[0][window]
            by_axes = [energy * w * t[0][window] * _UNIT["position"] for t in tangents[:3]]
            for k, derivative in enumerate((*by_axes, w * image)):
                rows.append(pixels[part].ravel())
                columns.append(np.full(derivative.size, 4 * number + k))
                values.append(derivative.ravel())
        count = 4 * len(positions) + 1 + len(self.terms)
        for k, derivative in enumerate((white, *(by_terms * _UNIT["path"]))):
            rows.append(pixels.ravel())
            columns.append(np.full(derivative.size, count - 1 - len(self.terms) + k))
            values.append(derivative.ravel().astype(np.float64))
        data, row, column = (np.concatenate(parts) for parts in (values, rows, columns))
        return _Model(mean, sparse.csc_matrix((data, (row, column)), (white.size, count)))

    def _overlap(
        self, lenslets: int, lenslet: tuple[int, int]
    ) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Return the overlap of a window about a lenslet with the frame, in frame and window."""
        part, window = [], []
        for k, count in zip(lenslet, self.shape, strict=True):
            first = k - lenslets // 2
            start, stop = max(first, 0), max(min(first + lenslets, count), max(first, 0))
            part.append(slice(start * self.n, stop * self.n))
            window.append(slice((start - first) * self.n, (stop - first) * self.n))
        return (part[0], part[1]), (window[0], window[1])


def fit_beads(
    frame: BeadFrame, positions: Vector, start: Vector, *, progress: Progress | None = None
) -> Beads:
    """Fit positions, energies, background and coefficients to a frame."""
    positions, c = positions.astype(np.float64).copy(), np.asarray(start, np.float64).copy()
    energies, background = _energies(frame, positions, c)
    damping, model = 1e-3, frame.model(positions, energies, background, c)
    loss = _loss(frame, model)
    before = frame.observed.residual(model.mean)
    for number in range(MAX_STEPS):
        scale = sparse.diags(1 / frame.observed.spread(model.mean).ravel())
        J = scale @ model.columns
        residuals = scale @ (frame.observed.counts - model.mean).ravel()
        normal, slope = (J.T @ J).toarray(), J.T @ residuals
        gain = 0.0
        while damping < 1e6:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-30), slope)
            parameters = _stepped(positions, energies, background, c, step)
            trial = frame.model(*parameters)
            trial_loss = _loss(frame, trial)
            if trial_loss < loss:
                gain = loss - trial_loss
                positions, energies, background, c = parameters
                model, loss, damping = trial, trial_loss, damping / 10
                break
            damping *= 10
        if progress is not None:
            progress(number + 1, MAX_STEPS)
        if gain < _MIN_GAIN * max(loss, 1.0):
            break
        damping = min(damping, 1e3)
    return _result(frame, positions, energies, background, c, model, before)


def _energies(frame: BeadFrame, positions: Vector, c: Vector) -> tuple[Vector, float]:
    """Estimate energies and background by non-negative least squares."""
    from scipy.optimize import lsq_linear

    ones = np.ones(len(positions))
    model = frame.model(positions, ones, 0.0, c)
    columns = [*range(3, 4 * len(positions), 4), 4 * len(positions)]
    scale = sparse.diags(1 / frame.observed.spread(frame.observed.counts + 1.0).ravel())
    A = scale @ model.columns[:, columns]
    light = scale @ (frame.observed.counts - frame.observed.background).ravel()
    solution = lsq_linear(A, light, bounds=(0, np.inf)).x
    energies = np.maximum(solution[:-1], 1e-3 * solution[:-1].max())
    return energies, float(solution[-1])


def _stepped(
    positions: Vector, energies: Vector, background: float, c: Vector, step: Vector
) -> tuple[Vector, Vector, float, Vector]:
    """Add a step to the parameters, limited in length and to positive energies."""
    beads = step[: 4 * len(positions)].reshape(-1, 4)
    reduction = max(1.0, float(np.abs(beads[:, :3]).max(initial=0.0)) / _MAX_STEP_UM)
    new_positions = positions + beads[:, :3] / reduction * _UNIT["position"]
    new_energies = np.maximum(energies + beads[:, 3], 0.1 * energies)
    terms = c + step[4 * len(positions) + 1 :] * _UNIT["path"] / reduction
    new_background = max(background + float(step[4 * len(positions)]), 0.0)
    return new_positions, new_energies, new_background, terms


def _loss(frame: BeadFrame, model: _Model) -> float:
    """Return half the Poisson deviance of the valid pixels over the variance of a count."""
    valid = frame.observed.valid
    F, mean = frame.observed.counts[valid], np.maximum(model.mean[valid], 1e-9)
    parts = mean - F + np.where(F > 0, F * np.log(np.maximum(F, 1e-300) / mean), 0)
    return float(parts.sum() / frame.observed.variance)


def _result(
    frame: BeadFrame, positions: Vector, energies: Vector, background: float, c: Vector,
    model: _Model, before: float,
) -> Beads:  # fmt: skip
    spread = frame.observed.spread(model.mean)
    scale = sparse.diags(1 / spread.ravel())
    J = scale @ model.columns
    covariance = np.linalg.pinv((J.T @ J).toarray(), hermitian=True)
    terms = slice(4 * len(positions) + 1, None)
    residuals = frame.observed.counts - model.mean
    valid = frame.observed.valid
    chi2 = float(np.square(residuals[valid] / spread[valid]).mean())
    return Beads(
        positions, energies, background, c, covariance[terms, terms] * _UNIT["path"] ** 2,
        frame.observed.residual(model.mean), before, chi2, model.mean,
    )  # fmt: skip
