"""Ground truth of a synthetic scene: disparity, surfaces and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clplen.compute.arrays import HostArray
from clplen.results import Plottable, Savable

MIN_EDGE_STEP = 0.15  # minimum disparity step between neighbouring surfaces that is a depth edge
EDGE_PIXELS = 4  # half width of the band around such an edge, in pixels
EMPTY_DISPARITY = -1e6  # disparity of pixels without a surface

Map = np.ndarray[Any, np.dtype[np.float32]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]


@dataclass(frozen=True, eq=False, repr=False)
class Truth(Savable, Plottable, HostArray):
    """Exact depth of the centre view of a synthetic light field.

    Attributes
    ----------
    disparity : numpy.ndarray
        Disparity of the surface that the ray through each pixel's centre meets, float32, shape
        (y, x); nan without a surface. The centre view is (V - 1)/2, (U - 1)/2, between views for
        even counts.
    z : numpy.ndarray
        Distance from the focused plane in metres, float32, shape (y, x), > 0 farther from the lens;
        nan without a camera.
    surface : numpy.ndarray
        Index of that surface in the scene, int32, shape (y, x), -1 for none.
    masks : dict of numpy.ndarray
        Masks, bool, shape (y, x): "edges", 4 pixels on both sides of a boundary between surfaces
        that differ by more than 0.15 in disparity; "near" and "far", its pixels on the nearer and
        the farther surface; "planes" and "smooth", pixels of planes and spheres without "edges".

    Examples
    --------
    >>> disc = clplen.cameras.Plane(1.0, outline=clplen.cameras.Ellipse((0, 0), 8))
    >>> scene = clplen.cameras.SurfaceScene([clplen.cameras.Plane(-0.5), disc])
    >>> lf, truth = scene.light_field((3, 3), (32, 32))
    >>> truth
    <Truth 32 x 32, disparity -0.500 to 1.000>
    >>> sorted(truth.masks)
    ['edges', 'far', 'near', 'planes', 'smooth']
    """

    _writer: ClassVar[str] = "write_truth"
    _figure: ClassVar[str] = "truth"
    _samples: ClassVar[str] = "disparity"

    disparity: Map
    z: Map
    surface: np.ndarray[Any, np.dtype[np.int32]]
    masks: dict[str, Mask]

    def __repr__(self) -> str:
        ny, nx = self.disparity.shape
        if np.isnan(self.disparity).all():
            return f"<Truth {ny} x {nx}, empty>"
        low, high = np.nanmin(self.disparity), np.nanmax(self.disparity)
        return f"<Truth {ny} x {nx}, disparity {low:.3f} to {high:.3f}>"


def truth_of(
    disparity: Any, surface: Any, is_smooth: Sequence[bool], *, z: Map | None = None
) -> Truth:
    """Return the ground truth with its masks."""
    disparity = np.asarray(disparity, np.float32)
    near, far = _edge_bands(disparity, surface)
    curved = np.append(np.asarray(is_smooth, bool), False)[surface]
    edges = near | far
    masks = {
        "edges": edges,
        "near": near,
        "far": far,
        "planes": (surface >= 0) & ~curved & ~edges,
        "smooth": curved & ~edges,
    }
    distance = np.full(disparity.shape, np.nan, np.float32) if z is None else z
    return Truth(disparity, distance, np.asarray(surface, np.int32), masks)


def _edge_bands(disparity: Map, surface: Any) -> tuple[Mask, Mask]:
    """Return pixels of the nearer and the farther surface within EDGE_PIXELS of their boundary."""
    from scipy.ndimage import maximum_filter, minimum_filter

    depth = np.where(np.isnan(disparity), EMPTY_DISPARITY, disparity)
    edges = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        n = depth.shape[axis]
        first, second = _part(axis, 0, n - 1), _part(axis, 1, n)
        rise = np.abs(depth[second] - depth[first])
        jump = (surface[first] != surface[second]) & (rise > MIN_EDGE_STEP)
        edges[first] |= jump
        edges[second] |= jump
    edges = maximum_filter(edges, 2 * EDGE_PIXELS - 1)  # less than EDGE_PIXELS away along both axes
    size = 2 * EDGE_PIXELS + 1  # reaches across the edge from every pixel of its band
    high = maximum_filter(depth, size, mode="nearest")
    low = minimum_filter(depth, size, mode="nearest")
    nearer = high - depth < depth - low
    return edges & nearer, edges & ~nearer


def _part(axis: int, first: int, stop: int) -> tuple[slice, ...]:
    return (slice(None),) * axis + (slice(first, stop),)
