"""Raw images of points, each in a window about its chief ray."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.local_window import (
    SAMPLED_RINGS,
    LocalWindows,
    Region,
    Windows,
    WindowShape,
    bounds,
    window_centres,
    window_shape,
)
from clplen.cameras.optics.pixel_array import PixelSums, pixel_weights
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.compute.fft.blocks import window
from clplen.compute.fft.lines import smooth_length
from clplen.errors import DeviceError
from clplen.lightfield.raw.raw_image import Exposure, Transforms, merged
from clplen.units import amount
from clplen.wave.coherence.averaging import Progress
from clplen.wave.field.field import Field

MAX_REGION_BYTES = 2**27  # maximum bytes of the array's transmission that windows share
INTENSITY_OVERSAMPLING = 2  # samples of the intensity for each sample of the field


def check_windows(optics: WaveOptics, points: PointSources) -> None:
    """Raise if windows of points do not fit the device."""
    device, positions = optics.device, points.positions
    beta = np.atleast_1d(optics.array_alpha(positions[:, 2]))
    reach = np.abs(optics.on_array(positions)).max(axis=1) / optics.array_distance
    widths = np.abs(1 - beta) * np.maximum(1, np.abs(beta)) * (1 + reach**2)
    worst = positions[int(widths.argmax())]
    shape = _shape(optics, worst, points.diameter)
    largest = max(shape.samples, shape.pupil) ** 2 * device.complex.itemsize
    available = min(device.memory_bytes, int(device.cl_device.max_mem_alloc_size))
    if shape.nbytes(device) <= device.memory_bytes and largest <= available:
        return
    blur = optics.aperture_diameter * abs(1 - float(optics.array_alpha(worst[2])))
    x, y, dz = worst
    raise DeviceError(
        f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is blurred over "
        f"{blur / optics.mla.pitch:.4g} lenslets: its window of {shape.samples} x {shape.samples} "
        f"samples needs {amount(shape.nbytes(device), 'B')}, but {device.name} has "
        f"{amount(device.memory_bytes, 'B')}. Move it nearer to the focused plane, use a smaller "
        "aperture_diameter, or model='rays'."
    )


def add_local(
    optics: WaveOptics,
    points: PointSources,
    total: cla.Array,
    progress: Progress | None,
    energies: Any = None,
) -> Exposure:
    """Add the energy of points to an image of the sensor, each in its own window."""
    energies = points.power if energies is None else energies
    done, transforms = 0, []
    for indices, windows, region in window_batches(optics, points):
        add_windows(windows, energies[indices], total, region)
        del region  # frees its memory before the next region is computed
        transforms.append((3 * len(indices), (windows.shape.samples, windows.shape.samples)))
        done += len(indices)
        if progress is not None:
            progress(done, len(points))
    return Exposure("local", merged(transforms), 0.0)


def window_batches(
    optics: WaveOptics, points: PointSources
) -> Iterator[tuple[list[int], LocalWindows, Region | None]]:
    """Yield windows of points in batches: indices, windows, and the array under them."""
    shapes = [_shape(optics, position, points.diameter) for position in points.positions]
    groups = list(batches(shapes, optics.device))
    region: Region | None = None
    for number, indices in enumerate(groups):
        shape = shapes[indices[0]]
        windows = LocalWindows.of(optics, shape, points.positions[indices], points.diameter)
        if region is None or not region.holds(shape, windows.centres):
            region = None  # frees its memory first
            region = _region(optics, points, shapes, groups[number:])
        yield indices, windows, region


def _region(
    optics: WaveOptics, points: PointSources, shapes: Sequence[WindowShape],
    groups: Sequence[list[int]],
) -> Region | None:  # fmt: skip
    """Return the array under the first windows and neighbours of their shape.

    None if these windows have less area in total than the region that contains them.
    """
    shape = shapes[groups[0][0]]
    nbytes = min(MAX_REGION_BYTES, optics.device.memory_bytes // 8)
    max_samples = max(nbytes // optics.device.complex.itemsize, shape.samples**2)
    extremes: list[Any] = []
    count = 0
    for indices in groups:
        if shapes[indices[0]] != shape:
            break
        centres = window_centres(optics, shape, points.positions[indices])
        count += len(indices)
        ends = np.concatenate([*extremes, centres])
        _, (ny, nx) = bounds(ends, shape.samples)
        if ny * nx > min(max_samples, count * shape.samples**2):
            break
        extremes = [ends.min(axis=0)[None], ends.max(axis=0)[None]]
    return Region.of(optics, shape, np.concatenate(extremes)) if extremes else None


def batches(shapes: Sequence[WindowShape], device: Device) -> Iterator[list[int]]:
    """Yield indices of windows in batches of equal shape, each window once."""
    ranked = sorted(range(len(shapes)), key=lambda n: shapes[n].sizes)
    for _, run in groupby(ranked, key=lambda n: shapes[n].sizes):
        members = list(run)
        shape = shapes[members[0]]
        count = shape.batch(device)
        device.require_memory(
            shape.nbytes(device) * min(count, len(members)),
            f"A point's window of {shape.samples} x {shape.samples} samples",
        )
        for start in range(0, len(members), count):
            yield members[start : start + count]


def local_transforms(optics: WaveOptics, points: PointSources, count: int) -> Transforms:
    """Return the transforms of ``count`` points, all with the widest window."""
    largest = max(
        (_shape(optics, p, points.diameter) for p in points.positions), key=lambda s: s.samples
    )
    return ((3 * count, (largest.samples, largest.samples)),)


def add_integrated(total: cla.Array, fields: Field, weights: Any, active: float) -> None:
    """Add intensities on the sensor's samples, integrated over the pixels around them."""
    fine, sums, scale = pixel_samples(fields, active)
    for number, weight in enumerate(np.atleast_1d(weights)):
        sums.put(total, fine, number, scale * weight, fields.device)


