"""Windows of single points before a light-field microscope, for pixels that integrate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.local_window import (
    BAND,
    NUMBERS,
    ORDERS,
    RINGS,
    TRANSITION,
    Windows,
    WindowShape,
)
from clplen.cameras.optics.microscope_optics import MicroscopeOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.fft.lines import smooth_length
from clplen.wave.field.field import Grid

Values = np.ndarray[Any, np.dtype[np.float64]]


def microscope_window_shape(
    optics: MicroscopeOptics, position: Values, diameter: float
) -> WindowShape:
    """The window of a point at (x, y, z) in metres about the native plane."""
    M, lam, mla = optics.magnification, optics.wavelength, optics.mla
    slope = optics.na / M + mla.steepest_slope(lam)
    many = math.floor(
        2 * (slope + ORDERS * lam / mla.diameter) * optics.pixel_pitch / lam / BAND
    ) + 1  # fmt: skip
    dx = optics.pixel_pitch / many
    walk = optics.sensor_distance * slope
    blur = float(optics.objective.blur(position[2])) + M * diameter / 2
    half = blur + RINGS * 0.61 * lam * M / optics.na + mla.pitch + walk
    samples = 2 * smooth_length(math.ceil(half / dx))
    middle = 0.5 - slope * dx / lam
    rim = (middle - TRANSITION / 2, middle + TRANSITION / 2)
    return WindowShape(many, dx, samples, samples, samples, math.ceil(walk / dx), rim)


@dataclass(frozen=True, eq=False)
class MicroscopeWindows(Windows):
    """Windows of points before an objective, whose image side is telecentric.

    Attributes
    ----------
    optics : MicroscopeOptics
    points : PointSources
    others
        Those of `Windows`.
    """

    optics: MicroscopeOptics
    points: PointSources

    @classmethod
    def of(
        cls, optics: MicroscopeOptics, shape: WindowShape, points: PointSources
    ) -> MicroscopeWindows:
        """The windows of points about the native plane."""
        count = len(points)
        images = points.positions[:, 1::-1] * optics.magnification
        centres = np.rint((images - np.asarray(optics.grid.origin)) / shape.pitch).astype(np.int64)
        none = np.zeros((count, 2))
        return cls(
            optics, shape, np.zeros((count, NUMBERS)), centres, none, none,
            none.astype(np.int64), np.ones(count), points,
        )  # fmt: skip

    def array_fields(self) -> cla.Array:
        """Fields on the array before its lenslets, shape (n, samples, samples)."""
        optics, n = self.optics, self.shape.samples
        out = optics.device.empty((len(self.points), n, n), optics.device.complex)
        for number, centre in enumerate(self.centres):
            one = PointSources(self.points.positions[number], diameter=self.points.diameter)
            grid = Grid((n, n), self.shape.pitch, origin=self._origin(centre))
            out[number] = optics.objective.fields(one, grid, optics.device).data[0]
        return out
