"""Interface of the depth cues, and their common tools."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.arrays.shear import vector_lanes
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import (
    DEVICE_FLOAT,
    HOST_FLOAT,
    FocalStack,
    MemoryEstimate,
    shear_halo,
)

Map = np.ndarray[Any, np.dtype[np.float32]]
Vector = np.ndarray[Any, np.dtype[np.float64]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

BATCH_PLANES = 8  # planes whose curve is stored at a time
MAP_BYTES = 16  # of a pixel of a depth map: four float32
_PAD = 15  # floats: padding of the last vector of a plane
_LENGTH = 4096  # pixels of a work-item on CPUs


class PartialDepth(NamedTuple):
    """Disparity and confidence of a part of a light field, float32 of shape (y, x).

    ``lost``, bool, marks mismatches, whose disparity is that of the sharpest plane.
    """

    disparity: Map
    confidence: Map
    lost: Mask


class Survey(Protocol):
    """Collector of whole-light-field statistics for a cue, from bands of full rows."""

    def add(self, rows: slice, lf: LightField) -> None:
        """Add some rows of all views."""

    def finish(self) -> Any:
        """Return the third argument of `Cue.disparity` after all rows."""


@dataclass(frozen=True)
class Cue:
    """A depth estimation method; `clplen.lightfield.depth.depth_maps` lists all cues.

    ``disparity(part, rising planes)`` returns (disparity, confidence) of a part of a light field,
    and ``memory(light field, rising planes)`` its `MemoryEstimate`. Parts of a cue with a
    ``survey`` depend on the whole light field: ``disparity(part, planes, survey result,
    inside=(rows, columns))`` returns a `PartialDepth`, and ``merge(confidence, lost)`` the
    confidence of the whole map.
    """

    disparity: Callable[..., Any]
    memory: Callable[[SampledViews, Vector], MemoryEstimate]
    survey: Callable[[SampledViews], Survey] | None = None
    merge: Callable[[Map, Mask], Map] | None = None


def nearest_zero(planes: Vector) -> float:
    """Return the plane nearest to the recorded focus, the disparity without evidence."""
    return float(planes[np.argmin(np.abs(planes))])


def require_maps(source: LightField | FocalStack, maps: int, pictures: int) -> None:
    """Reject more float32 maps (y, x) and pictures (y, x[, c]) than the device can hold."""
    before = 1 if isinstance(source, FocalStack) else 2
    ny, nx, colours = (*source.shape[before:], 1)[:3]
    nbytes = 4 * ny * nx * (maps + pictures * colours) + source.data.nbytes
    source.device.require_memory(nbytes, "This depth map with its source")


def depth_memory(
    cue: str, source: SampledViews, planes: Vector, *, reach: int, floats: int, largest: int
) -> MemoryEstimate:
    """Return the memory estimate of a cue with one pass over the samples."""
    return MemoryEstimate(
        f"A depth map (cue={cue!r})",
        (slice(0, planes.size),),
        shear_halo(source, planes, reach),
        int(DEVICE_FLOAT * floats) + 4 * HOST_FLOAT,
        4 * largest,
        MAP_BYTES,
    )


class PeakTracker:
    """Running maximum of a curve at every pixel, whose planes arrive in batches."""

    def __init__(
        self,
        shape: tuple[int, int],
        *,
        device: Device,
        start: float,
        capacity: int,
        lowest: bool = False,
    ) -> None:
        self._shape = shape
        self._size = shape[0] * shape[1]
        self._device = device
        self._defines: dict[str, Any] = {"LOWEST": True} if lowest else {}
        if device.rows:
            self._defines["LANES"] = vector_lanes(device)[0]
        self._state = [device.empty((self._padded(1),), np.float32) for _ in range(4)]
        self._start, self._fresh = start, True
        self.curve = device.empty((self._padded(capacity + 2),), np.float32)
        self.stored = 0
        self._values: list[float] = []

    def add(self, values: Vector) -> None:
        """Process planes stored in ``curve`` from index ``stored`` on."""
        count = len(values)
        overlap = 1 if self.stored else 0  # the last plane lacked its upper neighbour
        self._values.extend(float(value) for value in values)
        self._track(self.stored - overlap, count - 1 + overlap, len(self._values) - count - overlap)
        last = self.stored + count
        if last > 2:
            self._keep(last - 2)
        self.stored = min(last, 2)

    def finish(self) -> tuple[Map, Map]:
        """Return (values, confidence) of the peaks, float32, shape (y, x)."""
        self._track(self.stored - 1, 1, len(self._values) - 1)
        best, second, position, curvature = self._state
        confidence = self._device.empty(self._shape, np.float32)
        self._launch("confidence", (confidence, best, second, curvature))
        values = self._device.download(position)[: self._size].reshape(self._shape)
        return values, self._device.download(confidence)

    def _track(self, first: int, count: int, index: int) -> None:
        """Compare planes of `curve` from `first` on with their neighbours; the first is `index`."""
        if count < 1:
            return
        steps = np.concatenate(([0], np.diff(self._values), [0]))
        planes = slice(index, index + count)
        rows = np.stack((self._values[planes], steps[:-1][planes], steps[1:][planes]), axis=1)
        table = self._device.upload(rows.astype(np.float32))
        numbers = (np.int32(first), np.int32(count), np.int32(self._fresh))
        args = (*self._state, self.curve, table, *numbers, np.float32(self._start))
        self._launch("track_peaks", args)
        self._fresh = False

    def _launch(self, name: str, args: tuple[Any, ...]) -> None:
        length = _LENGTH if self._device.rows else 1
        kernel = self._device.kernel("peaks.cl", name, **self._defines)
        sizes = (np.int32(self._size), np.int32(length))
        self._device.launch(kernel, (-(-self._size // length),), *args, *sizes)

    def _keep(self, plane: int) -> None:
        """Move two planes to the front in sequence, since they may overlap."""
        for to in range(2):
            start = (plane + to) * self._size
            block = self.curve[start : start + self._size]
            if start != to * self._size:
                self._device.copy_into(self.curve, block, 4 * to * self._size)

    def _padded(self, planes: int) -> int:
        return planes * self._size + _PAD
