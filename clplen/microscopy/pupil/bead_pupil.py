"""The pupil of a microscope from a frame of beads whose places and energies are not known either.

The frame is w (sum_i E_i h(x_i, y_i, z_i; c)) + b. Levenberg and Marquardt's steps (Marquardt 1963)
in all (x, y, z, E) of the beads, the background and the coefficients c, with the weights 1/mean of
Poisson counts (Fisher's scoring): the covariance of what is found is the inverse of the normal
matrix.
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

PLACES = ("x", "y", "z")
LEAST = 3  # planes that a bead is found among
DIMMEST = 0.05  # of the brightest one: what is dimmer is rather a part of another one's image
ITERATIONS = 15  # of the volume that shows where beads are
MOST = 30  # steps
_STILL = 1e-4  # of the loss that a last step gains
_UNIT = {"place": 1e-6, "path": 1e-8}  # metres of a parameter of 1
_FARTHEST = 2.0  # micrometres of a step along an axis


@dataclass(frozen=True)
class Beads:
    """Parameters that fit a frame of beads best, in metres and photons."""

    positions: Vector  # (x, y, z) from the middle of the frame, shape (n, 3)
    energies: Vector  # photons in the pupil
    background: float  # photons of a pixel, beside the known ones
    coefficients: Vector
    covariance: Vector  # of the coefficients
    residual: float  # sum e^2/sum F^2
    residual_before: float  # with the coefficients to begin with
    chi2: float  # mean square of e over its standard deviation
    mean: Vector  # photons of each pixel, known background included


@dataclass(frozen=True)
class _Model:
    """Mean counts, and the derivatives of those from beads by every parameter."""

    mean: Vector
    columns: sparse.csc_matrix


def find_beads(
    camera: Microscope, seen: Observed, planes: Vector, *, voxels: int, binning: int, cut: float
) -> Vector:
    """About where beads are, by the maxima of the volume of their frame, the brightest first."""
    if len(planes) < LEAST:
        raise ShapeError(
            f"Beads are found among {LEAST} planes or more, not {len(planes)}: give planes on both "
            "sides of them."
        )
    images = point_images(camera, planes, voxels_per_lenslet=voxels, binning=binning, cut=cut)
    rows, columns = (size // images.pixels for size in seen.counts.shape)
    projector = Projector(images, (rows, columns), device=camera.device)
    volume = deconvolve(
        seen.counts, projector, iterations=ITERATIONS, background=seen.background,
        white=seen.white, accelerate=True,
    ).volume  # fmt: skip
    y, x = ((np.arange(k) - (k - 1) / 2) * images.side for k in volume.shape[1:])
    found = find_points(volume, axes=(images.planes, y, x), size=(0.5, 1.0))
    bright = found.peaks > DIMMEST * found.peaks.max(initial=0.0)
    if not bright.any():
        raise ValueError(
            "No bead is found in the frame: give planes that reach beyond the beads on both sides, "
            "or fit it without beads."
        )
    return np.ascontiguousarray(found.positions[bright][:, ::-1])


class BeadFrame:
    """A frame of beads, and the model of it."""

    def __init__(
        self, camera: Microscope, seen: Observed, terms: Sequence[int], binning: int
    ) -> None:
        self.camera, self.seen, self.terms, self.binning = camera, seen, tuple(terms), binning
        self.n = round(camera.pixels_per_lenslet) // binning
        self.shape = tuple(size // self.n for size in seen.counts.shape)
        self.side = camera.mla.pitch / camera.magnification

    def placed(self, position: Vector) -> tuple[PointSources, tuple[int, int]]:
        """Return a bead about the middle of its lenslet, and (row, column) of that lenslet."""
        middle = (np.array(self.shape) - 1) / 2
        lenslet = np.rint(position[1::-1] / self.side + middle).astype(int)
        y, x = position[1::-1] - (lenslet - middle) * self.side
        return PointSources([(x, y, position[2])]), (int(lenslet[0]), int(lenslet[1]))

    def model(
        self, positions: Vector, energies: Vector, background: float, coefficients: Vector
    ) -> _Model:
        """The frame of beads with derivatives by x, y, z, E of each, background and terms."""
        camera = with_coefficients(self.camera, self.terms, coefficients)
        white = self.seen.white
        mean = white * background + self.seen.background
        by_terms = np.zeros((len(self.terms), *white.shape))
        rows, columns, values = [], [], []
        pixels = np.arange(white.size).reshape(white.shape)
        for number, (position, energy) in enumerate(zip(positions, energies, strict=True)):
            waves = PupilWaves.of(camera, float(position[2]), binning=self.binning)
            point, lenslet = self.placed(position)
            image, tangents = waves.tangents(point, (*PLACES, *self.terms))
            on, of = self._overlap(waves.lenslets, lenslet)
            w, image = white[on], image[0][of]
            mean[on] += energy * w * image
            for total_of, one in zip(by_terms, tangents[3:], strict=True):
                total_of[on] += energy * w * one[0][of]
            whole = [energy * w * one[0][of] * _UNIT["place"] for one in tangents[:3]]
            for k, one in enumerate((*whole, w * image)):
                rows.append(pixels[on].ravel())
                columns.append(np.full(one.size, 4 * number + k))
                values.append(one.ravel())
        total = 4 * len(positions) + 1 + len(self.terms)
        for k, one in enumerate((white, *(by_terms * _UNIT["path"]))):
            rows.append(pixels.ravel())
            columns.append(np.full(one.size, total - 1 - len(self.terms) + k))
            values.append(one.ravel().astype(np.float64))
        joined = (np.concatenate(one) for one in (values, rows, columns))
        data, row, column = joined
        return _Model(mean, sparse.csc_matrix((data, (row, column)), (white.size, total)))

    def _overlap(
        self, lenslets: int, at: tuple[int, int]
    ) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Pixels of the frame under a window about a lenslet, and those of the window."""
        on, of = [], []
        for k, count in zip(at, self.shape, strict=True):
            first = k - lenslets // 2
            start, stop = max(first, 0), max(min(first + lenslets, count), max(first, 0))
            on.append(slice(start * self.n, stop * self.n))
            of.append(slice((start - first) * self.n, (stop - first) * self.n))
        return (on[0], on[1]), (of[0], of[1])


