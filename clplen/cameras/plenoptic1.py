"""The standard plenoptic camera (1.0): the array lies on the main lens' image."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras import geometry
from clplen.cameras.describe import Description, Row
from clplen.cameras.pupil import pupil_fields
from clplen.cameras.scene import PointSources
from clplen.compute.device import Device
from clplen.errors import SamplingError
from clplen.lightfield.raw import RawImage
from clplen.lightfield.sensor import Sensor
from clplen.wave.elements import thin_lens
from clplen.wave.field import Field, Grid, row_powers
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.propagation import plan
from clplen.wave.transfer import blas_band

Progress = Callable[[int, int], None]
BATCH_BYTES = 2**28  # of fields that travel through the camera together


@dataclass(frozen=True)
class Plenoptic1:
    """A plenoptic 1.0 camera. Made by `PlenopticCamera.type1`.

    Attributes
    ----------
    focal_length, object_distance, image_distance, aperture_diameter : float
        Main lens: f, lens to focused object plane, F (lens to array), D; in metres.
    mla : MicrolensArray
    wavelength : float
        In metres.
    pixels_per_lenslet : float
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor, and of every plane of the simulation.
    field_lens : bool
        Whether a lens of focal length F lies at the array (exit pupil at infinity).
    device : Device
    """

    focal_length: float
    object_distance: float
    image_distance: float
    aperture_diameter: float
    mla: MicrolensArray
    wavelength: float
    pixels_per_lenslet: float
    pixel_pitch: float
    grid: Grid
    field_lens: bool
    device: Device

    @property
    def lenslet_pitch(self) -> float:
        """p in metres."""
        return self.mla.pitch

    @property
    def lenslet_diameter(self) -> float:
        """d in metres."""
        return self.mla.diameter

    @property
    def lenslet_focal_length(self) -> float:
        """f_mu in metres, also the distance from array to sensor."""
        return self.mla.f

    def alpha(self, dz: Any) -> Any:
        """alpha = F/F' = F (1/f - 1/(object distance + dz)) of an object at dz.

        Parameters
        ----------
        dz : float or array_like
            In metres, > 0 farther from the lens than the focused plane.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            If the object does not lie in front of the lens.
        """
        z = self.object_distance + np.asarray(dz, np.float64)
        if not (z > 0).all():
            raise ValueError(
                f"dz = {dz!r} m lies behind the lens, {self.object_distance:g} m from the plane."
            )
        alpha = self.image_distance * (1 / self.focal_length - 1 / z)
        return float(alpha) if alpha.ndim == 0 else alpha

    def dz(self, alpha: Any) -> Any:
        """The inverse of `alpha`, in metres; infinite at F/f, NaN beyond."""
        rest = 1 / self.focal_length - np.asarray(alpha, np.float64) / self.image_distance
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(rest >= 0, 1 / np.maximum(rest, 0), np.nan) - self.object_distance
        return float(z) if z.ndim == 0 else z

    def image_of(self, positions: Any) -> np.ndarray[Any, Any]:
        """Where points are imaged on the array, (x, y) = -(x, y) F/(object distance + dz).

        Parameters
        ----------
        positions : array_like
            (x, y, dz) in metres, shape (n, 3).

        Returns
        -------
        numpy.ndarray
            Shape (n, 2), metres.
        """
        places = np.atleast_2d(np.asarray(positions, np.float64))
        scale = -self.image_distance / (self.object_distance + places[:, 2])
        return places[:, :2] * scale[:, None]

    def expose(
        self,
        scene: PointSources,
        *,
        coherence: None = None,
        sensor: Sensor | None = None,
        progress: Progress | None = None,
    ) -> RawImage:
        """Take a raw image by wave optics: one field per source, intensities added.

        Parameters
        ----------
        scene : PointSources
        coherence : None
            Point sources are mutually incoherent; no other model applies to them.
        sensor : Sensor, optional
            Photons, noise, bits; None keeps units of energy.
        progress : callable, optional
            Called as ``progress(done, total)`` after each batch of sources.

        Returns
        -------
        RawImage
            float32, shape of ``grid``; n sources of power 1 add up to n (1 - 1e-3 .. 1).

        Raises
        ------
        SamplingError
            If light reaches the sensor at angles that the pixels do not sample, or a point is
            imaged beyond the array.
        ValueError
            If a point lies behind the lens, or a coherence model is given.
        DeviceError
            If the fields do not fit the device.
        """
        if coherence is not None:
            raise ValueError("Point sources are mutually incoherent: leave out coherence.")
        self._check(scene)
        total = self.device.zeros(self.grid.shape, self.device.real)
        pad = self.padding(scene)
        field_bytes = math.prod(self.grid.shape) * self.device.complex.itemsize
        step = max(1, int(BATCH_BYTES / (field_bytes * pad**2)))
        self.device.require_memory(
            int((2 * pad**2 + 2) * field_bytes * min(step, len(scene))), "This exposure"
        )
        for start in range(0, len(scene), step):
            chosen = slice(start, min(start + step, len(scene)))
            pupil = self.pupil(scene, chosen)
            energy = row_powers(pupil).sum(axis=-1)
            self._add(
                total,
                self.sensor_field(self.array_field(pupil, pad=pad)),
                scene.power[chosen] / energy,
            )
            if progress is not None:
                progress(chosen.stop, len(scene))
        self.device.finish()
        data = total if total.dtype == np.float32 else total.astype(np.float32)
        raw = geometry.raw_image(self, data)
        return raw if sensor is None else sensor.record(raw)

    def pupil(self, scene: PointSources, chosen: slice = slice(None)) -> Field:
        """Fields of the sources right behind the main lens, shape (n, ny, nx)."""
        return pupil_fields(
            scene,
            chosen,
            grid=self.grid,
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.aperture_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )

    def array_field(self, pupil: Field, *, pad: int = 1) -> Field:
        """Fields behind the main lens propagated to the array, before its lenslets."""
        step = plan(
            self.grid,
            self.image_distance,
            wavelength=self.wavelength,
            method="blas",
            pad=pad,
            device=self.device,
        )
        return step(pupil)

    def sensor_field(self, at_array: Field) -> Field:
        """Fields at the array sent through it and on to the sensor."""
        if self.field_lens:
            at_array = thin_lens(at_array, self.image_distance)
        step = plan(
            self.grid,
            self.mla.f,
            wavelength=self.wavelength,
            method="as",
            pad=1,
            device=self.device,
        )
        return step(self.mla.apply(at_array))

    def padding(self, scene: PointSources) -> int:
        """1 where the window samples every ray from the pupil to the images, else 2."""
        half = self.aperture_diameter / 2
        reach = half + np.abs(self.image_of(scene.positions)).max(axis=0)[::-1]
        needed = reach / self.image_distance / self.wavelength
        band = blas_band(self.grid.shape, self.grid.pitch, self.image_distance, self.wavelength)
        return 1 if (needed <= np.asarray(band)).all() else 2

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        p, f_mu, lam = self.mla.pitch, self.mla.f, self.wavelength
        D, F = self.aperture_diameter, self.image_distance
        limit = math.sqrt(2.44 * lam * f_mu)
        met = "met" if self.mla.diameter > limit else "not met"
        rows = (
            Row("focal length", self.focal_length, "m", "main lens"),
            Row("object distance", self.object_distance, "m", "focused plane to main lens"),
            Row("image distance", F, "m", "F, main lens to array"),
            Row("aperture", D, "m", "D, main lens"),
            Row("f-number", self.focal_length / D, "", "f/D"),
            Row("working f-number", F / D, "", f"F/D; a lenslet has {f_mu / p:.6g}"),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", p, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            Row("lenslet focal length", f_mu, "m", "f_mu, array to sensor"),
            Row(
                "pixel pitch",
                self.pixel_pitch,
                "m",
                f"sensor {self.grid.shape[0]} x {self.grid.shape[1]}",
            ),
            Row("angle a pixel", self.pixel_pitch / f_mu, "rad", "angular sampling"),
            Row("aperture a pixel", self.pixel_pitch * F / f_mu, "m", "du on the main lens"),
            Row("views", geometry.views(self), "", "across, one a pixel of a lenslet"),
            Row(
                "independent views",
                self.mla.diameter**2 / (lam * f_mu),
                "",
                "across, d^2/(lam f_mu): the sub-image is blurred by diffraction",
            ),
            Row("Airy limit", limit, "m", f"lenslet diameter > sqrt(2.44 lam f_mu): {met}"),
            Row("focus tolerance", p / D, "", "|1 - alpha| below p/D blurs less than a lenslet"),
            Row(
                "disparity",
                F / (f_mu * self.pixels_per_lenslet),
                "",
                "pixels a view step for 1 - alpha = 1",
            ),
        )
        return Description("Plenoptic 1.0 camera", rows)

    def _check(self, scene: PointSources) -> None:
        behind = self.object_distance + scene.positions[:, 2] <= 0
        if behind.any():
            x, y, dz = scene.positions[behind][0]
            raise ValueError(
                f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m lies behind the main lens, which "
                f"is {self.object_distance:g} m from the focused plane."
            )
        images = self.image_of(scene.positions)
        outside = (np.abs(images) > np.asarray(self.grid.extent)[::-1] / 2).any(axis=1)
        if outside.any():
            (x, y, dz), (X, Y) = scene.positions[outside][0], images[outside][0]
            raise SamplingError(
                f"The point (x, y, dz) = ({x:g}, {y:g}, {dz:g}) m is imaged at ({X:g}, {Y:g}) m, "
                f"beyond the array of {self.grid.extent[1]:g} x {self.grid.extent[0]:g} m: move it "
                "or use more lenslets."
            )
        geometry.check_sampling(self, float(np.abs(images).max()))

    def _add(self, total: cla.Array, fields: Field, weights: np.ndarray[Any, Any]) -> None:
        (ny, nx), count = self.grid.shape, fields.shape[0]
        kernel = self.device.kernel("intensity.cl", "accumulate", **self.device.wave_defines())
        self.device.launch_rows(
            kernel,
            (ny, nx),
            total,
            fields.data,
            self.device.upload(weights.astype(self.device.real)),
            np.int32(count),
            np.int32(ny),
            np.int32(nx),
        )


def build(
    *,
    focal_length: float,
    mla: MicrolensArray,
    wavelength: float,
    pixels_per_lenslet: float,
    device: Device,
    object_distance: float | None = None,
    image_distance: float | None = None,
    aperture_diameter: float | None = None,
    field_lens: bool = False,
) -> Plenoptic1:
    """See `PlenopticCamera.type1`."""
    lengths = {"focal_length": focal_length, "wavelength": wavelength}
    optional = {
        "object_distance": object_distance,
        "image_distance": image_distance,
        "aperture_diameter": aperture_diameter,
    }
    lengths |= {name: value for name, value in optional.items() if value is not None}
    for name, value in lengths.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is positive, in metres, not {value!r}.")
    if mla.f <= 0:
        raise ValueError(f"The lenslets of a camera converge: f > 0, not {mla.f!r}.")
    z_obj, F = geometry.lens_law(focal_length, object_distance, image_distance)
    D = aperture_diameter or mla.pitch * F / mla.f
    grid = geometry.sensor_grid(mla, pixels_per_lenslet)
    camera = Plenoptic1(
        float(focal_length),
        z_obj,
        F,
        float(D),
        mla,
        float(wavelength),
        float(pixels_per_lenslet),
        grid.pitch[1],
        grid,
        bool(field_lens),
        device,
    )
    geometry.check_sampling(camera, 0.0)
    return camera


def scene_energy(camera: Plenoptic1, scene: PointSources) -> Sequence[tuple[float, float, float]]:
    """Energy of each source at the aperture, the array and the sensor, as fractions of the first.

    Returns
    -------
    list of tuple of float
        (1.0, at the array, at the sensor) for each source.
    """
    rows = []
    pad = camera.padding(scene)
    for n in range(len(scene)):
        pupil = camera.pupil(scene, slice(n, n + 1))
        at_array = camera.array_field(pupil, pad=pad)
        at_sensor = camera.sensor_field(at_array)
        energies = [float(row_powers(f).sum()) for f in (pupil, at_array, at_sensor)]
        rows.append((1.0, energies[1] / energies[0], energies[2] / energies[0]))
    return rows
