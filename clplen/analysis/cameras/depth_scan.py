"""Contrast and depth error of points at several depths through one camera."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import DepthTransfer, Done, check_places, transfer_of
from clplen.analysis.cameras.imaging import (
    central_lenslet,
    is_focused,
    local_m,
    point_at_lenslet,
    sample_offsets,
)
from clplen.analysis.point.otf import Curve
from clplen.analysis.point.samples import Values
from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.optics.ray_optics import view_step
from clplen.checks import fits_float64, real_array
from clplen.errors import SamplingError, SamplingWarning
from clplen.lightfield.depth.alpha_estimate import estimate_alpha, search_limit
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.raw.raw_image import RawImage
from clplen.reprs import OneLine

TOO_LARGE = 0.5  # abs(m) from which fewer than two by two lenslets see a point
SEARCH = 1.25  # how much farther than the depths asked for a 1.0 camera's search goes
LEAST_SEARCH = 0.3  # pixels a view step
WIDEST = 0.95  # of the largest search that the light field allows


@dataclass(frozen=True, eq=False, repr=False)
class DepthErrors(OneLine):
    """Measured minus true depth of points.

    Attributes
    ----------
    dz : numpy.ndarray
        True depths in metres from the focused plane, farther positive, float64, shape (n,).
    errors : numpy.ndarray
        float64, shape (n, k): metres, k places below a lenslet; NaN where nothing was measured.
    notes : tuple of str
        Why not; empty where it was.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> _, errors = clplen.analysis.depth_scan(camera, [5e-3], places=1, transfer=False)
    >>> errors.errors.shape, f"{errors.rms[0] * 1e3:.1f} mm"
    ((1, 1), '0.7 mm')
    """

    dz: Values
    errors: Values
    notes: tuple[str, ...]

    @property
    def rms(self) -> Values:
        """Root mean square over the places, shape (n,); NaN where one of them failed."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    @property
    def mean(self) -> Values:
        """Mean over the places, shape (n,)."""
        return np.asarray(np.mean(self.errors, axis=1))


def measured_depth(raw: RawImage, *, c_max: float = LEAST_SEARCH) -> float:
    """dz in metres of the point in a raw image, which lies by the middle lenslet.

    1.0: `estimate_alpha`, method "compensated". 2.0: `point_m`, by the pitch of its spots.
    """
    if is_focused(raw.camera):
        return _of_object(point_m(raw).z)
    camera: Any = raw.camera
    row, column = central_lenslet(camera)
    lf = LightField.from_raw(raw)
    search = min(c_max, WIDEST * search_limit(lf))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # said below
        found = estimate_alpha(lf, at=(row, column), c_max=search)
    if math.isnan(found.uncertainty):
        raise ValueError(
            f"sharpest at the end of the search, {search:.3g} pixels a view step from the focused "
            "plane"
        )
    return _of_object(found.z)


def _of_object(z: float) -> float:
    if not fits_float64(z):
        raise ValueError("measured at a place where no object can be")
    return z


def too_few_views(camera: Plenoptic | Any, dz: float) -> str:
    """Why a focused camera cannot tell depth at dz: a sentence, or nothing where it can."""
    if not is_focused(camera):
        return ""
    m = abs(local_m(camera, dz))
    if m < TOO_LARGE:
        return ""
    return f"too few views: at m = {m:.3g} a point is seen by {1 / m:.2g} lenslets a row"


def search_range(camera: Plenoptic | Any, depths: Values) -> float:
    """c_max of `estimate_alpha` that holds all of these depths, in pixels a view step."""
    if is_focused(camera):
        return LEAST_SEARCH
    farthest = float(np.abs(1 - camera.alpha(depths)).max())
    return max(LEAST_SEARCH, SEARCH * view_step(camera) / camera.mla.pitch * farthest)


PLACES = 3
_SHARES = (-0.15, -0.05, -0.02, 0.0, 0.02, 0.05, 0.15)  # of the object distance


