"""Maps along both axes, a product in between, and maps back: y and x, batches, many products.

On the host the arrays go through the cache in blocks: the lines along x a few rows at a time, then
for a few columns at a time everything that happens along y, with the product in its midst, then
the lines along x again. Padding is never transformed twice and the padded array never exists.
With VkFFT whole arrays stay on the device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.compute.lines import Line, Separable, still

if TYPE_CHECKING:
    import pyopencl.array as cla

    from clplen.compute.device import Device
    from clplen.compute.fft import FFTRoute

Array = np.ndarray[Any, Any]
BLOCK_BYTES = 2**19  # a block and its table fit the second-level cache of a core


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Factors of a 2-D spectrum on a device.

    Attributes
    ----------
    values : pyopencl.array.Array
        Complex, shape (my, mx); or, even in both axes, the quadrant (my//2 + 1, mx//2 + 1).
    shape : tuple of int
        (my, mx).
    """

    values: cla.Array
    shape: tuple[int, int]

    @property
    def is_quadrant(self) -> bool:
        """Whether only indices up to the middle are stored."""
        return tuple(self.values.shape) != self.shape


def run(
    data: cla.Array,
    into: Separable,
    spectra: Sequence[Spectrum],
    back: Sequence[Separable],
    device: Device,
) -> list[cla.Array]:
    """Map, multiply by each of several spectra, and map back.

    Parameters
    ----------
    data : pyopencl.array.Array
        Complex, shape (..., ny, nx); not changed.
    into : Separable
    spectra : sequence of Spectrum
        None: ``into`` is all there is.
    back : sequence of Separable
        One for each spectrum, all to the same shape.
    device : Device

    Returns
    -------
    list of pyopencl.array.Array
        Shape (..., my, mx), one for each spectrum (one in all where there is none).
    """
    if device.fft.name == "vkfft":
        return _on_device(data, into, spectra, back, device)
    batch, shape = tuple(data.shape[:-2]), (data.shape[-2], data.shape[-1])
    last = back[0].shape_after(into.shape_after(shape)) if back else into.shape_after(shape)
    results = [device.empty((*batch, *last), device.complex) for _ in range(max(1, len(spectra)))]
    count = int(np.prod(batch, dtype=np.int64))
    with ExitStack() as held:
        source = held.enter_context(device.on_host(data, write=False)).reshape(count, *shape)
        targets = [held.enter_context(device.on_host(result)) for result in results]
        flat = [target.reshape(count, *last) for target in targets]
        _on_host(source, into, spectra, back, flat, device)
    return results


# On the host


def _on_host(
    source: Array,
    into: Separable,
    spectra: Sequence[Spectrum],
    back: Sequence[Separable],
    targets: Sequence[Array],
    device: Device,
) -> None:
    with ThreadPoolExecutor(device.fft.threads) as pool:
        work = _rows(source, into.x, None, device.fft, pool)
        if not spectra:
            _columns(work, into.y, targets[0], device.fft, pool)
            return
        tall = back[0].y[-1].m if back[0].y else into.shape_after(source.shape[-2:])[0]
        between = [np.empty((len(work), tall, work.shape[-1]), work.dtype) for _ in spectra]
        _filtered(work, into.y, spectra, [b.y for b in back], between, device, pool)
        for made, way, out in zip(between, back, targets, strict=True):
            _rows(made, way.x, out, device.fft, pool)


def _rows(
    source: Array,
    lines: tuple[Line, ...],
    target: Array | None,
    fft: FFTRoute,
    pool: ThreadPoolExecutor,
) -> Array:
    """``lines`` along the last axis, a few rows at a time; into ``target`` if there is one."""
    rows = source.reshape(-1, source.shape[-1])
    width = lines[-1].m if lines else source.shape[-1]
    if target is None:
        target = np.empty((*source.shape[:-1], width), source.dtype)
    out = target.reshape(-1, width)
    longest = max((line.length for line in lines), default=width)

    def some(start: int, stop: int) -> None:
        out[start:stop] = _apply(rows[start:stop], lines, 1, fft)

    _each(some, len(rows), longest * source.itemsize, pool, fft.threads)
    return target


