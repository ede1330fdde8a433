"""Shear, interpolate, sum: the pictures of a light field refocused on many planes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.device import Device
from clplen.compute.drivers.failures import is_want_of_memory
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

_BLOCK_PLANES = 64  # of one launch
_LOCAL_BYTES = 1024 * 1024  # of one work-item: stays in a second-level cache
_LOCAL_RESERVE = 1024  # what an OpenCL runtime may keep for itself
_WIDEST = 16  # chunks of a block
_ITEMS_PER_CORE = 8  # so that no core waits long for the last one
_UNLIKE = 1.5  # ratio of widths
_TRIED = 4  # blocks that are worth timing


@dataclass(frozen=True)
class _Blocks:
    """What a work-item of shear_blocks does, and its share of the cost of a plane."""

    planes: int
    width: int
    height: int
    pitch: int
    cost: float

    @property
    def label(self) -> str:
        """What tells these blocks from others of the same views."""
        return f"blocks of {self.planes} x {self.width}"


def vector_lanes(device: Device) -> tuple[int, int]:
    """Floats of a vector, and vectors summed at a time: two registers each of 32, or 16."""
    lanes = min(max(int(device.cl_device.native_vector_width_float), 4), 16)
    return lanes, 8 if lanes == 16 else 6


def _candidate_blocks(views: Views, device: Device) -> list[_Blocks]:
    """Blocks whose local memory the device has, the cheapest first."""
    lanes, vectors = vector_lanes(device)
    chunk = lanes * vectors
    room = min(_LOCAL_BYTES, int(device.cl_device.local_mem_size) - _LOCAL_RESERVE) // 4
    items = _ITEMS_PER_CORE * int(device.cl_device.max_compute_units)
    first = views.channels // chunk + 1
    last = max(first, min(_WIDEST, -(-(views.samples + views.channels) // chunk)))
    passes = {-(-views.planes // most) for most in (1, 2, 4, 8, 16, 32, _BLOCK_PLANES)}
    found = []
    for planes in sorted({-(-views.planes // n) for n in passes}):
        spread = _spread(views, planes)
        for width in range(first * chunk, last * chunk + 1, chunk):
            found.append(_blocks(views, planes, width, spread, room, items, lanes))
    return sorted((b for b in found if b), key=lambda b: b.cost)


def _blocks_to_time(blocks: list[_Blocks]) -> list[_Blocks]:
    """The cheapest blocks that are unlike each other."""
    unlike: list[_Blocks] = []
    for b in blocks:
        if all(
            b.planes != o.planes or not 1 / _UNLIKE < b.width / o.width < _UNLIKE for o in unlike
        ):
            unlike.append(b)
    return unlike[:_TRIED]


def _spread(views: Views, planes: int) -> tuple[float, int]:
    """Furthest that planes of one launch lie apart: in rows (mean over v) and in samples."""
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
    """Blocks of a width as high as local memory (room, in floats) and enough items allow.

    The cost of a plane is counted in vectors that are multiplied and added; one that is fetched
    from the light field costs about 8, and the start of a row 40 (measured on two cores with
    512-bit vectors).
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
_NORM_FLOATS = 1 << 23  # of the weights that samples use, in one launch
_MOST_PLANES = 64  # of one launch without blocks
_INTEL = "Intel(R) OpenCL"  # whose compiler takes minutes to read integers in place
_PREFETCH = ("Portable Computing Language", _INTEL)  # their compilers have it
_GPU_PLANES, _GPU_HEIGHT, _GPU_GROUP = 4, 8, 64  # what a GPU's work-item and group do
_SLOW = 1.5e10  # samples of a plane that a core adds in a second, at least
_WORTH, _TRIAL = 0.1, 0.06  # seconds of work that is worth timing, and of one trial


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
    the sum of the weights (Ng 2005, shift and add); views that lie on no grid have a shift of
    their own each. The result has the same bits in every run.
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
    """What is summed, and where to."""

    device: Device
    out: cla.Array
    lf_data: cla.Array
    views: Views
    total: bool

    @property
    def defines(self) -> dict[str, Any]:
        """Of every form."""
        return {"SAMPLE": C_TYPE[np.dtype(self.lf_data.dtype)]}

    def step(self, most: int) -> int:
        """Planes of a launch, whose table of weights is not too large."""
        of_norm = _NORM_FLOATS // ((len(self.views.weights) + 1) * self.views.samples)
        return min(most, max(1, of_norm))


def _run_first_form(work: _Sum) -> None:
    """Enqueue everything; a form that the device cannot run is left and remembered."""
    tuning = work.device.tuning
    forms = [form for form in _forms(work.device) if f"shear {form}" not in tuning.set_aside]
    for form in forms:
        try:
            if _ENQUEUE[form](work):
                return
        except (KernelBuildError, DeviceError) as error:
            if form == forms[-1] or is_want_of_memory(error.__cause__):
                raise
            tuning.leave(f"shear {form}", error)
    raise DeviceError(
        f"{work.device!r} runs no form of shear.cl that sums these views: unset CLPLEN_SHEAR, or "
        "use another device."
    )


def _forms(device: Device) -> tuple[str, ...]:
    """Forms in which the sum can be done, the one to try first ahead."""
    forced = os.environ.get("CLPLEN_SHEAR", "")
    if forced and forced not in FORMS:
        raise ValueError(f"CLPLEN_SHEAR is one of {', '.join(FORMS)}, not {forced!r}.")
    if device.rows:
        usual = ("blocks", "samples")
    else:  # a GPU's first-level cache serves items faster than they copy to local memory
        usual = ("staged", "samples") if device.is_cpu else ("samples", "staged")
    return (forced, *(form for form in usual if form != forced)) if forced else usual


