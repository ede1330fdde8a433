"""Detail of views, which brightness that differs from view to view leaves alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

from clplen.lightfield.arrays.smoothing import gaussian_taps, launch_stretches, whole_taps
from clplen.lightfield.arrays.stored_samples import C_TYPE
from clplen.lightfield.model.light_field import LightField

Map = np.ndarray[Any, np.dtype[np.float32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

_SIGMA = 2.0  # pixels: what a wider Gaussian leaves is detail
STEPS = 64  # of a level: detail is kept as uint16, up to 512 levels either way
_OUTLINE = 0.25  # pixels a view step: disparities that differ more within
_WINDOW = 13  # so many pixels along both axes have an outline between them
_INSIDE = 0.1  # pixels a view step by which a disparity may leave that span
_ANY = 1e-3  # of a pixel near an outline: least weight
_EVENED = 3.0  # pixels: Gaussian over which costs are compared
# Where costs of the samples are above those of their detail by this factor and these levels a
# channel, brightness differs between the views: anywhere, and beside outlines.
_UNEVEN, _UNEVEN_AT_OUTLINES = (1.1, 0.1), (1.3, 0.4)
DETAIL_REACH = gaussian_taps(_SIGMA).size - 1  # pixels that detail needs,
OUTLINE_REACH = _WINDOW // 2 + gaussian_taps(_EVENED).size - 1  # and `is_even` of its maps


def view_detail(lf: LightField, gains: Map) -> LightField:
    """Each view less its own Gaussian of 2 pixels, in 64ths of a level, from 2^15 on.

    Brightness that differs from view to view, smoothly over the picture, is gone; so is what tells
    the two sides of an outline apart, which is why samples are compared as well (`is_even`).
    """
    device = lf.device
    V, U, ny, nx, channels = (*lf.shape, 1)[:5]
    taps = gaussian_taps(_SIGMA)
    radius = taps.size - 1
    out = device.empty(lf.data.shape, np.uint16)
    launch_stretches(
        device,
        ("view_detail.cl", "view_detail"),
        (V * U, ny, nx * channels),
        (
            out,
            lf.data,
            device.upload(whole_taps(taps, device)),
            device.upload((STEPS * gains).astype(np.float32)),
            *(np.int32(n) for n in (radius, ny, nx)),
        ),
        halos=(radius * channels,),
        channels=channels,
        SAMPLE=C_TYPE[lf.dtype],
        CHANNELS=channels,
    )
    return replace(lf, data=out, raw=None)


@dataclass(frozen=True)
class Surroundings:
    """What detail finds about each pixel, within 6 pixels."""

    low: Map  # low, high: The least and the largest disparity, float32, shape (y, x)
    high: Map
    # bool: where they differ by a quarter of a pixel and more, as beside an outline; and within 6
    # pixels of the edges, over which the Gaussian of each view reaches
    near: Mask

    @classmethod
    def of(cls, disparity: Map) -> Surroundings:
        """Those of a disparity map, shape (y, x)."""
        high = maximum_filter(disparity, _WINDOW, mode="nearest")
        low = minimum_filter(disparity, _WINDOW, mode="nearest")
        near = np.asarray(high - low > _OUTLINE)
        for rows in (near, near.T):
            rows[: _WINDOW // 2] = rows[max(len(rows) - _WINDOW // 2, 0) :] = True
        return cls(low, high, near)

    def between(self, disparity: Map) -> Mask:
        """Where a disparity lies between those around, or next to them."""
        return np.asarray((disparity > self.low - _INSIDE) & (disparity < self.high + _INSIDE))


def is_even(costs: tuple[Map, Map], disparity: Map, around: Surroundings, channels: int) -> Mask:
    """Where the samples themselves are to be believed, of what samples and their detail say.

    Detail is right where brightness differs from view to view, and mixes both sides of an outline.
    Near outlines samples are believed where brightness is the same in all views, so that samples
    agree as well as their detail; or nearly so well, if their disparity lies between those that
    detail finds around.
    """
    near = around.near
    weight = np.maximum(gaussian_filter(near.astype(np.float32), _EVENED, mode="nearest"), _ANY)
    ours, detail = (
        gaussian_filter(np.where(near, cost, np.float32(0)), _EVENED, mode="nearest") / weight
        for cost in costs
    )
    factor, more = _UNEVEN
    even = ours < factor * detail + more * channels
    factor, more = _UNEVEN_AT_OUTLINES
    nearly = ours < factor * detail + more * channels
    return np.asarray(near & (even | (nearly & around.between(disparity))))
