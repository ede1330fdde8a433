"""Depth of one object from focus: alpha = F/F' of its sharpest plane."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import is_integer
from clplen.errors import SamplingWarning, warn_caller
from clplen.lightfield.depth import window_measures
from clplen.lightfield.depth.best_focus import (
    SEARCH_SHARE,
    farthest_disparity,
    focus_ratio_of_disparity,
    high_na_message,
)
from clplen.lightfield.depth.camera_optics import (
    BAND,
    UNFLOORED,
    CameraOptics,
    Real,
    camera_optics,
)
from clplen.lightfield.depth.phase_slope import fit_slope
from clplen.lightfield.depth.spectral_sharpness import Peak, find_peak, sharpness
from clplen.lightfield.depth.window_measures import (
    brightest,
    read_lenslets,
    read_window,
    sample_noise,
)
from clplen.lightfield.model.alpha_law import depth_at, require_two_plane
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import Spacing, is_telecentric
from clplen.reprs import OneLine

METHODS = ("compensated", "energy", "slope", "thesis")

_SEARCH = 0.3  # pixels a view step: search range without a camera
# Times the depth range of a microscope: keeps peaks at its ends inside the search
_RANGE_MARGIN = 1.1
_MIN_BAND_RATIO = 1.25  # minimum ratio of the highest to the lowest frequency of a band
_PAD = 5  # lenslets of padding
_MAX_FOCUS_BLUR = 1.2  # times the focus tolerance p/D
_SCATTER = 1.5  # times a slope's own deviation: the scatter of the spots is not independent
_NOISE_STEP = 0.1  # of a step of the search: step of the sharpness' derivatives
_ROUNDING = 1e-6  # of the largest sample: detail below it is rounding
_EMPTY = np.empty(0)  # curve of a method without a search


@dataclass(frozen=True, repr=False)
class AlphaEstimate(OneLine):
    """Depth of one object, the result of `estimate_alpha`.

    Attributes
    ----------
    alpha : float
        F/F'; nan without spacing, and for a telecentric camera (a microscope).
    z : float
        Metres from the focused plane, farther positive; nan without a camera. For a telecentric
        camera it is ``camera.z(disparity)``, the paraxial law.
    in_focus : bool
        True if the object's blur is below 1.2 lenslets; its alpha is then accurate to about p/D /
        2.
    uncertainty : float
        Standard deviation of alpha - ``bias`` for a single point in the window (of d dx/du for a
        telecentric camera): 68 % of the errors are smaller, 95 % below twice the value. It includes
        the point's position relative to the lenslets and the noise of the samples. For a
        telecentric camera it also includes the offset of the best focus from the paraxial law
        (`clplen.lightfield.depth.best_focus`). nan without a camera, for the method "thesis",
        without a peak inside the search (raise ``c_max``), and if noise hides the spots of "slope".
    curve : tuple of numpy.ndarray
        (alphas, E): focus measure at the tested alphas, ascending; empty for the method "slope".
    method : str
    disparity : float
        Disparity of the object's plane in pixels a view step, nearer positive.
    disparities : numpy.ndarray
        Disparities of ``curve``.
    at : tuple of int
        (y, x) of the lenslet at the centre of the window.
    confidence : float
        Share of the scatter, 0 to 1, that the line of the method "slope" explains; else nan.
    blur : float
        Diameter of a point's blur on the lenslets, D abs(1 - alpha)/p, in lenslets; nan without a
        camera.
    z_uncertainty : float
        ``uncertainty`` converted to metres, half the distance between its ends; nan where z is.
    bias : float
        Mean error of alpha: (alpha - 1)(1 - 1/kappa) for "energy", which is not corrected, 0 for
        the other methods; nan without a camera and for "thesis".

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 10e-3, count=31, fill="full")
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0.03)), model="rays")
    >>> estimate = clplen.estimate_alpha(clplen.LightField.from_raw(raw), at=(15, 15))
    >>> estimate.at, estimate.method, bool(estimate.uncertainty > 0)
    ((15, 15), 'compensated', True)
    """

    alpha: float
    z: float
    in_focus: bool
    uncertainty: float
    curve: tuple[Real, Real] = field(repr=False)
    method: str
    disparity: float
    disparities: Real = field(repr=False)
    at: tuple[int, int]
    confidence: float = math.nan
    blur: float = math.nan
    z_uncertainty: float = math.nan
    bias: float = math.nan


def estimate_alpha(
    lf: LightField | ArrayLike,
    *,
    at: tuple[int, int] | None = None,
    method: str = "compensated",
    window: int = 21,
    c_max: float | None = None,
) -> AlphaEstimate:
    """Estimate the depth of one object from the sharpest refocused plane.

    "energy" is the spectral energy of the refocused window between 0.1 and 0.45 cycles a lenslet.
    Its peak is biased towards alpha = 1 by kappa = U^2/(U^2 + s^2), with U the rms radius of the
    pupil and s that of diffraction at the lenslets (errors in variables); the bias stays.
    "compensated" divides the spectrum by the ambiguity function of the lenslet aperture
    (`clplen.lightfield.depth.camera_optics`), which removes the bias. If both peaks lie within
    1.2 p/D of 1, the object is in focus and the compensated curve is flat; "compensated" then
    returns 1 + (alpha_energy - 1)/kappa. "slope" fits the line of one point in phase space
    (`fit_slope`) without a search; it needs a single defocused point of at least three spots.
    Lenslets of a hexagonal array are read at their sensor positions (`read_lenslets`), without the
    resampling of views. "thesis" is the baseline of
    `clplen.lightfield.depth.window_measures`: naive cells, 31 x 31 lenslets, alpha from 0.7 to
    1.3, regardless of ``window`` and ``c_max``.

    Parameters
    ----------
    lf : LightField or array_like
        Light field. "compensated" requires spacing and camera, "thesis" the raw image. Without
        spacing, "energy" and "slope" give the disparity only.
    at : tuple of int, optional
        (y, x) of the lenslet at the object, 0-based. None: the brightest region.
    method : {"compensated", "energy", "slope", "thesis"}
        Estimation method, see above.
    window : int
        Number of lenslets across, odd, at least 9; clipped at the border of the light field. The
        object should fill the window or be alone in it.
    c_max : float, optional
        Limit of the search, -c_max to c_max pixels a view step (lenslets a sub-image pixel). A
        larger limit lowers the highest frequency of "compensated". Default 0.3, or the depth
        range of a microscope.

    Returns
    -------
    AlphaEstimate
        Estimate of alpha with its uncertainty, z in metres, disparity and search curve.

    Raises
    ------
    ValueError
        If the method is unknown or lacks a requirement ("thesis" an F), ``at`` lies outside, the
        window is even or too small, ``c_max`` is out of range, or the window has no light or no
        detail.

    Warns
    -----
    SamplingWarning
        If the window is sharpest at an end of the search (the object is farther away), and from
        NA/n = 0.7 of a microscope on, where the paraxial ``z`` is too large by the factor in the
        message.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 0.5e-3, count=21)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=9)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 1e-3)))
    >>> estimate = clplen.estimate_alpha(clplen.LightField.from_raw(raw), window=15)
    >>> f"alpha = {estimate.alpha:.2f}, of the camera {camera.alpha(1e-3):.2f}"
    'alpha = 1.05, of the camera 1.05'
    """
    lf = as_lightfield(lf)
    at = _checked(lf, at, method, window)
    if method == "thesis":
        if is_telecentric(lf):
            raise ValueError(
                "method='thesis' searches alpha = F/F', which a telecentric camera (such as a "
                "microscope) does not have; use another method."
            )
        return _thesis(lf, at)
    optics = camera_optics(lf)
    if method == "slope":
        return _slope(lf, at, window, optics)
    if method == "compensated" and optics is None:
        raise ValueError(
            "method='compensated' needs a light field with spacing (dv, du, dy, dx) and camera; "
            "set both, or use method='energy'."
        )
    c_max = _range(lf, window, c_max, optics)
    samples = _detail(lf, at, window)
    aspect = _aspect(lf.spacing)
    farthest = c_max * max(abs(aspect) * (lf.shape[0] - 1), lf.shape[1] - 1) / 2
    pad = max(_PAD, math.ceil(farthest))
    step = 1 / lf.shape[1]  # moves the outermost views apart by a lenslet
    measures = {"energy": sharpness(samples, pad=pad, band=BAND, aspect=aspect)}
    energy = find_peak(measures["energy"], c_max, step=step)
    if optics is None:
        _warn_at_search_end(lf, energy, _limit(lf, window, optics))
        return _of_peak(lf, method, at, energy)
    measures["compensated"] = sharpness(
        samples, pad=pad, band=optics.band(c_max), aspect=aspect, blur=optics.blur
    )
    compensated = find_peak(measures["compensated"], c_max, step=step)
    peak = energy if method == "energy" else compensated
    _warn_at_search_end(lf, peak, _limit(lf, window, optics))
    in_focus = all(
        abs(lf.shear_alpha(candidate.position) - 1) < _MAX_FOCUS_BLUR * optics.tolerance
        for candidate in (energy, compensated)
    )
    noise = measures[method].deviation(
        peak.position, sample_noise(samples), step=_NOISE_STEP * step
    )
    alpha = None
    if in_focus and method == "compensated":
        alpha = 1 + float(lf.shear_alpha(energy.position) - 1) / optics.kappa
    return _of_peak(
        lf, method, at, peak, optics=optics, in_focus=in_focus, alpha=alpha, noise=noise
    )


def _aspect(spacing: Spacing | None) -> float:
    """Return the shear along y, in rows, over the shear along x, in columns."""
    if spacing is None or not np.isfinite(spacing).all():
        return 1.0
    dv, du, dy, dx = spacing
    return dv * dx / (du * dy)


def _detail(lf: LightField, at: tuple[int, int], size: int) -> Real:
    """Return a window less the mean of each view, so that its border makes no edge."""
    window = read_window(lf, at, size)
    largest = np.abs(window).max()
    window -= window.mean(axis=(-2, -1), keepdims=True)
    if np.abs(window).max() <= _ROUNDING * largest:
        raise ValueError(
            f"The {size} x {size} lenslets around {at} have no light or no detail; pass another "
            "at= or a larger window."
        )
    return window


def _checked(
    lf: LightField, at: tuple[int, int] | None, method: str, window: int
) -> tuple[int, int]:
    """Check the common arguments and return the central lenslet."""
    if method not in METHODS:
        raise ValueError(f"method must be {', '.join(map(repr, METHODS))}, got {method!r}.")
    if not is_integer(window) or window % 2 == 0 or window < 9:
        raise ValueError(f"window must be an odd integer of at least 9 lenslets, got {window!r}.")
    if at is None:
        return brightest(lf, window)
    ny, nx = lf.shape[2:4]
    y, x = at
    if not (is_integer(x) and is_integer(y) and 0 <= x < nx and 0 <= y < ny):
        raise ValueError(
            f"at must be (y, x) of a lenslet with 0 <= y < {ny} and 0 <= x < {nx}, got {at!r}."
        )
    return int(y), int(x)


def search_limit(lf: LightField, *, window: int = 21) -> float:
    """Return the upper bound of ``c_max`` set by alpha, the window and the band."""
    return _limit(lf, window, camera_optics(lf))


def _limit(lf: LightField, window: int, optics: CameraOptics | None) -> float:
    limits = [2 * window / max(max(lf.shape[:2]) - 1, 1)]  # the outermost view leaves the window
    if optics is not None:
        limits.append(UNFLOORED / (optics.blur.q * _MIN_BAND_RATIO * BAND[0]))
    if lf.spacing is not None and np.isfinite(lf.spacing).all():
        limits.append(abs(lf.spacing[1] / lf.spacing[3]))  # alpha = 0, infinity for naive cells
    return float(min(limits))


def _range(lf: LightField, window: int, c_max: float | None, optics: CameraOptics | None) -> float:
    """Return the search range after checking it against alpha, the window and the band."""
    limit = _limit(lf, window, optics)
    if c_max is None and is_telecentric(lf):
        return min(_RANGE_MARGIN * farthest_disparity(lf.camera), SEARCH_SHARE * limit)
    c_max = _SEARCH if c_max is None else c_max
    if not 0 < c_max < limit:
        raise ValueError(
            f"c_max must be between 0 and {limit:.3g} pixels a view step for this light field "
            f"and window, got {c_max!r}."
        )
    return c_max


def _of_peak(
    lf: LightField,
    method: str,
    at: tuple[int, int],
    peak: Peak,
    *,
    optics: CameraOptics | None = None,
    in_focus: bool = False,
    alpha: float | None = None,
    noise: float = 0.0,
) -> AlphaEstimate:
    """Build the estimate from a peak, or from an ``alpha`` that replaces it."""
    value = float(lf.shear_alpha(peak.position)) if alpha is None else alpha
    disparity = peak.position if alpha is None else float(lf.disparity_of_shear(alpha))
    uncertainty = math.nan
    if optics is not None and peak.inside:
        uncertainty = optics.deviation(value, method, noise * _alpha_per_disparity(lf))
        uncertainty += _paraxial_excess(lf, value, disparity)
    rising = np.argsort(lf.shear_alpha(peak.positions))
    curve = (lf.alpha(peak.positions)[rising], peak.values[rising])
    return _estimate(
        lf, method, at, value, disparity, optics=optics, in_focus=in_focus,
        uncertainty=uncertainty, curve=curve, disparities=peak.positions[rising],
    )  # fmt: skip


def _estimate(
    lf: LightField,
    method: str,
    at: tuple[int, int],
    alpha: float,
    disparity: float,
    *,
    optics: CameraOptics | None = None,
    in_focus: bool = False,
    uncertainty: float = math.nan,
    curve: tuple[Real, Real] = (_EMPTY, _EMPTY),
    disparities: Real = _EMPTY,
    confidence: float = math.nan,
) -> AlphaEstimate:
    """Build the estimate with all quantities that follow from alpha and its uncertainty."""
    return AlphaEstimate(
        alpha=math.nan if is_telecentric(lf) else alpha,
        z=float(depth_at(lf, disparity)),
        in_focus=in_focus,
        uncertainty=uncertainty,
        curve=curve,
        method=method,
        disparity=disparity,
        disparities=disparities,
        at=at,
        confidence=confidence,
        blur=math.nan if optics is None else abs(1 - alpha) / optics.tolerance,
        z_uncertainty=_z_uncertainty(lf, alpha, uncertainty),
        bias=math.nan if optics is None else optics.bias(alpha, method),
    )


def _warn_at_search_end(lf: LightField, peak: Peak, limit: float) -> None:
    """Warn if no peak lies inside the search; name the range and a remedy."""
    if peak.inside:
        return
    end = abs(float(peak.positions[0]))
    z = np.abs(depth_at(lf, [-end, end]))
    metres = f", abs(z) up to {z.max():.3g} m" if np.isfinite(z).all() else ""
    wider = min(2 * end, SEARCH_SHARE * limit)
    advice = (
        f"pass c_max={wider:.3g}"
        if wider > 1.01 * end
        else f"this window allows at most {limit:.3g}, pass a larger window"
    )
    warn_caller(
        f"The window is sharpest at an end of the search, disparity {peak.position:.3g} of "
        f"{-end:.3g} to {end:.3g} pixels a view step{metres}, so the depth is not valid: the "
        f"object lies farther from the focused plane; {advice}.",
        SamplingWarning,
    )


def _paraxial_excess(lf: LightField, alpha: float, disparity: float) -> float:
    """Return the excess of abs(1 - alpha) over a ray trace; 0 unless telecentric."""
    if not is_telecentric(lf):
        return 0.0
    message = high_na_message(lf.camera, disparity)
    ratio = focus_ratio_of_disparity(lf.camera, disparity)
    if message:
        z = float(depth_at(lf, disparity))
        warn_caller(
            f"{message}: the object lies at about {z / ratio:.3g} m, not at the paraxial "
            f"z = {z:.3g} m.",
            SamplingWarning,
        )
    return (1 - 1 / ratio) * abs(1 - alpha)


def _z_uncertainty(lf: LightField, alpha: float, uncertainty: float) -> float:
    """Convert an uncertainty of alpha to metres of z."""
    if not 0 <= uncertainty < alpha:  # also false for nan
        return math.nan
    ends = lf.disparity_of_shear([alpha - uncertainty, alpha + uncertainty])
    return float(np.ptp(depth_at(lf, ends))) / 2


def _alpha_per_disparity(lf: LightField) -> float:
    """Return abs(d alpha/d disparity)."""
    return float(abs(lf.shear_alpha(1.0) - lf.shear_alpha(0.0)))


def _slope(
    lf: LightField, at: tuple[int, int], window: int, optics: CameraOptics | None
) -> AlphaEstimate:
    require_two_plane(lf.parametrisation, "The slope")
    lenslets = read_lenslets(lf, at, window)
    samples = lenslets.samples * (lf.weights > 0)[:, :, None, None]
    if not samples.max() > 0:
        raise ValueError(
            f"The {window} x {window} lenslets around {at} have no light; pass another at= or a "
            "larger window."
        )
    slope = fit_slope(
        samples,
        aspect=_aspect(lf.spacing),
        y=lenslets.y,
        x=lenslets.x,
        pupil=None if optics is None else optics.pupil,
    )
    alpha = float(lf.shear_alpha(slope.disparity))
    uncertainty, in_focus = math.nan, False
    if optics is not None:
        in_focus = slope.spots > 0 and (abs(alpha - 1) < _MAX_FOCUS_BLUR * optics.tolerance)
        deviation = 0.0 if math.isnan(slope.deviation) else slope.deviation
        noise = _SCATTER * deviation * _alpha_per_disparity(lf)
        uncertainty = optics.deviation(alpha, "slope", noise) if slope.spots else math.nan
        uncertainty += _paraxial_excess(lf, alpha, slope.disparity)
    return _estimate(
        lf, "slope", at, alpha, slope.disparity, optics=optics, in_focus=in_focus,
        uncertainty=uncertainty, confidence=slope.confidence,
    )  # fmt: skip


def _thesis(lf: LightField, at: tuple[int, int]) -> AlphaEstimate:
    if lf.raw is None:
        raise ValueError(
            "method='thesis' needs the raw image, which this light field does not have; create it "
            "with LightField.from_raw, or use another method."
        )
    naive = LightField.from_raw(lf.raw, decode="naive")
    window = read_window(naive, at, window_measures.THESIS_WINDOW, fill=True)
    energies = window_measures.thesis_curve(window)
    best = int(np.argmax(energies))
    disparities = lf.disparity_of_shear(window_measures.THESIS_ALPHAS)
    alpha = float(window_measures.THESIS_ALPHAS[best])
    curve = (window_measures.THESIS_ALPHAS.copy(), energies)
    return _estimate(
        lf, "thesis", at, alpha, float(disparities[best]), curve=curve, disparities=disparities
    )
