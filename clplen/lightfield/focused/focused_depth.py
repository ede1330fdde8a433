"""Depth from the raw image of a focused camera, by matching neighbouring sub-images.

All planes are tested on the nearest pairs of lenslets. The best is refined by Gauss-Newton on more
pairs (Lucas & Kanade 1981); outliers restart from the median of their neighbours. See
`clplen.lightfield.focused.focused_matching` for the costs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from clplen.checks import real_array, require
from clplen.errors import argument
from clplen.lightfield.focused.focused_geometry import (
    FocusedGeometry,
    Values,
    require_finite,
    z_of_m,
)
from clplen.lightfield.focused.focused_matching import Match, Matcher
from clplen.lightfield.focused.focused_picture import (
    PictureGrid,
    fill_lenslets,
    interpolate_lenslets,
    median_of_neighbours,
)
from clplen.lightfield.raw.raw_image import RawImage
from clplen.results import Plottable

_WINDOW = 0.2  # radius in pitches
_MIN_VIEWS = 4.0  # views of a point in both directions: abs(m) = 1/2
_MAX_M = 0.45  # default largest and smallest abs(m) of the search
_MIN_M = 0.04
_MIN_CONFIDENCE = 0.3  # minimum confidence of a sub-image in maps and in the median
_MAX_DEVIATION = 0.15  # relative deviation from the neighbours' median that triggers a restart
_SCORE_MARGIN = 0.2  # score by which a restart may be worse and still be accepted
_MINIMUM_PLANES = 2.5  # planes from the best that belong to its minimum
_RANGE_MARGIN = 0.1  # of the search range: margin for a refined ratio


@dataclass(frozen=True, eq=False, repr=False)
class FocusedDepth:
    """Depth of every sub-image, in arrays of shape (lines, lenslets) as in ``geometry.kinds``.

    Attributes
    ----------
    geometry : FocusedGeometry
    m : numpy.ndarray
        Ratio b/a, float64; NaN without a lenslet or a match.
    confidence : numpy.ndarray
        Confidence, float64, 0 to 1, from the match, the texture and the distance to the next best
        plane.
    uncertainty : numpy.ndarray
        Standard deviation of m from the residuals of the match, float64; inf if unknown.
    z : numpy.ndarray
        Distance dz in metres from the focused plane, float64, farther positive; NaN without a
        camera.
    sure : float
        Minimum confidence of a sub-image for `ratios`, `on` and `median`.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> scene = clplen.SurfaceScene(clplen.cameras.Plane(-0.5, texture=clplen.cameras.noise(1)))
    >>> raw = camera.expose(scene, model="rays")
    >>> clplen.lightfield.focused_depth(raw).m.shape
    (9, 9)
    """

    geometry: FocusedGeometry
    m: Values
    confidence: Values
    uncertainty: Values
    z: Values
    sure: float = _MIN_CONFIDENCE

    def __repr__(self) -> str:
        valid = int((self.confidence >= self.sure).sum())
        return f"<FocusedDepth of {valid} of {self.geometry.count} lenslets>"

    @property
    def virtual_depth(self) -> Values:
        """Virtual depth v = a/b = 1/m of each sub-image."""
        with np.errstate(divide="ignore"):
            return 1 / self.m

    @property
    def median(self) -> float:
        """Median of m over the sub-images of sufficient confidence.

        Raises
        ------
        ValueError
            If no sub-image has sufficient confidence.
        """
        valid = self.m[self.confidence >= self.sure]
        if valid.size == 0:
            raise ValueError(
                "The depth is unknown: no sub-image has texture that matches its neighbours. Pass "
                "m."
            )
        return float(np.median(valid))

    def ratios(self, grid: PictureGrid) -> Values:
        """Return patch over pitch at every sample of a picture, shape (height, width).

        Values are linear between sub-images; uncertain sub-images are filled from their neighbours.
        """
        return interpolate_lenslets(self._filled, self.geometry, grid)

    def on(self, grid: PictureGrid) -> Values:
        """Return m at every sample of a picture, shape (height, width); see `ratios`."""
        return np.asarray(self.geometry.m(self.ratios(grid)))

    @cached_property
    def _filled(self) -> Values:
        weights = np.where(self.confidence >= self.sure, self.confidence, 0.0)
        ratio = self.geometry.ratio(np.where(weights > 0, self.m, self.median))
        return fill_lenslets(np.asarray(ratio), weights, self.geometry)


def focused_depth(
    raw: RawImage,
    *,
    ms: tuple[float, float] | None = None,
    window: float | None = None,
    white: ArrayLike | None = None,
) -> FocusedDepth:
    """Estimate m, virtual depth and distance of the scene in the middle of each sub-image.

    The nearest neighbours of one type are compared first (sqrt(3) pitches apart for three types on
    a hexagonal lattice), then those up to twice as far, as long as both sub-images contain the
    window.

    The aperture of a lenslet focused at m dims the rim of its sub-image over m pitches. Without a
    white image, the rim for the tested m and for the camera's or lens types' m is excluded, which
    leaves little area at abs(m) above 0.35.

    Parameters
    ----------
    raw : RawImage
        Raw image, simulated or captured with a lattice; grey or colour; finite.
    ms : tuple of float, optional
        Search range (lowest, highest) of m, of one sign, abs(m) below 0.5, so that at least four
        lenslets see a point. Default: for a camera of m, from a quarter of it to twice it; for lens
        types, their ranges; else abs(m) from 0.04 to 0.45. Without a camera both signs are tested,
        and the better overall fit is returned.
    window : float, optional
        Radius in pixels of the compared window; default a fifth of the pitch. On the picture it is
        1/m times as large.
    white : array_like, optional
        White image of shape (ny, nx[, c]); the raw image is divided by its mean over the colours.

    Returns
    -------
    FocusedDepth
        Depth of every sub-image.

    Raises
    ------
    ValueError
        If the range of m is empty, includes 0 or reaches 0.5; the window is larger than a quarter
        of the pitch or below 2 pixels; the raw image is of a plenoptic 1.0 camera or includes NaN;
        or the white image is black.
    ShapeError
        If fewer than two by two lenslets lie on the sensor, or the white image differs in shape.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> scene = clplen.SurfaceScene(clplen.cameras.Plane(-0.5, texture=clplen.cameras.noise(1)))
    >>> raw = camera.expose(scene, model="rays")
    >>> clplen.lightfield.focused_depth(raw).m.shape
    (9, 9)
    """
    geometry = FocusedGeometry.of(raw)
    require_finite(raw, "matching")
    matcher = Matcher(raw, geometry, _checked_window(geometry, window), white)
    bounds = [_checked_range(geometry, ms)] if ms is not None else _default_ranges(raw, geometry)
    ratios = [(float(geometry.ratio(low)), float(geometry.ratio(high))) for low, high in bounds]
    return _match_planes(raw, matcher, ratios)


def reference_m(raw: RawImage, *, white: ArrayLike | None = None) -> float:
    """Return the camera's m, or the median over the sub-images."""
    if raw.camera is not None:
        return float(raw.camera.m)  # type: ignore[attr-defined]
    return focused_depth(raw, white=white).median


