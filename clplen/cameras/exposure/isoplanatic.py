"""Raw image of a self-luminous picture from patterns of a few positions under one lenslet.

pattern_lattice.py derives why a few positions suffice. The sum over positions of pattern * comb of
weights is computed in the Fourier domain, by one inverse transform for the whole picture. The combs
lie on fractions of a pixel. Each tooth is spread by a short kernel, and the last step divides by
its spectrum (Greengard and Lee 2004, "Accelerating the nonuniform fast Fourier transform").
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.local_exposure import refine
from clplen.cameras.exposure.pattern_lattice import (
    Patch,
    PatternGrid,
    patches,
    pattern_grid,
    powers,
)
from clplen.cameras.optics.wave_optics import WaveOptics, padded_shape
from clplen.cameras.scenes.scene_sources import PicturePlane
from clplen.compute.device import Device
from clplen.compute.fft.lines import smooth_length
from clplen.lightfield.raw.raw_image import Transforms
from clplen.wave.coherence.averaging import Progress
from clplen.wave.field.field import Field

Vector = np.ndarray[Any, np.dtype[np.float64]]
Complex = np.ndarray[Any, np.dtype[np.complex128]]
TEETH = 8  # samples of the spreading kernel
BAND_RATIO = 1.25  # band of the pixels over band of the pattern; the kernel's error is then 3e-5
MAX_SIGNAL_FREQUENCY = 0.45  # cycles a sample above which the kernel has no signal


@dataclass(frozen=True, eq=False)
class Layout:
    """Plan that composes a picture's raw image from patterns."""

    grid: PatternGrid
    patches: list[Patch]
    finer: int  # samples a pixel and axis of the patterns, enough to sample an intensity
    window: tuple[int, int]  # samples (y, x) of the window in which patterns are added up
    padding: tuple[int, int]  # padding factors of the propagation to the array and to the sensor

    @property
    def patterns(self) -> int:
        """Number of patterns that are simulated."""
        return len(self.patches) * self.grid.count**2

    def transforms(self, shape: tuple[int, int]) -> Transforms:
        """Return the Fourier transforms by shape: (number, (ny, nx))."""
        counts = [(2 * self.patterns, padded_shape(shape, pad)) for pad in self.padding]
        if self.finer > 1:
            fine = (self.finer * shape[0], self.finer * shape[1])
            counts += [(self.patterns, shape), (self.patterns, fine)]
        return (*counts, (2 * self.patterns + 1, self.window))

    def memory(self, optics: WaveOptics, batch: int) -> int:
        """Return the bytes on the device."""
        field = math.prod(optics.grid.shape)
        fields = (2 * max(self.padding) ** 2 + 2 + self.finer**2) * field * batch
        return (fields + 4 * math.prod(self.window) + 2 * field) * optics.device.complex.itemsize


def layout(optics: WaveOptics, plane: PicturePlane) -> Layout:
    """Plan patterns, patches and windows for a picture; the camera's array is not rotated."""
    grid = pattern_grid(optics)
    patch_list = patches(optics, plane, grid, powers(optics, plane))
    finer = max(1, math.ceil(2 * BAND_RATIO * _band(optics) * optics.pixel_pitch))
    pixel = optics.pixel_pitch / finer
    overhang = _overhang(optics, plane)
    window = []
    for axis, pitch in enumerate((grid.height, grid.pitch)):
        first = [patch.first[axis] for patch in patch_list]
        last = [patch.first[axis] + patch.count[axis] for patch in patch_list]
        ends = np.abs([*first, *last])
        shift = (int(ends.max()) + 1) * pitch * optics.sub_image_scale / pixel
        size = finer * optics.grid.shape[axis] + math.ceil(overhang[axis] / pixel)
        window.append(smooth_length(max(size, math.ceil(2 * shift) + 2 * TEETH)))
    padding = optics.padding(plane.corners().positions)
    return Layout(grid, patch_list, finer, (window[0], window[1]), padding)


