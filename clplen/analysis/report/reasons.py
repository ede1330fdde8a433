"""Why a camera's numbers are what they are: said only where the reason makes such a number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

from clplen.analysis.cameras.comparison import Measured
from clplen.analysis.cameras.imaging import is_focused
from clplen.cameras.description import aberration_rows
from clplen.cameras.optics.camera_aberrations import NONE

EXPLAINS = 1.5  # ratio up to which what a reason alone would make is taken for what is measured


@dataclass(frozen=True)
class Blur:
    """What spreads a point on the main lens' image, and what it alone would leave."""

    name: str
    width: float  # lam a/d of an aperture, the side of a pixel or lenslet, in metres
    # mtf50, limit, radius, peak: MTF50 times ``width``; separation with mid/peak 8/pi^2 and radius
    # of 80 % of the light, over ``width``; peak for an energy of 1, times ``width``^2
    mtf50: float
    limit: float
    radius: float
    peak: float


_BOX = (0.603, 1.0, 0.51, 1.0)  # evenly over a square
_SQUARE = (0.5, 1.0, 0.88, 1.0)  # sinc^2 of both axes
_ROUND = (0.404, 1.16, 0.9, math.pi / 4)  # Airy's pattern


def places(one: Measured) -> str:
    """Of the places along x."""
    c: Any = one.camera
    if is_focused(c):
        return f"abs(m) = {abs(c.m):.3g} of {c.grid.shape[1]} pixels a row"
    return f"one a lenslet, {one.sampling.views:.3g} pixels each"


def views(one: Measured) -> str:
    """Of the independent directions."""
    s = one.sampling
    if is_focused(cast(Any, one.camera)):
        step = s.angular_step * 1e3
        return f"light of a point meets D abs(a)/(F p) lenslets a row, {step:.3g} mrad apart"
    if s.independent_views < s.views:
        mla: Any = one.camera.mla
        return (
            f"{s.views:.3g} pixels a lenslet, blurred by its diffraction to d^2/(lam f_mu), d = "
            f"{mla.diameter * 1e6:.4g} um, f_mu = {mla.focal_length * 1e3:.3g} mm"
        )
    return f"one a pixel of a lenslet, {s.angular_step * 1e3:.3g} mrad apart"


def frequency(one: Measured) -> str:
    """Of the usable MTF50."""
    mtf50, nyquist, blur = one.mtf().at(0.5), one.sampling.nyquist, _widest(one)
    if not mtf50 < nyquist:
        return f"limited by its samples, {one.sampling.spatial_pitch * 1e6:.4g} um apart"
    return _limited(one, blur.mtf50 / blur.width / mtf50)


def limit(one: Measured) -> str:
    """Of the usable two-point limit."""
    found, blur = one.two_point_limit(), _widest(one)
    if 2 * one.sampling.spatial_pitch > found:
        return f"two samples; its blur alone would allow {found * 1e6:.4g} um"
    return _limited(one, found / (blur.limit * blur.width))


def peak(one: Measured) -> str:
    """Of the Strehl ratio; by widths, the roots of areas."""
    c, blur = one.camera, _widest(one)
    alone = math.pi / 4 * (c.aperture_diameter / (c.wavelength * c.image_distance)) ** 2
    return _limited(one, math.sqrt(blur.peak / blur.width**2 / alone / one.strehl()))


def radius(one: Measured) -> str:
    """Of the radius of 80 % of the light."""
    blur = _widest(one)
    return _limited(one, one.radius(0.8) / (blur.radius * blur.width))


def crosstalk(one: Measured) -> str:
    """By the tails of a lenslet's pattern, 4/(pi^2 N) of the light with N = d^2/(lam b).

    Of sinc^2 the share 1/(pi^2 X) lies beyond X lam b/d to either side of the centre, in the mean
    over its zeros; a cell ends at X = N/2, along both axes.
    """
    assert one.crosstalk is not None
    c: Any = one.camera
    number = c.mla.diameter**2 / (c.wavelength * c.sensor_distance)
    tails = 4 / (math.pi**2 * number)
    if _explains(one.crosstalk / tails):
        return (
            f"the tails of a lenslet's diffraction, {100 * tails:.2g} % at a Fresnel number "
            f"d^2/(lam b) of {number:.3g}{_beside(one)}"
        )
    return _worse(one, one.crosstalk / tails)


def depth(one: Measured) -> str:
    """What depth is measured by."""
    c: Any = one.camera
    if is_focused(c):
        where = "before" if c.a > 0 else "behind"
        return (
            f"measured by the pitch of spots, {one.sampling.views:.2g} in a row at dz = 0, the "
            f"image {abs(c.a) * 1e3:.3g} mm {where} the array{_beside(one)}"
        )
    return (
        f"measured by blur over {c.aperture_diameter * 1e3:.3g} mm of the main lens, in focus "
        f"within p/D = {c.mla.pitch / c.aperture_diameter:.2g} of F/F'{_beside(one)}"
    )


def depth_range(one: Measured) -> str:
    """Where no depth is measured."""
    assert one.depth is not None
    failed = [k for k, note in enumerate(one.depth.notes) if note]
    if not failed:
        return ""
    where = ", ".join(f"{one.depth.dz[k] * 1e3:g}" for k in failed)
    first = one.depth.notes[failed[0]]
    same = all(one.depth.notes[k] == first for k in failed)
    return f"not at dz = {where} mm ({'' if same else 'at the first: '}{first.rstrip('.')})"


def _widest(one: Measured) -> Blur:
    """The widest of what spreads a point without aberrations: main lens, lenslet, sample."""
    c: Any = one.camera
    main = c.wavelength * c.image_distance / c.aperture_diameter
    blurs = [Blur("diffraction by the main lens", main, *_ROUND)]
    if is_focused(c):
        shape = _ROUND if c.mla.fill == "circular" else _SQUARE
        lenslet = c.wavelength * abs(c.a) / c.mla.diameter
        blurs.append(Blur("diffraction by a lenslet", lenslet, *shape))
        blurs.append(Blur("a pixel", c.pixel_pitch / abs(c.m), *_BOX))
    else:
        blurs.append(Blur("the width of a lenslet", c.mla.pitch, *_BOX))
    return max(blurs, key=lambda blur: blur.width)


def _limited(one: Measured, ratio: float) -> str:
    """By the widest blur where it alone makes such a number, else by aberrations, or not said."""
    if not _explains(ratio):
        return _worse(one, ratio)
    blur = _widest(one)
    return f"limited by {blur.name}, {blur.width * 1e6:.4g} um on the main image{_beside(one)}"


def _explains(ratio: float) -> bool:
    return 1 / EXPLAINS < ratio < EXPLAINS


def _worse(one: Measured, ratio: float) -> str:
    """Aberrations, where a number is worse than it would be without."""
    said = _aberrations(one)
    return f"worse than diffraction and samples alone make it; {said}" if said and ratio > 1 else ""


def _beside(one: Measured) -> str:
    said = _aberrations(one)
    return f"; beside it {said}" if said else ""


def _aberrations(one: Measured) -> str:
    """The aberrations of a camera in words, or nothing."""
    c = one.camera
    if c.aberrations == NONE:
        return ""
    found = aberration_rows(c.aberrations, c.wavelength)
    scales = {"m": (1e6, "um"), "rad": (1e3, "mrad"), "": (1.0, "")}
    words = []
    for row in found:
        factor, unit = scales[row.unit]
        words.append(f"{row.name} {row.value * factor:.3g} {unit}".rstrip())
    return f"aberrations: {', '.join(words)}"