def _checked_window(geometry: FocusedGeometry, window: float | None) -> float:
    value = max(2.5, _WINDOW * geometry.pitch) if window is None else window
    if not (np.ndim(value) == 0 and 2 <= value <= geometry.pitch / 4):
        raise ValueError(
            f"window must be 2 to {geometry.pitch / 4:.4g} px (a quarter of a sub-image), got "
            f"{value:.4g}; pass a window in this range, or a raw image of larger sub-images."
        )
    return float(value)


def _checked_range(geometry: FocusedGeometry, ms: Any) -> tuple[float, float]:
    values = real_array(ms, "ms", np.float64)
    if values.shape != (2,) or not np.isfinite(values).all() or not values[0] < values[1]:
        raise ValueError(f"ms must be an ascending pair (lowest, highest) of m, got {ms!r}.")
    if values[0] * values[1] <= 0:
        raise ValueError(
            f"m from {values[0]:g} to {values[1]:g} includes 0, an image at infinity; search one "
            "sign at a time."
        )
    largest = np.abs(values).max()
    if largest >= 1 / math.sqrt(_MIN_VIEWS):
        raise ValueError(
            f"At m = {values[np.abs(values).argmax()]:g} only {1 / largest:.2g} lenslets a row see "
            "a point, too few to match: depth needs abs(m) below 0.5."
        )
    if math.prod(map(geometry.ratio, values)) <= 0:
        raise ValueError(
            f"m from {values[0]:g} to {values[1]:g} includes {geometry.pupil:.4g}, the m of the "
            "main lens' pupil, at which depth is indeterminate; search larger values."
        )
    return float(values[0]), float(values[1])


