"""Adjoint of the refocusing by shear: pictures of planes back to views."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.drivers.failures import is_out_of_memory
from clplen.errors import DeviceError, KernelBuildError
from clplen.lightfield.arrays.shear import table_bytes, vector_lanes
from clplen.lightfield.arrays.shear_tables import (
    Table,
    Views,
    split_views,
    spread_tables,
    weight_norms,
)

_MAX_PLANES = 64  # planes of one launch
_NORM_FLOATS = 1 << 23  # floats of the table of weights in one launch
_LOCAL_BYTES = 512 * 1024  # bytes of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # bytes reserved for the OpenCL runtime
_MAX_CHUNKS = 16  # chunks of a block
_HEIGHT = 4  # rows of a GPU's work-item
_FORM = "shear adjoint blocks"


def shear_adjoint(
    pictures: cla.Array,
    shape: tuple[int, ...],
    weights: Table,
    shift_y: Table,
    shift_x: Table,
    *,
    device: Device,
    total: bool = False,
) -> cla.Array:
    """Apply the transpose of `shear_sum` to float32 pictures of every plane.

    Each picture is divided by the weights of `shear_sum`. Each view is its weight times the sum of
    the pictures shifted back, with linear interpolation and zeros outside. Results are bitwise
    reproducible.
    """
    views = split_views(shape, weights, shift_y, shift_x)
    light_field = 4 * int(np.prod(shape, dtype=np.int64))
    needed = light_field + (0 if total else int(pictures.nbytes))
    device.require_memory(needed, "The light field of these pictures")
    shares = pictures if total else _divided(pictures, views, device)
    out = device.empty(shape, np.float32)
    if device.rows and _FORM not in device.tuning.set_aside:
        try:
            if _spread_blocks(out, shares, views, device):
                return out
        except (KernelBuildError, DeviceError) as error:
            if is_out_of_memory(error.__cause__):
                raise
            device.tuning.leave(_FORM, error)
    _spread_samples(out, shares, views, device)
    return out


def _lane_defines(device: Device) -> dict[str, Any]:
    lanes, vectors = vector_lanes(device)
    return {"LANES": lanes, "VECTORS": vectors}


def _divided(pictures: cla.Array, views: Views, device: Device) -> cla.Array:
    """Return the pictures over the weights of the samples that contribute to each pixel."""
    shares = device.empty(pictures.shape, np.float32)
    defines = _lane_defines(device) if device.rows else {}
    kernel = device.kernel("shear_adjoint.cl", "divide", SAMPLE="float", **defines)
    V = len(views.weights)
    step = max(1, _NORM_FLOATS // ((V + 1) * views.samples))
    for first in range(0, views.planes, step):
        part = views.part(first, step)
        tables, numbers = _norm_tables(part, device)
        sizes = (V, views.ny, views.samples, part.planes, first, *numbers)
        device.launch_rows(
            kernel,
            (part.planes, views.ny, views.samples),
            *(shares, pictures, *tables),
            *(np.int32(n) for n in sizes),
        )
    return shares


def _norm_tables(part: Views, device: Device) -> tuple[list[cla.Array], tuple[int, ...]]:
    """Return the cached tables and numbers of `divide` for some planes."""
    key = ("shear norm", part.key)
    cached: tuple[list[cla.Array], tuple[int, ...]] | None = device.tables.get(key)
    if cached is not None:
        return cached
    norm = weight_norms(part, part.samples)
    down, fraction = part.down.T.astype(np.int32), part.fraction_y.T.astype(np.float32)
    tables = [device.upload(table) for table in (norm.table, down, fraction)]
    numbers = (norm.table.shape[2], norm.near, norm.far)
    return device.tables.keep(key, (tables, numbers), table_bytes(tables))


def _uploaded(views: Views, device: Device) -> list[cla.Array]:
    """Return the cached tables of some planes on the device."""
    key = ("shear adjoint", views.key)
    cached: list[cla.Array] | None = device.tables.get(key)
    if cached is not None:
        return cached
    tables = [device.upload(table) for table in spread_tables(views)]
    return device.tables.keep(key, tables, table_bytes(tables))


def _spread_blocks(out: cla.Array, shares: cla.Array, views: Views, device: Device) -> bool:
    """Enqueue rows of all views of one v per item; return False if local memory is too small."""
    lanes = vector_lanes(device)[0]
    block = _block(views, device)
    if block is None:
        return False
    width, pitch, step = block
    defines = {"CHANNELS": views.channels} if views.channels in (1, 3) else {}
    kernel = device.kernel(
        "shear_adjoint.cl", "spread_blocks", SAMPLE="float", **_lane_defines(device), **defines
    )
    V = len(views.weights)
    columns = -(-views.samples // (width - views.channels))
    for first in range(0, views.planes, step):
        part = views.part(first, step)
        second = width + max(views.channels, lanes) + lanes
        device.launch(
            kernel,
            (columns, views.ny, V),
            *(out, shares, *_uploaded(part, device)),
            *_numbers(part, first),
            *(np.int32(n) for n in (width, pitch)),
            *(cl.LocalMemory(4 * n) for n in (part.planes * pitch, second)),
            group=(1, 1, 1),
            operations=part.operations,
        )
    return True


def _block(views: Views, device: Device) -> tuple[int, int, int] | None:
    """Return (width, pitch, planes of a launch) of the least expected cost."""
    lanes, vectors = vector_lanes(device)
    chunk, U = lanes * vectors, views.weights.shape[1]
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    extra = int(np.ptp(views.right, axis=-1).max()) * views.channels
    first = views.channels // chunk + 1
    last = max(first, min(_MAX_CHUNKS, -(-(views.samples + views.channels) // chunk)))
    best, least_cost = None, np.inf
    for width in range(first * chunk, last * chunk + 1, chunk):
        pitch = -(-(width + max(extra, views.channels)) // lanes) * lanes
        limit = min(_MAX_PLANES, (room - width - views.channels - 2 * lanes) // pitch)
        if limit < 1:
            continue
        launches = -(-views.planes // limit)
        columns = -(-views.samples // (width - views.channels))
        # samples of the views, of a plane's row, and the cost of starting a row
        cost = columns * (U * (width + 2 * lanes + launches * width / views.planes)
                          + 3 * pitch + 20 * lanes)  # fmt: skip
        if cost < least_cost:
            best, least_cost = (width, pitch, -(-views.planes // launches)), cost
    return best


def _spread_samples(out: cla.Array, shares: cla.Array, views: Views, device: Device) -> None:
    """Enqueue a sample of some rows of a view per item."""
    kernel = device.kernel("shear_adjoint.cl", "spread_samples", SAMPLE="float", HEIGHT=_HEIGHT)
    V, U = views.weights.shape
    for first in range(0, views.planes, _MAX_PLANES):
        part = views.part(first, _MAX_PLANES)
        device.launch(
            kernel,
            (views.samples, -(-views.ny // _HEIGHT), V * U),
            *(out, shares, *_uploaded(part, device)),
            *_numbers(part, first),
            operations=part.operations,
        )


def _numbers(views: Views, first: int) -> list[Any]:
    """Return the numbers that both forms take after the tables."""
    sizes = (views.weights.shape[1], views.ny, views.samples, views.channels, views.planes, first)
    return [np.int32(n) for n in (*sizes, int(first > 0))]
