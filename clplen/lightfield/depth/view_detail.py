"""Detail of views, which brightness that differs from view to view leaves alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter, maximum_filter, minimum_filter

from clplen.lightfield.arrays.smoothing import gaussian_taps
from clplen.lightfield.model.light_field import LightField

Map = np.ndarray[Any, np.dtype[np.float32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

_SIGMA = 2.0  # pixels: what a wider Gaussian leaves is detail
STEPS = 64  # of a level: detail is kept as uint16, up to 512 levels either way
_MIDDLE = 2**15
_OUTLINE = 0.25  # pixels a view step: disparities that differ more within
_WINDOW = 13  # so many pixels along both axes have an outline between them
_INSIDE = 0.1  # pixels a view step by which a disparity may leave that span
_EVENED = 3.0  # pixels: Gaussian over which costs are compared
# Where costs of the samples are above those of their detail by this factor and these levels a
# channel, brightness differs between the views: anywhere, and beside outlines.
_UNEVEN, _UNEVEN_AT_OUTLINES = (1.1, 0.1), (1.3, 0.4)
REACH = gaussian_taps(_SIGMA).size - 1 + max(_WINDOW // 2, gaussian_taps(_EVENED).size - 1)


def view_detail(lf: LightField, gains: Map) -> LightField:
    """Each view less its own Gaussian of 2 pixels, in 64ths of a level, from 2^15 on.

    Brightness that differs from view to view, smoothly over the picture, is gone; so is what tells
    the two sides of an outline apart, which is why samples are compared as well (`is_even`).

    Parameters
    ----------
    lf : LightField
    gains : numpy.ndarray
        Levels a unit of the samples of each view, shape (V, U).

    Returns
    -------
    LightField
        uint16, which kernels read faster than float16.
    """
    device = lf.device
    taps = gaussian_taps(_SIGMA)
    window = np.concatenate((taps[:0:-1], taps))
    out = device.empty(lf.data.shape, np.uint16)
    for v, u in np.ndindex(*lf.shape[:2]):
        view = device.download(lf.data[v, u]).astype(np.float32)
        around = correlate1d(view, window, 0, mode="nearest")
        around = correlate1d(around, window, 1, mode="nearest")
        detail = np.rint((view - around) * np.float32(STEPS * gains[v, u])) + _MIDDLE
        out[v, u].set(np.clip(detail, 0, 2 * _MIDDLE - 1).astype(np.uint16), queue=device.queue)
    return replace(lf, data=out, raw=None)


def is_even(costs: tuple[Map, Map], disparities: tuple[Map, Map], channels: int) -> Mask:
    """Where the samples themselves are to be believed, of what samples and their detail say.

    Where brightness is the same in all views, samples agree as well as their detail, and they alone
    keep outlines sharp. Beside an outline detail mixes both sides; there samples are believed if
    their disparity lies between those that detail finds around, and costs are not much higher.

    Parameters
    ----------
    costs : tuple of numpy.ndarray
        Least cost of samples and of detail in levels, shape (y, x).
    disparities : tuple of numpy.ndarray
        Of samples and of detail.
    channels : int
    """
    ours, detail = (gaussian_filter(cost, _EVENED, mode="nearest") for cost in costs)
    factor, more = _UNEVEN
    even = ours < factor * detail + more * channels
    high = maximum_filter(disparities[1], _WINDOW, mode="nearest")
    low = minimum_filter(disparities[1], _WINDOW, mode="nearest")
    beside = (high - low > _OUTLINE) & (disparities[0] > low - _INSIDE)
    beside &= disparities[0] < high + _INSIDE
    factor, more = _UNEVEN_AT_OUTLINES
    return np.asarray(even | (beside & (ours < factor * detail + more * channels)))
