"""Focal stacks of light fields of any size.

A light field is a source of tiles, and one on a device is one tile. A stored one is loaded where
memory suffices, and else read tile by tile, each with a halo as wide as the planes shift its views;
the result has the same bits.
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
    """A focal stack that is computed tile by tile while it is iterated over, once.

    Yields (planes, rows, columns, pictures): three slices and float32 pictures of shape
    (planes, rows, columns[, c]), in new arrays. Leaving the loop early lets go of everything.

    Attributes
    ----------
    plan : StreamPlan
    shape : tuple of int
        (n, y, x[, c]).
    disparities, alphas : numpy.ndarray
        float64, shape (n,), as in `FocalStack`.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) of the light field, in metres.
    camera : CameraModel or None
        Of the light field.
    _parts : iterator
        The tiles that are left.

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
            "StackTiles are made one after the other and cannot be copied or pickled: copy the "
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
    """Make pictures focused on many planes, in one pass over the light field.

    Every plane is what `refocus` returns for it (without rescaling).

    Parameters
    ----------
    lf : LightField, StoredLightField or array_like
        Shape (v, u, y, x[, c]).
    alphas, disparities : array_like, optional
        Planes, shape (n,), in any order, or "START:STOP:N"; one of the two: F/F', which needs the
        spacing of the light field, or pixels a view step. Default: those of `suitable_planes`.
    aperture : int, float, str or array_like, optional
        As in `LightField.render`.
    interpolation : {"linear", "nearest", "cubic", "fourier"}
        As in `refocus`; "fourier" needs whole views.
    memory : int, optional
        Bytes for what a stored light field needs on the host and the device together, the result
        included; default half of what is free on the host, or of the device's memory if that is
        less. What does not fit is computed in tiles.
    device : Device or str, optional
        Where an array or a stored light field goes; default ``Device.open()``. Other light fields
        bring their own.

    Returns
    -------
    FocalStack
        Pictures, float32, shape (n, y, x[, c]). It keeps the weights of its views, by which depth
        makes planes equally blurred, for linear interpolation only.

    Raises
    ------
    ValueError
        If both alphas and disparities are given, or they are no finite numbers in one dimension, no
        two views overlap on a plane, the aperture does not fit, the interpolation is unknown, or a
        stored light field does not fit into the memory: its stack itself (take `stack_tiles`, or
        ``clplen stack``), its smallest tile, or whole views for "fourier".
    DeviceError
        If the stack and the light field together are larger than the device's memory.
    OSError, FormatError
        As in `stack_tiles`.

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
    chosen = _Stack.of(source, alphas, disparities, aperture, interpolation)
    if isinstance(source, StoredLightField):
        memory = memory_budget(memory, device)
        kept = _stack_bytes(chosen, source, memory, device)
        plan = plan_tiles(
            source, stack_memory(source, chosen.planes, kept=kept), memory=memory, device=device
        )
        if not plan.in_core or len(plan.planes) > 1:
            _require_tiles(chosen)
            return _gathered(chosen, source, plan, device)
        source = source.load(device)
    return stack_on_planes(source, *chosen)


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
    """Compute a focal stack tile by tile: one that may be larger than memory.

    Parameters
    ----------
    lf : LightField, StoredLightField or array_like
        As in `focal_stack`; one on a device is one tile.
    alphas, disparities, aperture, interpolation : array_like, array_like, object, str, optional
        As in `focal_stack`; several tiles without "fourier".
    memory, device : int, Device or str, optional
        As in `focal_stack`; the pictures of one tile count, not all.
    progress : callable, optional
        Called with (tiles done, tiles in all).

    Returns
    -------
    StackTiles
        Tiles that are computed as they are taken, with the bits of `focal_stack`.

    Raises
    ------
    ValueError
        As in `focal_stack`; for "fourier", which needs whole views; if the memory is too little
        for the smallest tile.
    OSError
        While iterating, if views have to be copied to a temporary file and the disk is too small.
    FormatError
        While iterating, if the file is damaged.

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
    chosen = _Stack.of(source, alphas, disparities, aperture, interpolation)
    estimates = stack_memory(source, chosen.planes)
    plan = plan_tiles(source, estimates, memory=memory, device=device)
    if not plan.in_core:
        _require_tiles(chosen)
    return StackTiles(
        plan,
        (chosen.planes.size, *source.shape[2:]),
        chosen.planes,
        chosen.ratios,
        source.spacing,
        source.camera,
        _stack_parts(chosen, source, plan, device, progress),
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
        given = {"alphas": alphas, "disparities": disparities}
        if alphas is None and disparities is None:
            given |= suitable_planes(source)
        weights = view_weights(source, aperture, None)
        planes, ratios = stack_planes(source, weights, **given)
        check_interpolation(interpolation)
        return cls(planes, ratios, weights, interpolation)


def _stack_bytes(chosen: _Stack, source: StoredLightField, memory: int, device: Device) -> int:
    """Bytes a pixel of the whole stack; refuse one that is larger than the memory."""
    shape = (chosen.planes.size, *source.shape[2:])
    nbytes = 4 * math.prod(shape)
    if nbytes > min(memory, device.memory_bytes):
        limit = (
            f"memory={memory:,}"
            if nbytes > memory
            else f"the {device.memory_bytes:,} of {device.name}"
        )
        raise ValueError(
            f"A focal stack of shape {shape} needs {nbytes:,} bytes itself, more than {limit}: "
            "take stack_tiles, or `clplen stack --memory` on the command line, which make it tile "
            "by tile."
        )
    copies = 1 if device.is_cpu else 2  # elsewhere than on a CPU it is filled on the host
    return copies * nbytes // math.prod(source.shape[2:4])


def _require_tiles(chosen: _Stack) -> None:
    """Refuse a stack whose pixels depend on whole views."""
    if chosen.interpolation == "fourier":
        raise ValueError(
            "A stack that is made in tiles takes interpolation='linear', 'nearest', 'cubic', not "
            "'fourier', which needs every pixel of a view."
        )


def _gathered(
    chosen: _Stack, source: StoredLightField, plan: StreamPlan, device: Device
) -> FocalStack:
    """Compute a stack on a device from tiles."""
    data = device.empty((chosen.planes.size, *source.shape[2:]), np.float32)
    parts = _stack_parts(chosen, source, plan, device, None)
    with device.on_host(data) as pictures:
        for group, rows, columns, values in parts:
            pictures[group, rows, columns] = values
    return stack_of(source, data, device, *chosen)


def _stack_parts(
    chosen: _Stack,
    source: Source,
    plan: StreamPlan,
    device: Device,
    progress: Progress | None,
) -> Iterator[Part]:
    with fast_source(source, plan) as fast:
        for tile, lf in read_tiles(fast, plan.tiles, device, progress):
            rows, columns = tile.inside
            for group in plan.planes:
                some = chosen._replace(planes=chosen.planes[group], ratios=chosen.ratios[group])
                stack = stack_on_planes(lf, *some)
                with device.on_host(stack.data, write=False) as pictures:
                    yield group, tile.rows, tile.columns, np.array(pictures[:, rows, columns])
            del lf, stack  # before the next tile is sent to the device
