"""What a cue of depth is, and what all cues share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from clplen.lightfield.arrays.peaks import Map
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import StoredLightField
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


@dataclass(frozen=True)
class PartialDepth:
    """What a cue of two passes finds in a part of a light field, at every pixel, shape (y, x).

    Attributes
    ----------
    disparity, confidence : numpy.ndarray
        float32.
    lost : numpy.ndarray
        bool: where the views agree on no plane, and both are those of the sharpest plane.
    """

    disparity: Map
    confidence: Map
    lost: Mask


class Survey(Protocol):
    """What a cue learns of a whole light field, from bands of full rows, before it finds depth."""

    def add(self, rows: slice, lf: LightField) -> None:
        """Look at some rows of all views."""

    def finish(self) -> Any:
        """What `TwoPasses.disparity` takes, when all rows were added."""


@dataclass(frozen=True)
class TwoPasses:
    """How a cue that depends on the whole light field is made in parts.

    Attributes
    ----------
    survey : callable
        (stored light field) to a `Survey`.
    disparity : callable
        (part, rising planes, what the survey gave, inside=(rows, columns) that are wanted) to the
        `PartialDepth` of the whole part.
    merge_confidence : callable
        (confidence, lost) of the whole map to its confidence.
    """

    survey: Callable[[StoredLightField], Survey]
    disparity: Callable[..., PartialDepth]
    merge_confidence: Callable[[Map, Mask], Map]


@dataclass(frozen=True)
class Cue:
    """One way to find depth; `clplen.lightfield.depth.depth_maps` lists them all.

    Attributes
    ----------
    disparity : callable
        (light field, rising planes) to (disparity, confidence), float32, shape (y, x).
    memory : callable
        (stored light field, rising planes) to the `MemoryEstimate` of that.
    two_passes : TwoPasses or None
        For a cue whose parts depend on the whole light field.
    """

    disparity: Callable[[LightField, Vector], tuple[Map, Map]]
    memory: Callable[[StoredLightField, Vector], MemoryEstimate]
    two_passes: TwoPasses | None = None


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
    cue: str, source: StoredLightField, planes: Vector, *, reach: int, floats: int, largest: int
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
