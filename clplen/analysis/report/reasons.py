"""Causes of a camera's numbers, stated only where the cause alone predicts such a number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

from clplen.analysis.cameras.comparison import Measured
from clplen.analysis.cameras.imaging import is_focused
from clplen.cameras.description import aberration_rows
from clplen.cameras.optics.camera_aberrations import NONE
from clplen.cameras.standard_camera import focus_range

MAX_RATIO = 1.5  # largest ratio of predicted and measured number that a cause explains


@dataclass(frozen=True)
class Blur:
    """Blur of a point on the main lens' image, with the resolution that it alone allows."""

    name: str
    width: float  # lam a/d of an aperture, the side of a pixel or lenslet, in metres
    # mtf50, limit, radius, peak: MTF50 times ``width``; separation with mid/peak 8/pi^2 and radius
    # of 80 % of the light, over ``width``; peak for an energy of 1, times ``width``^2
    mtf50: float
    limit: float
    radius: float
    peak: float


_BOX = (0.603, 1.0, 0.51, 1.0)  # uniform square
_SQUARE = (0.5, 1.0, 0.88, 1.0)  # sinc^2 along both axes
_ROUND = (0.404, 1.16, 0.9, math.pi / 4)  # Airy's pattern


def spatial_samples(measured: Measured) -> str:
    """Describe the origin of the number of spatial samples along x."""
    c: Any = measured.camera
    if is_focused(c):
        return f"abs(m) = {abs(c.m):.3g} of {c.grid.shape[1]} pixels a row"
    return f"one a lenslet, {measured.sampling.views:.3g} pixels each"


def views(measured: Measured) -> str:
    """Describe the origin of the number of independent directions."""
    s = measured.sampling
    if is_focused(cast(Any, measured.camera)):
        step = s.angular_step * 1e3
        return f"light of a point meets D abs(a)/(F p) lenslets a row, {step:.3g} mrad apart"
    if s.independent_views < s.views:
        mla: Any = measured.camera.mla
        return (
            f"{s.views:.3g} pixels a lenslet, blurred by its diffraction to d^2/(lam f_mu), d = "
            f"{mla.diameter * 1e6:.4g} um, f_mu = {mla.focal_length * 1e3:.3g} mm"
        )
    return f"one a pixel of a lenslet, {s.angular_step * 1e3:.3g} mrad apart"


def frequency(measured: Measured) -> str:
    """Describe the limit of the usable MTF50."""
    mtf50, nyquist, blur = measured.mtf().at(0.5), measured.sampling.nyquist, _widest(measured)
    if not mtf50 < nyquist:
        return f"limited by its samples, {measured.sampling.spatial_pitch * 1e6:.4g} um apart"
    return _limited(measured, blur.mtf50 / blur.width / mtf50)


def limit(measured: Measured) -> str:
    """Describe the limit of the usable two-point separation."""
    separation, blur = measured.two_point_limit(), _widest(measured)
    if 2 * measured.sampling.spatial_pitch > separation:
        return f"two samples; its blur alone would allow {separation * 1e6:.4g} um"
    return _limited(measured, separation / (blur.limit * blur.width))


def peak(measured: Measured) -> str:
    """Describe the limit of the Strehl ratio, compared by widths (roots of areas)."""
    c, blur = measured.camera, _widest(measured)
    reference_peak = math.pi / 4 * (c.aperture_diameter / (c.wavelength * c.image_distance)) ** 2
    return _limited(
        measured, math.sqrt(blur.peak / blur.width**2 / reference_peak / measured.strehl())
    )


def radius(measured: Measured) -> str:
    """Describe the limit of the radius of 80 % of the light."""
    blur = _widest(measured)
    return _limited(measured, measured.radius(0.8) / (blur.radius * blur.width))


