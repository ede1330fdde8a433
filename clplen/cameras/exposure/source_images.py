"""Images of single points on the sensor: their weighted sums, and the transpose of these sums."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Protocol

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.local_exposure import pixel_samples, window_batches, window_samples
from clplen.cameras.exposure.wave_exposure import batch_size
from clplen.cameras.optics.local_window import Windows
from clplen.cameras.optics.pixel_array import PixelSums
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.wave.field.field import Field

Values = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]


class SourceImages(Protocol):
    """Images of points of a scene, each of energy 1."""

    @property
    def indices(self) -> Counts:
        """Indices of the points, shape (n,)."""

    @property
    def nbytes(self) -> int:
        """Number of bytes of the images."""

    def add(self, totals: cla.Array, energies: Values) -> None:
        """Add sum over the points of energies[b, n] times the image of point n to totals[b]."""

    def inner(self, pictures: cla.Array) -> Values:
        """Sum every image times every picture over the pixels, the transpose of `add`."""


@dataclass(frozen=True, eq=False)
class DeviceImages:
    """Images on patches of the sensor, on a device; see `SourceImages`."""

    indices: Counts  # indices of the points in a scene, int64, shape (n,)
    data: cla.Array  # real, shape (n, height, width)
    gains: Values  # factors to the energy 1, shape (n,)
    # first pixel (y, x) of each image on the sensor, int64, shape (n, 2)
    origins: Counts
    shapes: Counts  # used (height, width) of each image, int64, shape (n, 2)
    device: Device

    @property
    def nbytes(self) -> int:
        """Number of bytes on the device."""
        return int(self.data.nbytes)

    def add(self, totals: cla.Array, energies: Values) -> None:
        """Implement `SourceImages.add`."""
        device, batch = self.device, len(energies)
        kernel = device.kernel("source_images.cl", "add_images", **device.wave_defines())
        weights = device.upload((energies * self.gains).astype(device.real))
        frames = [tuple(map(int, (*p, *s))) for p, s in zip(self.origins, self.shapes, strict=True)]
        for frame, members in groupby(range(len(frames)), key=lambda n: frames[n]):
            indices, (oy, ox, down, across) = list(members), frame
            if min(down, across) < 1:
                continue
            numbers = (indices[0], len(indices), len(frames), oy, ox, *totals.shape[-2:])
            sizes = (*self.data.shape[-2:], across)
            device.launch_rows(
                kernel, (batch, down, across), totals, self.data, weights,
                *(np.int32(n) for n in (*numbers, *sizes)),
            )  # fmt: skip

    def inner(self, pictures: cla.Array) -> Values:
        """Implement `SourceImages.inner`."""
        device, (count, height, width) = self.device, self.data.shape
        batch = pictures.shape[0]
        rows = device.empty((batch, count, height), device.real)
        device.launch(
            device.kernel("source_images.cl", "image_rows", **device.wave_defines()),
            (height, count, batch), rows, self.data, pictures,
            *(device.upload(pairs.astype(np.int32)) for pairs in (self.origins, self.shapes)),
            *(np.int32(n) for n in (count, *pictures.shape[-2:], height, width)),
        )  # fmt: skip
        return device.download(rows).sum(axis=-1, dtype=np.float64) * self.gains


@dataclass(frozen=True, eq=False)
class PointFields:
    """Fields of points on the sensor's samples, and fields before the lenslets."""

    indices: Counts  # indices of the points, int64, shape (n,)
    spherical: Field  # field behind the main lens, without its wavefront
    energy: Values  # energy of each field at the main lens, shape (n,)
    # at_array, at_sensor: shape (n, ny, nx), before the field lens and the lenslets (or None), and
    # on the sensor
    at_array: Field | None
    at_sensor: Field


def point_fields(
    optics: WaveOptics, points: PointSources, *, share: int = 1
) -> Iterator[PointFields]:
    """Yield fields of the sensor's size, in batches that pass the camera together."""
    to_array, to_sensor = optics.padding(points.positions)
    widest = max(to_array, to_sensor) ** 2
    step = batch_size(optics, share * widest)
    nbytes = optics.grid.shape[0] * optics.grid.shape[1] * optics.device.complex.itemsize
    count = min(step, len(points))
    optics.device.require_memory((2 * widest + 3 * share) * nbytes * count, "This exposure")
    for start in range(0, len(points), step):
        indices = np.arange(start, min(start + step, len(points)))
        positions = points.positions[indices]
        spherical = optics.spherical_waves(positions, points.diameter, full_grid=False)
        pupil, energy = optics.wavefront_and_energy(spherical, optics.image_of(positions)[:, ::-1])
        at_array = optics.array_field(pupil, pad=to_array)
        at_sensor = optics.sensor_field(at_array, pad=to_sensor)
        yield PointFields(indices, spherical, energy, at_array, at_sensor)


def images_of(optics: WaveOptics, fields: PointFields) -> DeviceImages:
    """Return the images of fields on the whole sensor."""
    device, count = fields.at_sensor.device, len(fields.indices)
    active = 0.0 if optics.pixels is None else optics.pixels.active
    if active:
        fine, sums, scale = pixel_samples(fields.at_sensor, active)
        gains = scale / fields.energy
        return images_on_patches(fields.indices, fine, [sums] * count, gains, device)
    origins, shapes = np.zeros((count, 2), np.int64), np.tile(optics.grid.shape, (count, 1))
    data = fields.at_sensor.intensity().data
    return DeviceImages(fields.indices, data, 1 / fields.energy, origins, shapes, device)


def point_images(optics: WaveOptics, points: PointSources) -> Iterator[DeviceImages]:
    """Yield images of points by fields of the sensor's size."""
    for fields in point_fields(optics, points):
        yield images_of(optics, fields)


def local_images(optics: WaveOptics, points: PointSources) -> Iterator[DeviceImages]:
    """Yield images of points by windows."""
    for indices, windows, region in window_batches(optics, points):
        images = window_images(indices, windows, *window_samples(windows, region))
        del windows, region  # frees the region's memory before the next is computed
        yield images


def window_images(
    indices: Sequence[int], windows: Windows, fields: cla.Array, sums: list[tuple[PixelSums, float]]
) -> DeviceImages:
    """Return the images of windows from their `window_samples`."""
    gains = np.array([gain for _, gain in sums])
    pixels = [patch_sums for patch_sums, _ in sums]
    return images_on_patches(indices, fields, pixels, gains, windows.optics.device)


def images_on_patches(
    indices: Any, fields: cla.Array, sums: Sequence[PixelSums], gains: Values, device: Device
) -> DeviceImages:
    """Return images of fields by sums over the pixels of a patch for each field."""
    origins, shapes = (
        np.array([getattr(patch_sums, name) for patch_sums in sums], np.int64)
        for name in ("pixel", "shape")
    )
    height, width = (max(1, int(n)) for n in shapes.max(axis=0))
    stack = device.zeros((len(sums) * height, width), device.real)  # patches below each other
    for number, patch_sums in enumerate(sums):
        replace(patch_sums, pixel=(number * height, 0)).put(stack, fields, number, 1.0, device)
    data = stack.reshape(len(sums), height, width)
    return DeviceImages(np.asarray(indices, np.int64), data, gains, origins, shapes, device)
