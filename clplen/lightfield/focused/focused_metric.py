"""From the magnification of the lenslets to distances, where the camera is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from clplen.lightfield.focused.focused_geometry import Values
    from clplen.lightfield.raw.raw_image import RawImage


def alpha_of(raw: RawImage, m: Any) -> Values:
    """alpha = F/F' of what the lenslets see with m = z3/(z2 - F').

    z2 is the distance from the main lens to the array, z3 that from there to the sensor, where this
    has moved too.

    Parameters
    ----------
    raw : RawImage
        Whose camera has ``image_distance`` (F), ``array_distance`` (z2) and ``sensor_distance``
        (z3) in metres.
    m : array_like

    Returns
    -------
    numpy.ndarray
        float64; NaN without a camera, where m is 0 or NaN, or F' <= 0.
    """
    m = np.asarray(m, np.float64)
    camera: Any = raw.camera
    if camera is None:
        return np.full(m.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        image = camera.array_distance - camera.sensor_distance / m
        return np.where(image > 0, camera.image_distance / image, np.nan)


def z_of(raw: RawImage, m: Any) -> Values:
    """dz of the object in metres, farther than the focused plane positive, as in `PointSources`.

    Returns
    -------
    numpy.ndarray
        float64; NaN where `alpha_of` is.
    """
    alpha = alpha_of(raw, m)
    if raw.camera is None:
        return alpha
    known = np.isfinite(alpha)
    z = np.asarray(raw.camera.dz(np.where(known, alpha, 1.0)), np.float64)
    return np.where(known, z, np.nan)