def crosstalk(measured: Measured) -> str:
    """Describe the cause of crosstalk: shared pixels, tails of a lenslet, or aberrations.

    Beyond X lam b/d on either side, sinc^2 has the share 1/(pi^2 X), averaged over its zeros. A
    cell ends at X = N/2, N = d^2/(lam b); both axes together give tails of 4/(pi^2 N).
    """
    assert measured.crosstalk is not None
    c: Any = measured.camera
    pixels = c.pixels_per_lenslet
    if not is_focused(c) and not math.isclose(pixels, round(pixels), rel_tol=1e-6):
        return (
            f"includes the light of pixels on two cells, at {pixels:.4g} pixels a lenslet; compare "
            f"whole numbers of pixels{_with_aberrations(measured)}"
        )
    number = c.mla.diameter**2 / (c.wavelength * c.sensor_distance)
    tails = 4 / (math.pi**2 * number)
    if _explains(measured.crosstalk / tails):
        return (
            f"the tails of a lenslet's diffraction, {100 * tails:.2g} % at a Fresnel number "
            f"d^2/(lam b) of {number:.3g}{_with_aberrations(measured)}"
        )
    return _worse(measured, measured.crosstalk / tails)


def depth(measured: Measured) -> str:
    """Describe the cue that measures depth."""
    c: Any = measured.camera
    if is_focused(c):
        side = "before" if c.a > 0 else "behind"
        return (
            f"measured by the pitch of spots, {measured.sampling.views:.2g} in a row at dz = 0, "
            f"the image {abs(c.a) * 1e3:.3g} mm {side} the array{_with_aberrations(measured)}"
        )
    return (
        f"measured by blur over {c.aperture_diameter * 1e3:.3g} mm of the main lens, in focus "
        f"within p/D = {c.mla.pitch / c.aperture_diameter:.2g} of F/F', "
        f"{focus_range(c)}{_with_aberrations(measured)}"
    )


def depth_range(measured: Measured) -> str:
    """List the depths that could not be measured, with the reason."""
    assert measured.depth is not None
    failed = [k for k, note in enumerate(measured.depth.notes) if note]
    if not failed:
        return ""
    depths = ", ".join(f"{measured.depth.dz[k] * 1e3:g}" for k in failed)
    first = measured.depth.notes[failed[0]]
    is_common = all(measured.depth.notes[k] == first for k in failed)
    return f"not at dz = {depths} mm ({'' if is_common else 'at the first: '}{first.rstrip('.')})"


def _widest(measured: Measured) -> Blur:
    """Return the widest blur without aberrations: main lens, lenslet or sample."""
    c: Any = measured.camera
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


def _limited(measured: Measured, ratio: float) -> str:
    """Name the widest blur if it explains the number, else aberrations or nothing."""
    if not _explains(ratio):
        return _worse(measured, ratio)
    blur = _widest(measured)
    width = f"{blur.width * 1e6:.4g} um on the main image"
    return f"limited by {blur.name}, {width}{_with_aberrations(measured)}"


def _explains(ratio: float) -> bool:
    return 1 / MAX_RATIO < ratio < MAX_RATIO


def _worse(measured: Measured, ratio: float) -> str:
    """Name the aberrations if the number is worse than without them."""
    cause = _aberrations(measured)
    return (
        f"worse than diffraction and samples alone make it; {cause}" if cause and ratio > 1 else ""
    )


def _with_aberrations(measured: Measured) -> str:
    cause = _aberrations(measured)
    return f"; in addition {cause}" if cause else ""


def _aberrations(measured: Measured) -> str:
    """List the aberrations of a camera, or return an empty string."""
    c = measured.camera
    if c.aberrations == NONE:
        return ""
    rows = aberration_rows(c.aberrations, c.wavelength)
    scales = {"m": (1e6, "um"), "rad": (1e3, "mrad"), "": (1.0, "")}
    texts = []
    for row in rows:
        factor, unit = scales[row.unit]
        texts.append(f"{row.name} {row.value * factor:.3g} {unit}".rstrip())
    return f"aberrations: {', '.join(texts)}"
