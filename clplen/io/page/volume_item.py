"""Volumes, focal stacks, time series, maps and pictures as items of a page."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.errors import ShapeError
from clplen.io.formats.animation import white_level
from clplen.io.page.samples import Array, Content, Levels, downscaled

_MAP_RANGE = (1.0, 99.0)  # percentiles at the ends of the colour table


def volume_item(
    values: ArrayLike,
    content: Content,
    *,
    name: str,
    downscale: int = 1,
    planes: tuple[str, str, ArrayLike] | None = None,
    first: int | None = None,
    voxel: tuple[float | None, float, float] | None = None,
    unit: str | None = None,
    table: str = "grey",
    dtype: np.dtype[Any] | None = None,
    srgb: bool = False,
) -> dict[str, Any]:
    """Add a series of pictures to a page, and return its description."""
    data = np.asarray(values)
    if data.ndim not in (4, 5) or data.size == 0 or data.shape[4:] not in ((), (1,), (3,)):
        raise ShapeError(
            f"A series must have shape (t, z, y, x) or (t, z, y, x, 3), got {data.shape}."
        )
    channels = (3,) if data.shape[4:] == (3,) else ()
    data = data.reshape(*data.shape[:4], *channels)
    T, Z = data.shape[:2]
    ny, nx = (size // downscale for size in data.shape[2:4])
    if min(ny, nx) < 1:
        raise ShapeError(
            f"downscale must be at most {data.shape[2]} x {data.shape[3]}, got {downscale}."
        )
    finite = data[np.isfinite(data)]
    levels = Levels.of(data)
    blobs = [
        content.add(lambda plane=plane: levels.packed(downscaled(plane, downscale)))  # type: ignore[misc]
        for plane in data.reshape(T * Z, *data.shape[2:])
    ]
    spacing = None
    if voxel is not None and np.isfinite(np.array(voxel[1:], float)).all():
        dz = voxel[0] if voxel[0] is not None and np.isfinite(voxel[0]) else None
        spacing = [dz, voxel[1] * downscale, voxel[2] * downscale]
    return {
        "kind": "volume",
        "name": name,
        "shape": [T, Z, ny, nx, *channels],
        "samples": {"type": "uint16", "low": levels.low, "step": levels.step, "blobs": blobs},
        "planes": None if planes is None else _planes(*planes),
        "first": Z // 2 if first is None else int(first),
        "spacing": spacing,
        "unit": unit,
        "shown": _display_range(finite, table, dtype, srgb),
    }


def _planes(label: str, unit: str, values: ArrayLike) -> dict[str, Any]:
    numbers = [float(v) if np.isfinite(v) else None for v in np.asarray(values, np.float64)]
    return {"label": label, "unit": unit, "values": numbers}


def _display_range(
    finite: Array, table: str, dtype: np.dtype[Any] | None, srgb: bool
) -> dict[str, Any]:
    """Return initial black, white and curve, and the range of both."""
    if finite.size == 0:
        return {"black": 0.0, "white": 1.0, "curve": "linear", "table": table, "range": [0.0, 1.0]}
    low, high = float(finite.min()), float(finite.max())
    if table == "grey":
        black = 0.0 if low >= 0 else low
        white = white_level(finite, np.dtype(np.float32) if dtype is None else dtype, srgb=srgb)
    else:
        black, white = (float(end) for end in np.percentile(finite, _MAP_RANGE))
    black, white = float(f"{black:.4g}"), float(f"{white:.4g}")
    if not white > black:
        white = black + max(abs(black), 1.0) * 1e-3
    ends = [min(low, black), max(high, white)]
    curve = "srgb" if srgb else "linear"
    return {"black": black, "white": white, "curve": curve, "table": table, "range": ends}
