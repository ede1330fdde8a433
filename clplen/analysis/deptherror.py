"""How far the depth that a plenoptic camera measures of a point is from where the point is."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.analysis.placing import is_focused, middle_lenslet
from clplen.analysis.rendered import local_m
from clplen.analysis.samples import Values
from clplen.cameras.optics.ray_optics import view_step
from clplen.errors import SamplingWarning
from clplen.lightfield.depth.alpha_estimate import estimate_alpha, search_limit
from clplen.lightfield.focused.focused_spots import point_m
from clplen.lightfield.model.light_field import LightField

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic
    from clplen.lightfield.raw.raw_image import RawImage

TOO_LARGE = 0.5  # abs(m) from which fewer than two by two lenslets see a point
SEARCH = 1.25  # how much farther than the depths asked for a 1.0 camera's search goes
LEAST_SEARCH = 0.3  # pixels a view step
WIDEST = 0.95  # of the largest search that the light field allows


@dataclass(frozen=True, eq=False)
class DepthErrors:
    """Measured minus true depth of points.

    Attributes
    ----------
    dz : numpy.ndarray
        True depths in metres from the focused plane, farther positive, float64, shape (n,).
    errors : numpy.ndarray
        float64, shape (n, k): metres, k places below a lenslet; NaN where nothing was measured.
    notes : tuple of str
        Why not; empty where it was.
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


def depth_of(raw: RawImage, *, c_max: float = LEAST_SEARCH) -> float:
    """dz in metres of the point in a raw image, which lies by the middle lenslet.

    1.0: `estimate_alpha`, method "compensated". 2.0: `point_m`, by the pitch of its spots.

    Parameters
    ----------
    raw : RawImage
        With its camera, dark but for the point.
    c_max : float
        Search of `estimate_alpha`, in pixels a view step; where that is more than the light field
        allows (`search_limit`), all that it allows.

    Raises
    ------
    ValueError
        If it cannot be measured: no peak inside the search, or a place where no object can be.
    """
    if is_focused(raw.camera):
        return _of_object(point_m(raw).z)
    camera: Any = raw.camera
    row, column = middle_lenslet(camera)
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
    if not math.isfinite(z):
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


def search_of(camera: Plenoptic | Any, depths: Values) -> float:
    """c_max of `estimate_alpha` that holds all of these depths, in pixels a view step."""
    if is_focused(camera):
        return LEAST_SEARCH
    farthest = float(np.abs(1 - camera.alpha(depths)).max())
    return max(LEAST_SEARCH, SEARCH * view_step(camera) / camera.mla.pitch * farthest)
