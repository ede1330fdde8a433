"""Depth from the raw image of a focused camera: the m of every sub-image, by matching neighbours.

All planes are tried on the nearest pairs of lenslets, the best is refined by Gauss-Newton on more
pairs (Lucas & Kanade 1981), and what disagrees with all its neighbours is started again from their
median. `clplen.lightfield.focused.focused_matching` says what is compared.
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
_MIN_VIEWS = 4.0  # per point, both ways: at abs(m) = 1/2
_LARGEST = 0.45  # abs(m), and the least, that are tried where nothing else is said
_LEAST = 0.04
_SURE = 0.3  # confidence from which on a sub-image counts for maps and the median
_OFF = 0.15  # of the ratio: farther from the median of the neighbours is tried again
_WORSE = 0.2  # score by which the median may fit worse and still be taken
_BESIDE = 2.5  # planes from the best that are part of its minimum
_SLACK = 0.1  # of the range: how far beyond it a refined ratio may lie


@dataclass(frozen=True, eq=False, repr=False)
class FocusedDepth:
    """What `focused_depth` finds; arrays of shape (lines, lenslets) as in ``geometry.kinds``.

    Attributes
    ----------
    geometry : FocusedGeometry
    m : numpy.ndarray
        float64: b/a; NaN where there is no lenslet or nothing matches.
    confidence : numpy.ndarray
        float64, 0 to 1: how well neighbours match, how much texture there is, and how much worse
        the next best plane is.
    uncertainty : numpy.ndarray
        float64: standard deviation of m by the residuals of the match; inf where not known.
    z : numpy.ndarray
        float64: dz in metres from the focused plane, farther positive; NaN without a camera.
    sure : float
        Confidence from which on a sub-image counts for `ratios`, `on` and `median`.

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
    sure: float = _SURE

    def __repr__(self) -> str:
        found = int((self.confidence >= self.sure).sum())
        return f"<FocusedDepth of {found} of {self.geometry.count} lenslets>"

    @property
    def virtual_depth(self) -> Values:
        """v = a/b = 1/m of each sub-image."""
        with np.errstate(divide="ignore"):
            return 1 / self.m

    @property
    def median(self) -> float:
        """The median of m over the sub-images that are sure.

        Raises
        ------
        ValueError
            If none is.
        """
        known = self.m[self.confidence >= self.sure]
        if known.size == 0:
            raise ValueError(
                "No sub-image shows texture that its neighbours show again, so that the depth is "
                "not known: give m."
            )
        return float(np.median(known))

    def ratios(self, grid: PictureGrid) -> Values:
        """Patch over pitch at every sample of a picture, shape (height, width).

        Linear between the sub-images; those that are not sure are filled from their neighbours.
        """
        return interpolate_lenslets(self._filled, self.geometry, grid)

    def on(self, grid: PictureGrid) -> Values:
        """m at every sample of a picture, shape (height, width); see `ratios`."""
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
    """Find m, virtual depth and distance of what each sub-image shows in its middle.

    Neighbours of the nearest distance are compared first (of one type: sqrt(3) pitches for three
    types on a hexagonal lattice), then those up to twice as far as long as both sub-images hold the
    window.

    The aperture of a lenslet that focuses on m dims the rim of its sub-image over m pitches.
    Without a white image what is dimmed for the m in question, and for those that the camera or
    its lens types are made for, is left out, which leaves little at abs(m) above 0.35.

    Parameters
    ----------
    raw : RawImage
        Simulated, or captured with a lattice; grey or colour; finite.
    ms : tuple of float, optional
        (least, greatest) m to try, of one sign, abs(m) below 0.5, where at least four lenslets see
        a point. Default: for a camera of m, from a quarter of it to twice it; for lens types, over
        their ranges; else abs(m) from 0.04 to 0.45. Without a camera both signs are tried, and the
        one is taken that fits better as a whole.
    window : float, optional
        Radius in pixels of what is compared; default a fifth of the pitch. On the picture it is
        1/m times as large.
    white : array_like, optional
        White image of shape (ny, nx[, c]), by whose mean over the colours the raw image is divided.

    Returns
    -------
    FocusedDepth
        Depth of every sub-image.

    Raises
    ------
    ValueError
        For a range of m that is empty, holds 0 or reaches 0.5, a window larger than a quarter of
        the pitch or below 2 pixels, a raw image of a plenoptic 1.0 camera, NaN in it, or a white
        image that is dark.
    ShapeError
        If fewer than two by two lenslets lie on the sensor, or the white image does not fit.

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
    """The camera's own m, else the median over the sub-images."""
    if raw.camera is not None:
        return float(raw.camera.m)  # type: ignore[attr-defined]
    return focused_depth(raw, white=white).median


def _checked_window(geometry: FocusedGeometry, window: float | None) -> float:
    value = max(2.5, _WINDOW * geometry.pitch) if window is None else window
    if not (np.ndim(value) == 0 and 2 <= value <= geometry.pitch / 4):
        raise ValueError(
            f"The window is 2 to {geometry.pitch / 4:.4g} px (a quarter of a sub-image), not "
            f"{value:.4g}: give a window that fits, or a raw image of larger sub-images."
        )
    return float(value)


