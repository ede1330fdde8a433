"""How sure a depth from focus is: the end of a search, and what the paraxial law leaves out."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from clplen.errors import SamplingWarning
from clplen.lightfield.depth.best_focus import high_na_words, ratio_at
from clplen.lightfield.model.alpha_law import depth_at
from clplen.lightfield.raw.raw_image import is_telecentric

if TYPE_CHECKING:
    from clplen.lightfield.arrays.spectral_sharpness import Peak
    from clplen.lightfield.model.light_field import LightField

WIDEST = 0.95  # of the largest search that a light field allows


def say_end(lf: LightField, peak: Peak, limit: float) -> None:
    """Warn where no peak was found, with what was searched and what would do."""
    if peak.inside:
        return
    end = abs(float(peak.positions[0]))
    z = np.abs(depth_at(lf, [-end, end]))
    metres = f", abs(z) up to {z.max():.3g} m" if np.isfinite(z).all() else ""
    wider = min(2 * end, WIDEST * limit)
    advice = (
        f"pass c_max={wider:.3g}"
        if wider > 1.01 * end
        else f"this window allows no more than {limit:.3g}, give a larger one"
    )
    warnings.warn(
        f"The window is sharpest at an end of the search, disparity {peak.position:.3g} of "
        f"{-end:.3g} to {end:.3g} pixels a view step{metres}, so that this is no depth: the object "
        f"lies farther from the focused plane; {advice}.",
        SamplingWarning,
        stacklevel=3,
    )


def beyond_paraxial(lf: LightField, alpha: float, disparity: float) -> float:
    """By how much abs(1 - alpha) is too large: 0, and of a telecentric camera what rays say."""
    if not is_telecentric(lf):
        return 0.0
    words = high_na_words(lf.camera, disparity)
    ratio = ratio_at(lf.camera, disparity)
    if words:
        z = float(depth_at(lf, disparity))
        warnings.warn(
            f"{words}: the object lies at about {z / ratio:.3g} m rather than at z = {z:.3g} m, "
            "which is that of the paraxial law.",
            SamplingWarning,
            stacklevel=4,
        )
    return (1 - 1 / ratio) * abs(1 - alpha)


def metres(lf: LightField, alpha: float, uncertainty: float) -> float:
    """An uncertainty of alpha as one of z."""
    if not 0 <= uncertainty < alpha:  # nor nan
        return math.nan
    ends = lf.disparity_of_shear([alpha - uncertainty, alpha + uncertainty])
    return float(np.ptp(depth_at(lf, ends))) / 2