def fit_beads(
    frame: BeadFrame, positions: Vector, start: Vector, *, progress: Progress | None = None
) -> Beads:
    """Places, energies, background and coefficients that fit a frame best."""
    positions, c = positions.astype(np.float64).copy(), np.asarray(start, np.float64).copy()
    energies, background = _energies(frame, positions, c)
    damping, model = 1e-3, frame.model(positions, energies, background, c)
    loss = _loss(frame, model)
    before = frame.seen.residual(model.mean)
    for number in range(MOST):
        scale = sparse.diags(1 / frame.seen.spread(model.mean).ravel())
        J = scale @ model.columns
        left = scale @ (frame.seen.counts - model.mean).ravel()
        normal, slope = (J.T @ J).toarray(), J.T @ left
        gained = 0.0
        while damping < 1e6:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-30), slope)
            there = _moved(positions, energies, background, c, step)
            tried = frame.model(*there)
            now = _loss(frame, tried)
            if now < loss:
                gained = loss - now
                positions, energies, background, c = there
                model, loss, damping = tried, now, damping / 10
                break
            damping *= 10
        if progress is not None:
            progress(number + 1, MOST)
        if gained < _STILL * max(loss, 1.0):
            break
        damping = min(damping, 1e3)
    return _result(frame, positions, energies, background, c, model, before)


def _energies(frame: BeadFrame, positions: Vector, c: Vector) -> tuple[Vector, float]:
    """Energies and background by least squares, not negative."""
    from scipy.optimize import lsq_linear

    ones = np.ones(len(positions))
    known = frame.model(positions, ones, 0.0, c)
    which = [*range(3, 4 * len(positions), 4), 4 * len(positions)]
    scale = sparse.diags(1 / frame.seen.spread(frame.seen.counts + 1.0).ravel())
    A = scale @ known.columns[:, which]
    light = scale @ (frame.seen.counts - frame.seen.background).ravel()
    found = lsq_linear(A, light, bounds=(0, np.inf)).x
    return np.maximum(found[:-1], 1e-3 * found[:-1].max()), float(found[-1])


def _moved(
    positions: Vector, energies: Vector, background: float, c: Vector, step: Vector
) -> tuple[Vector, Vector, float, Vector]:
    beads = step[: 4 * len(positions)].reshape(-1, 4)
    farthest = max(1.0, float(np.abs(beads[:, :3]).max(initial=0.0)) / _FARTHEST)
    moved = positions + beads[:, :3] / farthest * _UNIT["place"]
    brighter = np.maximum(energies + beads[:, 3], 0.1 * energies)
    terms = c + step[4 * len(positions) + 1 :] * _UNIT["path"] / farthest
    return moved, brighter, max(background + float(step[4 * len(positions)]), 0.0), terms


def _loss(frame: BeadFrame, model: _Model) -> float:
    """Deviance of Poisson counts over the pixels that count, halved, over their variance."""
    counted = frame.seen.counted
    F, mean = frame.seen.counts[counted], np.maximum(model.mean[counted], 1e-9)
    parts = mean - F + np.where(F > 0, F * np.log(np.maximum(F, 1e-300) / mean), 0)
    return float(parts.sum() / frame.seen.variance)


def _result(
    frame: BeadFrame, positions: Vector, energies: Vector, background: float, c: Vector,
    model: _Model, before: float,
) -> Beads:  # fmt: skip
    spread = frame.seen.spread(model.mean)
    scale = sparse.diags(1 / spread.ravel())
    J = scale @ model.columns
    covariance = np.linalg.pinv((J.T @ J).toarray(), hermitian=True)
    of_terms = slice(4 * len(positions) + 1, None)
    off = frame.seen.counts - model.mean
    counted = frame.seen.counted
    chi2 = float(np.square(off[counted] / spread[counted]).mean())
    return Beads(
        positions, energies, background, c, covariance[of_terms, of_terms] * _UNIT["path"] ** 2,
        frame.seen.residual(model.mean), before, chi2, model.mean,
    )  # fmt: skip
