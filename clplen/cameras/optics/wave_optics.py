"""Waves through a plenoptic camera: from points to the main lens, the array and the sensor.

Positions are plain arrays; sources and the sums of their energies are defined elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras.optics.ray_optics import RayOptics, check_in_view, check_sampling, is_sampled
from clplen.cameras.optics.tilted_sensor import SensorPlanes, sensor_planes
from clplen.cameras.scenes.occluders import Occluder
from clplen.compute.device import Device
from clplen.compute.fft.blocks import add, window
from clplen.compute.fft.lines import smooth_length
from clplen.errors import DeviceError, ShapeError
from clplen.wave.elements.hard_apertures import disc_coverage
from clplen.wave.elements.lens import thin_lens
from clplen.wave.elements.zernike import wavefront, zernike
from clplen.wave.field.field import Field, Grid, row_powers
from clplen.wave.field.transmission import multiply, offsets, phasor, split
from clplen.wave.propagation.band import blas_limit
from clplen.wave.propagation.free_space import plan
from clplen.wave.propagation.propagator import Propagator

Positions = np.ndarray[Any, np.dtype[np.float64]]

MAX_RESIDUAL_TURNS = 2.0  # maximum turns in single precision; the error is then 5e-6 rad
TABLE_STEP = 1e-2  # step of the table of 2 J1(v)/v; cubic Hermite interpolation errs by 3e-12


def pupil_fields(
    positions: Positions,
    diameter: float = 0.0,
    *,
    grid: Grid,
    object_distance: float,
    focal_length: float,
    aperture_diameter: float,
    wavelength: float,
    device: Device,
) -> Field:
    """Compute fields behind a thin lens with a circular aperture, one for each source.

    Each is an exact spherical wave from the source, times 2 J1(v)/v, v = pi d rho/(lam z), for a
    uniform coherent disc of diameter d (Goodman 2005, eq. 4-31), times aperture and lens.
    """
    y, x = grid.y, grid.x
    z = object_distance + positions[:, 2]
    ty, tx = (
        _quadratic_phasors(axis, positions[:, column], z, focal_length, wavelength, device)
        for axis, column in ((y, 1), (x, 0))
    )
    scale = np.pi * diameter / (wavelength * z)
    reach = np.hypot(*(aperture_diameter / 2 + np.abs(positions[:, :2]).max(axis=0)))
    table, per_step = disc_table(float(scale.max() * reach), device)
    defines = device.wave_defines() | _residual_route(reach, z.min(), wavelength, device)
    feet = np.stack([*split(z, device.real).T, scale, np.zeros_like(z)], axis=-1)
    out = device.empty((len(z), *grid.shape), device.complex)
    real = device.real.type
    device.launch_rows(
        device.kernel("source.cl", "point_sources", **defines),
        out.shape,
        out,
        device.upload(ty),
        device.upload(tx),
        device.upload(feet.astype(device.real)),
        device.upload(table),
        np.int32(len(table) - 1),
        real(per_step),
        split(wavelength, device.real),
        device.upload(split(y[None, :] - positions[:, 1:2], device.real)),
        device.upload(split(x[None, :] - positions[:, 0:1], device.real)),
        device.upload(y.astype(device.real)),
        device.upload(x.astype(device.real)),
        real(aperture_diameter / 2),
        real(grid.pitch[0] / 2),
        real(grid.pitch[1] / 2),
        np.int32(grid.shape[0]),
        np.int32(grid.shape[1]),
    )
    return Field(out, grid, wavelength, device)


def _residual_route(reach: float, z: float, wavelength: float, device: Device) -> dict[str, bool]:
    """Return the kernel's switches: the phase (r - z)^2/(2 z lam) beside tables may need fp64."""
    beyond = reach**2 / (np.hypot(reach, z) + z)
    turns = beyond**2 / (2 * z * wavelength)
    if device.precision == "double" or turns <= MAX_RESIDUAL_TURNS:
        return {}
    if not device.has_fp64:
        raise DeviceError(
            f"A source at {z:g} m from the lens leaves {turns:.3g} turns of phase to single "
            f"precision, more than {MAX_RESIDUAL_TURNS:g}, and {device.name} has no double "
            "precision: use another device, or a smaller aperture."
        )
    return {"RESIDUAL_FP64": True}