def _columns(
    source: Array, lines: tuple[Line, ...], target: Array, fft: FFTRoute, pool: ThreadPoolExecutor
) -> None:
    """``lines`` along the axis before the last, a few columns at a time."""
    longest = max((line.length for line in lines), default=source.shape[-2])

    def some(start: int, stop: int) -> None:
        for one, out in zip(source, target, strict=True):
            out[:, start:stop] = _apply(one[:, start:stop], lines, 0, fft)

    _each(some, source.shape[-1], longest * source.itemsize, pool, fft.threads)


def _filtered(
    source: Array,
    into: tuple[Line, ...],
    spectra: Sequence[Spectrum],
    back: Sequence[tuple[Line, ...]],
    targets: Sequence[Array],
    device: Device,
    pool: ThreadPoolExecutor,
) -> None:
    """Along y: ``into``, each spectrum, and its way ``back``, a few columns at a time."""
    fft, tall = device.fft, max((line.length for line in into), default=source.shape[-2])
    with ExitStack() as held:
        factors = [held.enter_context(device.on_host(s.values, write=False)) for s in spectra]

        def some(start: int, stop: int) -> None:
            for place, one in enumerate(source):
                block = _apply(one[:, start:stop], into, 0, fft)
                for which, spectrum in enumerate(spectra):
                    last = which == len(spectra) - 1 and block.base is not None
                    made = block if last else block.copy()
                    _multiply(made, factors[which], spectrum, start, stop)
                    targets[which][place, :, start:stop] = _apply(made, back[which], 0, fft)

        middle = spectra[0].shape[1] // 2 + 1
        _each(some, source.shape[-1], tall * source.itemsize, pool, fft.threads, middle)


def _multiply(block: Array, values: Array, spectrum: Spectrum, start: int, stop: int) -> None:
    """Columns start:stop of a spectrum times its factors, in place."""
    if not spectrum.is_quadrant:
        block *= values[:, start:stop]
        return
    my, mx = spectrum.shape
    if start > mx // 2:
        factors = values[:, mx - stop + 1 : mx - start + 1][:, ::-1]
    else:
        factors = values[:, start:stop]
    half = my // 2 + 1
    block[:half] *= factors
    block[half:] *= factors[1 : my - half + 1][::-1]


