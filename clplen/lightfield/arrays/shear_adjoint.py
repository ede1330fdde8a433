"""The adjoint of refocusing: pictures of planes spread back to the views they are means of."""

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

_MOST_PLANES = 64  # of one launch
_NORM_FLOATS = 1 << 23  # of the weights that samples use, in one launch
_LOCAL_BYTES = 512 * 1024  # of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # what an OpenCL runtime may keep for itself
_WIDEST = 16  # chunks of a block
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
    """The transpose of `shear_sum`, of float32 pictures of every plane.

    Every picture is divided by the weights that `shear_sum` divides by, and each view is the sum of
    the pictures moved back by its shifts, interpolated linearly and 0 outside, times its weight.
    The result has the same bits in every run.
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
    """Pictures over the weights of the samples that each pixel is made of."""
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
    """Return the tables and numbers of `divide` for some planes; keep them on the device."""
    key = ("shear norm", part.key)
    kept: tuple[list[cla.Array], tuple[int, ...]] | None = device.tables.get(key)
    if kept is not None:
        return kept
    norm = weight_norms(part, part.samples)
    down, below = part.down.T.astype(np.int32), part.below.T.astype(np.float32)
    tables = [device.upload(table) for table in (norm.table, down, below)]
    numbers = (norm.table.shape[2], norm.near, norm.far)
    return device.tables.keep(key, (tables, numbers), table_bytes(tables))


def _uploaded(views: Views, device: Device) -> list[cla.Array]:
    """Return the tables of some planes on the device; keep them for later calls."""
    key = ("shear adjoint", views.key)
    kept: list[cla.Array] | None = device.tables.get(key)
    if kept is not None:
        return kept
    tables = [device.upload(table) for table in spread_tables(views)]
    return device.tables.keep(key, tables, table_bytes(tables))


def _spread_blocks(out: cla.Array, shares: cla.Array, views: Views, device: Device) -> bool:
    """Rows of all views of one v an item; False where local memory does not suffice."""
    lanes = vector_lanes(device)[0]
    chosen = _block(views, device)
    if chosen is None:
        return False
    width, pitch, step = chosen
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
    """(width, pitch, planes of a launch) of the least expected cost."""
    lanes, vectors = vector_lanes(device)
    chunk, U = lanes * vectors, views.weights.shape[1]
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    extra = int(np.ptp(views.right, axis=-1).max()) * views.channels
    first = views.channels // chunk + 1
    last = max(first, min(_WIDEST, -(-(views.samples + views.channels) // chunk)))
    best, least = None, np.inf
    for width in range(first * chunk, last * chunk + 1, chunk):
        pitch = -(-(width + max(extra, views.channels)) // lanes) * lanes
        most = min(_MOST_PLANES, (room - width - views.channels - 2 * lanes) // pitch)
        if most < 1:
            continue
        launches = -(-views.planes // most)
        columns = -(-views.samples // (width - views.channels))
        # samples of the views, of a plane's row, and what the start of a row is worth
        cost = columns * (U * (width + 2 * lanes + launches * width / views.planes)
                          + 3 * pitch + 20 * lanes)  # fmt: skip
        if cost < least:
            best, least = (width, pitch, -(-views.planes // launches)), cost
    return best


def _spread_samples(out: cla.Array, shares: cla.Array, views: Views, device: Device) -> None:
    """A sample of some rows of a view an item."""
    kernel = device.kernel("shear_adjoint.cl", "spread_samples", SAMPLE="float", HEIGHT=_HEIGHT)
    V, U = views.weights.shape
    for first in range(0, views.planes, _MOST_PLANES):
        part = views.part(first, _MOST_PLANES)
        device.launch(
            kernel,
            (views.samples, -(-views.ny // _HEIGHT), V * U),
            *(out, shares, *_uploaded(part, device)),
            *_numbers(part, first),
            operations=part.operations,
        )


def _numbers(views: Views, first: int) -> list[Any]:
    """What both forms take after the tables."""
    sizes = (views.weights.shape[1], views.ny, views.samples, views.channels, views.planes, first)
    return [np.int32(n) for n in (*sizes, int(first > 0))]