def _quadratic_phasors(
    axis: np.ndarray[Any, Any],
    foot: np.ndarray[Any, Any],
    z: np.ndarray[Any, Any],
    f: float,
    wavelength: float,
    device: Device,
) -> np.ndarray[Any, Any]:
    """Compute the phase factors of source and lens along one axis, shape (sources, samples)."""
    spherical = (axis[None, :] - foot[:, None]) ** 2 / (2 * wavelength * z[:, None])
    return phasor(spherical - axis[None, :] ** 2 / (2 * wavelength * f), device.complex)


def disc_table(largest: float, device: Device) -> tuple[np.ndarray[Any, Any], float]:
    """Return a table of 2 J1(v)/v and its slope times the step, and steps a unit of v."""
    from scipy import special  # a slow import

    count = max(2, int(np.ceil(largest / TABLE_STEP)) + 2)
    v = np.arange(count) * TABLE_STEP
    safe = np.where(v > 0, v, 1.0)
    value = np.where(v > 0, 2 * special.j1(safe) / safe, 1.0)
    slope = np.where(v > 0, -2 * special.jv(2, safe) / safe, 0.0)
    return np.stack([value, slope * TABLE_STEP], axis=-1).astype(device.real), 1 / TABLE_STEP


Values = np.ndarray[Any, np.dtype[np.float64]]
MAX_RIM_SAMPLES = 4096  # samples across; a larger rim uses the mean loss below
MEAN_RIM_LOSS = 0.664  # energy loss of rim samples, times samples across: 4 int c (1 - c), c cover
FRESNEL_WIDTHS = 2  # Fresnel widths beyond the geometric edge that an unpadded window holds


