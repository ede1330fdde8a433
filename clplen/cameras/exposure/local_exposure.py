"""Raw images of points, each in a window of its own about its chief ray."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.local_window import ORDERS, LocalWindows, WindowShape, window_shape
from clplen.cameras.optics.pixel_array import PixelSums, pixel_weights
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.lightfield.raw.raw_image import Exposure, Transforms
from clplen.wave.coherence.averaging import Progress

BATCH_BYTES = 2**26  # of fields that travel through the camera together
FINER_INTENSITY = 2  # samples of the intensity a sample of the field


def expose_local(
    optics: WaveOptics,
    points: PointSources,
    total: cla.Array,
    *,
    active: float,
    orders: float = ORDERS,
    progress: Progress | None = None,
) -> Exposure:
    """Add the energy of points to an image of the sensor.

    Parameters
    ----------
    optics : WaveOptics
    points : PointSources
    total : pyopencl.array.Array
        Real, shape of the sensor; changed.
    active : float
        Side of the active square of a pixel over its pitch; 0 samples the pixel's middle.
    progress : callable, optional

    Returns
    -------
    Exposure
    """
    shapes = [window_shape(optics, position, orders=orders) for position in points.positions]
    order = sorted(range(len(points)), key=lambda n: (shapes[n].samples, shapes[n].finer, shapes[n].period, shapes[n].pupil))
    done, start, transforms = 0, 0, []
    while start < len(order):
        shape = shapes[order[start]]
        largest = max(1, BATCH_BYTES // (shape.samples**2 * 8 * optics.device.complex.itemsize))
        stop = start
        while stop < len(order) and stop - start < largest and shapes[order[stop]] == shape:
            stop += 1
        chosen = order[start:stop]
        windows = LocalWindows.of(optics, shape, points.positions[chosen], points.diameter)
        _add(windows, points.power[chosen], total, active)
        transforms += [(3 * len(chosen), (shape.samples,) * 2)]
        done, start = done + len(chosen), stop
        if progress is not None:
            progress(done, len(points))
    return Exposure("local", _merged(transforms), 0.0)


def _add(windows: LocalWindows, power: Any, total: cla.Array, active: float) -> None:
    optics, device = windows.optics, windows.optics.device
    fields = windows.array_fields()
    fields = windows.sensor_spectra(windows.behind_array(fields))
    more = FINER_INTENSITY if active and windows.shape.rim is None else 1
    fields = refined(fields, more, device)
    for number in range(len(power)):
        sums, gain = _sums(windows, number, more, active)
        sums.put(total, fields, number, gain * power[number], device)


def refined(spectra: cla.Array, more: int, device: Device) -> cla.Array:
    """Fields of spectra with ``more`` times as many samples along each axis."""
    *batch, ny, nx = spectra.shape
    if more > 1:
        out = device.empty((*batch, more * ny, more * nx), device.complex)
        kernel = device.kernel("patterns.cl", "refine", **device.wave_defines())
        sizes = (np.int32(n) for n in (more * ny, more * nx, ny, nx))
        device.launch_rows(kernel, out.shape, out, spectra, *sizes)
        spectra = out
    device.fft.inverse(spectra, device)
    return spectra


def _sums(windows: LocalWindows, number: int, more: int, active: float) -> tuple[PixelSums, float]:
    """The pixels that a window's samples fill, and the factor to a point's energy 1."""
    optics, shape = windows.optics, windows.shape
    k, n = shape.finer, shape.samples
    width = more * k * active
    reach = len(pixel_weights(width)) // 2
    first, count, place = [], [], []
    for axis in (0, 1):
        middle = int(windows.centres[number, axis] + windows.shifts[number, axis])
        low = middle - n // 2 + shape.guard + math.ceil(reach / more)
        high = middle + n // 2 - 1 - shape.guard - math.ceil(reach / more)
        pixels = optics.grid.shape[axis]
        begin = max(-(-low // k), -(pixels // 2))
        end = min(high // k, pixels - 1 - pixels // 2)
        first.append(more * (begin * k - middle + n // 2))
        count.append(max(0, end - begin + 1))
        place.append(begin + pixels // 2)
    sums = PixelSums((first[0], first[1]), more * k, width, (place[0], place[1]), (count[0], count[1]))
    # the finer inverse transform divides by more^2 as many samples
    scale = more**2 if active else (more * k)**2
    return sums, scale * optics.rim_energy(shape.pitch) / windows.energy[number]


def _merged(transforms: Any) -> Transforms:
    counts: dict[tuple[int, int], int] = {}
    for n, shape in transforms:
        counts[shape] = counts.get(shape, 0) + n
    return tuple((n, shape) for shape, n in counts.items())
