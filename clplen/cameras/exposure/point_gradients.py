"""Reverse mode of an exposure: gradients of a loss by the positions of points.

A loss L of the raw image has the derivatives Y = dL/dI by its pixels. A point of energy p has the
field u on the sensor, from e behind the main lens. The light h = 2 p Y conj(u) propagates back by
the transposed steps. Free space between equal windows and all plates are symmetric, so that these
are the forward steps in reverse order. At the main lens dL/dp = sum Re(h de/dp), e in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.local_exposure import pixel_samples, sample_sums, transposed_samples
from clplen.cameras.exposure.source_images import DeviceImages, PointFields, point_fields
from clplen.cameras.optics.wave_optics import WaveOptics, disc_table
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.device import Device
from clplen.compute.fft.blocks import window
from clplen.reprs import OneLine
from clplen.wave.field.field import Field, Grid

Values = np.ndarray[Any, np.dtype[np.float64]]

MEMORY_FACTOR = 2  # memory of the fields of a gradient, relative to an exposure


@dataclass(frozen=True, eq=False, repr=False)
class ExposureGradient(OneLine):
    """Derivatives of a loss of a raw image with respect to parameters of a scene.

    Attributes
    ----------
    values : numpy.ndarray
        Derivatives by the energies, shape of the operator's ``in_shape``: its adjoint of the
        cotangent.
    positions : numpy.ndarray
        Derivatives by (x, y, dz) of every point, per metre, float64, shape (n, 3). Points have the
        order of ``operator.positions``.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15, aperture_diameter=0.5e-3)
    >>> operator = clplen.cameras.ExposureOperator(camera, clplen.PointSources((0, 0, -1e-3)))
    >>> image = operator.forward([1.0])
    >>> gradient = operator.gradient([1.0], 2 * image)  # of the sum of the squares
    >>> gradient.values.shape, gradient.positions.shape
    ((1,), (1, 3))
    """

    values: Values
    positions: Values


@dataclass(frozen=True, eq=False)
class PointGradients:
    """Derivatives by the energies and the positions of points."""

    energies: Values  # derivatives by energies of points behind each filter, shape (filters, n)
    positions: Values  # derivatives by (x, y, dz), per metre, shape (n, 3)


def check_differentiable(optics: WaveOptics) -> None:
    """Raise if the field of a point has no derivative in closed form."""
    if optics.aberrations.varies and optics.aberrations.main_lens_opd is not None:
        raise ValueError(
            "Gradients by positions do not support OPD maps that change over the field: use a "
            "main_lens_opd that is constant over the field, or Zernike terms."
        )


def point_gradients(
    optics: WaveOptics,
    points: PointSources,
    energies: Values,
    pictures: Values,
    fields_of: Iterable[PointFields] | None = None,
) -> PointGradients:
    """Compute derivatives of a loss by the energies and the positions of points."""
    check_differentiable(optics)
    counts = _on_samples(optics, pictures)
    by_energy = np.zeros(energies.shape)
    by_place = np.zeros((len(points), 3))
    pads = optics.padding(points.positions)
    if fields_of is None:
        fields_of = point_fields(optics, points, share=MEMORY_FACTOR)
    for fields in fields_of:
        indices = fields.indices
        samples, _, scale = pixel_samples(fields.at_sensor, active_side(optics))
        by_energy[:, indices] = _inner(fields, samples, scale, counts)
        weights = energies[:, indices] * (scale / fields.energy)
        behind = _behind_array(optics, fields, samples, weights, counts, pads[1])
        lost = (energies[:, indices] * by_energy[:, indices]).sum(axis=0) / fields.energy
        by_place[indices] = _by_position(
            optics, points, fields, _before_lenslets(optics, behind), pads[0], lost
        )
    return PointGradients(by_energy, by_place)


def array_fields(
    optics: WaveOptics, points: PointSources, energies: Values, pictures: Values
) -> Iterator[tuple[Field, Field]]:
    """Yield fields before the lenslets, and gradients of a loss by fields behind them.

    Parameters are those of `point_gradients`.
    """
    to_sensor = optics.padding(points.positions)[1]
    counts = _on_samples(optics, pictures)
    for fields in point_fields(optics, points, share=MEMORY_FACTOR):
        samples, _, scale = pixel_samples(fields.at_sensor, active_side(optics))
        weights = energies[:, fields.indices] * (scale / fields.energy)
        behind = _behind_array(optics, fields, samples, weights, counts, to_sensor)
        assert fields.at_array is not None  # `point_fields` gives it
        conjugate = behind.with_data(_conjugate(behind.data, behind.device))
        yield optics.behind_field_lens(fields.at_array), conjugate


def active_side(optics: WaveOptics) -> float:
    return 0.0 if optics.pixels is None else optics.pixels.active


def _on_samples(optics: WaveOptics, pictures: Values) -> cla.Array:
    """Return the weights of the samples of `pixel_samples` in pictures (filters, ny, nx)."""
    device, active = optics.device, active_side(optics)
    sums, shape = sample_sums(active, optics.grid.shape)
    counts = (
        pictures if active == 0 else np.stack([sums.spread(picture, shape) for picture in pictures])
    )
    return device.upload(np.ascontiguousarray(counts, device.real))


def _inner(fields: PointFields, samples: cla.Array, scale: float, counts: cla.Array) -> Values:
    """Compute sums over pixels of pictures times images, shape (filters, n)."""
    device, sensor = fields.at_sensor.device, fields.at_sensor
    shape = (int(samples.shape[-2]), int(samples.shape[-1]))
    light = Field(samples, Grid(shape, sensor.grid.pitch), sensor.wavelength, device).intensity()
    origins = np.zeros((len(fields.indices), 2), np.int64)
    shapes = np.tile(shape, (len(fields.indices), 1))
    gains = scale / fields.energy
    return DeviceImages(fields.indices, light.data, gains, origins, shapes, device).inner(counts)


def _behind_array(
    optics: WaveOptics,
    fields: PointFields,
    samples: cla.Array,
    weights: Values,
    counts: cla.Array,
    pad: int,
) -> Field:
    """Compute h behind the lenslets as thin lenses, from weights (filters, n) of the samples."""
    device, field = optics.device, fields.at_sensor
    h = device.empty(samples.shape, device.complex)
    put_cotangents(h, samples, counts, weights, device)
    h = transposed_samples(h, active_side(optics), field.grid.shape, device)
    return optics.behind_lenslets(optics.from_sensor(field.with_data(h), pad=pad))


def put_cotangents(
    h: cla.Array, fields: cla.Array, pictures: cla.Array, weights: Values, device: Device
) -> None:
    """Write h[n] = 2 conj(fields[n]) sum_f weights[f, n] pictures[f]."""
    device.launch_rows(
        device.kernel("source_images.cl", "cotangent", **device.wave_defines()),
        h.shape, h, fields, pictures, device.upload(np.ascontiguousarray(weights, device.real)),
        *(np.int32(n) for n in (*weights.shape, *h.shape[-2:])),
    )  # fmt: skip


def _before_lenslets(optics: WaveOptics, behind: Field) -> Field:
    """Return h before the field lens and the lenslets."""
    return optics.behind_field_lens(optics.mla.apply(behind))


def _by_position(
    optics: WaveOptics, points: PointSources, fields: PointFields, h: Field, pad: int, lost: Values
) -> Values:
    """Compute dL/d(x, y, dz) of points from h before the array, shape (n, 3)."""
    device, positions = optics.device, points.positions[fields.indices]
    spherical = fields.spherical
    if points.diameter:
        spherical = optics.spherical_waves(positions, full_grid=False)
    grid = spherical.grid
    h = optics.propagator(optics.array_distance, "blas", pad)(h)
    at_lens = h.data
    if grid.shape != h.grid.shape:
        at_lens = window(at_lens, (len(positions), *grid.shape), device)
    images = optics.image_of(positions)[:, ::-1]
    behind = optics.behind_main_lens(spherical.with_data(at_lens), images)
    sums = point_rows(optics, spherical, behind.data, positions, points.diameter, lost)
    if not optics.aberrations.varies:
        return sums[:, :3]
    z = optics.object_distance + positions[:, 2]
    scale = -optics.image_distance / z  # image (y, x) = (y, x) scale
    by_y, by_x = sums[:, 3], sums[:, 4]
    sums[:, 0] += by_x * scale
    sums[:, 1] += by_y * scale
    sums[:, 2] -= (by_y * images[:, 0] + by_x * images[:, 1]) / z
    return sums[:, :3]


def point_rows(
    optics: WaveOptics, e0: Field, h: cla.Array, positions: Values, diameter: float, lost: Values
) -> Values:
    """Compute derivatives of Re sum h e by positions of points, from h behind the main lens."""
    device, grid = optics.device, e0.grid
    real, (count, ny, nx) = device.real, e0.shape
    z = optics.object_distance + positions[:, 2]
    scale = np.pi * diameter / (optics.wavelength * z)
    down, right = grid.y - positions[:, 1:2], grid.x - positions[:, 0:1]
    farthest = math.hypot(np.abs(down).max(), np.abs(right).max())
    table, per_step = disc_table(float(scale.max() * farthest), device)
    defines = device.wave_defines() | ({"SIZE": True} if diameter else {})
    plate = np.zeros((1, 1, 2))
    if optics.aberrations.varies:
        defines |= {"FIELD": True}
        plate = np.stack(optics.field_turns(e0)[1:], axis=-1)
    source = np.stack([z, scale, lost, np.zeros_like(z)], axis=-1)
    out = device.empty((count, ny, 5), real)
    device.launch(
        device.kernel("source_images.cl", "point_rows", **defines),
        (ny, count), out, h, e0.data,
        *(device.upload(np.ascontiguousarray(v, real)) for v in (source, down, right, table)),
        np.int32(len(table) - 1), real.type(per_step),
        device.upload(np.ascontiguousarray(plate, real)),
        real.type(2 * np.pi / optics.wavelength), np.int32(ny), np.int32(nx),
    )  # fmt: skip
    return device.download(out).sum(axis=1, dtype=np.float64)


def _conjugate(data: cla.Array, device: Device) -> cla.Array:
    out = device.empty(data.shape, device.complex)
    kernel = device.kernel("source_images.cl", "conjugate", **device.wave_defines())
    device.launch_rows(kernel, data.shape, out, data, *(np.int32(n) for n in data.shape[-2:]))
    return out
