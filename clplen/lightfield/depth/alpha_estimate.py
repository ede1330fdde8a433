"""Depth of one object from focus: alpha = F/F' of the plane where it is sharpest."""

from __future__ import annotations

import math
from dataclasses import dataclass

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

_SEARCH = 0.3  # pixels a view step, where no camera tells its depth range
_BEYOND = 1.1  # search past the depth range of a microscope, whose ends would be no peak
_NARROWEST = 1.25  # highest over lowest frequency that still is a band
_PAD = 5  # lenslets
_IN_FOCUS = 1.2  # in units of the focus tolerance p/D
_SCATTER = 1.5  # of a slope's own deviation: the spots' scatter is not independent
_NOISE_STEP = 0.1  # of a step of the search: for derivatives of the sharpness
_ROUNDING = 1e-6  # of the largest sample: less is no detail
_NONE = np.empty(0)  # curve of a method without a search


@dataclass(frozen=True, repr=False)
class AlphaEstimate(OneLine):
    """Where one object lies. Made by `estimate_alpha`.

    Attributes
    ----------
    alpha : float
        F/F'; nan without spacing, and for a telecentric camera (a microscope).
    z : float
        Metres from the focused plane, farther positive; nan without a camera. That of a telecentric
        camera is ``camera.z(disparity)``, the paraxial law.
    in_focus : bool
        Whether the object's blur is below 1.2 lenslets, where its alpha is known to about p/D / 2.
    uncertainty : float
        One standard deviation of alpha - ``bias`` for a single point in the window, or of d dx/du
        for a telecentric camera: 68 % of the errors are smaller, 95 % smaller than twice it. It
        holds where the point falls on the lenslets, by its blur, and the noise of the samples as
        their scatter shows it. nan without a camera, for the method "thesis", when no peak was
        found inside the search (raise ``c_max``), and for "slope" where noise hides the spots. Of
        a telecentric camera it holds how far the best focus lies beyond the paraxial law too
        (`clplen.lightfield.depth.best_focus`).
    curve : tuple of numpy.ndarray
        (alphas, E): focus measure at the alphas that were tried, alphas rising; empty for the
        method "slope".
    method : str
    disparity : float
        The same plane in pixels a view step, nearer positive.
    disparities : numpy.ndarray
        Of ``curve``.
    at : tuple of int
        (y, x) of the lenslet that the window was centred on.
    confidence : float
        Of the method "slope", 0 to 1: share of the scatter that the line explains; else nan.
    blur : float
        Diameter of a point's blur on the lenslets, D abs(1 - alpha)/p, in lenslets; nan without a
        camera.
    z_uncertainty : float
        ``uncertainty`` as metres of z, half of what lies between its ends; nan where that is.
    bias : float
        What alpha is off by in the mean: (alpha - 1)(1 - 1/kappa) for "energy", which is returned
        as found, 0 for the other methods; nan without a camera and for "thesis".

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 10e-3, count=31, fill="full")
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0.03)), model="rays")
    >>> found = clplen.estimate_alpha(clplen.LightField.from_raw(raw), at=(15, 15))
    >>> found.at, found.method, bool(found.uncertainty > 0)
    ((15, 15), 'compensated', True)
    """

    alpha: float
    z: float
    in_focus: bool
    uncertainty: float
    curve: tuple[Real, Real]
    method: str
    disparity: float
    disparities: Real
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
    """Estimate the depth of one object from where its refocused image is sharpest.

    "energy" is the spectral energy of the refocused window between .1 and .45 cycles a lenslet.
    Its peak is pulled towards alpha = 1 by kappa = U^2/(U^2 + s^2), U the rms radius of the pupil
    and s that of the lenslets' diffraction in a sub-image (errors in variables); it is returned
    as found. "compensated" divides the spectrum by the ambiguity function of the lenslet aperture
    (`clplen.lightfield.depth.camera_optics`), which puts the peak back. When both peaks lie
    within 1.2 p/D of 1, the object is in focus, the compensated curve is flat, and "compensated"
    returns 1 + (alpha_energy - 1)/kappa. "slope" fits the line of one point in phase space
    (`fit_slope`): no search, but a single point, out of focus, of at least three spots. The
    lenslets of a hexagonal array are read as they lie on the sensor (`read_lenslets`), not as they
    are resampled for views. "thesis" is the baseline of
    `clplen.lightfield.depth.window_measures`: naive cells, 31 x 31 lenslets, alpha from .7 to 1.3,
    whatever ``window`` and ``c_max`` say.

    Parameters
    ----------
    lf : LightField or array_like
        "compensated" needs its spacing and camera, "thesis" its raw image; "energy" and "slope"
        nothing, but without spacing they know the disparity only.
    at : tuple of int, optional
        (y, x) of the lenslet at the object, indices from 0. None: the brightest region.
    method : {"compensated", "energy", "slope", "thesis"}
        How the depth is found: see above.
    window : int
        Lenslets across, odd, at least 9; clipped at the border of the light field. One object at
        one depth should fill it or lie alone in it.
    c_max : float, optional
        Search range, -c_max to c_max pixels a view step (lenslets a sub-image pixel). A larger
        one lowers the highest frequency that "compensated" uses. Default .3, and the depth range
        of a microscope.

    Returns
    -------
    AlphaEstimate
        With alpha, its uncertainty, z in metres, the disparity and the curve that was searched.

    Raises
    ------
    ValueError
        If the method is unknown or lacks what it needs ("thesis" an F), ``at`` lies outside, the
        window is even or too small, ``c_max`` is out of range, or the window is black or without
        detail.

    Warns
    -----
    SamplingWarning
        If the window is sharpest at an end of the search, so that the object lies farther away;
        and from NA/n = .7 of a microscope on, where the paraxial ``z`` is too large by the factor
        that it names.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 0.5e-3, count=21)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=9)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 1e-3)))
    >>> found = clplen.estimate_alpha(clplen.LightField.from_raw(raw), window=15)
    >>> f"alpha = {found.alpha:.2f}, of the camera {camera.alpha(1e-3):.2f}"
    'alpha = 1.05, of the camera 1.05'
    """
    lf = as_lightfield(lf)
    at = _checked(lf, at, method, window)
    if method == "thesis":
        if is_telecentric(lf):
            raise ValueError(
                "method='thesis' looks for alpha = F/F', which a telecentric camera, such as a "
                "microscope, does not have: use another method."
            )
        return _thesis(lf, at)
    optics = camera_optics(lf)
    if method == "slope":
        return _slope(lf, at, window, optics)
    if method == "compensated" and optics is None:
        raise ValueError(
            "method='compensated' needs a light field with spacing (dv, du, dy, dx) and the "
            "camera that took it: give both, or use method='energy'."
        )
    c_max = _range(lf, window, c_max, optics)
    cells = _detail(lf, at, window)
    aspect = _aspect(lf.spacing)
    farthest = c_max * max(abs(aspect) * (lf.shape[0] - 1), lf.shape[1] - 1) / 2
    pad = max(_PAD, math.ceil(farthest))
    step = 1 / lf.shape[1]  # moves the outermost views apart by a lenslet
    sharp = {"energy": sharpness(cells, pad=pad, band=BAND, aspect=aspect)}
    energy = find_peak(sharp["energy"], c_max, step=step)
    if optics is None:
        _warn_at_search_end(lf, energy, _limit(lf, window, optics))
        return _of_peak(lf, method, at, energy)
    sharp["compensated"] = sharpness(
        cells, pad=pad, band=optics.band(c_max), aspect=aspect, blur=optics.blur
    )
    compensated = find_peak(sharp["compensated"], c_max, step=step)
    peak = energy if method == "energy" else compensated
    _warn_at_search_end(lf, peak, _limit(lf, window, optics))
    in_focus = all(
        abs(lf.shear_alpha(one.position) - 1) < _IN_FOCUS * optics.tolerance
        for one in (energy, compensated)
    )
    noise = sharp[method].deviation(peak.position, sample_noise(cells), step=_NOISE_STEP * step)
    alpha = None
    if in_focus and method == "compensated":
        alpha = 1 + float(lf.shear_alpha(energy.position) - 1) / optics.kappa
    return _of_peak(
        lf, method, at, peak, optics=optics, in_focus=in_focus, alpha=alpha, noise=noise
    )


