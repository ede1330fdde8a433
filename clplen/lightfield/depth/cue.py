"""What a cue of depth is, and what all cues share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from clplen.lightfield.arrays.peaks import Map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import FocalStack
from clplen.lightfield.refocusing.memory_estimate import (
    DEVICE_FLOAT,
    HOST_FLOAT,
    MemoryEstimate,
    shear_halo,
)

Vector = np.ndarray[Any, np.dtype[np.float64]]

Mask = np.ndarray[Any, np.dtype[np.bool_]]

AT_ONCE = 8  # planes whose curve is held at a time
MAP_BYTES = 16  # of a pixel of a depth map: four float32


class PartialDepth(NamedTuple):
    """Disparity and confidence of a part of a light field, float32 of shape (y, x).

    ``lost``, bool, marks pixels where the views agree on no plane and the sharpest one was taken.
    """

    disparity: Map
    confidence: Map
    lost: Mask


class Survey(Protocol):
    """Collect what a cue needs to know of a whole light field, from bands of full rows."""

    def add(self, rows: slice, lf: LightField) -> None:
        """Add some rows of all views."""

    def finish(self) -> Any:
        """Return what `Cue.disparity` takes as its third argument, when all rows were added."""


@dataclass(frozen=True)
class Cue:
    """One way to find depth; `clplen.lightfield.depth.depth_maps` lists them all.

    ``disparity(part of a light field, rising planes)`` returns (disparity, confidence), and
    ``memory(light field, rising planes)`` the `MemoryEstimate` of that. The parts of a cue with a
    ``survey`` depend on the whole light field: ``disparity(part, planes, what the survey found,
    inside=wanted rows and columns)`` returns a `PartialDepth`, and ``merge(confidence, lost)`` of
    the whole map its confidence.
    """

    disparity: Callable[..., Any]
    memory: Callable[[SampledViews, Vector], MemoryEstimate]
    survey: Callable[[SampledViews], Survey] | None = None
    merge: Callable[[Map, Mask], Map] | None = None


def nearest_zero(planes: Vector) -> float:
    """The plane nearest to the focus as recorded: the disparity where there is no evidence."""
    return float(planes[np.argmin(np.abs(planes))])


def require_maps(source: LightField | FocalStack, maps: int, pictures: int) -> None:
    """Refuse more float32 maps (y, x) and pictures (y, x[, c]) than the device's memory holds."""
    before = 1 if isinstance(source, FocalStack) else 2
    ny, nx, colours = (*source.shape[before:], 1)[:3]
    nbytes = 4 * ny * nx * (maps + pictures * colours) + source.data.nbytes
    source.device.require_memory(nbytes, "This depth map with its source")


def depth_memory(
    cue: str, source: SampledViews, planes: Vector, *, reach: int, floats: int, largest: int
) -> MemoryEstimate:
    """The estimate of a cue that needs one pass over the samples."""
    return MemoryEstimate(
        f"A depth map (cue={cue!r})",
        (slice(0, planes.size),),
        shear_halo(source, planes, reach),
        int(DEVICE_FLOAT * floats) + 4 * HOST_FLOAT,
        4 * largest,
        MAP_BYTES,
    )
