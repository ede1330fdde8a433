"""Refocus by shear: shift views, interpolate, and sum them on many planes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.drivers.failures import is_out_of_memory
from clplen.errors import DeviceError, KernelBuildError
from clplen.lightfield.arrays.shear_tables import (
    Norm,
    Table,
    Views,
    kernel_tables,
    split_views,
    weight_norms,
)
from clplen.lightfield.arrays.stored_samples import C_TYPE

_BLOCK_PLANES = 64  # planes of one launch
_LOCAL_BYTES = 1024 * 1024  # bytes of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # bytes reserved for the OpenCL runtime
_MAX_CHUNKS = 16  # chunks of a block
_ITEMS_PER_CORE = 8  # balances the load: no core waits long for the last item
_MIN_WIDTH_RATIO = 1.5  # ratio of the widths of two blocks that are timed separately
_MAX_TIMED_BLOCKS = 4  # number of blocks that are timed


@dataclass(frozen=True)
class _Blocks:
    """Block of samples of a work-item of shear_blocks, and its share of the cost of a plane."""

    planes: int
    width: int
    height: int
    pitch: int
    cost: float

    @property
    def label(self) -> str:
        """Name of these blocks in the tuning records."""
        return f"blocks of {self.planes} x {self.width}"


def vector_lanes(device: Device) -> tuple[int, int]:
    """Return the floats of a vector and the vectors summed at a time (two registers for each)."""
    lanes = min(max(int(device.cl_device.native_vector_width_float), 4), 16)
    return lanes, 8 if lanes == 16 else 6


def _candidate_blocks(views: Views, device: Device) -> list[_Blocks]:
    """Return blocks that fit the device's local memory, the cheapest first."""
    lanes, vectors = vector_lanes(device)
    chunk = lanes * vectors
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    items = _ITEMS_PER_CORE * int(device.cl_device.max_compute_units)
    first = views.channels // chunk + 1
    last = max(first, min(_MAX_CHUNKS, -(-(views.samples + views.channels) // chunk)))
    passes = {-(-views.planes // limit) for limit in (1, 2, 4, 8, 16, 32, _BLOCK_PLANES)}
    candidates = []
    for planes in sorted({-(-views.planes // n) for n in passes}):
        spread = _spread(views, planes)
        for width in range(first * chunk, last * chunk + 1, chunk):
            candidates.append(_blocks(views, planes, width, spread, room, items, lanes))
    return sorted((b for b in candidates if b), key=lambda b: b.cost)


def _blocks_to_time(blocks: list[_Blocks]) -> list[_Blocks]:
    """Return the cheapest blocks that differ clearly from each other."""
    distinct: list[_Blocks] = []
    for b in blocks:
        if all(
            b.planes != o.planes or not 1 / _MIN_WIDTH_RATIO < b.width / o.width < _MIN_WIDTH_RATIO
            for o in distinct
        ):
            distinct.append(b)
    return distinct[:_MAX_TIMED_BLOCKS]


def _spread(views: Views, planes: int) -> tuple[float, int]:
    """Return the largest shift between planes of one launch, in rows (mean over v) and samples."""
    first = np.arange(0, views.planes, planes)
    rows, pixels = (
        np.maximum.reduceat(a, first) - np.minimum.reduceat(a, first)
        for a in (views.down, views.right)
    )
    return float(rows.mean(axis=1).max()), int(pixels.max()) * views.channels


def _blocks(
    views: Views,
    planes: int,
    width: int,
    spread: tuple[float, int],
    room: int,
    items: int,
    lanes: int,
) -> _Blocks | None:
    """Return blocks of a width, with a height set by local memory (``room``) and the item count.

    The cost counts vectors summed; a fetched one costs 8, a row start 40 (2 cores, 512 bits).
    """
    pitch = -(-(width + max(spread[1], views.channels)) // lanes) * lanes
    columns = -(-views.samples // (width - views.channels))
    second = width + max(views.channels, lanes)
    highest = (room - views.weights.shape[1] * pitch - second) // (planes * width)
    highest = min(highest, views.ny, max(1, -(-views.ny * columns // items)))
    if highest < 1:
        return None
    height = -(-views.ny // -(-views.ny // highest))
    rows = (height + 1 + spread[0]) / height
    cost = columns * (width + rows * (8 * pitch + 40 * lanes) / planes)
    return _Blocks(planes, width, height, pitch, cost)


FORMS = ("blocks", "staged", "samples")
_NORM_FLOATS = 1 << 23  # floats of the table of weights in one launch
_MAX_PLANES = 64  # planes of one launch without blocks
_INTEL = "Intel(R) OpenCL"  # its compiler takes minutes for integers that are read in place
# Platforms whose compilers have prefetch
_PREFETCH_PLATFORMS = ("Portable Computing Language", _INTEL)
_GPU_PLANES, _GPU_HEIGHT, _GPU_GROUP = 4, 8, 64  # work of a GPU's item and group
_MIN_SAMPLE_RATE = 1.5e10  # lowest rate of a core in samples of a plane per second
# Seconds: least work that is timed, and length of one trial
_MIN_TUNED_SECONDS, _TRIAL_SECONDS = 0.1, 0.06


def shear_sum(
    lf_data: cla.Array,
    weights: Table,
    shift_y: Table,
    shift_x: Table,
    *,
    device: Device,
    total: bool = False,
) -> cla.Array:
    """Shift every view by its constant, interpolate linearly, and average over the views.

    Picture p is the sum over v, u of w[v, u] L[v, u](y + shift_y[p, v], x + shift_x[p, u]) over
    the sum of the weights (Ng 2005, shift and add). A view off the grid has a shift of its own.
    Results are bitwise reproducible.
    """
    shape = tuple(int(n) for n in lf_data.shape)
    views = split_views(shape, weights, shift_y, shift_x)
    nbytes = 4 * views.planes * views.ny * views.samples
    device.require_memory(nbytes, "The refocused pictures")
    out = device.empty((views.planes, *shape[2:]), np.float32)
    _run_first_form(_Sum(device, out, lf_data, views, total))
    return out


@dataclass(frozen=True)
class _Sum:
    """Arrays and views of one sum."""

    device: Device
    out: cla.Array
    lf_data: cla.Array
    views: Views
    total: bool

    @property
    def defines(self) -> dict[str, Any]:
        """Macros of every form of the kernel."""
        return {"SAMPLE": C_TYPE[np.dtype(self.lf_data.dtype)]}

    def step(self, limit: int) -> int:
        """Return the planes of a launch, limited by the size of the table of weights."""
        table_limit = _NORM_FLOATS // ((len(self.views.weights) + 1) * self.views.samples)
        return min(limit, max(1, table_limit))


def _run_first_form(job: _Sum) -> None:
    """Enqueue the sum in the first form that the device runs; record forms that fail."""
    tuning = job.device.tuning
    forms = [form for form in _forms(job.device) if f"shear {form}" not in tuning.set_aside]
    for form in forms:
        try:
            if _ENQUEUE[form](job):
                return
        except (KernelBuildError, DeviceError) as error:
            if form == forms[-1] or is_out_of_memory(error.__cause__):
                raise
            tuning.leave(f"shear {form}", error)
    raise DeviceError(
        f"{job.device!r} runs no form of shear.cl that sums these views; unset CLPLEN_SHEAR or "
        "use another device."
    )


def _forms(device: Device) -> tuple[str, ...]:
    """Return the forms of the sum in the order in which they are tried."""
    forced = os.environ.get("CLPLEN_SHEAR", "")
    if forced and forced not in FORMS:
        raise ValueError(f"CLPLEN_SHEAR must be one of {', '.join(FORMS)}, got {forced!r}.")
    if device.rows:
        default_order = ("blocks", "samples")
    else:  # a GPU's first-level cache serves items faster than they copy to local memory
        default_order = ("staged", "samples") if device.is_cpu else ("samples", "staged")
    return (
        (forced, *(form for form in default_order if form != forced)) if forced else default_order
    )


def _enqueue_blocks(work: _Sum) -> bool:
    """Enqueue blocks of rows and columns; return False if local memory is too small."""
    blocks = _candidate_blocks(work.views, work.device)
    if not blocks:
        return False
    best = _fastest(work, blocks)
    step = work.step(best.planes)
    for first in range(0, work.views.planes, step):
        _launch_blocks(work, best, work.views.part(first, step), first)
    return True


def _fastest(work: _Sum, blocks: list[_Blocks]) -> _Blocks:
    """Return the fastest blocks by measurement, or the blocks of least expected cost."""
    views, tuning = work.views, work.device.tuning
    V, U = work.lf_data.shape[:2]
    sizes = [int(n).bit_length() for n in (views.ny, views.nx)]
    problem = (
        f"{work.defines['SAMPLE']} {V}x{U} views of {views.channels}, {sizes}, "
        f"{views.planes} planes"
    )
    by_label = {b.label: b for b in reversed(blocks)}
    record = tuning.lookup("shear.cl", problem, list(by_label))
    if record is not None:
        return by_label[record]
    cores = int(work.device.cl_device.max_compute_units)
    samples = np.count_nonzero(views.weights) * views.ny * views.samples * views.planes
    seconds = samples / (_MIN_SAMPLE_RATE * cores)
    if seconds < _MIN_TUNED_SECONDS:
        return blocks[0]

    def run_trial(label: str) -> float:
        b = by_label[label]
        part = views.part(0, work.step(b.planes))
        rows = _TRIAL_SECONDS / seconds * views.ny * views.planes / part.planes
        bands = min(max(int(rows / b.height), 1), -(-views.ny // b.height))
        _launch_blocks(work, b, part, 0, bands)
        return part.planes * min(bands * b.height, views.ny)

    labels = [b.label for b in _blocks_to_time(blocks)]
    return by_label[tuning.fastest("shear.cl", problem, labels, run_trial)]


def _launch_blocks(
    work: _Sum, blocks: _Blocks, views: Views, first: int, bands: int | None = None
) -> None:
    """Enqueue some planes: all bands of rows, or the first ``bands``."""
    device, defines = work.device, work.defines
    lanes, vectors = vector_lanes(device)
    if device.platform in _PREFETCH_PLATFORMS:
        defines["AHEAD"] = True
    if views.channels in (1, 3):
        defines["CHANNELS"] = views.channels
    if views.planes == 1 and (work.lf_data.dtype.kind == "f" or device.platform != _INTEL):
        defines["DIRECT"] = True
    kernel = device.kernel("shear.cl", "shear_blocks", LANES=lanes, VECTORS=vectors, **defines)
    columns = -(-views.samples // (blocks.width - views.channels))
    floats = (
        views.weights.shape[1] * blocks.pitch,
        blocks.planes * blocks.height * blocks.width,
        blocks.width + max(views.channels, lanes),
    )
    device.launch(
        kernel,
        (columns, bands or -(-views.ny // blocks.height)),
        *_arguments(work, views, first, columns * blocks.width),
        *(np.int32(n) for n in (blocks.height, blocks.width, blocks.pitch)),
        *(cl.LocalMemory(4 * n) for n in floats),
        group=(1, 1),
        operations=views.operations,
    )


def _enqueue_staged(work: _Sum) -> bool:
    """Enqueue one sample per item with staged rows; return False if local memory is too small."""
    step = work.step(_MAX_PLANES)
    room = int(work.device.cl_device.local_mem_size)
    parts = {n: work.views.part(n, step) for n in range(0, work.views.planes, step)}
    tiles = {first: _tile(part) for first, part in parts.items()}
    if any(4 * rows * width > room for rows, width in tiles.values()):
        return False
    for first, part in parts.items():
        _launch_samples(work, part, first, tiles[first], GROUP=_GPU_GROUP)
    return True


def _tile(views: Views) -> tuple[int, int]:
    """Return the largest (rows, samples) of a view that the planes of one work-group read."""
    rows, samples, item_planes = 0, 0, _item_planes(views.planes)
    for first in range(0, views.planes, item_planes):
        part = views.part(first, item_planes)
        rows = max(rows, int(np.ptp(part.down, axis=0).max()))
        samples = max(samples, int(np.ptp(part.right, axis=0).max()) * views.channels)
    return _GPU_HEIGHT + 1 + rows, _GPU_GROUP + views.channels + samples


def _item_planes(planes: int) -> int:
    """Return the planes of a GPU's work-item, a power of two up to the number of planes."""
    return int(min(_GPU_PLANES, 2 ** (planes - 1).bit_length()))


def _enqueue_samples(work: _Sum) -> bool:
    """Enqueue one sample per item, with every tap read from global memory."""
    step = work.step(_MAX_PLANES)
    for first in range(0, work.views.planes, step):
        _launch_samples(work, work.views.part(first, step), first, (1, 1))
    return True


def _launch_samples(
    work: _Sum, views: Views, first: int, tile: tuple[int, int], **defines: Any
) -> None:
    """Enqueue some planes with local memory for ``tile`` (rows, samples)."""
    item_planes = _item_planes(views.planes)
    kernel = work.device.kernel(
        "shear.cl",
        "shear_samples",
        HEIGHT=_GPU_HEIGHT,
        PLANES=item_planes,
        **work.defines,
        **defines,
    )
    work.device.launch(
        kernel,
        (views.samples, -(-views.planes // item_planes), -(-views.ny // _GPU_HEIGHT)),
        *_arguments(work, views, first, views.samples),
        np.int32(tile[1]),
        cl.LocalMemory(4 * tile[0] * tile[1]),
        group=(_GPU_GROUP, 1, 1),
        operations=views.operations,
    )


def _arguments(work: _Sum, views: Views, first: int, width: int) -> list[Any]:
    """Return the arguments of every form for rows of ``width`` samples."""
    device, key = work.device, ("shear", width, views.key)
    cached: tuple[list[cla.Array], Norm] | None = device.tables.get(key)
    if cached is None:
        norm = weight_norms(views, width)
        uploaded = [device.upload(table) for table in (*kernel_tables(views), norm.table)]
        cached = device.tables.keep(key, (uploaded, norm), table_bytes(uploaded))
    tables, norm = cached
    sizes = (*views.weights.shape, views.ny, views.samples, views.channels, views.planes, first)
    numbers = (*sizes, norm.table.shape[2], norm.near, norm.far, int(work.total))
    return [work.out, work.lf_data, *tables, *(np.int32(n) for n in numbers)]


def table_bytes(tables: list[cla.Array]) -> int:
    """Return the bytes of tables, on the device and on the host together."""
    return sum(2 * int(table.nbytes) for table in tables)


_ENQUEUE: dict[str, Callable[[_Sum], bool]] = {
    "blocks": _enqueue_blocks,
    "staged": _enqueue_staged,
    "samples": _enqueue_samples,
}
