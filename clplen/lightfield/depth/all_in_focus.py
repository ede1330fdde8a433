"""All-in-focus pictures, composed of the sharpest plane at every pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.errors import ShapeError
from clplen.lightfield.arrays.ray_samples import checked_disparity
from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.energy_cue import ENERGY_REACH, LocalEnergy
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import (
    DEVICE_FLOAT,
    HOST_FLOAT,
    FocalStack,
    MemoryEstimate,
    shear_halo,
)

Vector = np.ndarray[Any, np.dtype[np.float64]]

_HIGH_PASS, _WINDOW = 1.5, 4.0  # pixels, equal to the cue of energy
_BATCH_PLANES = 8  # planes whose energy is stored before it is smoothed
_DOUBLINGS = 5  # energy to the power of 32: blends only planes next to the sharpest


def blend_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """Estimate the memory of an all-in-focus picture from the planes of a stack."""
    channels, size = (*source.shape, 1)[4], planes.size
    floats = size * channels + size + min(_BATCH_PLANES, size) + channels
    return MemoryEstimate(
        "An all-in-focus picture",
        (slice(0, size),),
        shear_halo(source, planes, ENERGY_REACH),
        int(DEVICE_FLOAT * floats) + HOST_FLOAT * channels,
        4 * size * channels,
        HOST_FLOAT * channels,
    )


def surface_memory(source: SampledViews, disparity: Vector) -> MemoryEstimate:
    """Estimate the memory of an all-in-focus picture on the surface of a depth map."""
    channels = (*source.shape, 1)[4]
    ends = np.array([disparity.min(), disparity.max()])
    return MemoryEstimate(
        "An all-in-focus picture",
        (slice(0, 1),),
        shear_halo(source, ends, 0),
        int(DEVICE_FLOAT * (channels + 1)) + HOST_FLOAT * (channels + 4),
        4 * channels,
        HOST_FLOAT * channels,
    )


def check_planes(depth: Any, disparities: Any) -> None:
    """Reject disparities if a depth map or a stack is present."""
    if disparities is not None and depth is not None:
        raise ValueError(
            "disparities cannot be combined with a depth map or a focal stack; omit disparities."
        )


def disparity_of(depth: Any, size: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Return the disparity of every pixel, from a depth map or an array, as float64."""
    d = checked_disparity(getattr(depth, "disparity", depth), (size[0], size[1]))
    if d.ndim == 0:
        raise ShapeError(
            f"depth must have a disparity for every pixel, shape {tuple(size)}; for one plane call "
            "refocus."
        )
    return d


def between_planes(stack: FocalStack, disparity: np.ndarray[Any, Any]) -> cla.Array:
    """Interpolate each pixel linearly between the planes below and above its disparity."""
    order = np.argsort(stack.disparities, kind="stable")
    rising = stack.disparities[order]
    data = stack.data
    if not np.array_equal(order, np.arange(order.size)):
        data = stack.device.empty(stack.shape, np.float32)
        for index, plane in enumerate(order):
            picture = stack.data[int(plane)]
            stack.device.copy_into(data, picture, index * picture.nbytes)
    position = np.interp(disparity, rising, np.arange(rising.size)).astype(np.float32)
    return _launch("between", stack, data, stack.device.upload(position))


def blended(stack: FocalStack) -> cla.Array:
    """Blend the planes of a stack by their local energy."""
    count, ny, nx = stack.shape[:3]
    device = stack.device
    maps = 4 * ny * nx * (count + _BATCH_PLANES)
    device.require_memory(stack.data.nbytes + maps, "This stack with its sharpness")
    energies = device.empty((count, ny, nx), np.float32)
    batch = device.empty((min(_BATCH_PLANES, count), ny, nx), np.float32)
    gather = Smoother(gaussian_taps(_WINDOW), device=device)
    measure = LocalEnergy(_HIGH_PASS, stack.shape[1:], device=device)
    for start in range(0, count, _BATCH_PLANES):
        planes = min(_BATCH_PLANES, count - start)
        measure(batch, stack, start=start, count=planes)
        gather(energies, batch, start=start, count=planes)
    return _launch("blend", stack, stack.data, energies, np.int32(_DOUBLINGS))


def _launch(name: str, stack: FocalStack, data: cla.Array, *more: Any) -> cla.Array:
    count, ny, nx, channels = (*stack.shape, 1)[:4]
    out = stack.device.empty(stack.shape[1:], np.float32)
    stack.device.launch_rows(
        stack.device.kernel("allinfocus.cl", name),
        (ny, nx * channels),
        out,
        data,
        *more,
        *(np.int32(n) for n in (count, ny, nx, channels)),
    )
    return out
