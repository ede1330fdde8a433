"""Comparison of the pupil of the point images with a white frame.

The mean lenslet of a white frame is the image of the pupil. It is compared with `EvenLight` of the
nominal parameters, sampled on the raw pixels of the lattice and rectified like the frame. An NA and
an apodisation are then fitted to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from clplen.checks import check_finite, require
from clplen.lightfield.raw.lenslet_lattice import Lattice
from clplen.microscopy.frames.prepare import Preparation, rectify
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.pupil.even_light import NEEDED, EvenLight
from clplen.reprs import OneLine

Vector = np.ndarray[Any, Any]

LENSLETS = 12  # along an axis of the rectified model, to average over pixel fractions
MODEL_ERROR = 0.015  # over the norm of the white frame; larger misfits are errors of the pupil
NOISE_SIGMAS = 4  # of the mean lenslet
MIN_NA_RATIO = 0.7  # smallest fitted NA over the nominal NA
APODISATIONS = (-1.0, 2.0)  # bounds of the fit
MAX_CORRECTION = 4.0  # largest corrected sensitivity over the mean of the lenslets
MIN_MODEL_LEVEL = 0.03  # over the brightest pixel of the model; below it nothing is corrected


@dataclass(frozen=True, eq=False, repr=False)
class PupilCheck(OneLine):
    """Comparison of the modelled pupil with a white frame. Made by `check_pupil`.

    A misfit is the norm of the difference of two mean lenslets after the best scale and shift, over
    the norm of the white frame's mean lenslet.

    Attributes
    ----------
    misfit : float
        Misfit with the NA and apodisation of the point images.
    noise : float
        Noise of the mean lenslet of the white frame, from the scatter of the lenslets.
    na, apodisation : float
        Fitted NA and apodisation; those of the point images if these fit.
    left : float
        Misfit with the fitted NA and apodisation.
    model, white : numpy.ndarray
        Modelled uniform light and mean lenslet of the white frame, float64, shape (n, n), mean 1.

    Examples
    --------
    >>> white = np.ones((6, 6))
    >>> check = clplen.microscopy.PupilCheck(0.1, 0.001, 0.475, 0.5, 0.004, white, white)
    >>> check.fits, check.sentence()
    (False, 'model pupil against white frame: 10 %; NA 0.475 and apodisation 0.5 leave 0.4 %')
    """

    misfit: float
    noise: float
    na: float
    apodisation: float
    left: float
    model: Vector
    white: Vector

    def __post_init__(self) -> None:
        names = ("misfit", "noise", "na", "apodisation", "left")
        check_finite(**{name: getattr(self, name) for name in names})

    @property
    def fits(self) -> bool:
        """Flag that noise and the accuracy of the model explain the misfit."""
        return self.misfit <= math.hypot(MODEL_ERROR, NOISE_SIGMAS * self.noise)

    @property
    def share(self) -> float:
        """Possible contribution of the misfit to a residual: its square, 0 if the pupil fits."""
        return 0.0 if self.fits else self.misfit**2

    def sentence(self) -> str:
        """Describe the misfit, and the fitted parameters if the pupil does not fit."""
        text = f"model pupil against white frame: {100 * self.misfit:.2g} %"
        if self.fits:
            return text
        return text + (
            f"; NA {self.na:.4g} and apodisation {self.apodisation:.2g} leave "
            f"{100 * self.left:.2g} %"
        )


def check_pupil(images: PointImages, prepare: Preparation) -> PupilCheck | None:
    """Compare the pupil of point images with a white frame; fit NA and apodisation.

    Parameters
    ----------
    images : PointImages
        Point images of the microscope.
    prepare : Preparation
        Preparation with the white frame, and as many pixels per lenslet as the images.

    Returns
    -------
    PupilCheck or None
        Comparison; None without a white frame, or if the images lack parameters of the optics.

    Raises
    ------
    TypeError
        If the images or the preparation have another type.
    ValueError
        If their numbers of pixels per lenslet differ.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> lattice = clplen.microscopy.square_lattice(11.2, (230, 230))
    >>> from clplen.microscopy.pupil.even_light import EvenLight
    >>> light = EvenLight(images.parameters)
    >>> white = 1e4 * light.frame(lattice, 0.19, 0.5)  # a smaller pupil
    >>> prepare = clplen.microscopy.preparation(11, white=white)
    >>> check = clplen.microscopy.check_pupil(images, prepare)
    >>> check.fits, f"{check.na:.3f}"
    (False, '0.190')
    """
    require(PointImages, images, "images", "point_images")
    require(Preparation, prepare, "prepare", "preparation")
    if prepare.lattice is None or prepare.level is None:
        return None
    if any(name not in images.parameters for name in NEEDED):
        return None
    if prepare.pixels != images.pixels:
        raise ValueError(
            f"prepare must have {images.pixels} pixels per lenslet, as the point images, got "
            f"{prepare.pixels}: give preparation(images.pixels, ...)."
        )
    white, noise = mean_lenslet(prepare.level, prepare.pixels)
    light, binning = EvenLight(images.parameters), int(images.parameters["binning"])
    small = _small_lattice(prepare.lattice)

    def modelled(na: float, apodisation: float) -> Vector:
        raw = light.frame(small, na, apodisation, binning)
        rectified = rectify(raw, small, device=prepare.device, pixels=prepare.pixels)
        return mean_lenslet(rectified, prepare.pixels)[0]

    nominal = float(images.parameters["na"]), float(images.parameters["apodisation"])
    model = modelled(*nominal)
    misfit = float(np.linalg.norm(_residuals(white, model)))
    check = PupilCheck(misfit, noise, *nominal, misfit, model, white)
    if check.fits:
        return check
    na, apodisation, left = _fitted(modelled, white, nominal, light.largest)
    return replace(check, na=na, apodisation=apodisation, left=left)


def corrected(prepare: Preparation, check: PupilCheck) -> Preparation:
    """Correct the pixel sensitivity of a preparation for errors of the modelled pupil.

    Parameters
    ----------
    prepare : Preparation
        Preparation with the white frame.
    check : PupilCheck
        Comparison of the pupil with the white frame.

    Returns
    -------
    Preparation
        Preparation whose sensitivity is the white frame over the modelled uniform light, at most
        four times the uncorrected sensitivity, and unchanged where the model is dark.

    Examples
    --------
    >>> white = np.tile(np.hanning(12)[1:-1], 8) + 0.1  # lenslets of 10 pixels
    >>> prepare = clplen.microscopy.preparation(10, white=np.outer(white, white))
    >>> cell = np.ones((10, 10))
    >>> check = clplen.microscopy.PupilCheck(0.1, 0.0, 0.5, 0.5, 0.0, 2 * cell, cell)
    >>> better = clplen.microscopy.corrected(prepare, check)
    >>> f"{(better.sensitivity / prepare.sensitivity).mean():.2f}"
    '0.50'
    """
    if prepare.sensitivity is None:
        return prepare
    model, n = check.model, prepare.pixels
    ratio = np.minimum(check.white / np.maximum(model, 1e-12), MAX_CORRECTION)
    ratio = np.where(model > MIN_MODEL_LEVEL * model.max(), ratio, 1)
    rows, columns = (size // n for size in prepare.sensitivity.shape)
    sensitivity = prepare.sensitivity * np.tile(ratio, (rows, columns)).astype(np.float32)
    return replace(prepare, sensitivity=sensitivity)


def mean_lenslet(level: Vector, n: int) -> tuple[Vector, float]:
    """Return the mean of all normalized lenslets, and its noise."""
    cells = level.reshape(level.shape[0] // n, n, level.shape[1] // n, n).astype(np.float64)
    cells = cells.transpose(0, 2, 1, 3).reshape(-1, n, n)
    complete = cells[(cells > 0).all(axis=(1, 2))]
    cells = complete if len(complete) > 1 else cells[cells.sum(axis=(1, 2)) > 0]
    cells = cells / cells.mean(axis=(1, 2), keepdims=True)
    mean = cells.mean(axis=0)
    error = cells.std(axis=0) / math.sqrt(len(cells))
    return mean, float(np.linalg.norm(error) / np.linalg.norm(mean))


def _small_lattice(lattice: Lattice) -> Lattice:
    """Return the lattice on a small frame, with equal pixel fractions."""
    row, column = np.array(lattice.row), np.array(lattice.column)
    side = math.ceil((LENSLETS + 2) * max(lattice.pitch))
    middle = np.round((np.array([side, side]) - 1) / 2) + np.array(lattice.origin) % 1
    first = middle - np.round(LENSLETS / 2) * (row + column)
    return Lattice(
        lattice.kind, (float(first[0]), float(first[1])), lattice.row, lattice.column, (side, side)
    )


def _residuals(white: Vector, model: Vector) -> Vector:
    """Return the residuals of a white lenslet after the best scale and shift, over its norm."""
    slopes = [(np.roll(model, -1, axis) - np.roll(model, 1, axis)) / 2 for axis in (0, 1)]
    basis = np.stack([values.ravel() for values in (model, *slopes)], axis=1)
    best, *_ = np.linalg.lstsq(basis, white.ravel(), rcond=None)
    return np.asarray((white.ravel() - basis @ best) / np.linalg.norm(white))


def _fitted(
    modelled: Callable[[float, float], Vector],
    white: Vector,
    nominal: tuple[float, float],
    largest: float,
) -> tuple[float, float, float]:
    """Fit NA and apodisation; return them and their misfit."""
    na = nominal[0]
    solution = least_squares(
        lambda x: _residuals(white, modelled(x[0] * na, x[1])),
        (1.0, nominal[1]),
        bounds=((MIN_NA_RATIO, APODISATIONS[0]), (largest / na, APODISATIONS[1])),
        x_scale=(0.05, 0.5),
        diff_step=(0.01, 0.05),
        xtol=1e-3,
        ftol=1e-3,
    )
    misfit = float(np.linalg.norm(solution.fun))
    return float(solution.x[0] * na), float(solution.x[1]), misfit
