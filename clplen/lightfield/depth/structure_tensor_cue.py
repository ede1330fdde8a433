"""Cue of the structure tensor: disparity from the orientation of epipolar-plane images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.lightfield.arrays.smoothing import Smoother, gaussian_taps
from clplen.lightfield.depth.cue import (
    BATCH_PLANES,
    Cue,
    Map,
    depth_memory,
    nearest_zero,
    require_maps,
)
from clplen.lightfield.depth.sheared_views import add_colours, launch_sheared, view_tables
from clplen.lightfield.model.alpha_law import unit_steps
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sampled_views import SampledViews
from clplen.lightfield.refocusing.focal_stacks import MemoryEstimate

Table = np.ndarray[Any, Any]
Vector = np.ndarray[Any, np.dtype[np.float64]]

_WINDOW = 2.0  # pixels: Gaussian over which the tensor is averaged
_STEP = 0.25  # pixels a view step: maximum distance between shears
_REACH = 0.75  # of a step: maximum deviation of an orientation from its shear


def structure_disparity(lf: LightField, planes: Vector) -> tuple[Map, Map]:
    """Return the disparity of the most coherent orientation and its coherence, per pixel.

    Shears are at most 0.25 px a view step apart. Tensors of rows and columns of views are averaged
    over a Gaussian of 2 pixels and summed by coherence.
    """
    _require_rows(lf)
    device = lf.device
    ny, nx = lf.shape[2:4]
    require_maps(lf, 9 + (6 if len(lf.shape) == 5 else 0), 6)
    shears, step = _shears(planes)
    best, second = (device.zeros((ny, nx), np.float32) for _ in range(2))
    position = device.upload(np.full((ny, nx), nearest_zero(planes), np.float32))
    tensors = device.empty((6, ny, nx), np.float32)
    gather = Smoother(gaussian_taps(_WINDOW), device=device)
    for shear in shears:
        gather(tensors, epi_tensors(lf, float(shear)), start=0, count=6)
        device.launch_rows(
            device.kernel("coherence.cl", "most_coherent"),
            (ny, nx),
            *(best, second, position, tensors),
            *(np.float32(value) for value in (shear, _REACH * step)),
            *(np.int32(n) for n in (ny, nx)),
        )
    confidence = device.download(best) - device.download(second)
    result = np.clip(device.download(position), planes[0], planes[-1])
    return result.astype(np.float32), confidence.clip(0, 1)


def _require_rows(lf: LightField) -> None:
    """Reject positions whose neighbours in the arrays are not neighbours in space."""
    if lf.positions is None:
        return
    for axis in (0, 1):
        step = np.diff(lf.positions, axis=axis)
        along, across = step[..., axis], step[..., 1 - axis]
        if not ((np.sign(along) == np.sign(along.sum())) & (np.abs(across) < np.abs(along))).all():
            raise ValueError(
                "cue='structure-tensor' compares neighbouring views in rows and columns, which "
                "these positions do not form; use another cue."
            )


def epi_tensors(lf: LightField, shear: float) -> cla.Array:
    """Return sums of (Lx Lx, Lx Lu, Lu Lu) of the light field sheared by a plane."""
    ny, nx, channels = (*lf.shape[2:], 1)[:3]
    J = lf.device.empty((6, ny, nx, channels), np.float32)
    for axis in (0, 1):
        views, links = _pairs(lf, 1 - axis)
        weights = np.where(links == 0, 0, lf.weights.ravel()[views])
        tables = view_tables(lf, np.array([shear]), views, weights, links)
        sizes = (np.int32(n) for n in (views.size // 2, axis, 3 * axis))
        launch_sheared(lf, ("tensor.cl", "epi_tensor"), 1, (J, lf.data, *tables, *sizes))
    return add_colours(J, lf.device)


def _pairs(lf: LightField, along: int) -> tuple[Table, Vector]:
    """Return pairs of weighted views, half a row (along = 1) or column (0) of views apart.

    Gives numbers (2 n,) and inverse distances in view steps; a dummy pair of weight 0 comes first.
    """
    numbers = np.arange(lf.weights.size).reshape(lf.weights.shape)
    steps = -unit_steps(lf)[..., along]
    if along == 0:
        numbers, steps = numbers.T, steps.T
    result = [(0, 0, 0.0)]
    for views, positions in zip(numbers, steps, strict=True):
        lit = lf.weights.ravel()[views] > 0
        views, positions = views[lit], positions[lit]
        half = max(views.size // 2, 1)
        distance = positions[half:] - positions[:-half]
        result += [
            (m, n, 1 / step)
            for m, n, step in zip(views, views[half:], distance, strict=False)
            if step != 0
        ]
    pairs = np.array(result)
    return pairs[:, :2].astype(int).ravel(), np.repeat(pairs[:, 2], 2)


def _shears(planes: Vector) -> tuple[Vector, float]:
    """Return (shears, step between them) over the range of the planes."""
    low, high = float(planes[0]), float(planes[-1])
    count = int(np.ceil((high - low) / _STEP)) + 1
    shears = np.linspace(low, high, count)
    return shears, float(shears[1] - shears[0])


def structure_memory(source: SampledViews, planes: Vector) -> MemoryEstimate:
    """Estimate the memory of `structure_disparity`; the gradient widens its window by a pixel."""
    channels = (*source.shape, 1)[4]
    return depth_memory(
        "structure-tensor",
        source,
        planes,
        reach=gaussian_taps(_WINDOW).size,
        floats=6 * channels + 19,
        largest=min(BATCH_PLANES, planes.size) * channels,
    )


CUE = Cue(structure_disparity, structure_memory)
