"""m of a single bright point, from where its spots lie under the lenslets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clplen.lightfield.focused.focused_geometry import (
    FocusedGeometry,
    Pair,
    Values,
    require_finite,
    z_of_m,
)
from clplen.lightfield.raw.raw_image import RawImage

_FEWEST = 3  # spots
_ROUNDS = 6
_WINDOW = 0.3  # pitches about a spot's centroid
_SCATTER = 3.2  # of the line's own deviation: diffraction moves all spots of a point alike
_AGREE = 1.5  # pixels off the law that are no reason to leave a spot out


@dataclass(frozen=True)
class SpotFit:
    """A point as `point_m` finds it.

    Attributes
    ----------
    m : float
        b/a.
    z : float
        dz in metres from the focused plane; NaN without a camera.
    position : tuple of float
        (y, x) in pixels of the sensor where the point's chief ray meets it.
    spots : int
        How many were used.
    residual : float
        rms distance in pixels of the spots from the law.
    uncertainty : float
        One standard deviation of m: by the scatter of the spots about the law, 3.2 times what it
        would be if they were independent, measured with four wave-optical cameras.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=21, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.2
    ... )
    >>> fit = clplen.lightfield.point_m(camera.expose(clplen.PointSources((0, 0, 0)), model="rays"))
    >>> f"{fit.m:.1f}", fit.spots > 3
    ('0.2', True)
    """

    m: float
    z: float
    position: Pair
    spots: int
    residual: float
    uncertainty: float = math.nan


def point_m(raw: RawImage, *, least: float = 0.25) -> SpotFit:
    """Find m of the only point in a raw image, by the pitch of its spots.

    The centroid of I^2 in every sub-image, and then within 0.3 pitches of itself, gives r_k. The
    ratio and Y of r_k = s_k + ratio (s_k - Y) follow by least squares, weighted by the squares of
    the sums of I^2. Left out, in turns, are spots that lie off the law because another lenslet's
    spot falls into their sub-image.

    Diffraction limits it: the rings at the rim of the blur turn the wave under the lenslets there,
    and the rim crosses some of them. Of a lenslet that is lit by a share s the sum of I^2 is s^3
    of the others'; those lit by less than 0.63 are left out, and the weights do the rest.

    Parameters
    ----------
    raw : RawImage
        Of a focused camera, one point, dark elsewhere.
    least : float
        Of the brightest spot's sum of I^2: weaker ones do not count.

    Returns
    -------
    SpotFit
        The m that fits, and how well.

    Raises
    ------
    ValueError
        If fewer than three lenslets see the point, or the raw image holds NaN or infinity.
    ShapeError
        If fewer than two by two lenslets lie on the sensor.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=21, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.2
    ... )
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)), model="rays")
    >>> f"{clplen.lightfield.point_m(raw).m:.1f}"
    '0.2'
    """
    geometry = FocusedGeometry.of(raw)
    require_finite(raw, "looking for the point")
    strength, offset = _spots(raw, geometry)
    centres, weight = geometry.centres.reshape(-1, 2), strength**2
    use = strength > least * strength.max()
    for _ in range(_ROUNDS):
        ratio, position, error = _line(centres[use], offset[use], weight[use])
        far = np.hypot(*(offset - ratio * (centres - position)).T)
        agreeing = use & (far < max(_AGREE, 3 * float(np.median(far[use]))))
        if agreeing.sum() == use.sum():
            break
        use = agreeing
    residual = float(np.sqrt(np.average(far[use] ** 2, weights=weight[use])))
    m = float(geometry.m(ratio))
    at = (float(position[0]), float(position[1]))
    ends = [float(geometry.m(ratio + side * error)) for side in (-1, 1)]
    deviation = _SCATTER * abs(ends[1] - ends[0]) / 2
    return SpotFit(m, float(z_of_m(raw, m)), at, int(use.sum()), residual, deviation)


def _line(centres: Values, offset: Values, weight: Values) -> tuple[float, Values, float]:
    """Ratio and Y of offset = ratio (centre - Y), and the standard error of the ratio.

    That of White 1980 ("A heteroskedasticity-consistent covariance matrix estimator", eq. 6), times
    sqrt(n/(n - 2)) for n spots.
    """
    if len(centres) < _FEWEST:
        raise ValueError(
            f"{len(centres)} lenslets see the point, fewer than {_FEWEST}: its m is not "
            "known, too few views (abs(m) is large or the point dark)."
        )
    middle, at = (np.average(v, axis=0, weights=weight) for v in (centres, offset))
    way = centres - middle
    spread = weight @ (way**2).sum(1)
    ratio = float((weight[:, None] * way * (offset - at)).sum() / spread)
    left = (weight[:, None] * way * (offset - at - ratio * way)).sum(1)
    few = len(centres) / (len(centres) - _FEWEST + 1)
    error = float(np.sqrt(few * (left**2).sum()) / spread)
    return ratio, middle - at / ratio, error


def _spots(raw: RawImage, geometry: FocusedGeometry) -> tuple[Values, Values]:
    """Sum of I^2 of each spot over the largest, and its centroid (y, x) from the sub-image's."""
    device, count = raw.device, geometry.kinds.size
    defines = {"CHANNELS": 3} if len(raw.data.shape) == 3 else {}
    kernel = device.kernel("focused_depth.cl", "spots", **defines)
    tables = geometry.tables(device)
    out = device.empty((count, 3), np.float32)
    centroid = np.zeros((count, 2))
    for radius in (1.0, *(_WINDOW,) * _ROUNDS):
        device.launch(
            kernel,
            (count,),
            *(out, raw.data, *tables, device.upload(centroid.astype(np.float32))),
            *(np.int32(n) for n in (count, *geometry.shape)),
            *(np.float32(n * geometry.pitch) for n in (0.5, radius)),
        )
        sums = device.download(out).astype(np.float64)
        centroid = np.divide(
            sums[:, 1:], sums[:, :1], out=np.zeros((count, 2)), where=sums[:, :1] > 0
        )
    return sums[:, 0] / max(sums[:, 0].max(), np.finfo(np.float64).tiny), centroid
