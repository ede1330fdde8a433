"""Layout of a file of a series of volumes, independent of its format."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

Record = dict[str, Any]  # keys: "name", "residual", "iterations", "range", "remarks"


@dataclass(frozen=True)
class SeriesLayout:
    """Layout of a series of volumes of equal shape."""

    frames: int  # number of volumes
    shape: tuple[int, int, int]  # (planes, y, x) of a volume
    voxel: tuple[float, float]  # (dy, dx) in metres
    planes: tuple[float, ...]  # z of each plane in metres
    depth: float | None  # distance of equidistant planes in metres
    # Further description of the series, of JSON values.
    about: dict[str, Any] = field(default_factory=dict)

    @property
    def first(self) -> float:
        """Depth z of the first plane in metres; 0 if the planes are not equidistant."""
        return self.planes[0] if self.depth is not None else 0.0


def checked_series(content: Any) -> tuple[dict[str, Any], list[Record]]:
    """Return description and records of a series from untrusted JSON."""
    about = dict(content)
    records, shape, batch = about.pop("records"), about["shape"], about.get("batch", 1)
    if len(shape) != 3 or not all(type(n) is int and n > 0 for n in (*shape, batch)):
        raise ValueError("the shape of its volumes is invalid")
    for record in records:
        low, high = record["range"]
        if not math.isfinite(low - high):
            raise ValueError("the range of a volume is not finite")
    return about, list(records)
