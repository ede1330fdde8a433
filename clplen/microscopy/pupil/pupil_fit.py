"""Aberrations of a microscope from its own frames: of beads, or of anything by its volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.objective import check_positions
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.checks import (
    check_keywords,
    is_finite,
    is_integer,
    keywords_of,
    positive_integer,
    real_array,
    require,
)
from clplen.errors import ShapeError
from clplen.microscopy.model.psf import checked_planes
from clplen.microscopy.pupil.bead_pupil import BeadFrame, find_beads, fit_beads
from clplen.microscopy.pupil.volume_pupil import (
    Observed,
    Sampling,
    state_of,
    step_of,
    with_coefficients,
)
from clplen.reprs import OneLine
from clplen.wave.coherence.averaging import Progress
from clplen.wave.elements.zernike import noll

Vector = np.ndarray[Any, Any]

TERMS = (5, 6, 7, 8, 9, 10, 11)  # astigmatism, coma, trefoil, spherical aberration
LEAST = 5  # lenslets of a frame, or of a patch of it, along an axis
_WITH_OBJECT = (2, 3, 4)  # Noll's indices of what moves all points alike
_MORE_LEFT = 1.5  # chi2 from which on beads are looked for in what is left
_STILL = 0.1  # of the standard errors: a step below it is the last one


@dataclass(frozen=True, eq=False, repr=False)
class PupilFit(OneLine):
    """What `fit_pupil` found.

    Attributes
    ----------
    pupil : PupilAberration
        Of the camera, with the coefficients that were found.
    terms : tuple of int
        Noll's indices that were fitted.
    coefficients, errors : numpy.ndarray
        Metres of path, rms over the pupil, and their standard errors by photon noise, shape
        (terms,). What the model does not know (sampling of the volume, other aberrations) is not in
        the errors.
    residuals : numpy.ndarray
        sum (I - model)^2 / sum I^2 with the camera's pupil, and after each step, float64.
    chi2 : float
        Mean square of I - model over the variance of photons, at the end; 1 where photon noise is
        all that is left.
    positions : numpy.ndarray or None
        Of beads: (x, y, z) in metres from the middle of the frame, shape (n, 3).
    energies : numpy.ndarray or None
        Of beads: photons in the pupil, shape (n,).
    volume : numpy.ndarray or None
        Of anything else: photons of each voxel, before the last step.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=7, fill="full"))
    >>> where = [(6e-6, -5e-6, 50e-6)]
    >>> frame = camera.expose(clplen.PointSources(where, power=1e5)).to_numpy()
    >>> found = clplen.microscopy.fit_pupil(frame, camera, beads=where, terms=[6])
    >>> found.terms, found.positions.shape
    ((6,), (1, 3))
    """

    pupil: PupilAberration
    terms: tuple[int, ...]
    coefficients: Vector
    errors: Vector
    residuals: Vector
    chi2: float
    positions: Vector | None = None
    energies: Vector | None = None
    volume: Vector | None = None


def fit_pupil(
    frame: Any,
    camera: Microscope,
    *,
    planes: Sequence[float] | Vector | None = None,
    beads: Any = None,
    terms: Sequence[int] = TERMS,
    background: Any = 0.0,
    white: Any = None,
    gain: float = 1.0,
    variance: float = 1.0,
    voxels_per_lenslet: int = 3,
    binning: int = 1,
    cut: float = 5e-3,
    iterations: int = 20,
    steps: int = 4,
    progress: Progress | None = None,
) -> PupilFit:
    """Find the Zernike coefficients of a microscope's pupil from a frame it took.

    With ``beads`` their places, energies and an even background are found along with the
    coefficients (Levenberg and Marquardt). Without, the frame may be of anything: each step finds a
    volume by Richardson and Lucy's iteration and moves the coefficients by Gauss and Newton, with
    derivatives that take into account what the volume makes up for (variable projection, Golub and
    Pereyra 1973). Tilts and defocus (2, 3, 4) move all that is seen alike, which a frame alone
    does not show; terms to fit are others.

    Parameters
    ----------
    frame : array_like or RawImage
        Counts, not negative and finite, shape (rows n, columns n), rectified.
    camera : Microscope
        As of `point_images`, with the pupil to begin with.
    planes : sequence of float, optional
        z in metres, rising, of the volume; they cover all light. Not where ``beads`` has places.
    beads : array_like or "find", optional
        About where beads are: (x, y, z) in metres from the middle of the frame, within a micrometre
        or two, shape (n, 3). "find": on ``planes``, which then reach beyond the
        beads on both sides; where more is left than noise they are looked for once more in it.
    terms : sequence of int
        Noll's indices to fit, from 5 on, each once; the others keep what the camera has.
    background : float or array_like
        Counts that come from nowhere in the volume, such as haze, of every pixel or each one.
    white : array_like, optional
        Sensitivity of the pixels, 0 where they are left out; shape of the frame.
    gain : float
        Counts of a photon.
    variance : float
        Of a photon count over its mean, `Preparation.variance` where frames were rectified.
    voxels_per_lenslet, binning : int
        As of `point_images`.
    cut : float
        As of `point_images`.
    iterations : int
        Of Richardson and Lucy, for each volume.
    steps : int
        At most, of the coefficients of a volume; mostly two do.
    progress : callable, optional
        Called as ``progress(done, total)`` after each plane of each step, of beads after each step.

    Returns
    -------
    PupilFit
        With the coefficients and their standard errors.

    Raises
    ------
    ShapeError
        If shapes do not fit, or the frame has fewer than five lenslets along an axis.
    ValueError
        If neither planes nor beads are given, or both; if lenslets are hexagonal or of several
        focal lengths; if terms cannot be fitted, a number is out of range, or values are negative
        or not finite.
    TypeError
        If the camera is no microscope, or something no array of real numbers.

    Examples
    --------
    >>> optics = dict(magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=7, fill="full"))
    >>> astigmatic = clplen.PlenopticCamera.microscope(**optics, pupil={6: 40e-9})
    >>> where = [(6e-6, -5e-6, 50e-6)]
    >>> frame = astigmatic.expose(clplen.PointSources(where, power=1e5)).to_numpy()
    >>> camera = clplen.PlenopticCamera.microscope(**optics)
    >>> found = clplen.microscopy.fit_pupil(frame, camera, beads=where, terms=(5, 6))
    >>> [f"{c * 1e9:.0f} nm" for c in found.coefficients + 0.0]
    ['0 nm', '41 nm']
    """
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    _check_array(camera)
    terms = _checked_terms(terms)
    steps, iterations = positive_integer(steps, "steps"), positive_integer(iterations, "iterations")
    is_looked_for = isinstance(beads, str)
    if is_looked_for and beads != "find":
        raise ValueError(f"beads is an array of places or 'find', not {beads!r}.")
    if (planes is None) == (beads is None or is_looked_for):
        raise ValueError(
            "A pupil is found from beads= about where they are, or from a volume on planes=, on "
            "which beads='find' looks for them: give one of both."
        )
    z = checked_planes(
        camera, [0.0] if planes is None else planes, voxels_per_lenslet, binning, cut, "float32"
    )
    binning, voxels = int(binning), int(voxels_per_lenslet)
    n = round(camera.pixels_per_lenslet) // binning
    seen = _observed(frame, n, background, white, gain, variance)
    known = {} if camera.pupil is None else camera.pupil.coefficients
    start = np.array([known.get(j, 0.0) for j in terms])
    if beads is not None:
        looked_for = partial(find_beads, planes=z, voxels=voxels, binning=binning, cut=cut)
        where = looked_for(camera, seen) if is_looked_for else _checked_beads(beads)
        found, mean = _of_beads(camera, seen, terms, start, where, binning, progress)
        if is_looked_for and found.chi2 > _MORE_LEFT:
            left = replace(seen, background=mean)
            try:
                more = looked_for(replace(camera, pupil=found.pupil), left)
            except ValueError:  # no bead is found in what is left
                return found
            where = np.concatenate([found.positions, more])
            again, _ = _of_beads(camera, seen, terms, found.coefficients, where, binning, progress)
            return replace(again, residuals=np.append(found.residuals, again.residuals[-1]))
        return found
    sampling = Sampling(z, voxels, binning, cut, iterations)
    return _of_volume(camera, seen, terms, start, sampling, steps, progress)


def fit_pupil_patches(
    frame: Any, camera: Microscope, patches: tuple[int, int], *, background: Any = 0.0,
    white: Any = None, **options: Any,
) -> list[list[PupilFit]]:  # fmt: skip
    """Find the pupil of each part of a frame, where aberrations change over the field.

    Parameters
    ----------
    frame : array_like or RawImage
        As of `fit_pupil`.
    camera : Microscope
        As of `fit_pupil`.
    patches : tuple of int
        (rows, columns) of parts, of whole lenslets, as alike in size as they can be. Each is fitted
        by itself, so that light from beside a part counts as its own: take parts that are wider
        than the images of points.
    background : float or array_like
        As of `fit_pupil`.
    white : array_like, optional
        As of `fit_pupil`.
    **options
        Others of `fit_pupil`, but ``beads``.

    Returns
    -------
    list of list of PupilFit
        By row and column.

    Raises
    ------
    ShapeError
        If a part has fewer than five lenslets along an axis.
    ValueError, TypeError
        As `fit_pupil`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=10, fill="full"))
    >>> frame = camera.expose(clplen.PointSources([(0, 0, 50e-6)], power=1e5)).to_numpy() + 1
    >>> found = clplen.microscopy.fit_pupil_patches(
    ...     frame, camera, (1, 2), planes=[50e-6], terms=[6], iterations=2, steps=1)
    >>> [[one.terms for one in row] for row in found]
    [[(6,), (6,)]]
    """
    if "beads" in options:
        raise ValueError("Beads of a frame are fitted together; patches are those of a volume.")
    check_keywords(options, keywords_of(fit_pupil), "fit_pupil_patches")
    counts = real_array(frame, "A frame")
    if np.shape(patches) != (2,):
        raise ShapeError(f"patches is (rows, columns) of parts, not {patches!r}.")
    parts = [positive_integer(k, "patches") for k in patches]
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    n = round(camera.pixels_per_lenslet) // int(options.get("binning", 1))
    edges = []
    for size, many in zip(counts.shape, parts, strict=True):
        lenslets = np.linspace(0, size // n, many + 1).round().astype(int)
        if np.diff(lenslets).min() < LEAST:
            raise ShapeError(
                f"A frame of {size // n} lenslets has no {many} parts of {LEAST} or more: give "
                "fewer patches."
            )
        edges.append(lenslets * n)
    found = []
    for top, bottom in zip(edges[0][:-1], edges[0][1:], strict=True):
        row = []
        for left, right in zip(edges[1][:-1], edges[1][1:], strict=True):
            at = (slice(top, bottom), slice(left, right))
            given = {
                "background": background if np.ndim(background) == 0 else background[at],
                "white": None if white is None else white[at],
            }
            row.append(fit_pupil(counts[at], camera, **given, **options))
        found.append(row)
    return found


def _of_beads(
    camera: Microscope, seen: Observed, terms: tuple[int, ...], start: Vector, beads: Vector,
    binning: int, progress: Progress | None,
) -> tuple[PupilFit, Vector]:  # fmt: skip
    """What beads tell, and the mean counts of their frame."""
    frame = BeadFrame(camera, seen, terms, binning)
    half = np.array(frame.shape[::-1]) * frame.side / 2
    outside = (np.abs(beads[:, :2]) > half).any(axis=1)
    if outside.any():
        x, y, z = beads[outside][0]
        raise ValueError(
            f"The bead at (x, y, z) = ({x:g}, {y:g}, {z:g}) m lies beside the frame, which reaches "
            f"to x = +-{half[0]:g} and y = +-{half[1]:g} m: places are those from its middle."
        )
    found = fit_beads(frame, beads, start, progress=progress)
    errors = np.sqrt(np.diag(found.covariance))
    pupil = with_coefficients(camera, terms, found.coefficients).pupil
    assert pupil is not None
    residuals = np.array([found.residual_before, found.residual])
    fit = PupilFit(
        pupil, terms, found.coefficients, errors, residuals, found.chi2, found.positions,
        found.energies,
    )  # fmt: skip
    return fit, found.mean


def _of_volume(
    camera: Microscope, seen: Observed, terms: tuple[int, ...], start: Vector, how: Sampling,
    steps: int, progress: Progress | None,
) -> PupilFit:  # fmt: skip
    done, total = 0, (steps + 1) * len(how.planes)

    def told() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    values, residuals = start, []
    for number in range(steps + 1):
        state = state_of(with_coefficients(camera, terms, values), seen, terms, how, told)
        residuals.append(state.residual)
        step, covariance = step_of(state)
        errors = np.sqrt(np.diag(covariance))
        if number == steps or (np.abs(step) <= _STILL * errors).all():
            break
        values = values + step
    pupil = with_coefficients(camera, terms, values).pupil
    assert pupil is not None
    return PupilFit(
        pupil, terms, values, errors, np.array(residuals), state.chi2, volume=state.volume
    )


def _check_array(camera: Microscope) -> None:
    """Refuse lenslets whose frames are not rectified to whole pixels of each."""
    if camera.mla.lattice != "square" or len(camera.mla.focal_lengths) > 1:
        raise ValueError(
            "A pupil is fitted to rectified frames behind a square array of one focal length, not "
            f"to those of a {camera.mla.lattice} one of {len(camera.mla.focal_lengths)}."
        )


def _checked_terms(terms: Any) -> tuple[int, ...]:
    found = tuple(int(j) for j in np.atleast_1d(terms) if is_integer(j) and j >= 1)
    if len(found) != np.size(terms) or len(set(found)) != len(found) or not found:
        raise ValueError(f"terms are Noll's indices, each once, not {terms!r}.")
    if min(found) in (1, *_WITH_OBJECT):
        raise ValueError(
            "Terms 1 to 4, piston, tilts and defocus, move all that is seen alike, which a frame "
            f"does not show: fit terms from 5 on, not {min(found)}."
        )
    for j in found:
        noll(j)
    return found


def _checked_beads(beads: Any) -> Vector:
    found = real_array(beads, "beads", np.float64)
    if found.ndim != 2 or found.shape[1] != 3 or not len(found):
        raise ShapeError(f"beads has shape (n, 3), (x, y, z) of each, not {found.shape}.")
    if not np.isfinite(found).all():
        raise ValueError("beads has places that are not finite.")
    check_positions(found)
    return found


def _observed(
    frame: Any, n: int, background: Any, white: Any, gain: float, variance: float
) -> Observed:
    """A frame in photons, after the checks."""
    for name, number in (("gain", gain), ("variance", variance)):
        if not (is_finite(number) and number > 0):
            raise ValueError(f"{name} is positive and finite, not {number!r}.")
    counts = real_array(frame, "A frame", np.float64)
    if counts.ndim != 2 or any(size % n or size < LEAST * n for size in counts.shape):
        raise ShapeError(
            f"A frame has whole lenslets of {n} x {n} pixels, at least {LEAST} along an axis, not "
            f"shape {counts.shape}: rectify it."
        )
    weight = np.ones(counts.shape) if white is None else real_array(white, "white", np.float64)
    beside = np.asarray(real_array(background, "background", np.float64))
    for name, values in (("white", weight), ("background", np.broadcast_to(beside, beside.shape))):
        if values.shape not in ((), counts.shape):
            raise ShapeError(f"{name} has shape {counts.shape} of the frame, not {values.shape}.")
    for name, values in (("A frame", counts), ("white", weight), ("background", beside)):
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError(f"{name} has values that are negative or not finite.")
    if not (counts * (weight > 0)).any():
        raise ValueError("The frame is black where pixels count: there is nothing to fit.")
    background = np.broadcast_to(beside / gain, counts.shape)
    return Observed(counts / gain, weight, np.ascontiguousarray(background), float(variance))