def _checked_range(geometry: FocusedGeometry, ms: Any) -> tuple[float, float]:
    values = real_array(ms, "ms", np.float64)
    if values.shape != (2,) or not np.isfinite(values).all() or not values[0] < values[1]:
        raise ValueError(f"ms is (least, greatest) of m to try, not {ms!r}.")
    if values[0] * values[1] <= 0:
        raise ValueError(
            f"m from {values[0]:g} to {values[1]:g} holds 0, an image infinitely far: try one sign "
            "at a time."
        )
    largest = np.abs(values).max()
    if largest >= 1 / math.sqrt(_MIN_VIEWS):
        raise ValueError(
            f"At m = {values[np.abs(values).argmax()]:g} a point is seen by {1 / largest:.2g} "
            "lenslets a row, which is too few to compare: depth needs abs(m) below 0.5."
        )
    if math.prod(map(geometry.ratio, values)) <= 0:
        raise ValueError(
            f"m from {values[0]:g} to {values[1]:g} holds {geometry.pupil:.4g}, the m of the main "
            "lens' pupil, which no lenslet can tell from any other: try larger ones."
        )
    return float(values[0]), float(values[1])


def _default_ranges(raw: RawImage, geometry: FocusedGeometry) -> list[tuple[float, float]]:
    """The ranges of m that a raw image suggests."""
    largest = _LARGEST
    camera: Any = raw.camera
    if camera is not None:
        if abs(camera.m) >= 1 / math.sqrt(_MIN_VIEWS):
            raise ValueError(
                f"At the camera's m = {camera.m:g} a point is seen by {1 / abs(camera.m):.2g} "
                "lenslets a row, which is too few to compare: depth needs abs(m) below 0.5, or a "
                f"range {argument('ms')} of what lies farther from the array."
            )
        low, high = abs(camera.m) / 4, min(largest, 2 * abs(camera.m))
    elif len(geometry.ranges) > 1:
        low = min(pair[0] for pair in geometry.ranges)
        high = max(pair[1] for pair in geometry.ranges)
        low, high = max(_LEAST, low), min(largest, high)
    else:
        low, high = _LEAST, largest
    low = max(low, 1.3 * geometry.pupil, _LEAST / 4)
    signs = (1, -1) if camera is None else (math.copysign(1, camera.m),)
    return [(min(s * low, s * high), max(s * low, s * high)) for s in signs]


def _match_planes(
    raw: RawImage, matcher: Matcher, bounds: list[tuple[float, float]]
) -> FocusedDepth:
    """The best plane within that range of the ratio which fits best as a whole, refined."""
    geometry = matcher.geometry
    planes = [matcher.planes(low, high) for low, high in bounds]
    costs = [matcher.costs(values) for values in planes]
    fitting = int(np.argmin([np.minimum(cost.min(0), 1).mean() for cost in costs]))
    start, first, second = _best(planes[fitting], costs[fitting])
    found = refine_outliers(matcher, start)
    low, high = bounds[fitting]
    slack = _SLACK * (high - low)
    inside = (found.ratio > low - slack) & (found.ratio < high + slack)
    there = inside & (geometry.kinds >= 0) & (found.weight > 0)
    unique = 1 - np.clip(first / np.maximum(second, np.finfo(np.float64).tiny), 0, 1)
    confidence = np.where(there, matcher.worth(found) * unique, 0.0)
    m = np.where(confidence > 0, geometry.m(found.ratio), np.nan)
    scale = (1 + geometry.pupil) * math.sqrt(matcher.redundancy)
    deviation = np.where(there, scale * found.deviation, np.inf)
    return FocusedDepth(geometry, m, confidence, deviation, z_of_m(raw, m))


def refine_outliers(matcher: Matcher, start: Values) -> Match:
    """Refined ratios; what lies far from all neighbours is started again from their median."""
    found = matcher.refined(start)
    near = median_of_neighbours(found.ratio, matcher.worth(found), matcher.geometry)
    astray = np.abs(found.ratio - near) > _OFF * np.abs(near)
    if not astray.any():
        return found
    other = matcher.refined(np.where(astray, near, found.ratio))
    return found.where(~astray | (other.score > found.score + _WORSE), other)


def _best(planes: Values, cost: Values) -> tuple[Values, Values, Values]:
    """Ratio of least cost, that cost, and the least of other minima (1 where there is none)."""
    order = np.argmin(cost, axis=0)
    first = np.take_along_axis(cost, order[None], 0)[0]
    padded = np.pad(cost, ((1, 1), (0, 0), (0, 0)), constant_values=np.inf)
    is_minimum = (cost <= padded[:-2]) & (cost <= padded[2:])
    is_beside = np.abs(np.arange(len(planes))[:, None, None] - order) < _BESIDE
    second = np.where(is_minimum & ~is_beside, cost, 1.0).min(0)
    return planes[order], first, second


@dataclass(frozen=True, eq=False, repr=False)
class FocusedMaps(Plottable):
    """Maps over a picture, float64, shape (height, width). By `focused_maps`.

    Attributes
    ----------
    grid : PictureGrid
    m : numpy.ndarray
        b/a, filled where it is not sure.
    z : numpy.ndarray
        dz in metres from the focused plane, farther positive; NaN without a camera.
    confidence : numpy.ndarray
        0 to 1, linear between the sub-images: 0 where m is filled.

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
        """v = a/b = 1/m."""
        return np.asarray(1 / self.m)


def focused_maps(
    raw: RawImage, depth: FocusedDepth, *, grid: PictureGrid | None = None
) -> FocusedMaps:
    """What `focused_depth` found, on the picture of `render_focused` with ``method="depth"``.

    Parameters
    ----------
    raw : RawImage
        Whose depth it is.
    depth : FocusedDepth
        The depth map.
    grid : PictureGrid, optional
        Of a picture; default that of the median of m.

    Returns
    -------
    FocusedMaps
        Maps on the picture.

    Raises
    ------
    ValueError
        If no sub-image is sure.

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
