"""What a file of a series of volumes holds, whatever its format."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

Record = dict[str, Any]  # "name", "residual", "iterations", "range", "remarks" of a volume


@dataclass(frozen=True)
class SeriesLayout:
    """Volumes of a series, all alike."""

    frames: int  # of the whole series
    shape: tuple[int, int, int]  # (planes, y, x) of each
    voxel: tuple[float, float]  # (dy, dx) in metres
    planes: tuple[float, ...]  # z of each plane in metres
    depth: float | None  # distance of planes that are equidistant, in metres
    # What else is known of all of them, of JSON.
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def first(self) -> float:
        """z of the first plane, where its place can be said."""
        return self.planes[0] if self.depth is not None else 0.0


def checked_series(content: Any) -> tuple[dict[str, Any], list[Record]]:
    """Return description and records of a series, out of JSON of unknown origin."""
    about = dict(content)
    records, shape, batch = about.pop("records"), about["shape"], about.get("batch", 1)
    if len(shape) != 3 or not all(type(n) is int and n > 0 for n in (*shape, batch)):
        raise ValueError("the shape of its volumes is none")
    for record in records:
        low, high = record["range"]
        if not math.isfinite(low - high):
            raise ValueError("the range of a volume is none")
    return about, list(records)