def _enqueue_blocks(work: _Sum) -> bool:
    """Blocks of rows and columns; False where local memory does not suffice for any."""
    blocks = _candidate_blocks(work.views, work.device)
    if not blocks:
        return False
    chosen = _fastest(work, blocks)
    step = work.step(chosen.planes)
    for first in range(0, work.views.planes, step):
        _launch_blocks(work, chosen, work.views.part(first, step), first)
    return True


def _fastest(work: _Sum, blocks: list[_Blocks]) -> _Blocks:
    """The blocks that were found fastest, else those of least expected cost."""
    views, tuning = work.views, work.device.tuning
    V, U = work.lf_data.shape[:2]
    sizes = [int(n).bit_length() for n in (views.ny, views.nx)]
    problem = (
        f"{work.defines['SAMPLE']} {V}x{U} views of {views.channels}, {sizes}, "
        f"{views.planes} planes"
    )
    by_label = {b.label: b for b in reversed(blocks)}
    found = tuning.found("shear.cl", problem, list(by_label))
    if found is not None:
        return by_label[found]
    cores = int(work.device.cl_device.max_compute_units)
    samples = np.count_nonzero(views.weights) * views.ny * views.samples * views.planes
    seconds = samples / (_SLOW * cores)
    if seconds < _WORTH:
        return blocks[0]

    def part_of(label: str) -> float:
        b = by_label[label]
        part = views.part(0, work.step(b.planes))
        rows = _TRIAL / seconds * views.ny * views.planes / part.planes
        bands = min(max(int(rows / b.height), 1), -(-views.ny // b.height))
        _launch_blocks(work, b, part, 0, bands)
        return part.planes * min(bands * b.height, views.ny)

    tried = [b.label for b in _blocks_to_time(blocks)]
    return by_label[tuning.fastest("shear.cl", problem, tried, part_of)]


def _launch_blocks(
    work: _Sum, blocks: _Blocks, views: Views, first: int, bands: int | None = None
) -> None:
    """Enqueue some planes (all bands of rows, or the first ones)."""
    device, defines = work.device, work.defines
    lanes, vectors = vector_lanes(device)
    if device.platform in _PREFETCH:
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
    """A sample an item, rows of views through local memory; False where that does not suffice."""
    step = work.step(_MOST_PLANES)
    room = int(work.device.cl_device.local_mem_size)
    parts = {n: work.views.part(n, step) for n in range(0, work.views.planes, step)}
    tiles = {first: _tile(part) for first, part in parts.items()}
    if any(4 * rows * width > room for rows, width in tiles.values()):
        return False
    for first, part in parts.items():
        _launch_samples(work, part, first, tiles[first], GROUP=_GPU_GROUP)
    return True


def _tile(views: Views) -> tuple[int, int]:
    """(rows, samples) of a view that the planes of one work-group see at most."""
    rows, samples, together = 0, 0, _together(views.planes)
    for first in range(0, views.planes, together):
        part = views.part(first, together)
        rows = max(rows, int(np.ptp(part.down, axis=0).max()))
        samples = max(samples, int(np.ptp(part.right, axis=0).max()) * views.channels)
    return _GPU_HEIGHT + 1 + rows, _GPU_GROUP + views.channels + samples


def _together(planes: int) -> int:
    """Planes of a work-item of a GPU: no more than there are, up to the next power of two."""
    return int(min(_GPU_PLANES, 2 ** (planes - 1).bit_length()))


def _enqueue_samples(work: _Sum) -> bool:
    """A sample an item, every tap from the light field's memory."""
    step = work.step(_MOST_PLANES)
    for first in range(0, work.views.planes, step):
        _launch_samples(work, work.views.part(first, step), first, (1, 1))
    return True


def _launch_samples(
    work: _Sum, views: Views, first: int, tile: tuple[int, int], **defines: Any
) -> None:
    """Enqueue some planes, with local memory for so many (rows, samples)."""
    together = _together(views.planes)
    kernel = work.device.kernel(
        "shear.cl",
        "shear_samples",
        HEIGHT=_GPU_HEIGHT,
        PLANES=together,
        **work.defines,
        **defines,
    )
    work.device.launch(
        kernel,
        (views.samples, -(-views.planes // together), -(-views.ny // _GPU_HEIGHT)),
        *_arguments(work, views, first, views.samples),
        np.int32(tile[1]),
        cl.LocalMemory(4 * tile[0] * tile[1]),
        group=(_GPU_GROUP, 1, 1),
        operations=views.operations,
    )


def _arguments(work: _Sum, views: Views, first: int, width: int) -> list[Any]:
    """What every form takes, for rows of `width` samples."""
    device, key = work.device, ("shear", width, views.key)
    kept: tuple[list[cla.Array], Norm] | None = device.tables.get(key)
    if kept is None:
        norm = weight_norms(views, width)
        uploaded = [device.upload(table) for table in (*kernel_tables(views), norm.table)]
        kept = device.tables.keep(key, (uploaded, norm), table_bytes(uploaded))
    tables, norm = kept
    sizes = (*views.weights.shape, views.ny, views.samples, views.channels, views.planes, first)
    numbers = (*sizes, norm.table.shape[2], norm.near, norm.far, int(work.total))
    return [work.out, work.lf_data, *tables, *(np.int32(n) for n in numbers)]


def table_bytes(tables: list[cla.Array]) -> int:
    """Bytes of tables on a device, with those on the host."""
    return sum(2 * int(table.nbytes) for table in tables)


_ENQUEUE: dict[str, Callable[[_Sum], bool]] = {
    "blocks": _enqueue_blocks,
    "staged": _enqueue_staged,
    "samples": _enqueue_samples,
}
