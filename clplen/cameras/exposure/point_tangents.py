"""Forward mode of an exposure: derivatives of the images of points.

A point's image of energy 1 is I = S(|u|^2)/E, u its field on the sensor, E its energy at the main
lens and S the sums over pixels. A change de behind the main lens, or dt of the lenslets, propagates
to du as the light itself does, and dI = S(2 Re(conj(u) du))/E - I dE/E.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import special

from clplen.cameras.exposure.local_exposure import pixel_samples
from clplen.cameras.exposure.point_gradients import MEMORY_FACTOR, active_side, check_differentiable
from clplen.cameras.exposure.source_images import PointFields, point_fields
from clplen.cameras.optics.wave_optics import WaveOptics
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.wave.field.field import Field
from clplen.wave.field.transmission import multiply

Values = np.ndarray[Any, np.dtype[np.float64]]
Group = Literal["values", "positions", "lenslets", "sensor"]


@dataclass(frozen=True, eq=False)
class PointTangents:
    """Images of points of energy 1, and their derivatives; float64."""

    indices: np.ndarray[Any, Any]  # indices of the points, int64, shape (n,)
    images: Values  # shape (n, ny, nx)
    # derivatives by (x, y, dz), per metre, shape (3, n, ny, nx), or (0, n, ny, nx) if not requested
    positions: Values
    # derivatives by common parameters, shapes (k, n, ny, nx): of the lenslets the names of
    # `MicrolensArray.jacobian` and "focal_length"; of the sensor "shift" (k = 1), "tilt" (y, x)
    shared: dict[str, Values]


def point_tangents(
    optics: WaveOptics, points: PointSources, by: Sequence[Group]
) -> Iterator[PointTangents]:
    """Yield images of points with their derivatives, in batches."""
    check_differentiable(optics)
    pads = optics.padding(points.positions)
    for fields in point_fields(optics, points, share=MEMORY_FACTOR):
        pixels = _Pixels.of(optics, fields)
        images = pixels.change(fields.at_sensor) / 2
        shared: dict[str, Values] = {}
        positions = np.zeros((0, *images.shape))
        if "positions" in by:
            positions = _by_position(optics, points, fields, images, pixels, pads)
        assert fields.at_array is not None  # `point_fields` gives it
        before = optics.behind_field_lens(fields.at_array)
        if "lenslets" in by:
            shared |= _by_lenslets(optics, before, pixels, pads[1])
        if "sensor" in by:
            shared |= _by_sensor(optics, before, pixels, pads[1])
        yield PointTangents(fields.indices, images, positions, shared)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Pixel signals of fields u, and of changes of u."""

    u: np.ndarray[Any, Any]  # samples that pixels integrate over, complex, shape (n, ny, nx)
    active: float  # argument of `pixel_samples`
    energy: Values  # energy of each field at the main lens, shape (n,)

    @classmethod
    def of(cls, optics: WaveOptics, fields: PointFields) -> _Pixels:
        samples, _, _ = pixel_samples(fields.at_sensor, active_side(optics))
        return cls(optics.device.download(samples), active_side(optics), fields.energy)

    def change(self, du: Field) -> Values:
        """Compute S(2 Re(conj(u) du))/E, float64, shape (n, ny, nx)."""
        samples, sums, scale = pixel_samples(du, self.active)
        changes = du.device.download(samples)
        product = self.u.real.astype(np.float64) * changes.real + self.u.imag * changes.imag
        light = product if self.active == 0 else sums.sums(product)
        return np.asarray(light * (2 * scale / self.energy)[:, None, None])


def _by_position(
    optics: WaveOptics,
    points: PointSources,
    fields: PointFields,
    images: Values,
    pixels: _Pixels,
    pads: tuple[int, int],
) -> Values:
    """Compute derivatives by x, y and dz, shape (3, n, ny, nx)."""
    positions, device, derivatives = points.positions[fields.indices], optics.device, []
    e0 = fields.spherical
    if points.diameter:
        e0 = optics.spherical_waves(positions, full_grid=False)
    of_image, samples = optics.image_of(positions)[:, ::-1], device.download(e0.data)
    power = np.abs(samples.astype(np.complex128)) ** 2
    for factor, grows in position_factors(optics, e0, positions, points.diameter):
        light = device.upload((samples * factor).astype(device.complex))
        pupil = optics.behind_main_lens(e0.with_data(light), of_image)
        at_array = optics.array_field(pupil, pad=pads[0])
        change = pixels.change(optics.sensor_field(at_array, pad=pads[1]))
        lost = (power * grows).sum(axis=(1, 2)) / fields.energy
        derivatives.append(change - images * lost[:, None, None])
    return np.stack(derivatives)