@dataclass(frozen=True, repr=False)
class WaveOptics(RayOptics):
    """Fields behind the main lens, at the array and on the sensor of a plenoptic camera.

    Attributes
    ----------
    occluders : tuple of Occluder
        Screens before the camera, which only windows of points support.
    focal_length, object_distance, image_distance, aperture_diameter, mla, wavelength, device
        Same attributes as in `Plenoptic1`.
    pixels_per_lenslet, pixel_pitch, grid, field_lens, aberrations, lens_model, pixels, m
        Same attributes as in `Plenoptic1` and `Plenoptic2`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15, aperture_diameter=0.5e-3)
    >>> waves = camera.optics
    >>> at_array = waves.array_field(waves.pupil(np.zeros((1, 3))))
    >>> y, x = np.unravel_index(np.abs(at_array.to_numpy()[0]).argmax(), (75, 75))
    >>> at_array.shape, (int(y), int(x))  # the image of the axis point lies in the middle
    ((1, 75, 75), (37, 37))
    """

    occluders: tuple[Occluder, ...] = field(default=(), kw_only=True)

    def pupil(self, positions: Values, diameter: float = 0.0, *, full_grid: bool = True) -> Field:
        """Compute fields of points behind the main lens.

        Parameters
        ----------
        positions : numpy.ndarray
            (x, y, dz) in metres from the axis point of the focused plane, shape (n, 3).
        diameter : float
            Diameter of each point as a uniform coherent disc, in metres; 0 is a point.
        full_grid : bool
            True for fields on the whole grid, False for the samples that the aperture touches.

        Returns
        -------
        Field
            Shape (n, ny, nx); not normalised.
        """
        images = self.image_of(positions)[:, ::-1]
        return self.behind_main_lens(self.spherical_waves(positions, diameter, full_grid), images)

    def pupil_and_energy(
        self, positions: Values, diameter: float = 0.0, *, full_grid: bool = True
    ) -> tuple[Field, Values]:
        """Compute fields of points behind the main lens, and their energies without vignetting."""
        spherical = self.spherical_waves(positions, diameter, full_grid)
        return self.wavefront_and_energy(spherical, self.image_of(positions)[:, ::-1])

    def wavefront_and_energy(self, spherical: Field, images: Values) -> tuple[Field, Values]:
        """Apply the main lens to `spherical_waves` with images (y, x), shape (n, 2)."""
        if not self.aberrations.vignettes:
            behind = self.behind_main_lens(spherical, images)
            return behind, row_powers(behind).sum(axis=-1)
        bent = self._apply_wavefront(spherical, images)
        return self._apply_vignetting(bent, images), row_powers(bent).sum(axis=-1)

    def spherical_waves(
        self, positions: Values, diameter: float = 0.0, full_grid: bool = True
    ) -> Field:
        """Compute fields of points behind the main lens without its wavefront; as `pupil`."""
        return pupil_fields(
            positions,
            diameter,
            grid=self.grid if full_grid else aperture_grid(self.grid, self.lit_diameter),
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.lit_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )

    def array_field(self, pupil: Field, *, pad: int = 1) -> Field:
        """Propagate fields behind the main lens to the array, before its lenslets.

        Parameters
        ----------
        pupil : Field
            Shape (..., ny, nx), on the camera's grid or a part of it about the same centre.
        pad : int
            Zero padding, see `padding`.

        Returns
        -------
        Field
            On the camera's grid.
        """
        return propagate_part(self.propagator(self.array_distance, "blas", pad), pupil)

    def sensor_field(self, at_array: Field, *, pad: int = 1) -> Field:
        """Propagate fields at the array through it and to the sensor.

        Parameters
        ----------
        at_array : Field
            Shape (..., ny, nx).
        pad : int
            Zero padding, see `padding`.

        Returns
        -------
        Field
            Same shape.
        """
        through = self.mla.apply(self.behind_field_lens(at_array))
        return self.to_sensor(self.behind_lenslets(through), pad=pad)

    def behind_field_lens(self, at_array: Field) -> Field:
        """Apply the field lens at the array, if the camera has one."""
        return thin_lens(at_array, self.array_distance) if self.field_lens else at_array

    def to_sensor(self, behind: Field, *, pad: int = 1) -> Field:
        """Propagate fields behind the lenslets to the pixels of the sensor."""
        if not any(self.aberrations.sensor_tilt):
            return self.propagator(self.sensor_distance, "as", pad)(behind)
        planes = self._sensor_planes()
        return self._interpolate_planes(behind, planes, planes.weights, pad)

    def sensor_slope(self, behind: Field, *, pad: int = 1) -> Field:
        """Compute the derivative of `to_sensor` by the distance of the sensor, per metre.

        Parameters are those of `to_sensor`. With a tilt, every pixel has its own distance.
        """
        planes = self._sensor_planes()
        return self._interpolate_planes(behind, planes, planes.slopes, pad)

    def from_sensor(self, field: Field, *, pad: int = 1) -> Field:
        """Apply the transpose of `to_sensor`."""
        if not any(self.aberrations.sensor_tilt):
            return self.propagator(self.sensor_distance, "as", pad)(field)
        planes, total = self._sensor_planes(), None
        for z, weight in zip(planes.distances, planes.weights, strict=True):
            back = self.propagator(z, "as", pad)(multiply(field, weight))
            total = self._accumulate(total, back)
        assert total is not None
        return total

    def _sensor_planes(self) -> SensorPlanes:
        """Return the planes between which fields on a tilted sensor are interpolated."""
        tilt, device = self.aberrations.sensor_tilt, self.device
        key = (self.grid, self.sensor_distance, tilt, self.wavelength)
        planes: SensorPlanes | None = device.plans.get(("sensor planes", *key))
        if planes is None:
            planes = sensor_planes(*key, device)
            planes = device.plans.keep(("sensor planes", *key), planes, planes.nbytes)
        return planes

    def _interpolate_planes(
        self, behind: Field, planes: SensorPlanes, weights: tuple[cla.Array, ...], pad: int
    ) -> Field:
        total = None
        for z, weight in zip(planes.distances, weights, strict=True):
            plane = multiply(self.propagator(z, "as", pad)(behind), weight)
            total = self._accumulate(total, plane)
        assert total is not None
        return total

    def _accumulate(self, total: Field | None, term: Field) -> Field:
        if total is None:
            return term
        add(total.data, term.data, self.device)
        return total

    def padding(self, positions: Values) -> tuple[int, int]:
        """Return the padding factors to the array and to the sensor: 1 if the window holds all.

        A ray to the array moves sideways by up to abs(X) + abs(beta) D/2 and z2 times the slope of
        the main lens' wavefront. Diffraction adds a few Fresnel widths sqrt(lam z2). Behind the
        array light stays within `spread` of X (1 + z3/z2).

        Parameters
        ----------
        positions : numpy.ndarray
            (x, y, dz) in metres, shape (n, 3).

        Returns
        -------
        tuple of int
            Padding factors, 1 or 2 each.
        """
        D, z2 = self.lit_diameter, self.array_distance
        X = np.abs(self.on_array(positions))[:, ::-1]  # (y, x)
        beta = np.abs(np.atleast_1d(self.array_alpha(positions[:, 2])))[:, None]
        guard = FRESNEL_WIDTHS * math.sqrt(self.wavelength * z2)
        shift = X + np.maximum(1, beta) * D / 2 + z2 * self.main_slope() + guard
        limit = np.array(
            [
                blas_limit(n, d, z2, self.wavelength)
                for n, d in zip(self.grid.shape, self.grid.pitch, strict=True)
            ]
        )
        to_array = 1 if (shift / z2 / self.wavelength <= limit).all() else 2
        spread = np.atleast_1d(self.spread(positions[:, 2]))[:, None]
        at_sensor = X * self.sub_image_scale + spread + guard
        to_sensor = 1 if (at_sensor <= np.asarray(self.grid.extent) / 2).all() else 2
        return to_array, to_sensor

    def propagator(self, z: float, method: str, pad: int) -> Propagator:
        """Return the propagator of a distance on the camera's grid, padded by at least ``pad``."""
        return plan(
            self.grid,
            z,
            wavelength=self.wavelength,
            method=method,
            pad=_pad_factor(self.grid.shape, pad),
            device=self.device,
        )

    def check_positions(self, positions: Values) -> None:
        """Raise for points that the camera cannot image, as `Plenoptic.expose`."""
        check_in_view(self, positions)
        images = self.on_array(positions)
        beta = np.abs(np.atleast_1d(self.array_alpha(positions[:, 2])))
        for reach, b in zip(np.abs(images).max(axis=1), beta, strict=True):
            check_sampling(self, float(reach), max(1.0, float(b)))

    def samples(self, positions: Values) -> bool:
        """Return True if pixels sample the light of points, and the window holds the aperture."""
        images = np.abs(self.on_array(positions)).max(axis=1)
        beta = np.abs(np.atleast_1d(self.array_alpha(positions[:, 2])))
        return all(
            is_sampled(self, float(reach), max(1.0, float(b)))
            for reach, b in zip(images, beta, strict=True)
        )

    def behind_main_lens(self, pupil: Field, images: Values | None = None) -> Field:
        """Apply the wavefront and the vignetting of the main lens to fields.

        ``images`` (y, x), shape (n, 2), are required if the wavefront changes over the field.
        """
        if not self.aberrations.bends_main_lens:
            return pupil
        bent = self._apply_wavefront(pupil, images)
        return self._apply_vignetting(bent, images) if self.aberrations.vignettes else bent

    def main_lens_path(
        self, image_y: float, image_x: float, v: Any, u: Any
    ) -> tuple[Values, Values]:
        """Compute path and transmission of the main lens for the light of one point.

        Zernike terms and OPD maps are added. The path is relative to the sphere about the image
        without distortion. Distortion is the difference from the sphere about the chief ray's
        position, almost a tilt.

        Parameters
        ----------
        image_y, image_x : float
            Image position without distortion on the main lens' image plane, in metres.
        v, u : array_like
            Positions along y and x on the aperture, as fractions of its radius. Light passes beyond
            1 if OPD maps shift the pupil, up to ``aberrations.pupil_reach``.

        Returns
        -------
        tuple of numpy.ndarray
            W in metres, constant beyond the rim except for Zernike terms, which continue; and the
            transmitted fraction of the energy, 0 beyond the pupil. Both are float64, of the
            broadcast shape of ``v`` and ``u``.

        Raises
        ------
        ValueError
            If OPD maps do not include the image position or the camera's wavelength.
        """
        v, u = np.broadcast_arrays(np.asarray(v, np.float64), np.asarray(u, np.float64))
        rho, theta = np.hypot(v, u), np.arctan2(v, u)
        path = np.zeros(v.shape)
        for (n, m), metres in self.aberrations.main_terms(image_y, image_x).items():
            path += metres * zernike(n, m, rho, theta)
        maps, arguments = self.aberrations.main_lens_opd, (image_y, image_x, self.wavelength)
        if maps is None:
            return path, (rho <= 1).astype(np.float64)
        path += self._map_path(image_y, image_x, v, u)
        down, right = maps.pupil_centre(*arguments)
        inside = np.hypot(v - down, u - right) <= 1 + 1e-12
        return path, maps.transmission(*arguments, v - down, u - right) * inside

    def _map_path(self, y: float, x: float, v: Values, u: Values) -> Values:
        """Compute W of the OPD maps for an image at (y, x), in metres.

        Distortion is the sphere about the undistorted image minus that about the chief ray's.
        """
        maps, arguments = self.aberrations.main_lens_opd, (y, x, self.wavelength)
        assert maps is not None
        down, right = maps.pupil_centre(*arguments)
        path = maps.path(*arguments, v - down, u - right)
        Y, X = maps.chief_ray(*arguments)
        if (y, x) == (Y, X):
            return path
        v, u = v * (self.aperture_diameter / 2), u * (self.aperture_diameter / 2)
        first, moved = (
            np.sqrt((v - a) ** 2 + (u - b) ** 2 + self.image_distance**2)
            for a, b in ((y, x), (Y, X))
        )
        nearer = (Y - y) * (2 * v - y - Y) + (X - x) * (2 * u - x - X)
        return np.asarray(path + nearer / (first + moved))  # first - moved, without rounding

    def _apply_wavefront(self, pupil: Field, images: Values | None) -> Field:
        """Apply the wavefront of the main lens to fields in its pupil."""
        if not self.aberrations.varies:
            return self._multiply_plates(
                pupil, None, "wavefront", lambda y, x: self._wavefront_plate(pupil, y, x)
            )
        if self.aberrations.main_lens_opd is not None:
            return self._multiply_plates(
                pupil, images, "wavefront", lambda y, x: self._wavefront_plate(pupil, y, x)
            )
        middle, down, right = self.field_turns(pupil)
        dtype = pupil.device.complex
        return self._multiply_plates(
            pupil, images, "", lambda y, x: phasor(middle + y * down + x * right, dtype)
        )

    def field_turns(self, pupil: Field) -> tuple[Values, Values, Values]:
        """Return the axial wavefront by Zernike terms in turns, and its change with the image.

        The changes are per metre of the image along y, and along x.
        """
        middle = self._turns(pupil, 0.0, 0.0)
        down, right = (self._turns(pupil, *image) - middle for image in ((1.0, 0.0), (0.0, 1.0)))
        return middle, down, right

    def _apply_vignetting(self, pupil: Field, images: Values | None) -> Field:
        """Multiply fields behind the main lens by the transmission of OPD maps."""
        varies = images if self.aberrations.varies else None
        return self._multiply_plates(
            pupil, varies, "vignetting", lambda y, x: self._transmission_plate(pupil, y, x)
        )

    def _multiply_plates(
        self,
        pupil: Field,
        images: Values | None,
        name: str,
        plate: Callable[[float, float], Values],
    ) -> Field:
        """Multiply fields by plates for their images; without images by one cached plate."""
        device = pupil.device
        if images is None:
            key = (
                *("main lens", name, self.aberrations, self.aperture_diameter),
                *(self.image_distance, pupil.grid, pupil.wavelength),
            )
            shared_plate = device.plans.get(key)
            if shared_plate is None:
                shared_plate = device.upload(plate(0.0, 0.0))
                shared_plate = device.plans.keep(key, shared_plate, int(shared_plate.nbytes))
            return multiply(pupil, shared_plate)
        plates = [plate(float(y), float(x)) for y, x in images]
        (ny, nx), count = pupil.grid.shape, len(images)
        tall = Grid((count * ny, nx), pupil.grid.pitch)  # all fields below each other
        stack = Field(pupil.data.reshape(tall.shape), tall, pupil.wavelength, device)
        bent = multiply(stack, device.upload(np.concatenate(plates)))
        return pupil.with_data(bent.data.reshape(pupil.shape))

    def rim_loss(self, pitch: float) -> float:
        """Return the energy fraction that samples of an evenly lit aperture lack at its rim.

        Rim samples have the fraction of their cells that the aperture covers. Light that the rim
        scatters beyond the samples' band does not count to the power of a point. With this fraction
        a window of other samples agrees with a window of the sensor's samples.
        """
        across = self.aperture_diameter / pitch
        if pitch != self.pixel_pitch or across > MAX_RIM_SAMPLES:
            return MEAN_RIM_LOSS / across
        key = ("rim loss", self.grid, self.aperture_diameter)
        loss: float | None = self.device.plans.get(key)
        return self.device.plans.keep(key, self._rim_loss(), 8) if loss is None else loss

    def _rim_loss(self) -> float:
        area = math.pi / 4 * (self.aperture_diameter / self.pixel_pitch) ** 2
        across = 2 * math.ceil(self.aperture_diameter / 2 / self.pixel_pitch) + 5
        sampled = pupil_fields(
            np.zeros((1, 3)),
            grid=Grid((across, across), self.grid.pitch, origin=_nearest_sample(self.grid)),
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.aperture_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )
        return 1 - float(row_powers(sampled).sum()) / area

    def array_transmission(
        self, grid: Grid, *, rim: tuple[float, float] | None = None
    ) -> cla.Array:
        """Compute the transmission of the array with its lenslets' errors, on any grid.

        ``rim`` has the meaning of `MicrolensArray.transmission`.
        """
        ideal = self.mla.transmission(grid, self.wavelength, self.device, rim=rim)
        if not self.aberrations.bends_lenslets:
            return ideal
        return self.behind_lenslets(Field(ideal, grid, self.wavelength, self.device)).data

    def _wavefront_plate(self, pupil: Field, y: float, x: float) -> Values:
        """Compute exp(2 pi i W/lam) for an image at (y, x), 0 beyond a shifted pupil."""
        turns, dtype = self._turns(pupil, y, x), pupil.device.complex
        maps = self.aberrations.main_lens_opd
        if maps is None or not maps.largest_shift:
            return phasor(turns, dtype)
        radius = self.aperture_diameter / 2
        down, right = maps.pupil_centre(y, x, self.wavelength)
        covered = disc_coverage(pupil.grid, radius, (down * radius, right * radius))
        return (covered * phasor(turns)).astype(dtype)

    def _transmission_plate(self, pupil: Field, y: float, x: float) -> Values:
        """Compute the amplitude transmission of the main lens for an image at (y, x)."""
        maps, arguments = self.aberrations.main_lens_opd, (y, x, self.wavelength)
        assert maps is not None
        rows, columns, v, u = self._cells(pupil)
        down, right = maps.pupil_centre(*arguments)
        amplitude = np.zeros(pupil.grid.shape)
        cell = max(pupil.grid.pitch) / (self.aperture_diameter / 2)
        share, covered = maps.share_and_cover(*arguments, v - down, u - right, cell)
        amplitude[rows, columns] = np.sqrt(share) * covered
        return amplitude.astype(pupil.device.complex)

    def _cells(self, pupil: Field) -> tuple[Any, Any, Any, Any]:
        """Return samples that light may touch: rows, columns, positions v, u on the aperture."""
        y, x = offsets(pupil.grid)
        reach, radius = self.lit_diameter / 2, self.aperture_diameter / 2
        near = [
            np.maximum(np.abs(c) - (pitch / 2 if c.size > 1 else 0), 0)
            for c, pitch in zip((y, x), pupil.grid.pitch, strict=True)
        ]
        rows, columns = np.nonzero(near[0][:, None] ** 2 + near[1] ** 2 < reach**2)
        return rows, columns, y[rows] / radius, x[columns] / radius

    def behind_lenslets(self, field: Field) -> Field:
        """Apply the lenslets' departures from thin lenses to fields behind the array."""
        aberrations, mla, device = self.aberrations, self.mla, field.device
        if not aberrations.bends_lenslets:
            return field
        where = (mla, field.grid, field.wavelength)
        key = ("lenslet errors", aberrations, *where)
        phase = device.plans.get(key)
        if phase is None:
            phase = aberrations.lenslet_errors(mla).phase(*where, device)
            phase = device.plans.keep(key, phase, int(phase.nbytes))
        return multiply(field, phase)

    def _turns(self, pupil: Field, y: float, x: float) -> Values:
        """Compute W/lam of the main lens for an image at (y, x) in metres, shape of the grid."""
        terms = self.aberrations.main_terms(y, x)
        path, _ = wavefront(pupil.grid, terms, diameter=self.aperture_diameter)
        if self.aberrations.main_lens_opd is not None:
            rows, columns, v, u = self._cells(pupil)
            path[rows, columns] += self._map_path(y, x, v, u)
        return path / pupil.wavelength