def _aspect(spacing: Spacing | None) -> float:
    """Shear along y, in rows, over shear along x, in columns."""
    if spacing is None or not np.isfinite(spacing).all():
        return 1.0
    dv, du, dy, dx = spacing
    return dv * dx / (du * dy)


def _detail(lf: LightField, at: tuple[int, int], size: int) -> Real:
    """A window without the mean of each view, so that its own border is no edge."""
    window = read_window(lf, at, size)
    largest = np.abs(window).max()
    window -= window.mean(axis=(-2, -1), keepdims=True)
    if np.abs(window).max() <= _ROUNDING * largest:
        raise ValueError(
            f"The {size} x {size} lenslets round {at} are black or without any detail: give "
            "another at= or a larger window."
        )
    return window


def _checked(
    lf: LightField, at: tuple[int, int] | None, method: str, window: int
) -> tuple[int, int]:
    """The central lenslet, after the checks that every method shares."""
    if method not in METHODS:
        raise ValueError(f"method is one of {', '.join(map(repr, METHODS))}, not {method!r}.")
    if not is_integer(window) or window % 2 == 0 or window < 9:
        raise ValueError(f"window is an odd number of lenslets, at least 9, not {window!r}.")
    if at is None:
        return brightest(lf, window)
    ny, nx = lf.shape[2:4]
    y, x = at
    if not (is_integer(x) and is_integer(y) and 0 <= x < nx and 0 <= y < ny):
        raise ValueError(
            f"at is (y, x) of a lenslet with 0 <= y < {ny} and 0 <= x < {nx}, not {at!r}."
        )
    return int(y), int(x)


def search_limit(lf: LightField, *, window: int = 21) -> float:
    """Return the bound of ``c_max`` of `estimate_alpha`, where alpha, window or band ends."""
    return _limit(lf, window, camera_optics(lf))