def position_factors(
    optics: WaveOptics, e0: Field, positions: Values, diameter: float
) -> Iterator[tuple[np.ndarray[Any, Any], Values]]:
    """Yield de/dp over e0 for p = x, y, dz of points, and the derivative of (e/e0)^2 in amplitude.

    e = e0 D exp(i phase of the main lens), D(v) = 2 J1(v)/v, v = pi d rho/(lam z); with r^2 =
    rho^2 + z^2 see kernels/cameras/source_images.cl. If the wavefront of the main lens changes
    over the field, its phase changes with the position of the image.
    """
    z = (optics.object_distance + positions[:, 2])[:, None, None]
    down = (e0.grid.y - positions[:, 1:2])[:, :, None]
    right = (e0.grid.x - positions[:, 0:1])[:, None, :]
    rho2, k = down**2 + right**2, 2 * np.pi / optics.wavelength
    r = np.sqrt(rho2 + z**2)
    scale = np.pi * diameter / (optics.wavelength * z)
    v = scale * np.sqrt(rho2)
    safe = np.where(v > 0, v, 1.0)
    disc = np.where(v > 0, 2 * special.j1(safe) / safe, 1.0)
    slope = np.where(v > 0, -2 * special.jv(2, safe) / safe, 0.0)
    across = scale**2 * np.where(v > 0, slope / safe, -0.25)
    turns = _turns(optics, e0, positions, z)
    for axis, away in ((0, right), (1, down)):
        grows = -away * across
        yield disc * (-1j * k * away / r + 1j * turns[axis]) + grows, 2 * disc * grows
    grows = -slope * v / z
    yield disc * (-1j * k * rho2 / (r * (r + z)) + 1j * turns[2]) + grows, 2 * disc * grows


def _turns(optics: WaveOptics, e0: Field, positions: Values, z: Values) -> list[Any]:
    """Compute the change of the main lens' phase with x, y and dz, in radians a metre."""
    if not optics.aberrations.varies:
        return [0.0, 0.0, 0.0]
    by_y, by_x = (2 * np.pi * turns for turns in optics.field_turns(e0)[1:])
    y, x = (coordinate[:, None, None] for coordinate in optics.image_of(positions)[:, ::-1].T)
    scale = -optics.image_distance / z
    return [scale * by_x, scale * by_y, -(by_y * y + by_x * x) / z]


def _by_lenslets(optics: WaveOptics, before: Field, pixels: _Pixels, pad: int) -> dict[str, Values]:
    """Compute derivatives by the parameters of the array."""
    derivatives, device = {}, optics.device
    for name, changes in optics.mla.jacobian(before.grid, before.wavelength, device).items():
        each = []
        for change in changes:
            behind = optics.behind_lenslets(multiply(before, device.upload(change)))
            each.append(pixels.change(optics.to_sensor(behind, pad=pad)))
        derivatives[name] = np.stack(each)
    return derivatives | {"focal_length": derivatives["focal_lengths"].sum(axis=0, keepdims=True)}


def _by_sensor(optics: WaveOptics, before: Field, pixels: _Pixels, pad: int) -> dict[str, Values]:
    """Compute derivatives by the distance and the slopes of the sensor."""
    behind = optics.behind_lenslets(optics.mla.apply(before))
    slope, device = optics.sensor_slope(behind, pad=pad), optics.device
    y, x = np.meshgrid(slope.grid.y, slope.grid.x, indexing="ij")
    tilts = [
        pixels.change(multiply(slope, device.upload(coordinate.astype(device.complex))))
        for coordinate in (y, x)
    ]
    return {"shift": pixels.change(slope)[None], "tilt": np.stack(tilts)}
