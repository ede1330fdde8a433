"""Focal stacks, depth maps and all-in-focus pictures of light fields larger than memory.

A light field is read tile by tile, each with a halo as wide as the planes shift its views and the
windows of a cue reach, and every tile goes through the same functions as a whole light field. What
depends on the whole picture is found in a pass before (`clplen.lightfield.depth.cue.TwoPasses`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.compute.device import Device, DeviceLike, as_device
from clplen.lightfield.arrays.ray_samples import INTERPOLATIONS
from clplen.lightfield.depth.all_in_focus import (
    blend_memory,
    blended,
    check_planes,
    disparity_of,
    surface_memory,
)
from clplen.lightfield.depth.best_focus import default_disparities
from clplen.lightfield.depth.cue import TwoPasses
from clplen.lightfield.depth.depth_maps import (
    DepthMap,
    cue_named,
    default_cue,
    depth_map_in_memory,
    distinct_planes,
    with_depth,
)
from clplen.lightfield.model.alpha_law import require_overlap
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.rendering import view_weights
from clplen.lightfield.model.stored_light_field import StoredLightField
from clplen.lightfield.raw.raw_image import CameraModel, Spacing
from clplen.lightfield.refocusing.focal_stacks import (
    FocalStack,
    focal_stack_in_memory,
    on_surface,
    stack_memory,
    stack_of,
    stack_on_planes,
    stack_planes,
)
from clplen.lightfield.streaming.tile_plan import StreamPlan, Tile, bands, memory_budget, plan_tiles
from clplen.lightfield.streaming.tile_reading import (
    Progress,
    TileFunction,
    fast_source,
    process_tiles,
    report,
)
from clplen.reprs import OneLine

Array = np.ndarray[Any, Any]
Vector = np.ndarray[Any, np.dtype[np.float64]]
Pictures = np.ndarray[Any, np.dtype[np.float32]]
Part = tuple[slice, slice, slice, Pictures]


@dataclass(frozen=True, eq=False, repr=False)
class StackTiles(OneLine):
    """A focal stack that is made tile by tile while it is iterated over, once.

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
    ...     tiles = clplen.lightfield.stream_stack(stored, disparities=[0, 1])
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
            "pictures that they yield, or call stream_stack in the other process."
        )