def raw_patterns(
    optics: WaveOptics,
    plane: PicturePlane,
    plan: Layout,
    *,
    probes: Vector,
    batch: int,
    progress: Progress | None,
) -> tuple[cla.Array, cla.Array]:
    """Compute the raw image of a picture, and of a second picture of probes with it."""
    device = optics.device
    unit = plane.image.max()
    level = np.linalg.norm(plane.image / unit) / np.linalg.norm(probes)
    image = plane.image / unit + 1j * level * probes
    total, z, c = (device.zeros(plan.window, device.complex) for _ in range(3))
    done = 0
    for patch in plan.patches:
        teeth, part = _teeth(patch, optics, plan), image * patch.share
        for offsets in _batches(plan.grid.offsets(), batch):
            fields, gains = _fields(optics, plane, patch, offsets, plan)
            for b, offset in enumerate(offsets):
                _put_pattern(z, fields, b, gains[b])
                _put_comb(c, patch.weights(part, plan.grid, offset), teeth, plan, device)
                _add_product(total, z, c, device)
            done += len(offsets)
            if progress is not None:
                progress(done, plan.patterns)
    return _finish_images(total, optics, plan, unit, 1 / level)


def _band(optics: WaveOptics) -> float:
    """Return the highest frequency of a pattern: twice that of its field, D/(2 z2) + d/(2 f_mu).

    The main lens' wavefront adds none: on the array D/(2 z2) is the angle of its pupil.
    """
    lenslet = 2 * optics.mla.steepest_slope(optics.wavelength)
    slopes = optics.aperture_diameter / optics.array_distance + lenslet
    slopes += 2 * optics.aberrations.lenslet_slope(optics.mla)
    return slopes / (optics.wavelength * optics.sub_image_scale)


def _overhang(optics: WaveOptics, plane: PicturePlane) -> tuple[float, float]:
    """Return the reach of light past the sensor's edge along y and x, in metres."""
    images = np.abs(optics.on_array(plane.corners().positions)).max(axis=0)[::-1]
    overhang = images * optics.sub_image_scale + optics.spread(plane.z)
    overhang -= np.asarray(optics.grid.extent) / 2
    y, x = np.maximum(overhang, 0)
    return float(y), float(x)


def _source_points(optics: WaveOptics, plane: PicturePlane, images: Vector) -> Vector:
    """Return (x, y, dz) on the picture's plane of points whose chief rays meet the array there."""
    scale = 1 / optics.array_scale(plane.z)
    flat = np.full(len(images), plane.z)
    return np.stack([images[:, 1] * scale, images[:, 0] * scale, flat], axis=-1)


def _batches(offsets: Vector, batch: int) -> Iterator[Vector]:
    for start in range(0, len(offsets), batch):
        yield offsets[start : start + batch]


def _fields(
    optics: WaveOptics, plane: PicturePlane, patch: Patch, offsets: Vector, plan: Layout
) -> tuple[Field, Vector]:
    """Compute sensor fields of points imaged about a lenslet, and their factors to energy 1."""
    points = _source_points(optics, plane, np.asarray(patch.centre) + offsets)
    pupil, energies = optics.pupil_and_energy(points, full_grid=False)
    gains = 1 / energies
    to_array, to_sensor = plan.padding
    fields = optics.sensor_field(optics.array_field(pupil, pad=to_array), pad=to_sensor)
    if plan.finer > 1:
        optics.device.fft.forward(fields.data, optics.device)
        fields = fields.with_data(refine(fields.data, plan.finer, optics.device))
    return fields, gains


def _put_pattern(z: cla.Array, fields: Field, b: int, gain: float) -> None:
    """Write the transform of field b's intensity times ``gain``, without its padding's factor."""
    device, shape = fields.device, fields.data.shape[-2:]
    scale = gain * (math.prod(shape) / math.prod(fields.grid.shape)) ** 2
    kernel = device.kernel("patterns.cl", "pattern", **device.wave_defines())
    sizes = (np.int32(n) for n in (b, *z.shape, *shape))
    device.launch_rows(kernel, z.shape, z, fields.data, device.real.type(scale), *sizes)
    device.fft.forward(z, device)


@dataclass(frozen=True, eq=False)
class Teeth:
    """Tables of kernel `comb`: lenslets that each sample of the window meets, and their factors."""

    row: cla.Array
    down: cla.Array
    column: cla.Array
    across: cla.Array