def _limit(lf: LightField, window: int, optics: CameraOptics | None) -> float:
    limits = [2 * window / max(max(lf.shape[:2]) - 1, 1)]  # the outermost view leaves the window
    if optics is not None:
        limits.append(UNFLOORED / (optics.blur.q * _NARROWEST * BAND[0]))
    if lf.spacing is not None and np.isfinite(lf.spacing).all():
        limits.append(abs(lf.spacing[1] / lf.spacing[3]))  # alpha = 0, for naive cells infinity
    return float(min(limits))


def _range(lf: LightField, window: int, c_max: float | None, optics: CameraOptics | None) -> float:
    """The search range, after a check that alpha, the window and the band do not end in it."""
    limit = _limit(lf, window, optics)
    if c_max is None and is_telecentric(lf):
        return min(_BEYOND * farthest_disparity(lf.camera), SEARCH_SHARE * limit)
    c_max = _SEARCH if c_max is None else c_max
    if not 0 < c_max < limit:
        raise ValueError(
            f"c_max lies between 0 and {limit:.3g} pixels a view step for this light field "
            f"and window, not at {c_max!r}."
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
    """Estimate from a peak, or from an alpha that takes its place."""
    value = float(lf.shear_alpha(peak.position)) if alpha is None else alpha
    disparity = peak.position if alpha is None else float(lf.disparity_of_shear(alpha))
    uncertainty = math.nan
    if optics is not None and peak.inside:
        uncertainty = optics.deviation(value, method, noise * _alpha_of_one(lf))
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
    curve: tuple[Real, Real] = (_NONE, _NONE),
    disparities: Real = _NONE,
    confidence: float = math.nan,
) -> AlphaEstimate:
    """Everything that follows from an alpha and its uncertainty."""
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
    """Warn where no peak was found, with what was searched and what would do."""
    if peak.inside:
        return
    end = abs(float(peak.positions[0]))
    z = np.abs(depth_at(lf, [-end, end]))
    metres = f", abs(z) up to {z.max():.3g} m" if np.isfinite(z).all() else ""
    wider = min(2 * end, SEARCH_SHARE * limit)
    advice = (
        f"pass c_max={wider:.3g}"
        if wider > 1.01 * end
        else f"this window allows no more than {limit:.3g}, give a larger one"
    )
    warn_caller(
        f"The window is sharpest at an end of the search, disparity {peak.position:.3g} of "
        f"{-end:.3g} to {end:.3g} pixels a view step{metres}, so that this is no depth: the object "
        f"lies farther from the focused plane; {advice}.",
        SamplingWarning,
    )


def _paraxial_excess(lf: LightField, alpha: float, disparity: float) -> float:
    """By how much abs(1 - alpha) is too large: 0, and of a telecentric camera what rays say."""
    if not is_telecentric(lf):
        return 0.0
    words = high_na_message(lf.camera, disparity)
    ratio = focus_ratio_of_disparity(lf.camera, disparity)
    if words:
        z = float(depth_at(lf, disparity))
        warn_caller(
            f"{words}: the object lies at about {z / ratio:.3g} m rather than at z = {z:.3g} m, "
            "which is that of the paraxial law.",
            SamplingWarning,
        )
    return (1 - 1 / ratio) * abs(1 - alpha)


def _z_uncertainty(lf: LightField, alpha: float, uncertainty: float) -> float:
    """An uncertainty of alpha as one of z."""
    if not 0 <= uncertainty < alpha:  # nor nan
        return math.nan
    ends = lf.disparity_of_shear([alpha - uncertainty, alpha + uncertainty])
    return float(np.ptp(depth_at(lf, ends))) / 2


def _alpha_of_one(lf: LightField) -> float:
    """abs(d alpha/d disparity)."""
    return float(abs(lf.shear_alpha(1.0) - lf.shear_alpha(0.0)))


def _slope(
    lf: LightField, at: tuple[int, int], window: int, optics: CameraOptics | None
) -> AlphaEstimate:
    require_two_plane(lf.parametrisation, "The slope")
    lenslets = read_lenslets(lf, at, window)
    samples = lenslets.samples * (lf.weights > 0)[:, :, None, None]
    if not samples.max() > 0:
        raise ValueError(
            f"The {window} x {window} lenslets round {at} are black: give another at= or a larger "
            "window."
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
        in_focus = slope.spots > 0 and (abs(alpha - 1) < _IN_FOCUS * optics.tolerance)
        deviation = 0.0 if math.isnan(slope.deviation) else slope.deviation
        noise = _SCATTER * deviation * _alpha_of_one(lf)
        uncertainty = optics.deviation(alpha, "slope", noise) if slope.spots else math.nan
        uncertainty += _paraxial_excess(lf, alpha, slope.disparity)
    return _estimate(
        lf, "slope", at, alpha, slope.disparity, optics=optics, in_focus=in_focus,
        uncertainty=uncertainty, confidence=slope.confidence,
    )  # fmt: skip


def _thesis(lf: LightField, at: tuple[int, int]) -> AlphaEstimate:
    if lf.raw is None:
        raise ValueError(
            "method='thesis' decodes the raw image again, which this light field does not have: "
            "make it with LightField.from_raw, or use another method."
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
