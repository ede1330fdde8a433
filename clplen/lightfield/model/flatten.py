"""All views into one picture: mean, median, largest, smallest, variance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.arrays import Image
from clplen.lightfield.arrays.ray_samples import along_rays, checked_disparity
from clplen.lightfield.arrays.shear import shear_sum
from clplen.lightfield.model.rendering import view_weights
from clplen.lightfield.model.view_shifts import shifts, unit_steps

if TYPE_CHECKING:
    from clplen.lightfield.model.light_field import LightField


def flatten(
    lf: LightField,
    statistic: str,
    *,
    disparity: Any,
    aperture: Any,
    viewpoint: Any,
    mask: Any,
    interpolation: str,
) -> Image:
    """See `LightField.flatten`."""
    weights = view_weights(lf, aperture, viewpoint)
    d = checked_disparity(disparity, (lf.shape[2], lf.shape[3]))
    if statistic == "mean" and d.ndim == 0 and mask is None and interpolation == "linear":
        picture = shear_sum(lf.data, weights, *shifts(lf, d.reshape(1)), device=lf.device)
        return Image(picture.reshape(lf.shape[2:]), lf.device)
    picture = along_rays(
        lf.data,
        statistic,
        device=lf.device,
        weights=weights,
        steps=unit_steps(lf),
        disparity=d,
        interpolation=interpolation,
        mask=None if mask is None else np.asarray(mask),
    )
    return Image(picture, lf.device)
