"""Focal stacks of light fields of any size.

A light field is a source of tiles; on a device it is a single tile. A stored light field is loaded
if memory suffices. Otherwise it is read tile by tile, with a halo for the shifts of the planes; the
result is bitwise equal.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import Device, DeviceLike
from clplen.lightfield.depth.best_focus import suitable_planes
from clplen.lightfield.model.apertures import Weights
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import view_weights
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.raw_image import CameraModel, Spacing
from clplen.lightfield.refocusing.focal_stacks import (
    FocalStack,
    check_interpolation,
    stack_memory,
    stack_of,
    stack_on_planes,
    stack_planes,
)
from clplen.lightfield.streaming.tile_plan import StreamPlan, memory_budget, plan_tiles
from clplen.lightfield.streaming.tile_reading import (
    Progress,
    Source,
    as_source,
    fast_source,
    read_tiles,
)
from clplen.reprs import OneLine

Vector = np.ndarray[Any, np.dtype[np.float64]]
Pictures = np.ndarray[Any, np.dtype[np.float32]]
Part = tuple[slice, slice, slice, Pictures]


@dataclass(frozen=True, eq=False, repr=False)
class StackTiles(OneLine):
    """A focal stack that is computed tile by tile during iteration, once.

    Yields (planes, rows, columns, pictures): three slices and float32 pictures of shape
    (planes, rows, columns[, c]) in new arrays. Leaving the loop early releases all resources.

    Attributes
    ----------
    plan : StreamPlan
    shape : tuple of int
        Shape (n, y, x[, c]).
    disparities, alphas : numpy.ndarray
        Planes, float64, shape (n,), as in `FocalStack`.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    camera : CameraModel or None
        Camera of the light field.
    _parts : iterator
        Remaining tiles.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 16, 20))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     tiles = clplen.lightfield.stack_tiles(stored, disparities=[0, 1])
    ...     print(tiles.shape)
    (2, 16, 20)
    """

    plan: StreamPlan
    shape: tuple[int, ...]
    disparities: Vector
    alphas: Vector
    spacing: Spacing | None
    camera: CameraModel | None
    _parts: Iterator[Part] = field(repr=False)

    def __iter__(self) -> Iterator[Part]:
        return self._parts

    def __getstate__(self) -> dict[str, Any]:
        raise TypeError(
            "StackTiles are computed in sequence and cannot be copied or pickled: copy the "
            "pictures that they yield, or call stack_tiles in the other process."
        )


def focal_stack(
    lf: LightField | StoredLightField | ArrayLike,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    interpolation: str = "linear",
    memory: int | None = None,
    device: DeviceLike | None = None,
) -> FocalStack:
    """Render a light field refocused on many planes in one pass.

    Every plane equals `refocus` (without rescaling).

    Parameters
    ----------
    lf : LightField, StoredLightField or array_like
        Light field, shape (v, u, y, x[, c]).
    alphas, disparities : array_like, optional
        Planes, shape (n,), in any order, or "START:STOP:N": F/F', which requires the spacing, or
        pixels a view step. Only one of the two may be set; default `suitable_planes`.
    aperture : int, float, str or array_like, optional
        Aperture, see `LightField.render`.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        Interpolation, see `refocus`; "fourier" needs whole views.
    memory : int, optional
        Maximum bytes of host and device together for a stored light field, result included;
        default half of the free memory of the host, or of the device if that is less. Larger
        computations are split into tiles.
    device : Device or str, optional
        Device for an array or a stored light field; default ``Device.open()``. Other light fields
        stay on their device.

    Returns
    -------
    FocalStack
        Pictures, float32, shape (n, y, x[, c]). Weights of the views, with which depth maps correct
        interpolation blur, are stored for linear interpolation only.

    Raises
    ------
    ValueError
        If both alphas and disparities are set, or are not finite and one-dimensional; no two views
        overlap on a plane; the aperture or the interpolation is invalid; or the memory does not
        suffice for a stored light field: for its stack (call `stack_tiles`, or run ``clplen
        stack``), its smallest tile, or whole views for "fourier".
    DeviceError
        If stack and light field exceed the device's memory.
    OSError, FormatError
        See `stack_tiles`.

    Examples
    --------
    >>> plane = clplen.cameras.Plane(0.5, texture=clplen.cameras.noise(1, 64))
    >>> lf, truth = clplen.SurfaceScene(plane).light_field((5, 5), (32, 32))
    >>> stack = clplen.focal_stack(lf, disparities=[-0.5, 0, 0.5, 1])
    >>> stack.shape
    (4, 32, 32)
    >>> int(stack.to_numpy().std(axis=(1, 2)).argmax())  # the plane in focus
    2
    """
    source, device = as_source(lf, device)
    options = _Stack.of(source, alphas, disparities, aperture, interpolation)
    if isinstance(source, StoredLightField):
        memory = memory_budget(memory, device)
        result_bytes = _stack_bytes(options, source, memory, device)
        plan = plan_tiles(
            source,
            stack_memory(source, options.planes, result_bytes=result_bytes),
            memory=memory,
            device=device,
        )
        if not plan.in_core or len(plan.planes) > 1:
            _require_tiles(options)
            return _gather_tiles(options, source, plan, device)
        source = source.load(device)
    return stack_on_planes(source, *options)


def stack_tiles(
    lf: LightField | StoredLightField | ArrayLike,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    interpolation: str = "linear",
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> StackTiles:
    """Compute a focal stack tile by tile, even if it exceeds the memory.

    Parameters
    ----------
    lf : LightField, StoredLightField or array_like
        Light field, see `focal_stack`; on a device it is one tile.
    alphas, disparities, aperture, interpolation : array_like, array_like, object, str, optional
        Options of `focal_stack`; "fourier" only for a single tile.
    memory, device : int, Device or str, optional
        Memory and device, see `focal_stack`; only the pictures of one tile count.
    progress : callable, optional
        Function called with (tiles done, number of tiles).

    Returns
    -------
    StackTiles
        Tiles that are computed on iteration, bitwise equal to `focal_stack`.

    Raises
    ------
    ValueError
        See `focal_stack`; if "fourier" is used with tiles; or if the memory does not suffice for
        the smallest tile.
    OSError
        If, during iteration, the disk is too small for a temporary copy of the views.
    FormatError
        If, during iteration, the file is damaged.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 32, 32))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     tiles = clplen.lightfield.stack_tiles(stored, disparities=[-1, 0, 1])
    ...     clplen.io.write_stack("stack.ome.tif", tiles)
    >>> clplen.io.read_stack("stack.ome.tif").shape
    (3, 32, 32)
    """
    source, device = as_source(lf, device)
    options = _Stack.of(source, alphas, disparities, aperture, interpolation)
    estimates = stack_memory(source, options.planes)
    plan = plan_tiles(source, estimates, memory=memory, device=device)
    if not plan.in_core:
        _require_tiles(options)
    return StackTiles(
        plan,
        (options.planes.size, *source.shape[2:]),
        options.planes,
        options.ratios,
        source.spacing,
        source.camera,
        _stack_parts(options, source, plan, device, progress),
    )


class _Stack(NamedTuple):
    """Checked planes, weights of the views and interpolation of a stack."""

    planes: Vector
    ratios: Vector
    weights: Weights
    interpolation: str

    @classmethod
    def of(
        cls, source: Source, alphas: Any, disparities: Any, aperture: Any, interpolation: str
    ) -> _Stack:
        planes_options = {"alphas": alphas, "disparities": disparities}
        if alphas is None and disparities is None:
            planes_options |= suitable_planes(source)
        weights = view_weights(source, aperture, None)
        planes, ratios = stack_planes(source, weights, **planes_options)
        check_interpolation(interpolation)
        return cls(planes, ratios, weights, interpolation)


def _stack_bytes(options: _Stack, source: StoredLightField, memory: int, device: Device) -> int:
    """Return the bytes a pixel of the whole stack; reject a stack larger than the memory."""
    shape = (options.planes.size, *source.shape[2:])
    nbytes = 4 * math.prod(shape)
    if nbytes > min(memory, device.memory_bytes):
        limit = (
            f"memory={memory:,}"
            if nbytes > memory
            else f"the {device.memory_bytes:,} of {device.name}"
        )
        raise ValueError(
            f"A focal stack of shape {shape} needs {nbytes:,} bytes, more than {limit}; call "
            "stack_tiles, or run `clplen stack --memory`, which compute it tile by tile."
        )
    copies = 1 if device.is_cpu else 2  # elsewhere the host fills a second copy
    return copies * nbytes // math.prod(source.shape[2:4])


def _require_tiles(options: _Stack) -> None:
    """Reject interpolation that needs whole views."""
    if options.interpolation == "fourier":
        raise ValueError(
            "A stack in tiles needs interpolation='linear', 'nearest' or 'cubic', got "
            "'fourier', which needs every pixel of a view."
        )


def _gather_tiles(
    options: _Stack, source: StoredLightField, plan: StreamPlan, device: Device
) -> FocalStack:
    """Compute a stack on a device from tiles."""
    data = device.empty((options.planes.size, *source.shape[2:]), np.float32)
    parts = _stack_parts(options, source, plan, device, None)
    with device.on_host(data) as pictures:
        for group, rows, columns, values in parts:
            pictures[group, rows, columns] = values
    return stack_of(source, data, device, *options)


def _stack_parts(
    options: _Stack,
    source: Source,
    plan: StreamPlan,
    device: Device,
    progress: Progress | None,
) -> Iterator[Part]:
    with fast_source(source, plan) as fast:
        for tile, lf in read_tiles(fast, plan.tiles, device, progress):
            rows, columns = tile.inside
            for group in plan.planes:
                part = options._replace(planes=options.planes[group], ratios=options.ratios[group])
                stack = stack_on_planes(lf, *part)
                with device.on_host(stack.data, write=False) as pictures:
                    yield group, tile.rows, tile.columns, np.array(pictures[:, rows, columns])
            del lf, stack  # before the next tile is sent to the device
