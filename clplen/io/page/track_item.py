"""Tracks drawn over the volumes of a page."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.errors import FormatError

Values = np.ndarray[Any, Any]


def add_tracks(
    item: dict[str, Any], frames: Values, ids: Values, positions: Values, *, downscale: int = 1
) -> None:
    """Add tracks to the description of a volume."""
    planes, spacing = item.get("planes"), item.get("spacing")
    if item["kind"] != "volume":
        raise FormatError(f"Tracks need a volume, but {item['name']} is a {item['kind']}.")
    is_flat = item["shape"][1] == 1
    if spacing is None or not (is_flat or (planes is not None and planes["unit"] == "m")):
        raise FormatError(
            f"Tracks in metres need the z of planes and the voxel size, but {item['name']} has "
            "none."
        )
    z, y, x = positions.T
    plane = np.zeros_like(z) if planes is None or is_flat else _plane(z, planes["values"])
    middle = (downscale - 1) / (2 * downscale)
    rows, columns = (at / step - middle for at, step in zip((y, x), spacing[1:], strict=True))
    item["tracks"] = {
        "ids": ids.tolist(),
        "frames": frames.tolist(),
        **{
            axis: np.round(values, 3).tolist()
            for axis, values in zip("zyx", (plane, rows, columns), strict=True)
        },
    }


def _plane(z: Values, planes: list[float]) -> Values:
    """Return the fractional index of z among planes by linear interpolation."""
    order = np.argsort(planes)
    return np.interp(z, np.array(planes)[order], order.astype(float))
