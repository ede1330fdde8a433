"""What focal stacks, cues and all-in-focus pictures need: pixels around a tile, and memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.lightfield.depth import combined_cue, correspondence, sharpness_cue, structure_tensor
from clplen.lightfield.depth.sharpness_cue import AT_ONCE, PICTURES
from clplen.lightfield.model.alpha_law import shifts
from clplen.lightfield.streaming.tile_plan import Work

if TYPE_CHECKING:
    from clplen.lightfield.model.stored_light_field import StoredLightField

Vector = np.ndarray[Any, np.dtype[np.float64]]

_TAPS = 2  # pixels beyond a shift that interpolations reach
_FLOAT = 4.5  # bytes of one on the device: its spare buffers are up to an eighth larger
_HOST = 4
_MAPS = 16  # bytes of a pixel of a depth map
_MERGED = _MAPS + 13  # while its confidence is merged
_REACH = {
    "energy": sharpness_cue.REACH,
    "correspondence": correspondence.REACH,
    "structure-tensor": structure_tensor.REACH,
    "combined": combined_cue.REACH,
}


def stack_works(source: StoredLightField, planes: Vector) -> list[Work]:
    """A focal stack: all planes of a tile at once, or fewer and fewer."""
    channels = _channels(source)
    works, count = [], planes.size
    while True:
        groups = [slice(i, min(i + count, planes.size)) for i in range(0, planes.size, count)]
        works.append(
            Work(
                "A focal stack",
                tuple(groups),
                halo_of(source, planes, 0),
                int(count * channels * (_FLOAT + 2 * _HOST)),
                4 * count * channels,
            )
        )
        if count == 1:
            return works
        count = -(-count // 2)


def depth_work(source: StoredLightField, planes: Vector, cue: str) -> Work:
    """A depth map by one of the cues."""
    channels, size = _channels(source), planes.size
    most, pictures = min(AT_ONCE, size), min(PICTURES, size)
    floats = {
        "energy": (1 + (size > PICTURES)) * pictures * channels + 2 * most + 9,
        "correspondence": 3 * most * channels + 2 * most + 9,
        "structure-tensor": 6 * channels + 19,
    }
    largest = (pictures if cue in ("energy", "combined") else most) * channels
    if cue == "combined":
        tried = combined_cue.planes_tried(planes)
        floats["combined"] = 2 * tried + 4 * channels + 24 + floats["energy"]
        largest = max(tried, largest)
    both = cue == "combined"
    return Work(
        f"A depth map (cue={cue!r})",
        (slice(0, size),),
        halo_of(source, planes, _REACH[cue]),
        int(_FLOAT * floats[cue]) + _HOST * (18 + 3 * channels if both else 4),
        4 * largest,
        _MAPS + both,
        max(_MERGED, 3 * _HOST * channels) if both else 0,
        2 if both else 1,
    )


def blend_work(source: StoredLightField, planes: Vector) -> Work:
    """An all-in-focus picture from the planes of a stack."""
    channels, size = _channels(source), planes.size
    floats = size * channels + size + min(AT_ONCE, size) + channels
    return Work(
        "An all-in-focus picture",
        (slice(0, size),),
        halo_of(source, planes, sharpness_cue.REACH),
        int(_FLOAT * floats) + _HOST * channels,
        4 * size * channels,
        _HOST * channels,
    )


def surface_work(source: StoredLightField, disparity: Vector) -> Work:
    """An all-in-focus picture on the surface of a depth map, which is there already."""
    channels = _channels(source)
    ends = np.array([disparity.min(), disparity.max()])
    return Work(
        "An all-in-focus picture",
        (slice(0, 1),),
        halo_of(source, ends, 0),
        int(_FLOAT * (channels + 1)) + _HOST * (channels + 4),
        4 * channels,
        _HOST * channels,
    )


def halo_of(source: StoredLightField, planes: Vector, reach: int) -> tuple[int, int]:
    """Pixels (y, x) around a tile: as far as the planes shift views, and windows reach."""
    ends = np.array([planes.min(), planes.max()])  # shifts are linear in the disparity
    down, right = shifts(source, ends)
    if source.positions is None:
        down, right = np.broadcast_arrays(down[:, :, None], right[:, None, :])
    lit = source.weights > 0
    y, x = (int(np.ceil(np.abs(moved[:, lit]).max())) + _TAPS + reach for moved in (down, right))
    return min(y, source.shape[2]), min(x, source.shape[3])


def _channels(source: StoredLightField) -> int:
    return int(np.prod(source.shape[4:], dtype=np.int64))
