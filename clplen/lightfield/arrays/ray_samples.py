"""Samples of the views along the rays that meet on a surface, averaged, ranked or compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array, real_array
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.lightfield.arrays.stored_samples import C_TYPE

Table = np.ndarray[Any, Any]

STATISTICS = ("mean", "variance", "median", "max", "min")
INTERPOLATIONS = ("linear", "nearest", "cubic")
_ROUNDING = 2.0**-20  # pixels: shifts are rounded to it, so that 3 x 0.1 pixels differ not from 0.3
_MOST = 1024  # views of a median: they are held at once


def along_rays(
    data: cla.Array,
    statistic: str,
    *,
    device: Device,
    weights: Table,
    steps: Table,
    disparity: Table | float = 0.0,
    interpolation: str = "linear",
    mask: Any = None,
) -> cla.Array:
    """One picture of what all views see of a surface.

    The samples are L[v, u](y + s_y d, x + s_x d) with (s_y, s_x) = steps[v, u], weighted with
    w[v, u] times the share of their taps that is known. Linear interpolation leaves out taps
    outside a view (and brings the others to the sum 1), "nearest" rounds halves up, "cubic" (Keys
    1981, a = -1/2) repeats the edge sample within a view and takes no place outside it.
    """
    _check(statistic, interpolation, mask)
    shape = tuple(int(n) for n in data.shape)
    w = np.asarray(weights, np.float64)
    kept = np.flatnonzero(w)
    d = checked_disparity(disparity, (shape[2], shape[3]))
    whole, part = _split(steps.reshape(-1, 2)[kept, ::-1], d)
    tables = (
        _mask_of(mask, shape[:4]),
        np.float32(d).reshape(-1),
        kept.astype(np.int32),
        (w.ravel()[kept] / max(float(w.max()), np.finfo(float).tiny)).astype(np.float32),
        whole,
        part,
    )
    defines = _defines(data, d, interpolation, mask)
    extra: tuple[Any, ...] = ()
    name = statistic
    if statistic in ("max", "min"):
        name, extra = "extreme", (np.float32(1 if statistic == "max" else -1),)
    if statistic == "median":
        defines["VIEWS"] = _room(kept.size)
    channels = shape[4] if len(shape) == 5 else 1
    out = device.empty(shape[2:], np.float32)
    device.launch_rows(
        device.kernel("along_rays.cl", name, **defines),
        (shape[2], shape[3] * channels),
        out,
        data,
        *(device.upload(table) for table in tables),
        *(np.int32(n) for n in (kept.size, shape[2], shape[3], channels)),
        *extra,
    )
    return out


def checked_disparity(disparity: Any, size: tuple[int, int]) -> Table:
    """Disparity of a picture, one number or one of every pixel; float64."""
    d = real_array(disparity, "A disparity", np.float64)
    if d.shape not in ((), size):
        raise ShapeError(
            f"A disparity is one number or one of every pixel, shape {size}, not {d.shape}."
        )
    if not np.isfinite(d).all():
        raise ValueError(
            "Disparities are finite numbers; fill the pixels that are NaN or infinite first."
        )
    return d


def _check(statistic: str, interpolation: str, mask: Any) -> None:
    for value, known, what in (
        (statistic, STATISTICS, "A statistic over views"),
        (interpolation, INTERPOLATIONS, "The interpolation"),
    ):
        if value not in known:
            raise ValueError(f"{what} is {', '.join(map(repr, known))}, not {value!r}.")
    if mask is not None and interpolation == "cubic":
        raise ValueError("A mask goes with interpolation='linear' or 'nearest', not 'cubic'.")


def _split(steps: Table, d: Table) -> tuple[Table, Table]:
    """Whole pixels and fractions of shifts (x, y); with a map, nothing and the steps."""
    if d.ndim:
        return np.zeros(steps.shape, np.int32), steps.astype(np.float32)
    shift = np.round(steps * float(d) / _ROUNDING) * _ROUNDING
    whole = np.floor(shift)
    return np.clip(whole, -(2**20), 2**20).astype(np.int32), (shift - whole).astype(np.float32)


def _mask_of(mask: Any, rays: tuple[int, ...]) -> Table:
    if mask is None:
        return np.zeros(1, np.uint8)
    known = host_array(mask, "A mask")
    if known.shape != rays:
        raise ShapeError(f"A mask has one value a ray, shape {rays}, not {known.shape}.")
    return (known != 0).astype(np.uint8)


def _defines(data: cla.Array, d: Table, interpolation: str, mask: Any) -> dict[str, Any]:
    defines: dict[str, Any] = {"SAMPLE": C_TYPE[np.dtype(data.dtype)]}
    if d.ndim:
        defines["MAP"] = True
    if interpolation != "linear":
        defines[interpolation.upper()] = True
    if mask is not None:
        defines["MASK"] = True
    return defines


def _room(views: int) -> int:
    """Views that a median has room for: few different numbers, so that few kernels are built."""
    if views > _MOST:
        raise ValueError(
            f"A median of {views} views: it takes at most {_MOST}; give a smaller aperture."
        )
    return next(room for room in (16, 64, 128, 256, 512, _MOST) if views <= room)
