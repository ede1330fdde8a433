"""Planes of the focus search, and the offset of the best focus from the paraxial law.

A telecentric light field of high NA is sharpest off the paraxial plane. A ray at the angle theta
from z meets the array at X = M z tan(theta), and leaves it towards the pixel at f_mu n sin(theta)/M
(sine condition). The law d = -M^2 z dx/(n f_mu p) assumes tan(theta) = sin(theta). Rays of the
rim lie farther out, so no d focuses all rays; the best d is r times the paraxial one.
With s = sin(theta), c = cos(theta), frequencies k in cycles a lenslet and views as bright as the
pupil's c^(2 e), r is where the spectral energy

    E(r) = int k dk abs(int c^(2 e) J0(2 pi k M z s (1/c - r)/p) s ds)^2

of the refocused point is highest. To second order of small z, r is <s^2/c>/<s^2>: 1.03 for
NA/n = 0.3 and 1.10 for 0.5.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import check_finite
from clplen.lightfield.depth.camera_optics import BAND
from clplen.lightfield.model.alpha_law import overlap_limit, unit_steps
from clplen.lightfield.model.sampled_views import FocusableViews
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import is_telecentric

DEFAULT_DISPARITIES = (-2.0, 2.0, 33)  # first, last, number of planes
DEFAULT_ALPHAS = (0.65, 1.35, 33)
HIGH_NA = 0.7  # NA/n from which warnings name the ratio
SEARCH_SHARE = 0.95  # of the largest search range of a light field

_FAR_DISTANCE = 1e3  # metres: a finite stand-in for infinity

_NODES = 96  # quadrature nodes over the pupil
_FREQUENCIES = 16  # frequencies in the band
_STEPS = 400  # candidates of r
_MIN_DEFOCUS = 0.1  # M z/p below which r does not depend on z
_ROUNDS = 4  # fixed-point iterations; r varies with z by a few per cent


def focus_ratio(camera: Any, z: float) -> float:
    """Return the disparity of best focus over ``camera.disparity(z)``, by rays.

    Parameters
    ----------
    camera : Microscope
        Microscope; NA, index, apodisation, magnification and lenslet pitch are used, not the cover
        glass.
    z : float
        Distance from the native plane in metres; the sign has no effect.

    Returns
    -------
    float
        Ratio of at least 1. Diffraction at the lenslets changes it by a few hundredths.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(125e-6, 2.5e-3, count=3, fill="full")
    >>> microscope = clplen.PlenopticCamera.microscope(
    ...     magnification=20, na=0.5, mla=lenslets, wavelength=525e-9, pixels_per_lenslet=25
    ... )
    >>> 1 <= clplen.lightfield.focus_ratio(microscope, 2e-5) < 1.2
    True
    """
    from scipy import special  # slow import

    check_finite(z=z)
    x, weights = np.polynomial.legendre.leggauss(_NODES)
    s = camera.na / camera.medium_index * (x + 1) / 2
    c = np.sqrt(1 - s**2)
    weights = weights * s * c ** (2 * camera.apodisation)
    scale = max(camera.magnification * abs(z) / camera.mla.pitch, _MIN_DEFOCUS)
    k = np.linspace(*BAND, _FREQUENCIES)[:, None]
    ratios = np.linspace(1, 1 / c[-1], _STEPS)
    energy = [
        (k[:, 0] * (special.j0(2 * np.pi * k * scale * s * (1 / c - r)) @ weights) ** 2).sum()
        for r in ratios
    ]
    return float(ratios[np.argmax(energy)])


def focus_ratio_of_disparity(camera: Any, disparity: float) -> float:
    """Return `focus_ratio` of the plane in best focus at a disparity.

    Parameters
    ----------
    camera : Microscope
        Microscope, see `focus_ratio`.
    disparity : float
        Disparity in pixels a view step.

    Returns
    -------
    float
        Ratio of at least 1.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(125e-6, 2.5e-3, count=3, fill="full")
    >>> microscope = clplen.PlenopticCamera.microscope(
    ...     magnification=20, na=0.5, mla=lenslets, wavelength=525e-9, pixels_per_lenslet=25
    ... )
    >>> 1 <= clplen.lightfield.focus_ratio_of_disparity(microscope, 0.1) < 1.2
    True
    """
    paraxial = camera.z(disparity)
    ratio = 1.0
    for _ in range(_ROUNDS):
        ratio = focus_ratio(camera, paraxial / ratio)
    return ratio


def farthest_disparity(camera: Any) -> float:
    """Return abs(d) of best focus at the ends of a telecentric camera's depth range."""
    end = camera.depth_range / 2
    return float(abs(camera.disparity(end)) * focus_ratio(camera, end))


def high_na_message(camera: Any, disparity: float) -> str:
    """Return a message about the error of the paraxial law; "" up to NA/n 0.7."""
    sine = camera.na / camera.medium_index
    if sine <= HIGH_NA:
        return ""
    return (
        f"At NA/n = {sine:.3g} marginal rays make points sharpest at "
        f"{focus_ratio_of_disparity(camera, disparity):.3g} times their paraxial disparity "
        f"({focus_ratio(camera, 0.0):.3g} times near the native plane)"
    )


def suitable_planes(lf: FocusableViews | ArrayLike, *, count: int | None = None) -> dict[str, Any]:
    """Choose planes for `focal_stack` that suit a light field.

    Parameters
    ----------
    lf : LightField or array_like
        The light field.
    count : int, optional
        Number of planes; default 33. For a microscope the default also resolves the depth range:
        between neighbouring planes a point shifts by at most a lenslet in the outermost views.

    Returns
    -------
    dict
        Keyword for `focal_stack`. ``alphas`` from 0.65 to 1.35, up to infinity, if the spacing is
        known and views shift by less than a picture. Otherwise ``disparities``: the range of best
        focus of a microscope, or -2 to 2, reduced while views would not overlap.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 3, 16, 20), np.float32))
    >>> planes = clplen.lightfield.suitable_planes(lf)["disparities"]
    >>> len(planes), float(planes[0]), float(planes[-1])
    (33, -2.0, 2.0)
    """
    views: Any = lf if hasattr(lf, "alpha") else as_lightfield(lf)
    if np.isfinite(views.alpha(0.0)):
        low, high, default_count = DEFAULT_ALPHAS
        if views.camera is not None:
            high = min(high, views.camera.alpha(_FAR_DISTANCE))
        alphas = np.linspace(low, high, count or default_count)
        if _stay_in_view(views, views.disparity(alphas)):
            return {"alphas": alphas}
    low, high, default_count = DEFAULT_DISPARITIES
    if is_telecentric(views):
        high = farthest_disparity(views.camera)
        low = -high
        default_count = max(
            default_count, 2 * math.ceil(high * views.camera.pixels_per_lenslet) + 1
        )
    else:
        limit = SEARCH_SHARE * overlap_limit(unit_steps(views)[views.weights > 0], views.shape)
        low, high = max(low, -limit), min(high, limit)
    return {"disparities": np.linspace(low, high, count or default_count)}


def _stay_in_view(lf: FocusableViews, disparities: Any) -> bool:
    """Return True if no view shifts by the size of a picture; widely spaced cameras fail."""
    V, U, ny, nx = lf.shape[:4]
    farthest = float(np.abs(disparities).max())
    return farthest * max(1, (max(V, U) - 1) / 2) < min(ny, nx)


def default_disparities(lf: Any) -> Any:
    """Return the disparities of `suitable_planes`, the default search range."""
    planes = suitable_planes(lf)
    return planes["disparities"] if "disparities" in planes else lf.disparity(planes["alphas"])
