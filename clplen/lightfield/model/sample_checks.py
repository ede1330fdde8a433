"""Checks of the arrays, spacing, positions and weights of a light field."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.checks import host_array, masked_array
from clplen.compute.arrays import count_bad
from clplen.compute.device import Device
from clplen.errors import DeviceError, SamplingWarning, ShapeError, warn_caller, worded
from clplen.lightfield.arrays.stored_samples import C_TYPE, lit_views
from clplen.lightfield.raw.raw_image import Spacing
from clplen.types import Array


class Shaped(Protocol):
    """Object with the shape of a light field."""

    @property
    def shape(self) -> tuple[int, ...]: ...


def checked_samples(a: Any, device: Device) -> tuple[cla.Array, Array | None]:
    """Return finite samples on the device in a storage type of the light field.

    The second array is False for views with masked samples; None without a mask.
    """
    data, valid = _adopt(a, device)
    check_shape(data.shape)
    require_finite(count_bad(data, device))
    return data, valid


def fill_masked(values: Array, mask: Array) -> tuple[Array, Array]:
    """Replace masked samples by 0; return a mask of the views (v, u) without any."""
    check_shape(values.shape)
    view_masks = mask.reshape(*mask.shape[:2], -1)
    valid = np.asarray(~view_masks.any(axis=-1))
    count = np.count_nonzero(~valid & ~view_masks.all(axis=-1))
    if not valid.any():
        raise ValueError(
            "A light field must have a view without masked samples, as weights belong to whole "
            "views; replace the samples by array.filled(value), or pass their mask to flatten."
        )
    if count:
        warn_caller(
            f"{count} of {valid.size} views have both masked and valid samples; weights belong to "
            "whole views, so these views have weight 0.",
            SamplingWarning,
        )
    return np.where(mask, np.zeros((), values.dtype), values), valid


def check_shape(shape: Any) -> None:
    """Reject an invalid shape of a light field."""
    if len(shape) not in (4, 5) or 0 in shape:
        raise ShapeError(
            "A light field must have shape (v, u, y, x) or (v, u, y, x, c), not empty, got "
            f"{tuple(shape)}."
        )


def require_finite(bad: int) -> None:
    """Reject a light field with NaN or infinite samples."""
    if bad:
        raise ValueError(
            f"The light field has {bad} samples that are NaN or infinite, which interpolation "
            "would spread; replace them by 0"
            + worded(python=" and set their views to weight 0 (weights=).", command=".", file=".")
        )


def storage_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the storage type of a real dtype: itself, or float32."""
    if dtype.kind not in "buif":
        raise TypeError(f"A light field must be real, got {dtype}.")
    native = dtype.newbyteorder("=")
    return native if native in C_TYPE else np.dtype(np.float32)


def _adopt(a: Any, device: Device) -> tuple[cla.Array, Array | None]:
    if isinstance(a, cla.Array):
        return _adopt_device(a, device), None
    values, mask = masked_array(a, "A light field")
    dtype = storage_dtype(values.dtype)
    device.require_memory(values.size * dtype.itemsize, "This light field")
    valid = None
    if mask is not None:
        values, valid = fill_masked(values, mask)
    return device.upload(values.astype(dtype, copy=False)), valid


def _adopt_device(a: cla.Array, device: Device) -> cla.Array:
    """Return an array of this device after everything on its queue has finished."""
    if a.context != device.context:
        raise DeviceError(
            f"The array belongs to another OpenCL context than {device!r}; create it on "
            "device.queue."
        )
    if np.dtype(a.dtype) not in C_TYPE:
        raise TypeError(
            f"A light field on the device must be uint8, uint16, float16 or float32, got {a.dtype}."
        )
    if not a.flags.c_contiguous:
        raise ShapeError(
            f"A light field on the device must be C-contiguous, got strides {a.strides}; copy it "
            "into a new array, or pass a NumPy array."
        )
    if a.queue is not None:
        a.queue.finish()
    return a if a.offset == 0 else a.copy(queue=device.queue)


def checked_spacing(spacing: Any) -> Spacing | None:
    """Check four signed steps other than 0, or None; NaN and infinity are allowed."""
    if spacing is None:
        return None
    try:
        values = tuple(float(s) for s in spacing)
    except OverflowError:  # an integer above 1.8e308
        values = ()
    if len(values) != 4 or 0.0 in values:
        raise ValueError(
            f"spacing must be (dv, du, dy, dx) in metres, all other than 0, got {spacing!r}."
        )
    return values


def checked_positions(positions: Any, data: Shaped) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Check (y, x) of each view, float64, or None."""
    if positions is None:
        return None
    values = np.array(host_array(positions, "positions"), np.float64)
    views = (int(data.shape[0]), int(data.shape[1]))
    if values.shape != (*views, 2):
        raise ShapeError(
            f"positions must be (y, x) for each of {views[0]} x {views[1]} views, shape "
            f"{(*views, 2)}, got {values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError("positions must be finite, in view steps, but include NaN or infinity.")
    return values


def weights_of_lit(data: cla.Array, device: Device) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return 0 for black views, 1 for others; 1 for all if all views are black."""
    return weights_where(lit_views(data, device))


def weights_where(
    lit: np.ndarray[Any, np.dtype[np.bool_]],
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return 1 for lit views, 0 for others; 1 for all if no view is lit."""
    return (lit if lit.any() else ~lit).astype(np.float32)


def checked_weights(weights: Any, data: Shaped) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Check weights of the views, float32, not negative; masked weights are 0."""
    weight_values, mask = masked_array(weights, "weights")
    values = np.array(
        weight_values if mask is None else np.where(mask, 0, weight_values), np.float32
    )
    views = (int(data.shape[0]), int(data.shape[1]))
    if values.shape != views:
        raise ShapeError(f"weights must have the shape of the views, {views}, got {values.shape}.")
    if not (np.isfinite(values).all() and (values >= 0).all() and values.any()):
        raise ValueError("weights must be finite, not negative and not all 0.")
    return values