def _teeth(patch: Patch, optics: WaveOptics, plan: Layout) -> Teeth:
    device, grid = optics.device, plan.grid
    per_pixel = optics.sub_image_scale * plan.finer / optics.pixel_pitch
    row, down = _nearest_teeth(plan.window[0], patch.first[0], grid.height * per_pixel, 0.0)
    pairs = [
        _nearest_teeth(plan.window[1], patch.first[1], grid.pitch * per_pixel, kind / 2)
        for kind in range(grid.kinds)
    ]
    column, across = (np.stack(tables) for tables in zip(*pairs, strict=True))
    return Teeth(
        device.upload(row),
        device.upload(down.astype(device.real)),
        device.upload(column),
        device.upload(across.astype(device.real)),
    )


def _nearest_teeth(
    length: int, first: int, pitch: float, shift: float
) -> tuple[np.ndarray[Any, Any], Vector]:
    """Return each sample's first tooth within reach, counted from ``first``, and its factors."""
    sample = np.arange(length)
    sample = np.where(sample < length / 2, sample, sample - length)
    nearest = np.floor((sample - TEETH / 2) / pitch - shift).astype(np.int64) + 1
    tooth = nearest[:, None] + np.arange(math.ceil(TEETH / pitch))
    root = 1 - ((sample[:, None] - (tooth + shift) * pitch) / (TEETH / 2)) ** 2
    beta = _beta()
    factors = np.where(root > 0, np.i0(beta * np.sqrt(np.maximum(root, 0))) / np.i0(beta), 0.0)
    return (nearest - first).astype(np.int32), factors


def _beta() -> float:
    """Return the spreading kernel's beta: its main lobe ends at the first alias."""
    return math.pi * TEETH * (1 - 1 / (2 * BAND_RATIO))


def _put_comb(c: cla.Array, weights: Complex, teeth: Teeth, plan: Layout, device: Device) -> None:
    """Write the transform of the lenslets' weights on the window."""
    kernel = device.kernel("patterns.cl", "comb", **device.wave_defines())
    tall, wide = teeth.down.shape[-1], teeth.across.shape[-1]
    sizes = (np.int32(n) for n in (*weights.shape, plan.grid.kinds, tall, wide, *plan.window))
    tables = (teeth.row, teeth.down, teeth.column, teeth.across)
    device.launch_rows(
        kernel, plan.window, c, device.upload(weights.astype(device.complex)), *tables, *sizes
    )
    device.fft.forward(c, device)


def _add_product(total: cla.Array, a: cla.Array, b: cla.Array, device: Device) -> None:
    kernel = device.kernel("patterns.cl", "add_product", **device.wave_defines())
    device.launch_rows(kernel, total.shape, total, a, b, *(np.int32(n) for n in total.shape))


def _finish_images(
    total: cla.Array, optics: WaveOptics, plan: Layout, unit: float, probe: float
) -> tuple[cla.Array, cla.Array]:
    """Divide by the spreading kernel's spectrum, transform, and sample the pixels."""
    device, (ny, nx) = optics.device, optics.grid.shape
    kernel = device.kernel("separable.cl", "multiply_separable", **device.wave_defines())
    active = 0.0 if optics.pixels is None else optics.pixels.active
    width = plan.finer * active  # side that a pixel integrates over, in samples
    spectra = (
        device.upload((_unspread(n) * np.sinc(np.fft.fftfreq(n) * width)).astype(device.complex))
        for n in plan.window
    )
    share = active or 1.0
    sizes = (np.int32(n) for n in plan.window)
    device.launch_rows(kernel, plan.window, total, total, *spectra, *sizes)
    device.fft.inverse(total, device)
    images = []
    for pick in ((unit * share**2, 0.0), (0.0, probe * share**2)):
        out = device.zeros((ny, nx), device.real)
        kernel = device.kernel("patterns.cl", "add_part", **device.wave_defines())
        numbers = (np.int32(n) for n in (plan.finer, plan.window[1], ny, nx))
        device.launch_rows(kernel, (ny, nx), out, total, np.array(pick, device.real), *numbers)
        images.append(out)
    return images[0], images[1]


def _unspread(length: int) -> Vector:
    """Return 1 over the spectrum of I0(beta sqrt(1 - (2 t/w)^2))/I0(beta), 0 above the band."""
    f = np.fft.fftfreq(length)
    root = np.sqrt(np.maximum(_beta() ** 2 - (math.pi * TEETH * f) ** 2, 1e-12))
    spectrum = TEETH * np.sinh(root) / root / np.i0(_beta())
    return np.where(np.abs(f) <= MAX_SIGNAL_FREQUENCY, 1 / spectrum, 0.0)
