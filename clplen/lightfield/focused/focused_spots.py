"""Magnification m of a single bright point, from the spots behind the lenslets."""

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

_MIN_SPOTS = 3  # spots of a fit
_ROUNDS = 6  # iterations
_WINDOW = 0.3  # pitches around a spot's centroid
_SCATTER = 3.2  # times the line's own deviation: diffraction moves all spots of a point alike
_MIN_DISTANCE = 1.5  # pixels: smaller residuals never exclude a spot


@dataclass(frozen=True)
class SpotFit:
    """Fit of a single point, the result of `point_m`.

    Attributes
    ----------
    m : float
        Ratio b/a.
    z : float
        Distance dz in metres from the focused plane; NaN without a camera.
    position : tuple of float
        Position (y, x) in pixels of the point's chief ray on the sensor.
    spots : int
        Number of spots in the fit.
    residual : float
        Root mean square distance in pixels of the spots from the law.
    uncertainty : float
        Standard deviation of m from the scatter of the spots about the law: 3.2 times the value
        for independent spots, measured with four wave-optical cameras.

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


def point_m(raw: RawImage, *, min_strength: float = 0.25) -> SpotFit:
    """Estimate m of a single point from the pitch of its spots in a raw image.

    The centroid of I^2 in every sub-image, and then within 0.3 pitches of itself, gives r_k. Least
    squares, weighted by the squared sums of I^2, gives the ratio and Y of
    r_k = s_k + ratio (s_k - Y). Spots off the law are excluded in turn; light of another lenslet
    falls into their sub-images.

    Diffraction limits the accuracy: rings at the rim of the blur tilt the wave behind the lenslets,
    and the rim crosses some of them. A lenslet that is lit by a share s has s^3 of the full sum of
    I^2. Lenslets lit by less than 0.63 are excluded; the weights reduce the influence of others.

    Parameters
    ----------
    raw : RawImage
        Raw image of a focused camera with one point, dark elsewhere.
    min_strength : float
        Minimum sum of I^2 of a spot, relative to the brightest.

    Returns
    -------
    SpotFit
        The fitted m with its quality.

    Raises
    ------
    ValueError
        If fewer than three lenslets see the point, or the raw image includes NaN or infinity.
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
    require_finite(raw, "locating the point")
    strength, offset = _spots(raw, geometry)
    centres, weight = geometry.centres.reshape(-1, 2), strength**2
    use = strength > min_strength * strength.max()
    for _ in range(_ROUNDS):
        ratio, position, error = _line(centres[use], offset[use], weight[use])
        distance = np.hypot(*(offset - ratio * (centres - position)).T)
        agreeing = use & (distance < max(_MIN_DISTANCE, 3 * float(np.median(distance[use]))))
        if agreeing.sum() == use.sum():
            break
        use = agreeing
    residual = float(np.sqrt(np.average(distance[use] ** 2, weights=weight[use])))
    m = float(geometry.m(ratio))
    sensor_position = (float(position[0]), float(position[1]))
    ends = [float(geometry.m(ratio + side * error)) for side in (-1, 1)]
    deviation = _SCATTER * abs(ends[1] - ends[0]) / 2
    return SpotFit(m, float(z_of_m(raw, m)), sensor_position, int(use.sum()), residual, deviation)


def _line(centres: Values, offset: Values, weight: Values) -> tuple[float, Values, float]:
    """Fit offset = ratio (centre - Y); return ratio, Y and the ratio's standard error.

    The error follows White 1980 (Econometrica 48, 817, eq. 6), times sqrt(n/(n - 2)).
    """
    if len(centres) < _MIN_SPOTS:
        raise ValueError(
            f"At least {_MIN_SPOTS} lenslets must see the point to estimate m, got {len(centres)}; "
            "abs(m) is too large or the point too dark."
        )
    middle, offset_mean = (np.average(v, axis=0, weights=weight) for v in (centres, offset))
    deviations = centres - middle
    spread = weight @ (deviations**2).sum(1)
    ratio = float((weight[:, None] * deviations * (offset - offset_mean)).sum() / spread)
    scores = (weight[:, None] * deviations * (offset - offset_mean - ratio * deviations)).sum(1)
    correction = len(centres) / (len(centres) - _MIN_SPOTS + 1)
    error = float(np.sqrt(correction * (scores**2).sum()) / spread)
    return ratio, middle - offset_mean / ratio, error


def _spots(raw: RawImage, geometry: FocusedGeometry) -> tuple[Values, Values]:
    """Return each spot's sum of I^2 over the largest, and its centroid (y, x) in the sub-image."""
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