def pixel_samples(fields: Field, active: float) -> tuple[cla.Array, PixelSums, float]:
    """Sample fields so finely that sums over their intensity integrate it over pixels."""
    device = fields.device
    sums, _ = sample_sums(active, fields.grid.shape)
    if active == 0:
        return fields.data, sums, 1.0
    room, shape = _surround(active, fields.grid.shape)
    wide = window(fields.data, (*fields.shape[:-2], *shape), device, offset=(room, room))
    device.fft.forward(wide, device)
    return refine(wide, INTENSITY_OVERSAMPLING, device), sums, float(INTENSITY_OVERSAMPLING**2)


def sample_sums(active: float, shape: tuple[int, int]) -> tuple[PixelSums, tuple[int, int]]:
    """Return the sums over the samples of `pixel_samples`, and the shape of these samples."""
    if active == 0:
        return PixelSums((0, 0), 1, 0.0, (0, 0), shape), shape
    room, (ny, nx) = _surround(active, shape)
    first, width = INTENSITY_OVERSAMPLING * room, INTENSITY_OVERSAMPLING * active
    sums = PixelSums((first, first), INTENSITY_OVERSAMPLING, width, (0, 0), shape)
    return sums, (INTENSITY_OVERSAMPLING * ny, INTENSITY_OVERSAMPLING * nx)


def transposed_samples(
    fine: cla.Array, active: float, shape: tuple[int, int], device: Device
) -> cla.Array:
    """Apply the transpose of `pixel_samples`, a linear map of the fields, to fine samples."""
    if active == 0:
        return fine
    room, wide = _surround(active, shape)
    device.fft.inverse(fine, device)
    out = device.empty((*fine.shape[:-2], *wide), device.complex)
    kernel = device.kernel("patterns.cl", "coarsen", **device.wave_defines())
    device.launch_rows(kernel, out.shape, out, fine, *map(np.int32, (*wide, *fine.shape[-2:])))
    device.fft.forward(out, device)
    return window(out, (*fine.shape[:-2], *shape), device, offset=(-room, -room))


def _surround(active: float, shape: tuple[int, int]) -> tuple[int, tuple[int, int]]:
    """Return the margin of samples that the pixels' sums need, and the window with it."""
    reach = len(pixel_weights(INTENSITY_OVERSAMPLING * active)) // 2
    room = -(-reach // INTENSITY_OVERSAMPLING)
    ny, nx = (smooth_length(n + 2 * room) for n in shape)
    return room, (ny, nx)


def _shape(optics: WaveOptics, position: Any, diameter: float) -> WindowShape:
    """Return a point's window: finer than pixels that integrate, else sampled as the sensor."""
    if optics.pixels is None:
        return window_shape(optics, position, diameter, rings=SAMPLED_RINGS, orders=0.0)
    return window_shape(optics, position, diameter)


def add_windows(
    windows: Windows, power: Any, total: cla.Array, region: Region | None = None
) -> None:
    """Add the energy of points in their windows to an image of the sensor."""
    fields, sums = window_samples(windows, region)
    for number, (pixels, gain) in enumerate(sums):
        pixels.put(total, fields, number, gain * power[number], windows.optics.device)


def window_samples(
    windows: Windows, region: Region | None = None
) -> tuple[cla.Array, list[tuple[PixelSums, float]]]:
    """Compute fields of windows on the sensor, and the pixels that they fill."""
    optics, device = windows.optics, windows.optics.device
    active = 0.0 if optics.pixels is None else optics.pixels.active
    fields = windows.array_fields()
    fields = windows.sensor_spectra(windows.behind_array(fields, region))
    more = INTENSITY_OVERSAMPLING if active and windows.shape.rim is None else 1
    fields = refine(fields, more, device)
    return fields, [_sums(windows, n, more, active) for n in range(len(windows.energy))]


def refine(spectra: cla.Array, more: int, device: Device) -> cla.Array:
    """Compute fields of spectra with ``more`` times as many samples along each axis."""
    *batch, ny, nx = spectra.shape
    if more > 1:
        out = device.empty((*batch, more * ny, more * nx), device.complex)
        kernel = device.kernel("patterns.cl", "refine", **device.wave_defines())
        sizes = (np.int32(n) for n in (more * ny, more * nx, ny, nx))
        device.launch_rows(kernel, out.shape, out, spectra, *sizes)
        spectra = out
    device.fft.inverse(spectra, device)
    return spectra


def _sums(windows: Windows, number: int, more: int, active: float) -> tuple[PixelSums, float]:
    """Return the pixels that a window's samples fill, and the factor to a point's energy 1."""
    optics, shape = windows.optics, windows.shape
    k, n = shape.finer, shape.samples
    width = more * k * active
    reach = len(pixel_weights(width)) // 2
    first, count, pixel = [], [], []
    for axis in (0, 1):
        middle = int(windows.centres[number, axis] + windows.shifts[number, axis])
        low = middle - n // 2 + shape.guard + math.ceil(reach / more)
        high = middle + n // 2 - 1 - shape.guard - math.ceil(reach / more)
        pixels = optics.grid.shape[axis]
        begin = max(-(-low // k), -(pixels // 2))
        end = min(high // k, pixels - 1 - pixels // 2)
        first.append(more * (begin * k - middle + n // 2))
        count.append(max(0, end - begin + 1))
        pixel.append(begin + pixels // 2)
    sums = PixelSums(
        (first[0], first[1]), more * k, width, (pixel[0], pixel[1]), (count[0], count[1])
    )
    # the finer inverse transform divides by more^2 as many samples
    scale = more**2 if active else (more * k) ** 2
    return sums, scale / windows.energy[number]
