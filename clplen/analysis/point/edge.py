"""Transfer function of a picture from a slanted edge.

ISO 12233:2017, annex D: fit a straight line to the edge, bin all samples by their distance from it
in quarters of a sample, window the derivative of this edge spread function and transform it. Three
refinements go beyond the annex. Distances are measured along the edge's normal. The mean over a bin
compensates the uneven density of its samples. The result is corrected for this mean, not only for
the difference of bins. The window is Tukey's, flat over the middle half.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.point.otf import Curve
from clplen.analysis.point.samples import Pair, Values, checked
from clplen.errors import ShapeError
from clplen.reprs import OneLine
from clplen.wave.field.field import Grid

BINS = 4  # per sample (ISO 12233)
MIN_ANGLE, MAX_ANGLE = 1.5, 14.0  # degrees; from 14 on an edge shifts by 1/4 sample a line
_MIN_MARGIN = 8  # samples between the edge and the border of the picture
_PAD = 4  # length of the transform over that of the line spread function
_FIT_PASSES = 3
_MERGE_DISTANCE = 1 / 32  # samples; nearer ones are averaged
_MAX_GAP = 0.15  # largest gap between distances, in samples
_BIN_POINTS = 16  # interpolated points per bin


@dataclass(frozen=True, eq=False, repr=False)
class SlantedEdge(OneLine):
    """Transfer function and geometry of a slanted edge.

    Attributes
    ----------
    axis : int
        Axis that the edge crosses: 1 for an edge nearly along y, 0 for an edge along x.
    angle : float
        Angle in radians between the edge and the other axis, positive towards ``axis``.
    residual : float
        Root mean square distance of the lines' edges from the fitted line, in metres.
    distance, spread : numpy.ndarray
        Edge spread function: metres along the normal, towards growing ``axis``, and the mean of the
        samples in each bin.
    mtf : Curve
        Contrast along the normal, up to one cycle per sample.

    Examples
    --------
    >>> y, x = np.indices((32, 32))
    >>> picture = 1 / (1 + np.exp((14 + 0.12 * y - x) / 0.6))  # an edge, 7 degrees off y
    >>> edge = clplen.analysis.slanted_edge(picture, pitch=5e-6)
    >>> edge.axis, f"{np.degrees(edge.angle):.1f} degrees"
    (1, '6.8 degrees')
    """

    axis: int
    angle: float
    residual: float
    distance: Values
    spread: Values
    mtf: Curve


def slanted_edge(picture: Any, *, pitch: float | Pair) -> SlantedEdge:
    """Measure the transfer function across a slanted edge.

    Parameters
    ----------
    picture : array_like
        Linear intensities, shape (y, x), of one straight edge between two uniform areas. The edge
        must cross every line at least 8 samples from the ends of the line.
    pitch : float or tuple of float
        Sample spacing (dy, dx) in metres.

    Returns
    -------
    SlantedEdge
        Angle of the edge, its edge spread function and the transfer function.

    Raises
    ------
    ShapeError
        If the picture is not two-dimensional or too small, or the edge shifts by less than a
        sample over the picture or is too close to the border.
    ValueError
        If the picture has no edge, or the edge is not at 1.5 to 14 degrees (on square samples)
        from an axis, has a slope near 1/4, 1/5 or 1/6, or reverses its contrast between lines.

    Examples
    --------
    >>> y, x = np.indices((32, 32))
    >>> picture = 1 / (1 + np.exp((14 + 0.12 * y - x) / 0.6))  # an edge, 7 degrees off y
    >>> edge = clplen.analysis.slanted_edge(picture, pitch=5e-6)
    >>> f"MTF50 {edge.mtf.at(0.5) / 1e3:.0f} cycles/mm"
    'MTF50 37 cycles/mm'
    """
    values = checked(picture, "The picture of an edge", min_samples=2 * _MIN_MARGIN + 2)
    dy, dx = Grid(values.shape, pitch).pitch
    axis = _crossed_axis(values)
    lines, along, across = (values, dy, dx) if axis == 1 else (values.T, dx, dy)
    centres, start, slope = _fit(lines)
    _check(lines.shape, start, slope)
    offset, spread = _edge_spread(lines, start, slope)
    angle = math.atan2(slope * across, along)
    length = across * math.cos(angle)
    error = centres - (start + slope * np.arange(centres.size))
    return SlantedEdge(
        axis=axis,
        angle=angle,
        residual=float(np.sqrt(np.mean(error**2))) * length,
        distance=offset * length,
        spread=spread,
        mtf=_edge_transfer(spread, length),
    )


def _crossed_axis(values: Values) -> int:
    """Return the axis with the largest step of the picture's mean profile."""
    steps = [np.diff(values.mean(axis=1 - axis)) for axis in (0, 1)]
    strength = [float(np.sum(step**2)) for step in steps]
    if max(strength) <= 1e-12 * float(np.mean(values**2)):
        raise ValueError("The picture has no edge: it is uniform along both axes.")
    return int(np.argmax(strength))


