"""The pupil of the point images beside that of the white frame.

The mean lenslet of a white frame is the image of the pupil. Here it is compared with `EvenLight` of
the stated parameters, put on the raw pixels of the lattice and rectified as the frame was; and an
NA and an apodisation are fitted to it.
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

LENSLETS = 12  # along an axis, on which the pupil is rectified: all fractions of a pixel
MODEL = 0.015  # of the white frame's norm: from here on a misfit is one of the pupil
SURE = 4  # times the noise of the mean lenslet
SMALLEST = 0.7  # of the stated NA, down to which it is fitted
APODISATIONS = (-1.0, 2.0)
MOST = 4.0  # times the model, beyond which no pixel is taken to be more sensitive
DARK = 0.03  # of the brightest pixel of the model: below it the frame says nothing of the pupil


@dataclass(frozen=True, eq=False, repr=False)
class PupilCheck(OneLine):
    """How the modelled pupil fits a white frame. Made by `check_pupil`.

    Misfits are norms of the difference of two mean lenslets over that of the white frame's, after
    the best scale and shift.

    Attributes
    ----------
    misfit : float
        With the NA and the apodisation of the point images.
    noise : float
        Of the white frame's mean lenslet, by the scatter of single ones.
    na, apodisation : float
        That fit best; those of the point images where these fit.
    left : float
        Misfit with these.
    model, white : numpy.ndarray
        float64, shape (n, n), mean 1: even light as it should be, and the mean lenslet.

    Examples
    --------
    >>> white = np.ones((6, 6))
    >>> found = clplen.microscopy.PupilCheck(0.1, 0.001, 0.475, 0.5, 0.004, white, white)
    >>> found.fits, found.sentence()
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
        """Whether the misfit is no more than noise and the model's own accuracy explain."""
        return self.misfit <= math.hypot(MODEL, SURE * self.noise)

    @property
    def share(self) -> float:
        """The part of a residual that the misfit may leave: its square, 0 where the pupil fits."""
        return 0.0 if self.fits else self.misfit**2

    def sentence(self) -> str:
        """The misfit in words, and what would fit better where that is needed."""
        text = f"model pupil against white frame: {100 * self.misfit:.2g} %"
        if self.fits:
            return text
        return text + (
            f"; NA {self.na:.4g} and apodisation {self.apodisation:.2g} leave "
            f"{100 * self.left:.2g} %"
        )


def check_pupil(images: PointImages, prepare: Preparation) -> PupilCheck | None:
    """Compare the pupil of point images with a white frame, and fit one to it.

    Parameters
    ----------
    images : PointImages
        Of the microscope.
    prepare : Preparation
        Of the white frame, with as many pixels a lenslet as the images have.

    Returns
    -------
    PupilCheck or None
        None where there is no white frame, or the images do not tell their optics.

    Raises
    ------
    TypeError
        If the images or the preparation are none.
    ValueError
        If they have different numbers of pixels a lenslet.

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
    >>> found = clplen.microscopy.check_pupil(images, prepare)
    >>> found.fits, f"{found.na:.3f}"
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
            f"The point images have {images.pixels} pixels a lenslet, the preparation "
            f"{prepare.pixels}: give preparation(images.pixels, ...)."
        )
    white, noise = mean_lenslet(prepare.level, prepare.pixels)
    light, binning = EvenLight(images.parameters), int(images.parameters["binning"])
    small = _part(prepare.lattice)

    def seen(na: float, apodisation: float) -> Vector:
        raw = light.frame(small, na, apodisation, binning)
        rectified = rectify(raw, small, device=prepare.device, pixels=prepare.pixels)
        return mean_lenslet(rectified, prepare.pixels)[0]

    stated = float(images.parameters["na"]), float(images.parameters["apodisation"])
    model = seen(*stated)
    misfit = float(np.linalg.norm(_left(white, model)))
    found = PupilCheck(misfit, noise, *stated, misfit, model, white)
    if found.fits:
        return found
    na, apodisation, left = _fitted(seen, white, stated, light.largest)
    return replace(found, na=na, apodisation=apodisation, left=left)


def corrected(prepare: Preparation, check: PupilCheck) -> Preparation:
    """A preparation whose sensitivity holds what the modelled pupil lacks.

    Parameters
    ----------
    prepare : Preparation
        Of the white frame.
    check : PupilCheck
        Of it.

    Returns
    -------
    Preparation
        Its sensitivity is the white frame over even light of the model, at most four times that of
        the lenslets' mean, and left as it was where the model is dark.

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
    ratio = np.minimum(check.white / np.maximum(model, 1e-12), MOST)
    ratio = np.where(model > DARK * model.max(), ratio, 1)
    rows, columns = (size // n for size in prepare.sensitivity.shape)
    found = prepare.sensitivity * np.tile(ratio, (rows, columns)).astype(np.float32)
    return replace(prepare, sensitivity=found)


def mean_lenslet(level: Vector, n: int) -> tuple[Vector, float]:
    """The mean of all lenslets, each over its own light, and its noise."""
    cells = level.reshape(level.shape[0] // n, n, level.shape[1] // n, n).astype(np.float64)
    cells = cells.transpose(0, 2, 1, 3).reshape(-1, n, n)
    whole = cells[(cells > 0).all(axis=(1, 2))]
    cells = whole if len(whole) > 1 else cells[cells.sum(axis=(1, 2)) > 0]
    cells = cells / cells.mean(axis=(1, 2), keepdims=True)
    mean = cells.mean(axis=0)
    error = cells.std(axis=0) / math.sqrt(len(cells))
    return mean, float(np.linalg.norm(error) / np.linalg.norm(mean))


def _part(lattice: Lattice) -> Lattice:
    """The same lattice on a small frame, with the same fractions of pixels."""
    row, column = np.array(lattice.row), np.array(lattice.column)
    side = math.ceil((LENSLETS + 2) * max(lattice.pitch))
    middle = np.round((np.array([side, side]) - 1) / 2) + np.array(lattice.origin) % 1
    first = middle - np.round(LENSLETS / 2) * (row + column)
    return Lattice(
        lattice.kind, (float(first[0]), float(first[1])), lattice.row, lattice.column, (side, side)
    )


def _left(white: Vector, model: Vector) -> Vector:
    """What the best scale and shift of a model leave of a white lenslet, over its norm."""
    slopes = [(np.roll(model, -1, axis) - np.roll(model, 1, axis)) / 2 for axis in (0, 1)]
    basis = np.stack([one.ravel() for one in (model, *slopes)], axis=1)
    best, *_ = np.linalg.lstsq(basis, white.ravel(), rcond=None)
    return np.asarray((white.ravel() - basis @ best) / np.linalg.norm(white))


def _fitted(
    seen: Callable[[float, float], Vector],
    white: Vector,
    stated: tuple[float, float],
    largest: float,
) -> tuple[float, float, float]:
    """NA, apodisation and misfit that fit best."""
    na = stated[0]
    found = least_squares(
        lambda one: _left(white, seen(one[0] * na, one[1])),
        (1.0, stated[1]),
        bounds=((SMALLEST, APODISATIONS[0]), (largest / na, APODISATIONS[1])),
        x_scale=(0.05, 0.5),
        diff_step=(0.01, 0.05),
        xtol=1e-3,
        ftol=1e-3,
    )
    return float(found.x[0] * na), float(found.x[1]), float(np.linalg.norm(found.fun))