def stream_stack(
    source: StoredLightField,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    interpolation: str = "linear",
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> StackTiles:
    """The focal stack of a stored light field, with the bits of `focal_stack`, tile by tile.

    Parameters
    ----------
    source : StoredLightField
        A stored light field.
    alphas, disparities, aperture, interpolation : array_like, array_like, object, str, optional
        As in `focal_stack`, without "fourier".
    memory : int, optional
        Bytes for samples, pictures and what is between, on the host and the device together.
        Default half of what is free on the host, or of the device's memory if that is less.
    device : Device or str, optional
        Default ``Device.open()``.
    progress : callable, optional
        Called with (tiles done, tiles in all).

    Returns
    -------
    StackTiles
        Tiles that are computed as they are taken.

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
    ...     tiles = clplen.lightfield.stream_stack(stored, disparities=[-1, 0, 1])
    ...     clplen.io.write_stack("stack.ome.tif", tiles)
    >>> clplen.io.read_stack("stack.ome.tif").shape
    (3, 32, 32)
    """
    return _stack_tiles(
        source,
        {"alphas": alphas, "disparities": disparities},
        aperture,
        interpolation,
        memory,
        _check_source(source, device),
        progress,
    )


def assemble_stack(
    source: StoredLightField,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    aperture: Any = None,
    interpolation: str = "linear",
    memory: int | None = None,
    device: DeviceLike | None = None,
) -> FocalStack:
    """The focal stack of a stored light field on a device: whole where it fits, else from tiles."""
    device = _check_source(source, device)
    given: dict[str, Any] = {"alphas": alphas, "disparities": disparities}
    weights = view_weights(source, aperture, None)
    planes, ratios = stack_planes(source, weights, **given)
    shape = (planes.size, *source.shape[2:])
    nbytes = 4 * math.prod(shape)
    budget = memory_budget(memory, device)
    if nbytes > min(budget, device.memory_bytes):
        limit = (
            f"memory={budget:,}"
            if nbytes > budget
            else f"the {device.memory_bytes:,} of {device.name}"
        )
        raise ValueError(
            f"A focal stack of shape {shape} needs {nbytes:,} bytes itself, more than {limit}: "
            "take stream_stack, or `clplen stack --memory` on the command line, which make it tile "
            "by tile."
        )
    copies = 1 if device.is_cpu else 2  # elsewhere than on a CPU it is filled on the host
    kept = 4 * copies * math.prod(shape) // math.prod(source.shape[2:4])
    plan = plan_tiles(source, stack_memory(source, planes, kept=kept), memory=budget, device=device)
    if plan.in_core and len(plan.planes) == 1:
        lf = source.load(device)
        return focal_stack_in_memory(lf, **given, aperture=aperture, interpolation=interpolation)
    tiles = _stack_tiles(source, given, aperture, interpolation, budget, device, None, kept=kept)
    data = device.empty(shape, np.float32)
    with device.on_host(data) as pictures:
        for group, rows, columns, values in tiles:
            pictures[group, rows, columns] = values
    return stack_of(source, data, device, planes, ratios, weights, interpolation)


def _stack_tiles(
    source: StoredLightField,
    given: dict[str, Any],
    aperture: Any,
    interpolation: str,
    memory: int | None,
    device: Device,
    progress: Progress | None,
    *,
    kept: int = 0,
) -> StackTiles:
    """`stream_stack`, where so many bytes a pixel are held besides."""
    if interpolation not in INTERPOLATIONS:
        known = ", ".join(map(repr, INTERPOLATIONS))
        raise ValueError(
            f"A stack that is made in tiles takes interpolation={known}, not {interpolation!r}"
            + (", which needs every pixel of a view." if interpolation == "fourier" else ".")
        )
    weights = view_weights(source, aperture, None)
    planes, ratios = stack_planes(source, weights, **given)
    estimates = stack_memory(source, planes, kept=kept)
    plan = plan_tiles(source, estimates, memory=memory, device=device)

    def process(tile: Tile, lf: LightField) -> Iterator[Part]:
        for group in plan.planes:
            some = planes[group], ratios[group], weights, interpolation
            pictures = _pictures(stack_on_planes(lf, *some), tile)
            yield group, tile.rows, tile.columns, pictures

    return StackTiles(
        plan,
        (planes.size, *source.shape[2:]),
        planes,
        ratios,
        source.spacing,
        source.camera,
        _stack_parts(source, plan, process, device, progress),
    )


def stream_depth(
    source: StoredLightField,
    *,
    alphas: ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    cue: str | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> DepthMap:
    """The depth map of a stored light field, as `depth_map` finds it, tile by tile.

    Parameters
    ----------
    source : StoredLightField
        A stored light field.
    alphas, disparities, cue : array_like, array_like, str, optional
        As in `depth_map`. "combined" reads all samples twice.
    memory, device, progress : int, Device or str, callable, optional
        As in `stream_stack`; the maps count too.

    Returns
    -------
    DepthMap
        Disparity and confidence of every pixel.

    Raises
    ------
    ValueError
        As in `depth_map`; if the memory is too little for the smallest tile.
    OSError, FormatError
        As in `stream_stack`.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 32, 32))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     depth = clplen.lightfield.stream_depth(stored, disparities=[-1, 0, 1], cue="energy")
    >>> depth.disparity.shape
    (32, 32)
    """
    device = _check_source(source, device)
    name = default_cue(source) if cue is None else cue
    chosen = cue_named(name)
    planes = distinct_planes(source, alphas, disparities)
    plan = plan_tiles(source, [chosen.memory(source, planes)], memory=memory, device=device)
    if plan.in_core:
        result = depth_map_in_memory(source.load(device), disparities=planes, cue=name)
        report(progress, 1, 1)
        return result
    passes = chosen.two_passes
    lost = np.zeros(source.shape[2:4] if passes else (0, 0), np.bool_)
    maps = DepthMap(*(np.empty(source.shape[2:4], np.float32) for _ in range(4)))
    with fast_source(source, plan) as fast:
        known = _surveyed(fast, plan, passes, device) if passes else None

        def process(tile: Tile, lf: LightField) -> Iterator[DepthMap]:
            if passes is None:
                disparity, confidence = chosen.disparity(lf, planes)
            else:
                part = passes.disparity(lf, planes, known, inside=tile.inside)
                disparity, confidence = part.disparity, part.confidence
                lost[tile.rows, tile.columns] = part.lost[tile.inside]
            yield with_depth(source, disparity[tile.inside], confidence[tile.inside])

        for tile, part in process_tiles(fast, plan.tiles, process, device, progress):
            for attribute, values in vars(part).items():
                getattr(maps, attribute)[tile.rows, tile.columns] = values
    if passes is not None:
        maps.confidence[...] = passes.merge_confidence(maps.confidence, lost)
    return maps


def stream_all_in_focus(
    source: StoredLightField,
    *,
    depth: DepthMap | ArrayLike | None = None,
    disparities: ArrayLike | None = None,
    memory: int | None = None,
    device: DeviceLike | None = None,
    progress: Progress | None = None,
) -> Pictures:
    """The all-in-focus picture of a stored light field, as `all_in_focus` makes it, tile by tile.

    Parameters
    ----------
    source : StoredLightField
        A stored light field.
    depth, disparities : DepthMap, array_like, optional
        As in `all_in_focus`.
    memory, device, progress : int, Device or str, callable, optional
        As in `stream_stack`; the picture counts too.

    Returns
    -------
    numpy.ndarray
        float32, shape (y, x[, c]).

    Raises
    ------
    ValueError, ShapeError
        As in `all_in_focus`; if the memory is too little for the smallest tile.
    OSError, FormatError
        As in `stream_stack`.

    Examples
    --------
    >>> clplen.write_lightfield("l.h5", clplen.LightField.from_array(np.ones((3, 3, 32, 32))))
    >>> with clplen.open_lightfield("l.h5") as stored:
    ...     print(clplen.lightfield.stream_all_in_focus(stored, disparities=[-1, 0, 1]).shape)
    (32, 32)
    """
    device = _check_source(source, device)
    check_planes(depth, disparities)
    if depth is not None:
        surface = disparity_of(depth, source.shape[2:4])
        require_overlap(source, source.weights, surface)
        estimate = surface_memory(source, surface)
    else:
        given = default_disparities(source) if disparities is None else disparities
        planes, ratios = stack_planes(source, source.weights, alphas=None, disparities=given)
        estimate = blend_memory(source, planes)
    plan = plan_tiles(source, [estimate], memory=memory, device=device)

    def process(tile: Tile, lf: LightField) -> Iterator[Pictures]:
        if depth is None:
            pictures = blended(stack_on_planes(lf, planes, ratios, lf.weights))
        else:
            pictures = on_surface(lf, surface[tile.outer_rows, tile.outer_columns])
        yield device.download(pictures)[tile.inside]

    out = np.empty(source.shape[2:], np.float32)
    with fast_source(source, plan) as fast:
        for tile, picture in process_tiles(fast, plan.tiles, process, device, progress):
            out[tile.rows, tile.columns] = picture
    return out


def _check_source(source: Any, device: DeviceLike | None) -> Device:
    if not isinstance(source, StoredLightField):
        raise TypeError(
            "A stream_ function takes a StoredLightField, as open_lightfield or "
            f"StoredLightField.from_array gives it, not {type(source).__name__}."
        )
    return as_device(device)


def _pictures(stack: FocalStack, tile: Tile) -> Pictures:
    """Some planes of a tile on the host, without its halo."""
    with stack.device.on_host(stack.data, write=False) as pictures:
        rows, columns = tile.inside
        return np.array(pictures[:, rows, columns])


def _stack_parts(
    source: StoredLightField,
    plan: StreamPlan,
    process: TileFunction,
    device: Device,
    progress: Progress | None,
) -> Iterator[Part]:
    with fast_source(source, plan) as fast:
        for _, part in process_tiles(fast, plan.tiles, process, device, progress):
            yield part


def _surveyed(source: StoredLightField, plan: StreamPlan, passes: TwoPasses, device: Device) -> Any:
    """What a cue learns of the whole light field, in bands of its rows."""
    survey = passes.survey(source)

    def process(tile: Tile, lf: LightField) -> Iterator[None]:
        survey.add(tile.rows, lf)
        yield None

    for _ in process_tiles(source, bands(source.shape[2:4], plan.band_rows), process, device, None):
        pass
    return survey.finish()
