"""Depth from a focused camera on the picture that is rendered from its raw image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clplen.compute.checks import require
from clplen.lightfield.focused.focused_depth import FocusedDepth
from clplen.lightfield.focused.focused_geometry import Values
from clplen.lightfield.focused.focused_lattice_maps import interpolate_lenslets
from clplen.lightfield.focused.focused_metric import z_of
from clplen.lightfield.focused.focused_picture import PictureGrid
from clplen.lightfield.raw.raw_image import RawImage


@dataclass(frozen=True, eq=False, repr=False)
class FocusedMaps:
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
    """

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
    grid : PictureGrid, optional
        Of a picture; default that of the median of m.

    Returns
    -------
    FocusedMaps

    Raises
    ------
    ValueError
        If no sub-image is sure.
    """
    require(RawImage, raw, "raw", "read_raw or camera.expose")
    require(FocusedDepth, depth, "depth", "focused_depth")
    if grid is None:
        geometry = depth.geometry
        grid = PictureGrid.over(geometry, geometry.patch(depth.median), None)
    m = depth.on(grid)
    confidence = np.where(depth.confidence >= depth.sure, depth.confidence, 0.0)
    return FocusedMaps(grid, m, z_of(raw, m), interpolate_lenslets(confidence, depth.geometry, grid))
