"""Disparity to distance, for cameras whose baseline is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def metric_depth(
    disparity: ArrayLike,
    *,
    baseline: float,
    focal_length: float,
    pixel_pitch: float,
    focus_distance: float | None = None,
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Distance of the points from the cameras, along the optical axis.

    Solves d = (b f/p) (1/Z - 1/Z0) for Z, the form of the HCI 4D light field benchmark (Honauer et
    al. 2016), whose p is the sensor's larger side over its pixels. For a lens with microlenses b is
    the distance between views on the main lens, f the distance from the lens to the image plane
    and p the pitch of the microlenses: then it is the lens law, 1/z = 1/z0 + d/(kappa F).

    Parameters
    ----------
    disparity : array_like
        d in pixels a view step, nearer larger.
    baseline : float
        b, distance between neighbouring cameras, in metres, positive.
    focal_length : float
        f, from lens to sensor, in metres, positive.
    pixel_pitch : float
        p in metres, positive.
    focus_distance : float, optional
        Z0, where d = 0, in metres, positive. None: infinity, as for rectified cameras with parallel
        axes.

    Returns
    -------
    numpy.ndarray
        Z in metres, float64, the shape of ``disparity``; inf where the disparity is that of
        infinity, NaN where it is lower still (behind infinity) or NaN.

    Raises
    ------
    ValueError
        If a length is not positive and finite.
    """
    lengths = {"baseline": baseline, "focal_length": focal_length, "pixel_pitch": pixel_pitch}
    if focus_distance is not None:
        lengths["focus_distance"] = focus_distance
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is a length in metres, positive and finite, not {value!r}.")
    at_focus = 0.0 if focus_distance is None else 1 / focus_distance
    inverse = np.asarray(disparity, np.float64) * pixel_pitch / (baseline * focal_length) + at_focus
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inverse >= 0, 1 / np.abs(inverse), np.nan)
