"""Estimation of the aberrations of a microscope from frames of beads or of any object."""

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
MIN_LENSLETS = 5  # along an axis of a frame or a patch, as for `deconvolve`
_SHIFT_TERMS = (2, 3, 4)  # Noll indices of tilts and defocus, which shift all points equally
_MAX_BEAD_CHI2 = 1.5  # above it further beads are searched in the residual
_MIN_STEP_SIGMAS = 0.1  # of the standard errors; a smaller step is the last step


@dataclass(frozen=True, eq=False, repr=False)
class PupilFit(OneLine):
    """Result of `fit_pupil`.

    Attributes
    ----------
    pupil : PupilAberration
        Pupil of the camera with the fitted coefficients.
    terms : tuple of int
        Noll indices of the fitted terms.
    coefficients, errors : numpy.ndarray
        Coefficients in metres of path, rms over the pupil, and their standard errors by photon
        noise, shape (terms,). Errors of the model (sampling of the volume, other aberrations) are
        not included.
    residuals : numpy.ndarray
        sum (I - model)^2 / sum I^2 with the camera's pupil, and after each step, float64.
    chi2 : float
        Final mean square of I - model over the variance of photons; 1 for pure photon noise.
    positions : numpy.ndarray or None
        Positions (x, y, z) of beads in metres from the centre of the frame, shape (n, 3).
    energies : numpy.ndarray or None
        Energies of beads, photons in the pupil, shape (n,).
    volume : numpy.ndarray or None
        Volume of other objects before the last step, photons per voxel.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=7, fill="full"))
    >>> beads = [(6e-6, -5e-6, 50e-6)]
    >>> frame = camera.expose(clplen.PointSources(beads, power=1e5)).to_numpy()
    >>> fit = clplen.microscopy.fit_pupil(frame, camera, beads=beads, terms=[6])
    >>> fit.terms, fit.positions.shape
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
    """Estimate the Zernike coefficients of a microscope's pupil from a frame.

    With ``beads``, their positions, energies and a uniform background are fitted together with the
    coefficients (Levenberg-Marquardt). Without beads, the frame may show any object: each step
    estimates a volume by Richardson-Lucy iterations and updates the coefficients by a Gauss-Newton
    step. Its derivatives account for changes of the volume (variable projection, Golub and Pereyra
    1973). Tilts and defocus (2, 3, 4) shift all objects equally and cannot be fitted.

    Parameters
    ----------
    frame : array_like or RawImage
        Counts, not negative and finite, shape (rows n, columns n), rectified.
    camera : Microscope
        Camera as in `point_images`, with the initial pupil.
    planes : sequence of float, optional
        z of the planes of the volume in metres, rising, which cover all light. Leave it out if
        ``beads`` gives positions.
    beads : array_like or "find", optional
        Approximate positions (x, y, z) of beads in metres from the centre of the frame, within one
        or two micrometres, shape (n, 3). "find" detects beads on ``planes``, which must extend
        beyond them, and again in the residual if it exceeds the noise.
    terms : sequence of int
        Noll indices of the fitted terms, from 5 on, each once; other terms keep the camera's value.
    background : float or array_like
        Background counts, such as haze: a number, or an array with the shape of the frame.
    white : array_like, optional
        Pixel sensitivity with the shape of the frame, 0 at excluded pixels.
    gain : float
        Counts per photon.
    variance : float
        Variance of a photon count over its mean, `Preparation.variance` for rectified frames.
    voxels_per_lenslet, binning : int
        Sampling as in `point_images`.
    cut : float
        Share of light that may be cropped, as in `point_images`.
    iterations : int
        Number of Richardson-Lucy iterations of each volume.
    steps : int
        Maximum number of Gauss-Newton steps; two are usually enough.
    progress : callable, optional
        Callback ``progress(done, total)``, called after each plane of a step, or each step of
        beads.

    Returns
    -------
    PupilFit
        Coefficients with their standard errors.

    Raises
    ------
    ShapeError
        If shapes do not match, or the frame has fewer than five lenslets along an axis.
    ValueError
        If neither planes nor beads are given, or both; if lenslets are hexagonal or of several
        focal lengths; if terms cannot be fitted, a number is out of range, or values are negative
        or not finite.
    TypeError
        If the camera is not a microscope, or an argument not an array of real numbers.

    Examples
    --------
    >>> optics = dict(magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=7, fill="full"))
    >>> astigmatic = clplen.PlenopticCamera.microscope(**optics, pupil={6: 40e-9})
    >>> beads = [(6e-6, -5e-6, 50e-6)]
    >>> frame = astigmatic.expose(clplen.PointSources(beads, power=1e5)).to_numpy()
    >>> camera = clplen.PlenopticCamera.microscope(**optics)
    >>> fit = clplen.microscopy.fit_pupil(frame, camera, beads=beads, terms=(5, 6))
    >>> [f"{c * 1e9:.0f} nm" for c in fit.coefficients + 0.0]
    ['0 nm', '41 nm']
    """
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    _check_array(camera)
    terms = _checked_terms(terms)
    steps, iterations = positive_integer(steps, "steps"), positive_integer(iterations, "iterations")
    is_search = isinstance(beads, str)
    if is_search and beads != "find":
        raise ValueError(f"beads must be an array of positions or 'find', got {beads!r}.")
    if (planes is None) == (beads is None or is_search):
        raise ValueError(
            "Give either beads=, the approximate positions of beads, or planes= of a volume, in "
            "which beads='find' detects beads."
        )
    z = checked_planes(
        camera, [0.0] if planes is None else planes, voxels_per_lenslet, binning, cut, "float32"
    )
    binning, voxels = int(binning), int(voxels_per_lenslet)
    n = round(camera.pixels_per_lenslet) // binning
    observed = _observed(frame, n, background, white, gain, variance)
    initial = {} if camera.pupil is None else camera.pupil.coefficients
    start = np.array([initial.get(j, 0.0) for j in terms])
    if beads is not None:
        detect = partial(find_beads, planes=z, voxels=voxels, binning=binning, cut=cut)
        positions = detect(camera, observed) if is_search else _checked_beads(beads)
        fit, mean = _bead_fit(camera, observed, terms, start, positions, binning, progress)
        if is_search and fit.chi2 > _MAX_BEAD_CHI2:
            residual = replace(observed, background=mean)
            try:
                more = detect(replace(camera, pupil=fit.pupil), residual)
            except ValueError:  # no bead detected in the residual
                return fit
            positions = np.concatenate([fit.positions, more])
            coefficients = fit.coefficients
            refit, _ = _bead_fit(
                camera, observed, terms, coefficients, positions, binning, progress
            )
            return replace(refit, residuals=np.append(fit.residuals, refit.residuals[-1]))
        return fit
    sampling = Sampling(z, voxels, binning, cut, iterations)
    return _volume_fit(camera, observed, terms, start, sampling, steps, progress)


def fit_pupil_patches(
    frame: Any, camera: Microscope, patches: tuple[int, int], *, background: Any = 0.0,
    white: Any = None, **options: Any,
) -> list[list[PupilFit]]:  # fmt: skip
    """Estimate the pupil of each patch of a frame, for aberrations that vary over the field.

    Parameters
    ----------
    frame : array_like or RawImage
        Counts as in `fit_pupil`.
    camera : Microscope
        Camera as in `fit_pupil`.
    patches : tuple of int
        Number (rows, columns) of patches with whole lenslets and nearly equal sizes. A patch is
        fitted on its own and includes light from outside: take patches wider than the images of
        points.
    background : float or array_like
        Background counts as in `fit_pupil`.
    white : array_like, optional
        Pixel sensitivity as in `fit_pupil`.
    **options
        Further options of `fit_pupil`, except ``beads``.

    Returns
    -------
    list of list of PupilFit
        Fits by row and column.

    Raises
    ------
    ShapeError
        If a patch has fewer than five lenslets along an axis.
    ValueError, TypeError
        See `fit_pupil`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=10, fill="full"))
    >>> frame = camera.expose(clplen.PointSources([(0, 0, 50e-6)], power=1e5)).to_numpy() + 1
    >>> fits = clplen.microscopy.fit_pupil_patches(
    ...     frame, camera, (1, 2), planes=[50e-6], terms=[6], iterations=2, steps=1)
    >>> [[fit.terms for fit in row] for row in fits]
    [[(6,), (6,)]]
    """
    if "beads" in options:
        raise ValueError("Patches need a volume: leave out beads, or use fit_pupil for beads.")
    check_keywords(options, keywords_of(fit_pupil), "fit_pupil_patches")
    counts = real_array(frame, "A frame")
    if np.shape(patches) != (2,):
        raise ShapeError(f"patches must be (rows, columns), got {patches!r}.")
    counts_of_patches = [positive_integer(k, "patches") for k in patches]
    require(Microscope, camera, "camera", "PlenopticCamera.microscope")
    n = round(camera.pixels_per_lenslet) // int(options.get("binning", 1))
    edges = []
    for size, number in zip(counts.shape, counts_of_patches, strict=True):
        lenslets = np.linspace(0, size // n, number + 1).round().astype(int)
        if np.diff(lenslets).min() < MIN_LENSLETS:
            raise ShapeError(
                f"A patch must have at least {MIN_LENSLETS} lenslets along an axis, got {number} "
                f"patches of {size // n} lenslets: give fewer patches."
            )
        edges.append(lenslets * n)
    fits = []
    for top, bottom in zip(edges[0][:-1], edges[0][1:], strict=True):
        row = []
        for left, right in zip(edges[1][:-1], edges[1][1:], strict=True):
            patch = (slice(top, bottom), slice(left, right))
            arrays = {
                "background": background if np.ndim(background) == 0 else background[patch],
                "white": None if white is None else white[patch],
            }
            row.append(fit_pupil(counts[patch], camera, **arrays, **options))
        fits.append(row)
    return fits


def _bead_fit(
    camera: Microscope, observed: Observed, terms: tuple[int, ...], start: Vector, beads: Vector,
    binning: int, progress: Progress | None,
) -> tuple[PupilFit, Vector]:  # fmt: skip
    """Fit the pupil to beads; return the fit and the mean counts of the frame."""
    frame = BeadFrame(camera, observed, terms, binning)
    half = np.array(frame.shape[::-1]) * frame.side / 2
    outside = (np.abs(beads[:, :2]) > half).any(axis=1)
    if outside.any():
        x, y, z = beads[outside][0]
        raise ValueError(
            f"The bead at (x, y, z) = ({x:g}, {y:g}, {z:g}) m must be within x = +-{half[0]:g} and "
            f"y = +-{half[1]:g} m: give positions relative to the centre of the frame."
        )
    result = fit_beads(frame, beads, start, progress=progress)
    errors = np.sqrt(np.diag(result.covariance))
    pupil = with_coefficients(camera, terms, result.coefficients).pupil
    assert pupil is not None
    residuals = np.array([result.residual_before, result.residual])
    fit = PupilFit(
        pupil, terms, result.coefficients, errors, residuals, result.chi2, result.positions,
        result.energies,
    )  # fmt: skip
    return fit, result.mean


def _volume_fit(
    camera: Microscope, observed: Observed, terms: tuple[int, ...], start: Vector,
    sampling: Sampling, steps: int, progress: Progress | None,
) -> PupilFit:  # fmt: skip
    """Fit the pupil to a frame of any object by Gauss-Newton steps."""
    done, total = 0, (steps + 1) * len(sampling.planes)

    def report() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    values, residuals = start, []
    for number in range(steps + 1):
        modified = with_coefficients(camera, terms, values)
        state = state_of(modified, observed, terms, sampling, report)
        residuals.append(state.residual)
        step, covariance = step_of(state)
        errors = np.sqrt(np.diag(covariance))
        if number == steps or (np.abs(step) <= _MIN_STEP_SIGMAS * errors).all():
            break
        values = values + step
    pupil = with_coefficients(camera, terms, values).pupil
    assert pupil is not None
    return PupilFit(
        pupil, terms, values, errors, np.array(residuals), state.chi2, volume=state.volume
    )


def _check_array(camera: Microscope) -> None:
    """Raise ValueError unless the array is square with a single focal length."""
    if camera.mla.lattice != "square" or len(camera.mla.focal_lengths) > 1:
        raise ValueError(
            "The fit of a pupil needs a square array with a single focal length, got a "
            f"{camera.mla.lattice} array with {len(camera.mla.focal_lengths)}."
        )


def _checked_terms(terms: Any) -> tuple[int, ...]:
    indices = tuple(int(j) for j in np.atleast_1d(terms) if is_integer(j) and j >= 1)
    if len(indices) != np.size(terms) or len(set(indices)) != len(indices) or not indices:
        raise ValueError(f"terms must be Noll indices, each once, got {terms!r}.")
    if min(indices) in (1, *_SHIFT_TERMS):
        raise ValueError(
            f"terms must be from 5 on, got {min(indices)}: a frame does not show terms 1 to 4, "
            "piston, tilts and defocus, which shift all objects equally."
        )
    for j in indices:
        noll(j)
    return indices


def _checked_beads(beads: Any) -> Vector:
    positions = real_array(beads, "beads", np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or not len(positions):
        raise ShapeError(f"beads must have shape (n, 3), (x, y, z), got {positions.shape}.")
    if not np.isfinite(positions).all():
        raise ValueError("beads must have finite positions.")
    check_positions(positions)
    return positions


def _observed(
    frame: Any, n: int, background: Any, white: Any, gain: float, variance: float
) -> Observed:
    """Check the arguments; return the frame in photons."""
    for name, number in (("gain", gain), ("variance", variance)):
        if not (is_finite(number) and number > 0):
            raise ValueError(f"{name} must be positive and finite, got {number!r}.")
    counts = real_array(frame, "A frame", np.float64)
    if counts.ndim != 2 or any(size % n or size < MIN_LENSLETS * n for size in counts.shape):
        raise ShapeError(
            f"A frame must have whole lenslets of {n} x {n} pixels, at least {MIN_LENSLETS} along "
            f"an axis, got shape {counts.shape}: rectify it."
        )
    weight = np.ones(counts.shape) if white is None else real_array(white, "white", np.float64)
    level = np.asarray(real_array(background, "background", np.float64))
    for name, values in (("white", weight), ("background", np.broadcast_to(level, level.shape))):
        if values.shape not in ((), counts.shape):
            raise ShapeError(
                f"{name} must have the shape {counts.shape} of the frame, got {values.shape}."
            )
    for name, values in (("A frame", counts), ("white", weight), ("background", level)):
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError(f"{name} has values that are negative or not finite.")
    if not (counts * (weight > 0)).any():
        raise ValueError("The frame must have counts at pixels that are not excluded.")
    background = np.broadcast_to(level / gain, counts.shape)
    return Observed(counts / gain, weight, np.ascontiguousarray(background), float(variance))