def padded_shape(shape: tuple[int, int], pad: int) -> tuple[int, int]:
    """Return the shape that `WaveOptics.propagator` pads to."""
    if pad == 1:
        return shape
    factor = _pad_factor(shape, pad)
    return (round(factor * shape[0]), round(factor * shape[1]))


def _pad_factor(shape: tuple[int, int], pad: int) -> float:
    """Return ``pad``, or a little more for a fast transform."""
    longest = max(shape)
    return 1 if pad == 1 else smooth_length(pad * longest) / longest


def _nearest_sample(grid: Grid) -> tuple[float, float]:
    """Return the point (y, x) of a grid's lattice nearest to the axis, in metres."""
    y, x = (
        centre - round(centre / pitch) * pitch
        for centre, pitch in zip(grid.origin, grid.pitch, strict=True)
    )
    return y, x


def aperture_grid(grid: Grid, diameter: float) -> Grid:
    """Return the samples of a grid whose cells a circular aperture about the axis touches."""
    shape = []
    for n, pitch, centre in zip(grid.shape, grid.pitch, grid.origin, strict=True):
        half = math.ceil((diameter / 2 + abs(centre)) / pitch + 0.5)
        shape.append(min(n, 2 * half + 1))
    return replace(grid, shape=(shape[0], shape[1]))


def propagate_part(plan: Propagator, field: Field) -> Field:
    """Propagate a field on a part of a plan's grid, padded with zeros."""
    if field.grid == plan.grid:
        return plan(field)
    fits = all(n <= m for n, m in zip(field.grid.shape, plan.grid.shape, strict=True))
    if not fits or replace(field.grid, shape=plan.grid.shape) != plan.grid:
        raise ShapeError(
            f"The field must be on a part of the plan's grid, {plan.grid}, got {field.grid}."
        )
    shape = (*field.shape[:-2], *plan.grid.shape)
    padded = window(field.data, shape, field.device)
    return plan(Field(padded, plan.grid, field.wavelength, field.device))