def _default_ranges(raw: RawImage, geometry: FocusedGeometry) -> list[tuple[float, float]]:
    """Return the default ranges of m for a raw image."""
    largest = _MAX_M
    camera: Any = raw.camera
    if camera is not None:
        if abs(camera.m) >= 1 / math.sqrt(_MIN_VIEWS):
            raise ValueError(
                f"At the camera's m = {camera.m:g} only {1 / abs(camera.m):.2g} lenslets a row see "
                "a point, too few to match: depth needs abs(m) below 0.5, or a range "
                f"{argument('ms')} of objects farther from the array."
            )
        low, high = abs(camera.m) / 4, min(largest, 2 * abs(camera.m))
    elif len(geometry.ranges) > 1:
        low = min(pair[0] for pair in geometry.ranges)
        high = max(pair[1] for pair in geometry.ranges)
        low, high = max(_MIN_M, low), min(largest, high)
    else:
        low, high = _MIN_M, largest
    low = max(low, 1.3 * geometry.pupil, _MIN_M / 4)
    signs = (1, -1) if camera is None else (math.copysign(1, camera.m),)
    return [(min(s * low, s * high), max(s * low, s * high)) for s in signs]


def _match_planes(
    raw: RawImage, matcher: Matcher, bounds: list[tuple[float, float]]
) -> FocusedDepth:
    """Return the refined best plane, from the range of the ratio that fits best as a whole."""
    geometry = matcher.geometry
    planes = [matcher.planes(low, high) for low, high in bounds]
    costs = [matcher.costs(values) for values in planes]
    fitting = int(np.argmin([np.minimum(cost.min(0), 1).mean() for cost in costs]))
    start, first, second = _best(planes[fitting], costs[fitting])
    match = refine_outliers(matcher, start)
    low, high = bounds[fitting]
    slack = _RANGE_MARGIN * (high - low)
    inside = (match.ratio > low - slack) & (match.ratio < high + slack)
    valid = inside & (geometry.kinds >= 0) & (match.weight > 0)
    unique = 1 - np.clip(first / np.maximum(second, np.finfo(np.float64).tiny), 0, 1)
    confidence = np.where(valid, matcher.quality(match) * unique, 0.0)
    m = np.where(confidence > 0, geometry.m(match.ratio), np.nan)
    scale = (1 + geometry.pupil) * math.sqrt(matcher.redundancy)
    deviation = np.where(valid, scale * match.deviation, np.inf)
    return FocusedDepth(geometry, m, confidence, deviation, z_of_m(raw, m))


def refine_outliers(matcher: Matcher, start: Values) -> Match:
    """Refine ratios; restart outliers from the median of their neighbours."""
    match = matcher.refined(start)
    median = median_of_neighbours(match.ratio, matcher.quality(match), matcher.geometry)
    outlier = np.abs(match.ratio - median) > _MAX_DEVIATION * np.abs(median)
    if not outlier.any():
        return match
    restarted = matcher.refined(np.where(outlier, median, match.ratio))
    return match.where(~outlier | (restarted.score > match.score + _SCORE_MARGIN), restarted)


