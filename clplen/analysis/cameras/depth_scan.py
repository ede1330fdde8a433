"""Contrast and depth error of points at several depths through one camera."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import DepthTransfer, Done, check_positions, transfer_of
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

MAX_M = 0.5  # abs(m) from which fewer than 2 x 2 lenslets image a point
SEARCH_MARGIN = 1.25  # search range over the range of the depths, for 1.0 cameras
MIN_SEARCH = 0.3  # search range in pixels a view step
MAX_SEARCH_RATIO = 0.95  # search range over the limit of the light field


@dataclass(frozen=True, eq=False, repr=False)
class DepthErrors(OneLine):
    """Measured minus true depth of points.

    Attributes
    ----------
    dz : numpy.ndarray
        True depths in metres from the focused plane, farther positive, float64, shape (n,).
    errors : numpy.ndarray
        Errors in metres at k positions below a lenslet, float64, shape (n, k); NaN where no depth
        was measured.
    notes : tuple of str
        Reasons for missing errors; empty where depth was measured.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> _, errors = clplen.analysis.depth_scan(camera, [5e-3], positions=1, transfer=False)
    >>> errors.errors.shape, f"{errors.rms[0] * 1e3:.1f} mm"
    ((1, 1), '0.7 mm')
    """

    dz: Values
    errors: Values
    notes: tuple[str, ...]

    @property
    def rms(self) -> Values:
        """Root mean square over the positions, shape (n,); NaN where a position failed."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    @property
    def mean(self) -> Values:
        """Mean over the positions, shape (n,)."""
        return np.asarray(np.mean(self.errors, axis=1))


def measured_depth(raw: RawImage, *, c_max: float = MIN_SEARCH) -> float:
    """Estimate dz in metres of a point by the middle lenslet, from its raw image.

    1.0: `estimate_alpha`, method "compensated". 2.0: `point_m`, by the pitch of its spots.
    """
    if is_focused(raw.camera):
        return _object_depth(point_m(raw).z)
    camera: Any = raw.camera
    row, column = central_lenslet(camera)
    lf = LightField.from_raw(raw)
    search_range = min(c_max, MAX_SEARCH_RATIO * search_limit(lf))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # reported below
        estimate = estimate_alpha(lf, at=(row, column), c_max=search_range)
    if math.isnan(estimate.uncertainty):
        raise ValueError(
            f"sharpest at the end of the search, {search_range:.3g} pixels a view step from the "
            "focused plane"
        )
    return _object_depth(estimate.z)


def _object_depth(z: float) -> float:
    if not fits_float64(z):
        raise ValueError("measured depth is outside the object space")
    return z


def too_few_views(camera: Plenoptic | Any, dz: float) -> str:
    """Return the reason why a focused camera cannot measure depth at dz, or an empty string."""
    if not is_focused(camera):
        return ""
    m = abs(local_m(camera, dz))
    if m < MAX_M:
        return ""
    return f"too few views: at m = {m:.3g} a point is seen by {1 / m:.2g} lenslets a row"


def search_range(camera: Plenoptic | Any, depths: Values) -> float:
    """Return ``c_max`` of `estimate_alpha` that covers these depths, in pixels a view step."""
    if is_focused(camera):
        return MIN_SEARCH
    farthest = float(np.abs(1 - camera.alpha(depths)).max())
    return max(MIN_SEARCH, SEARCH_MARGIN * view_step(camera) / camera.mla.pitch * farthest)


DEPTH_POSITIONS = 3  # positions of the point along x below a lenslet
_DEPTH_FRACTIONS = (-0.15, -0.05, -0.02, 0.0, 0.02, 0.05, 0.15)  # of the object distance


def default_depths(camera: Plenoptic, *, quick: bool = False) -> Values:
    """Return dz in metres, -15 to 15 % of the object distance; quick: both ends and 0."""
    shares = _DEPTH_FRACTIONS[::3] if quick else _DEPTH_FRACTIONS
    return np.array(shares) * camera.object_distance


def depth_scan(
    camera: Plenoptic,
    depths: Sequence[float] | Values,
    *,
    positions: int = DEPTH_POSITIONS,
    transfer: bool = True,
    errors: bool = True,
    done: Done | None = None,
) -> tuple[DepthTransfer | None, DepthErrors | None]:
    """Measure contrast of refocused pictures and error of measured depth over depth.

    Each depth takes ``positions`` exposures of a point that moves along x below the middle lenslet.
    A depth that cannot be imaged or measured gives NaN, with the reason in ``notes``.

    Parameters
    ----------
    camera : Plenoptic
        Camera from `PlenopticCamera.type1` or `type2`, with its device.
    depths : array_like
        Values of dz in metres, shape (n,), from the focused plane, farther positive.
    positions : int
        Number of positions below the lenslet; odd and positive.
    transfer, errors : bool
        Flags that select the results; the other result is None.
    done : callable, optional
        Function that is called as ``done(1)`` after each exposure.

    Returns
    -------
    tuple
        `DepthTransfer` or None, `DepthErrors` or None.

    Raises
    ------
    ValueError
        If ``depths`` is empty, a depth is not finite or behind the main lens, or ``positions`` is
        not odd and positive.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> transfer, errors = clplen.analysis.depth_scan(camera, [5e-3])
    >>> f"MTF50 {transfer.mtf50[0] / 1e3:.0f} cycles/mm, rms error {errors.rms[0] * 1e3:.1f} mm"
    'MTF50 4 cycles/mm, rms error 0.4 mm'
    """
    dz = _checked_depths(camera, depths)
    check_positions(positions)
    c_max = search_range(camera, dz)
    curves: list[Curve | None] = []
    measured = np.full((len(dz), positions), np.nan)
    notes: list[tuple[str, str]] = []
    for k, z in enumerate(dz):
        raws, failure = _exposures(camera, float(z), positions, done or (lambda _: None))
        curve, no_curve = _curve(raws, float(z)) if raws and transfer else (None, failure)
        no_depth = failure or too_few_views(camera, float(z))
        if errors and not no_depth:
            measured[k], no_depth = _depths(raws, c_max)
        curves.append(curve)
        notes.append((no_curve, no_depth))
    contrast = DepthTransfer(dz, tuple(curves), tuple(note for note, _ in notes))
    depth_errors = DepthErrors(dz, measured - dz[:, None], tuple(note for _, note in notes))
    return contrast if transfer else None, depth_errors if errors else None


def _checked_depths(camera: Plenoptic, depths: Sequence[float] | Values) -> Values:
    dz = real_array(depths, "depths", np.float64)
    if dz.ndim != 1 or dz.size == 0 or not np.isfinite(dz).all():
        raise ValueError(f"depths must be finite numbers, at least one, in m, got {depths!r}.")
    camera.alpha(dz)  # raises for depths behind the lens
    return dz


def _exposures(
    camera: Plenoptic, dz: float, positions: int, done: Done
) -> tuple[list[RawImage], str]:
    """Return raw images of a point at all positions, or an empty list and the reason."""
    raws = []
    for n, x in enumerate(sample_offsets(camera.mla.pitch, positions)):
        try:
            raws.append(camera.expose(point_at_lenslet(camera, (0.0, float(x)), dz)))
        except SamplingError as error:
            done(positions - n)
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
