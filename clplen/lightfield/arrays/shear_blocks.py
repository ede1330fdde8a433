"""Blocks of pictures that a work-item of shear.cl sums on CPUs, and their expected cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clplen.lightfield.arrays.shear_tables import Views

if TYPE_CHECKING:
    from clplen.compute.device import Device

_BLOCK_PLANES = 64  # of one launch
_LOCAL_BYTES = 1024 * 1024  # of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # what an OpenCL runtime may keep for itself
_WIDEST = 16  # chunks of a block
_ITEMS_PER_CORE = 8  # so that no core waits long for the last one
_UNLIKE = 1.5  # ratio of widths
_TRIED = 4  # blocks that are worth timing


@dataclass(frozen=True)
class Blocks:
    """What a work-item of shear_blocks does, and its share of the cost of a plane."""

    planes: int
    width: int
    height: int
    pitch: int
    cost: float

    @property
    def label(self) -> str:
        """What tells these blocks from others of the same views."""
        return f"blocks of {self.planes} x {self.width}"


def lanes_of(device: Device) -> tuple[int, int]:
    """Floats of a vector, and vectors summed at a time: two registers each of 32, or 16."""
    lanes = min(max(int(device.cl_device.native_vector_width_float), 4), 16)
    return lanes, 8 if lanes == 16 else 6


def all_blocks(views: Views, device: Device) -> list[Blocks]:
    """Blocks whose local memory the device has, the cheapest first."""
    lanes, vectors = lanes_of(device)
    chunk = lanes * vectors
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    items = _ITEMS_PER_CORE * int(device.cl_device.max_compute_units)
    first = views.channels // chunk + 1
    last = max(first, min(_WIDEST, -(-(views.samples + views.channels) // chunk)))
    passes = {-(-views.planes // most) for most in (1, 2, 4, 8, 16, 32, _BLOCK_PLANES)}
    found = []
    for planes in sorted({-(-views.planes // n) for n in passes}):
        spread = _spread(views, planes)
        for width in range(first * chunk, last * chunk + 1, chunk):
            found.append(_blocks(views, planes, width, spread, room, items, lanes))
    return sorted((b for b in found if b), key=lambda b: b.cost)


def worth_timing(blocks: list[Blocks]) -> list[Blocks]:
    """The cheapest blocks that are unlike each other."""
    unlike: list[Blocks] = []
    for b in blocks:
        if all(
            b.planes != o.planes or not 1 / _UNLIKE < b.width / o.width < _UNLIKE for o in unlike
        ):
            unlike.append(b)
    return unlike[:_TRIED]


def _spread(views: Views, planes: int) -> tuple[float, int]:
    """Furthest that planes of one launch lie apart: in rows (mean over v) and in samples."""
    first = np.arange(0, views.planes, planes)
    rows, pixels = (
        np.maximum.reduceat(a, first) - np.minimum.reduceat(a, first)
        for a in (views.down, views.right)
    )
    return float(rows.mean(axis=1).max()), int(pixels.max()) * views.channels


def _blocks(
    views: Views,
    planes: int,
    width: int,
    spread: tuple[float, int],
    room: int,
    items: int,
    lanes: int,
) -> Blocks | None:
    """Blocks of a width as high as local memory (room, in floats) and enough items allow.

    The cost of a plane is counted in vectors that are multiplied and added; one that is fetched
    from the light field costs about 8, and the start of a row 40 (measured on two cores with
    512-bit vectors).
    """
    pitch = -(-(width + max(spread[1], views.channels)) // lanes) * lanes
    columns = -(-views.samples // (width - views.channels))
    second = width + max(views.channels, lanes)
    highest = (room - views.weights.shape[1] * pitch - second) // (planes * width)
    highest = min(highest, views.ny, max(1, -(-views.ny * columns // items)))
    if highest < 1:
        return None
    height = -(-views.ny // -(-views.ny // highest))
    rows = (height + 1 + spread[0]) / height
    cost = columns * (width + rows * (8 * pitch + 40 * lanes) / planes)
    return Blocks(planes, width, height, pitch, cost)