def _best(planes: Values, cost: Values) -> tuple[Values, Values, Values]:
    """Return the ratio of least cost, its cost, and the cost of the next minimum (or 1)."""
    order = np.argmin(cost, axis=0)
    first = np.take_along_axis(cost, order[None], 0)[0]
    padded = np.pad(cost, ((1, 1), (0, 0), (0, 0)), constant_values=np.inf)
    is_minimum = (cost <= padded[:-2]) & (cost <= padded[2:])
    is_beside = np.abs(np.arange(len(planes))[:, None, None] - order) < _MINIMUM_PLANES
    second = np.where(is_minimum & ~is_beside, cost, 1.0).min(0)
    return planes[order], first, second


@dataclass(frozen=True, eq=False, repr=False)
class FocusedMaps(Plottable):
    """Maps of a focused camera over a picture, float64, shape (height, width).

    Attributes
    ----------
    grid : PictureGrid
    m : numpy.ndarray
        Ratio b/a, filled in uncertain areas.
    z : numpy.ndarray
        Distance dz in metres from the focused plane, farther positive; NaN without a camera.
    confidence : numpy.ndarray
        Confidence, 0 to 1, linear between the sub-images; 0 where m is filled.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> scene = clplen.SurfaceScene(clplen.cameras.Plane(-0.5, texture=clplen.cameras.noise(1)))
    >>> raw = camera.expose(scene, model="rays")
    >>> maps = clplen.lightfield.focused_maps(raw, clplen.lightfield.focused_depth(raw))
    >>> maps.m.shape == maps.confidence.shape
    True
    """

    _figure: ClassVar[str] = "focused_depth"

    grid: PictureGrid
    m: Values
    z: Values
    confidence: Values

    def __repr__(self) -> str:
        height, width = self.grid.shape
        return f"<FocusedMaps {height} x {width}>"

    @property
    def virtual_depth(self) -> Values:
        """Virtual depth v = a/b = 1/m."""
        return np.asarray(1 / self.m)


def focused_maps(
    raw: RawImage, depth: FocusedDepth, *, grid: PictureGrid | None = None
) -> FocusedMaps:
    """Resample a `FocusedDepth` to the picture of `render_focused` with ``method="depth"``.

    Parameters
    ----------
    raw : RawImage
        Raw image of the depth map.
    depth : FocusedDepth
        The depth map.
    grid : PictureGrid, optional
        Grid of a picture; default that of the median of m.

    Returns
    -------
    FocusedMaps
        Maps on the picture.

    Raises
    ------
    ValueError
        If no sub-image has sufficient confidence.

    Examples
    --------
    >>> lenslets = clplen.MicrolensArray(150e-6, 3e-3, count=9, fill="full")
    >>> camera = clplen.PlenopticCamera.type2(
    ...     focal_length=0.12, mla=lenslets, wavelength=532e-9, pixels_per_lenslet=16, m=0.25
    ... )
    >>> scene = clplen.SurfaceScene(clplen.cameras.Plane(-0.5, texture=clplen.cameras.noise(1)))
    >>> raw = camera.expose(scene, model="rays")
    >>> maps = clplen.lightfield.focused_maps(raw, clplen.lightfield.focused_depth(raw))
    >>> maps.m.shape == maps.z.shape
    True
    """
    require(RawImage, raw, "raw", "read_raw or camera.expose")
    require(FocusedDepth, depth, "depth", "focused_depth")
    if grid is None:
        geometry = depth.geometry
        grid = PictureGrid.over(geometry, geometry.patch(depth.median), None)
    m = depth.on(grid)
    confidence = np.where(depth.confidence >= depth.sure, depth.confidence, 0.0)
    return FocusedMaps(
        grid, m, z_of_m(raw, m), interpolate_lenslets(confidence, depth.geometry, grid)
    )