def _fit(lines: Values) -> tuple[Values, float, float]:
    """Return the edge position on every line, in samples, and (start, slope) of the fitted line.

    Each position is the centroid of the derivative under a Hamming window about the last fit.
    """
    number, n = lines.shape
    step = np.diff(lines, axis=1)
    step = step * np.sign(step.sum())
    positions = np.arange(n - 1) + 0.5
    index = np.arange(number)
    centres = np.full(number, (n - 1) / 2)
    start, slope, reach = (n - 1) / 2, 0.0, float(n)
    for _ in range(_FIT_PASSES):
        middle = start + slope * index
        t = np.clip((positions - middle[:, None]) / reach, -1, 1)
        weight = step * (0.54 + 0.46 * np.cos(np.pi * t))
        total = weight.sum(axis=1)
        if not (total > 1e-3 * np.abs(weight).sum(axis=1)).all() or not total.min() > 0:
            raise ValueError(
                "The edge does not cross every line with the same contrast sign: crop to a part "
                "with one straight edge."
            )
        centres = (weight * positions).sum(axis=1) / total
        slope, start = (float(c) for c in np.polyfit(index, centres, 1))
        ends = (start, start + slope * (number - 1))
        reach = max(_MIN_MARGIN, min(*ends, n - 1 - ends[0], n - 1 - ends[1]))
    return centres, start, slope


def _check(shape: tuple[int, ...], start: float, slope: float) -> None:
    number, n = shape
    angle = math.degrees(math.atan(abs(slope)))
    if not MIN_ANGLE <= angle <= MAX_ANGLE:
        raise ValueError(
            f"The edge must be at {MIN_ANGLE} to {MAX_ANGLE} degrees from an axis, got "
            f"{angle:.3g}: turn it to about 5 degrees."
        )
    if number * abs(slope) < 1:
        raise ShapeError(
            f"The edge must shift by at least one sample, got {number * abs(slope):.2g} over "
            f"{number} lines: take at least {math.ceil(1 / abs(slope))} lines at {angle:.3g} "
            "degrees."
        )
    ends = (start, start + slope * (number - 1))
    if min(ends) < _MIN_MARGIN or max(ends) > n - 1 - _MIN_MARGIN:
        raise ShapeError(
            f"The edge must have at least {_MIN_MARGIN} samples on both sides; it runs from sample "
            f"{ends[0]:.1f} to {ends[1]:.1f} of {n}."
        )


def _edge_spread(lines: Values, start: float, slope: float) -> tuple[Values, Values]:
    """Return bin centres in samples along the line, and mean values, for bins that all lines reach.

    Merge samples within 1/32, interpolate linearly, and average over each bin.
    """
    number, n = lines.shape
    middle = start + slope * np.arange(number)
    reach = min(middle.min(), n - 1 - middle.max())
    half = math.floor(BINS * (reach - _MERGE_DISTANCE) - 0.5)
    offset = np.arange(n) - middle[:, None]
    near = np.abs(offset) <= reach
    index = np.floor((offset[near] + reach) / _MERGE_DISTANCE).astype(np.int64)
    count = np.bincount(index)
    is_filled = count > 0
    positions, value = (
        np.bincount(index, v[near])[is_filled] / count[is_filled] for v in (offset, lines)
    )
    gap = float(np.diff(positions).max())
    if gap > _MAX_GAP:
        raise ValueError(
            f"Distances from the edge have gaps of {gap:.2g} samples, above {_MAX_GAP}: the slope "
            f"of {slope:.4g} samples a line is nearly a simple fraction; rotate the edge slightly."
        )
    bins = np.arange(-half, half + 1) / BINS
    points = ((np.arange(_BIN_POINTS) + 0.5) / _BIN_POINTS - 0.5) / BINS
    return bins, np.interp(bins[:, None] + points, positions, value).mean(axis=1)


def _edge_transfer(spread: Values, length: float) -> Curve:
    """Return the transfer function of an edge spread function sampled every ``length`` m."""
    from scipy.signal.windows import tukey

    line = np.diff(spread)
    line = line * tukey(line.size, 0.5)
    n = _PAD * line.size
    f = np.arange(n // BINS + 1, dtype=np.float64) * (BINS / n)  # cycles a sample, up to 1
    value = np.abs(np.fft.rfft(line, n))[: f.size]
    smoothed = np.sinc(f / BINS) ** 2  # difference of neighbouring bins, average over each
    return Curve(np.asarray(f / length), np.asarray(value / value[0] / smoothed))
