"""Which planes are searched for the best focus, and where it lies beyond the paraxial law.

A telecentric light field of high NA is sharpest off the paraxial plane. A ray at the angle theta
from z meets the array at X = M z tan(theta), and leaves it towards the pixel at f_mu n sin(theta)/M
(sine condition). The law d = -M^2 z dx/(n f_mu p) of a plane takes tan(theta) = sin(theta); as rays
of the rim lie farther out, no d gathers all of them, and the best one is r times the paraxial one.
With s = sin(theta), c = cos(theta), frequencies k in cycles a lenslet and views as bright as the
pupil's c^(2 e), r is where the spectral energy

    E(r) = int k dk abs(int c^(2 e) J0(2 pi k M z s (1/c - r)/p) s ds)^2

of the refocused point is highest. To second order of small z it is <s^2/c>/<s^2>, 1.03 for
NA/n = .3 and 1.10 for .5.
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

DEFAULT_DISPARITIES = (-2.0, 2.0, 33)  # first, last, how many
DEFAULT_ALPHAS = (0.65, 1.35, 33)
HIGH_NA = 0.7  # NA/n from which warnings name the ratio
SEARCH_SHARE = 0.95  # of the largest search that a light field allows

_FAR = 1e3  # metres: as good as infinity, and still finite

_NODES = 96  # over the pupil
_FREQUENCIES = 16
_STEPS = 400  # of r
_LEAST = 0.1  # M z/p below which r no longer depends on z
_ROUNDS = 4  # r changes with z by a few per cent only


def focus_ratio(camera: Any, z: float) -> float:
    """Disparity of best focus over ``camera.disparity(z)``, by rays.

    Parameters
    ----------
    camera : Microscope
        Its NA, index, apodisation, magnification and lenslet pitch count, its cover glass does not.
    z : float
        In metres from the native plane; the sign does not matter.

    Returns
    -------
    float
        1 or more. Diffraction at the lenslets adds or takes a few hundredths.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(125e-6, 2.5e-3, count=3, fill="full")
    >>> microscope = clplen.PlenopticCamera.microscope(
    ...     magnification=20, na=0.5, mla=lenslets, wavelength=525e-9, pixels_per_lenslet=25
    ... )
    >>> 1 <= clplen.lightfield.focus_ratio(microscope, 2e-5) < 1.2
    True
    """
    from scipy import special  # here: slow to import

    check_finite(z=z)
    x, weights = np.polynomial.legendre.leggauss(_NODES)
    s = camera.na / camera.medium_index * (x + 1) / 2
    c = np.sqrt(1 - s**2)
    weights = weights * s * c ** (2 * camera.apodisation)
    scale = max(camera.magnification * abs(z) / camera.mla.pitch, _LEAST)
    k = np.linspace(*BAND, _FREQUENCIES)[:, None]
    ratios = np.linspace(1, 1 / c[-1], _STEPS)
    energy = [
        (k[:, 0] * (special.j0(2 * np.pi * k * scale * s * (1 / c - r)) @ weights) ** 2).sum()
        for r in ratios
    ]
    return float(ratios[np.argmax(energy)])


def focus_ratio_of_disparity(camera: Any, disparity: float) -> float:
    """Return `focus_ratio` of the plane that is in best focus at a disparity.

    Parameters
    ----------
    camera : Microscope
        As for `focus_ratio`.
    disparity : float
        In pixels a view step.

    Returns
    -------
    float
        1 or more.

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
    """abs(d) at which the ends of the depth range of a telecentric camera are in best focus."""
    end = camera.depth_range / 2
    return float(abs(camera.disparity(end)) * focus_ratio(camera, end))


def high_na_message(camera: Any, disparity: float) -> str:
    """Return how far the paraxial law is off at a disparity; "" up to NA/n 0.7."""
    sine = camera.na / camera.medium_index
    if sine <= HIGH_NA:
        return ""
    return (
        f"At NA/n = {sine:.3g} rays of the rim make points sharpest at "
        f"{focus_ratio_of_disparity(camera, disparity):.3g} times their paraxial disparity "
        f"({focus_ratio(camera, 0.0):.3g} times near the native plane)"
    )


def suitable_planes(lf: FocusableViews | ArrayLike, *, count: int | None = None) -> dict[str, Any]:
    """Choose planes that suit a light field, as ``alphas`` or ``disparities`` of `focal_stack`.

    Parameters
    ----------
    lf : LightField or array_like
        The light field.
    count : int, optional
        How many; default 33, and for a microscope at least as many as resolve its depth range:
        one pixel in the sub-images moves a point by one lenslet between the outermost views.

    Returns
    -------
    dict
        ``alphas`` from .65 to 1.35, at most up to infinity, where the spacing is known and these
        move no view by the size of a picture; ``disparities`` over the depth range of a
        microscope, to where its ends are sharpest; else from -2 to 2, or to where views of few
        pixels still overlap.

    Examples
    --------
    >>> lf = clplen.LightField.from_array(np.ones((3, 3, 16, 20), np.float32))
    >>> planes = clplen.lightfield.suitable_planes(lf)["disparities"]
    >>> len(planes), float(planes[0]), float(planes[-1])
    (33, -2.0, 2.0)
    """
    views: Any = lf if hasattr(lf, "alpha") else as_lightfield(lf)
    if np.isfinite(views.alpha(0.0)):
        low, high, many = DEFAULT_ALPHAS
        if views.camera is not None:
            high = min(high, views.camera.alpha(_FAR))
        alphas = np.linspace(low, high, count or many)
        if _stay_in_view(views, views.disparity(alphas)):
            return {"alphas": alphas}
    low, high, many = DEFAULT_DISPARITIES
    if is_telecentric(views):
        high = farthest_disparity(views.camera)
        low = -high
        many = max(many, 2 * math.ceil(high * views.camera.pixels_per_lenslet) + 1)
    else:
        limit = SEARCH_SHARE * overlap_limit(unit_steps(views)[views.weights > 0], views.shape)
        low, high = max(low, -limit), min(high, limit)
    return {"disparities": np.linspace(low, high, count or many)}


def _stay_in_view(lf: FocusableViews, disparities: Any) -> bool:
    """Whether no view is moved by the size of a picture: cameras far apart have other alphas."""
    V, U, ny, nx = lf.shape[:4]
    farthest = float(np.abs(disparities).max())
    return farthest * max(1, (max(V, U) - 1) / 2) < min(ny, nx)


def default_disparities(lf: Any) -> Any:
    """Disparities that are tried where none were given: those of `suitable_planes`."""
    planes = suitable_planes(lf)
    return planes["disparities"] if "disparities" in planes else lf.disparity(planes["alphas"])
