"""The transfer function of a picture from a slanted edge in it.

ISO 12233:2017, annex D: the edge is fitted by a straight line, all samples are put in order of
their distance from it in bins of a quarter of a sample, and the derivative of that edge spread
function is windowed and transformed. Three things go beyond the annex: distances are those along
the edge's normal, the mean over a bin allows for how samples crowd in it, and that mean is
corrected as the difference of two bins is. The window is Tukey's, which leaves the middle half as
it is.
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

BINS = 4  # a sample
LEAST, MOST = 1.5, 14.0  # degrees on the samples: a steeper edge shifts by 1/4 a line, or more
_BESIDE = 8  # samples that an edge needs on both sides
_PAD = 4  # length of the transform over that of the line spread function
_ROUNDS = 3
_CROWD = 1 / 32  # of a sample: nearer ones count as one place
_GAP = 0.15  # of a sample, between places
_PARTS = 16  # of a bin


@dataclass(frozen=True, eq=False, repr=False)
class SlantedEdge(OneLine):
    """What a slanted edge tells.

    Attributes
    ----------
    axis : int
        The axis that the edge crosses: 1 for an edge that is nearly along y, 0 for one along x.
    angle : float
        In radians, from the other axis: of the edge's y or x axis towards ``axis``.
    residual : float
        rms distance of the lines' edges from the fitted one, in metres.
    distance, spread : numpy.ndarray
        The edge spread function: metres along the normal, towards growing ``axis``, and the mean of
        the samples in each bin.
    mtf : Curve
        Along the normal, up to one cycle a sample.

    Examples
    --------
    >>> y, x = np.indices((32, 32))
    >>> picture = 1 / (1 + np.exp((14 + 0.12 * y - x) / 0.6))  # an edge, 7 degrees off y
    >>> found = clplen.analysis.slanted_edge(picture, pitch=5e-6)
    >>> found.axis, f"{np.degrees(found.angle):.1f} degrees"
    (1, '6.8 degrees')
    """

    axis: int
    angle: float
    residual: float
    distance: Values
    spread: Values
    mtf: Curve


def slanted_edge(picture: Any, *, pitch: float | Pair) -> SlantedEdge:
    """Measure the transfer function across the one edge of a picture.

    Parameters
    ----------
    picture : array_like
        Linear intensities, shape (y, x), of a straight edge between two even areas, either side the
        brighter. It crosses all lines of the picture, at least 8 samples from their ends.
    pitch : float or tuple of float
        Sample spacing (dy, dx) in metres.

    Returns
    -------
    SlantedEdge
        The edge's place and angle, its edge spread function and the transfer function.

    Raises
    ------
    ShapeError
        If the picture is not two-dimensional or too small, its edge does not shift by a whole
        sample over it, or comes too close to the border.
    ValueError
        If there is no edge, it lies outside 1.5 to 14 degrees (on square samples) from an axis,
        has a slope near 1/4, 1/5 or 1/6, or does not cross all lines the same way.

    Examples
    --------
    >>> y, x = np.indices((32, 32))
    >>> picture = 1 / (1 + np.exp((14 + 0.12 * y - x) / 0.6))  # an edge, 7 degrees off y
    >>> found = clplen.analysis.slanted_edge(picture, pitch=5e-6)
    >>> f"MTF50 {found.mtf.at(0.5) / 1e3:.0f} cycles/mm"
    'MTF50 37 cycles/mm'
    """
    values = checked(picture, "The picture of an edge", least=2 * _BESIDE + 2)
    dy, dx = Grid(values.shape, pitch).pitch
    axis = _crossed(values)
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
        mtf=_transformed(spread, length),
    )


def _crossed(values: Values) -> int:
    """The axis along which the picture, averaged over the other one, steps most."""
    steps = [np.diff(values.mean(axis=1 - axis)) for axis in (0, 1)]
    strength = [float(np.sum(step**2)) for step in steps]
    if max(strength) <= 1e-12 * float(np.mean(values**2)):
        raise ValueError("The picture has no edge: it is even along both axes.")
    return int(np.argmax(strength))


def _fit(lines: Values) -> tuple[Values, float, float]:
    """Place of the edge on every line, in samples, and (start, slope) of the straight line.

    The place is the centre of gravity of the derivative under a Hamming window about the line
    found before.
    """
    number, n = lines.shape
    step = np.diff(lines, axis=1)
    step = step * np.sign(step.sum())
    at = np.arange(n - 1) + 0.5
    index = np.arange(number)
    centres = np.full(number, (n - 1) / 2)
    start, slope, reach = (n - 1) / 2, 0.0, float(n)
    for _ in range(_ROUNDS):
        middle = start + slope * index
        t = np.clip((at - middle[:, None]) / reach, -1, 1)
        weight = step * (0.54 + 0.46 * np.cos(np.pi * t))
        total = weight.sum(axis=1)
        if not (total > 1e-3 * np.abs(weight).sum(axis=1)).all() or not total.min() > 0:
            raise ValueError(
                "The edge does not cross every line of the picture the same way: cut out a part "
                "with one straight edge."
            )
        centres = (weight * at).sum(axis=1) / total
        slope, start = (float(c) for c in np.polyfit(index, centres, 1))
        ends = (start, start + slope * (number - 1))
        reach = max(_BESIDE, min(*ends, n - 1 - ends[0], n - 1 - ends[1]))
    return centres, start, slope


def _check(shape: tuple[int, ...], start: float, slope: float) -> None:
    number, n = shape
    angle = math.degrees(math.atan(abs(slope)))
    if not LEAST <= angle <= MOST:
        raise ValueError(
            f"The edge lies at {angle:.3g} degrees from the samples' axis; {LEAST} to {MOST} "
            "degrees spread its distances evenly: turn it to about 5."
        )
    if number * abs(slope) < 1:
        raise ShapeError(
            f"The edge shifts by {number * abs(slope):.2g} samples over the {number} lines of the "
            f"picture: at least {math.ceil(1 / abs(slope))} lines are needed at {angle:.3g} "
            "degrees."
        )
    ends = (start, start + slope * (number - 1))
    if min(ends) < _BESIDE or max(ends) > n - 1 - _BESIDE:
        raise ShapeError(
            f"The edge runs from sample {ends[0]:.1f} to {ends[1]:.1f} of {n}: at least {_BESIDE} "
            "are needed on both of its sides."
        )


def _edge_spread(lines: Values, start: float, slope: float) -> tuple[Values, Values]:
    """Offsets in samples along the line and mean values of the bins that all lines reach.

    Samples that lie within 1/32 of one another are averaged; the mean over a bin is that of the
    straight lines between those averages, so that it does not matter how they crowd in it.
    """
    number, n = lines.shape
    middle = start + slope * np.arange(number)
    reach = min(middle.min(), n - 1 - middle.max())
    half = math.floor(BINS * (reach - _CROWD) - 0.5)
    offset = np.arange(n) - middle[:, None]
    near = np.abs(offset) <= reach
    place = np.floor((offset[near] + reach) / _CROWD).astype(np.int64)
    count = np.bincount(place)
    some = count > 0
    at, value = (np.bincount(place, v[near])[some] / count[some] for v in (offset, lines))
    gap = float(np.diff(at).max())
    if gap > _GAP:
        raise ValueError(
            f"Distances from the edge are {gap:.2g} samples apart, more than {_GAP}: its slope of "
            f"{slope:.4g} samples a line is nearly a fraction of few parts; turn it a little."
        )
    bins = np.arange(-half, half + 1) / BINS
    parts = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) / BINS
    return bins, np.interp(bins[:, None] + parts, at, value).mean(axis=1)


def _transformed(spread: Values, length: float) -> Curve:
    """The transfer function of an edge spread function, ``length`` metres a sample."""
    from scipy.signal.windows import tukey

    line = np.diff(spread)
    line = line * tukey(line.size, 0.5)
    n = _PAD * line.size
    f = np.arange(n // BINS + 1, dtype=np.float64) * (BINS / n)  # cycles a sample, up to 1
    value = np.abs(np.fft.rfft(line, n))[: f.size]
    smoothed = np.sinc(f / BINS) ** 2  # difference of neighbouring bins, average over each
    return Curve(np.asarray(f / length), np.asarray(value / value[0] / smoothed))