def default_depths(camera: Plenoptic, *, quick: bool = False) -> Values:
    """dz in metres, from -15 to 15 % of the object distance; quick: the outer two and 0."""
    shares = _SHARES[::3] if quick else _SHARES
    return np.array(shares) * camera.object_distance


def depth_scan(
    camera: Plenoptic,
    depths: Sequence[float] | Values,
    *,
    places: int = PLACES,
    transfer: bool = True,
    errors: bool = True,
    done: Done | None = None,
) -> tuple[DepthTransfer | None, DepthErrors | None]:
    """Measure over depth the contrast of refocused pictures, and the errors of measured depth.

    Each depth takes ``places`` exposures of one point, moved along x below the middle lenslet.
    Where a camera cannot picture or measure a depth the result is NaN and says why.

    Parameters
    ----------
    camera : Plenoptic
        `PlenopticCamera.type1` or `type2`, with its device.
    depths : array_like
        Values of dz in metres, shape (n,), from the focused plane, farther positive.
    places : int
        Number of places below the lenslet; odd and positive.
    transfer, errors : bool
        Which of the two are wanted; the other is None.
    done : callable, optional
        Called as ``done(1)`` for each exposure.

    Returns
    -------
    tuple
        `DepthTransfer` or None, `DepthErrors` or None.

    Raises
    ------
    ValueError
        If there is no depth, one is not finite or lies behind the main lens, or ``places`` is not
        odd and positive.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> transfer, errors = clplen.analysis.depth_scan(camera, [5e-3])
    >>> f"MTF50 {transfer.mtf50[0] / 1e3:.0f} cycles/mm, rms error {errors.rms[0] * 1e3:.1f} mm"
    'MTF50 4 cycles/mm, rms error 0.4 mm'
    """
    dz = _checked(camera, depths)
    check_places(places)
    c_max = search_range(camera, dz)
    curves: list[Curve | None] = []
    measured = np.full((len(dz), places), np.nan)
    notes: list[tuple[str, str]] = []
    for k, one in enumerate(dz):
        raws, why = _exposed(camera, float(one), places, done or (lambda _: None))
        curve, no_curve = _curve(raws, float(one)) if raws and transfer else (None, why)
        no_depth = why or too_few_views(camera, float(one))
        if errors and not no_depth:
            measured[k], no_depth = _depths(raws, c_max)
        curves.append(curve)
        notes.append((no_curve, no_depth))
    contrast = DepthTransfer(dz, tuple(curves), tuple(note for note, _ in notes))
    wrong = DepthErrors(dz, measured - dz[:, None], tuple(note for _, note in notes))
    return contrast if transfer else None, wrong if errors else None


def _checked(camera: Plenoptic, depths: Sequence[float] | Values) -> Values:
    dz = real_array(depths, "depths", np.float64)
    if dz.ndim != 1 or dz.size == 0 or not np.isfinite(dz).all():
        raise ValueError(f"depths are finite numbers of metres, at least one, not {depths!r}.")
    camera.alpha(dz)  # refuses what lies behind the lens
    return dz


def _exposed(camera: Plenoptic, dz: float, places: int, done: Done) -> tuple[list[RawImage], str]:
    """Raw images of the point at all places, or why there are none."""
    raws = []
    for n, right in enumerate(sample_offsets(camera.mla.pitch, places)):
        try:
            raws.append(camera.expose(point_at_lenslet(camera, (0.0, float(right)), dz)))
        except SamplingError as error:
            done(places - n)
            return [], str(error)
        done(1)
    return raws, ""


def _curve(raws: list[RawImage], dz: float) -> tuple[Curve | None, str]:
    try:
        return transfer_of(raws, dz), ""
    except ValueError as error:
        return None, str(error)


def _depths(raws: list[RawImage], c_max: float) -> tuple[Values, str]:
    try:
        return np.array([measured_depth(raw, c_max=c_max) for raw in raws]), ""
    except ValueError as error:
        return np.full(len(raws), np.nan), str(error)