def _each(
    work: Callable[[int, int], None],
    count: int,
    line_bytes: int,
    pool: ThreadPoolExecutor,
    threads: int,
    never_across: int = 0,
) -> None:
    """``work`` on all of range(count), in parts that fit the cache."""
    size = max(1, min(64, BLOCK_BYTES // max(1, line_bytes), -(-count // threads)))
    ends = [0, *(edge for edge in (never_across,) if 0 < edge < count), count]
    parts = [
        (start, min(start + size, high))
        for low, high in pairwise(ends)
        for start in range(low, high, size)
    ]
    list(pool.map(lambda part: work(*part), parts))


def _apply(values: Array, lines: tuple[Line, ...], axis: int, fft: FFTRoute) -> Array:
    """``lines`` along one axis of a 2-D block; a new array, or ``values`` where none moves."""
    for line in lines:
        if line.kind != "none":
            values = _one(values, line, axis, fft)
    return values


def _one(values: Array, line: Line, axis: int, fft: FFTRoute) -> Array:
    shape = list(values.shape)
    shape[axis] = line.length
    window = np.empty(shape, values.dtype)
    along = window if axis == 0 else window.T  # the axis first
    stop = line.place + line.n
    along[: line.place] = 0
    along[stop:] = 0
    source = values if axis == 0 else values.T
    if line.pre is None:
        along[line.place : stop] = source
    else:
        np.multiply(source, line.pre[:, None], out=along[line.place : stop])
    fft.lines(window, axis, line.kind != "inverse")
    if line.kernel is not None:
        along *= line.kernel[:, None]
        fft.lines(window, axis, False)
    kept = along[line.start : line.start + line.m]
    if line.post is not None:
        kept *= line.post[:, None]
    return kept if axis == 0 else kept.T


# On the device


def _on_device(
    data: cla.Array,
    into: Separable,
    spectra: Sequence[Spectrum],
    back: Sequence[Separable],
    device: Device,
) -> list[cla.Array]:
    work = data
    for y, x in zip_longest(into.y, into.x):
        work = _stage(work, y, x, device)
    if not spectra:
        return [work]
    results = []
    for spectrum, way in zip(spectra, back, strict=True):
        made = multiplied(work, spectrum, device, copy=work is data or spectrum is not spectra[-1])
        for y, x in zip_longest(way.y, way.x):
            made = _stage(made, y, x, device)
        results.append(made)
    return results


def _stage(data: cla.Array, y: Line | None, x: Line | None, device: Device) -> cla.Array:
    """One line along each axis; None: the axis waits."""
    y, x = y or still(data.shape[-2]), x or still(data.shape[-1])
    if y.kind == x.kind == "none":
        return data
    batch = data.shape[:-2]
    work = window(data, (*batch, y.length, x.length), device, place=(y.place, x.place))
    _factors(work, _placed(y), _placed(x), device)
    for kinds, forward in ((("forward", "convolve"), True), (("inverse",), False)):
        _transform(work, y.kind in kinds, x.kind in kinds, forward, device)
    _factors(work, y.kernel, x.kernel, device)
    _transform(work, y.kind == "convolve", x.kind == "convolve", False, device)
    if (y.m, x.m) != (y.length, x.length):
        work = window(work, (*batch, y.m, x.m), device, place=(-y.start, -x.start))
    _factors(work, y.post, x.post, device)
    return work


def _placed(line: Line) -> Array | None:
    """The factors before the transform on the window's samples."""
    if line.pre is None:
        return None
    table = np.zeros(line.length, line.pre.dtype)
    table[line.place : line.place + line.n] = line.pre
    return table


def _transform(work: cla.Array, y: bool, x: bool, forward: bool, device: Device) -> None:
    axes = tuple(axis for axis, wanted in ((-2, y), (-1, x)) if wanted)
    if axes:
        device.fft.transform(work, device, axes=axes, forward=forward)


def _factors(work: cla.Array, y: Array | None, x: Array | None, device: Device) -> None:
    """Times two 1-D tables in place; None: 1."""
    if y is None and x is None:
        return
    ny, nx = work.shape[-2:]
    ty = np.ones(ny, device.complex) if y is None else y.astype(device.complex)
    tx = np.ones(nx, device.complex) if x is None else x.astype(device.complex)
    kernel = device.kernel("separable.cl", "multiply_separable", **device.wave_defines())
    tables = (device.upload(ty), device.upload(tx))
    device.launch_rows(kernel, work.shape, work, work, *tables, np.int32(ny), np.int32(nx))


def multiplied(work: cla.Array, spectrum: Spectrum, device: Device, *, copy: bool) -> cla.Array:
    """Spectra (..., my, mx) times their factors; in place unless ``copy``."""
    out = window(work, work.shape, device) if copy else work
    ny, nx = (np.int32(n) for n in spectrum.shape)
    defines = device.wave_defines()
    if spectrum.is_quadrant:
        kernel = device.kernel("spectral_filter.cl", "filter_spectrum", **defines)
        device.launch_rows(kernel, out.shape, out, spectrum.values, ny, nx)
    else:
        kernel = device.kernel("multiply.cl", "multiply", **defines)
        device.launch_rows(kernel, out.shape, out, out, spectrum.values, ny, nx)
    return out


def window(
    data: cla.Array,
    shape: Sequence[int],
    device: Device,
    *,
    place: tuple[int, int] | None = None,
) -> cla.Array:
    """A copy of complex samples in a larger or smaller window, zeros around them.

    Parameters
    ----------
    data : pyopencl.array.Array
        Shape (..., in_ny, in_nx).
    shape : sequence of int
        (..., ny, nx) of the result.
    device : Device
    place : tuple of int, optional
        (y, x) index in the result of the first sample; by default sample N//2 stays on N//2.
    """
    out = device.empty(shape, device.complex)
    (ny, nx), (in_ny, in_nx) = shape[-2:], data.shape[-2:]
    if place is None:
        place = (ny // 2 - in_ny // 2, nx // 2 - in_nx // 2)
    kernel = device.kernel("window.cl", "window", **device.wave_defines())
    numbers = (ny, nx, in_ny, in_nx, -place[0], -place[1])
    device.launch_rows(kernel, shape, out, data, *(np.int32(n) for n in numbers))
    return out
