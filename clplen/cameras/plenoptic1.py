"""The standard plenoptic camera (1.0): the array lies on the main lens' image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clplen.cameras import geometry
from clplen.cameras.describe import Description, Row
from clplen.cameras.emission import Method
from clplen.cameras.exposing import expose_scene
from clplen.cameras.part import aperture_grid, from_part
from clplen.cameras.pictures import PicturePlane
from clplen.cameras.pupil import pupil_fields
from clplen.cameras.rays import expose_rays, is_rays
from clplen.cameras.scene import PointSources
from clplen.cameras.surfaces import SurfaceScene
from clplen.compute.device import Device
from clplen.compute.lines import smooth_length
from clplen.files import PathLike
from clplen.lightfield.raw import RawImage
from clplen.lightfield.sensor import Sensor
from clplen.wave.average import Averaging, Progress
from clplen.wave.band import blas_limit
from clplen.wave.coherence import Coherence
from clplen.wave.elements import thin_lens
from clplen.wave.field import Field, Grid, row_powers
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.propagation import Propagator, plan
from clplen.wave.statistics import Region

Scene = SurfaceScene | PointSources | PicturePlane | Sequence[PointSources | PicturePlane]
FRESNEL_WIDTHS = 2  # diffraction beyond the geometric edge that a window without padding holds


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

    @property
    def lenslet_fill(self) -> str:
        """Aperture of a lenslet: "circular", a disc, or "full", the cell of the lattice."""
        return self.mla.fill

    @property
    def lenslet_lattice(self) -> str:
        """Lattice of the lenslets, "square" or "hexagonal"."""
        return self.mla.lattice

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
        scene: Scene,
        *,
        model: Literal["waves", "rays"] = "waves",
        coherence: Coherence | None = None,
        sensor: Sensor | None = None,
        progress: Progress | None = None,
        method: Method = "auto",
        koehler: bool = True,
        snapshots: int | None = None,
        rtol: float | None = None,
        region: Region | None = None,
        checkpoint: PathLike | None = None,
    ) -> RawImage:
        """Take a raw image: intensities of all points and pictures added.

        Parameters
        ----------
        scene : PointSources, PicturePlane, list of them, or SurfaceScene
            The members of a list add up without occlusion. A `SurfaceScene` has occlusion and needs
            ``model="rays"``: Y and X count lenslets from the middle of the array, d is the
            disparity of the decoded light field, and 1 is the raw image of white.
        model : {"waves", "rays"}
            Wave optics, or geometrical rays: no diffraction, and of what follows only ``sensor``.
        coherence : Coherence, optional
            Its spectrum holds for everything, its spatial model for slides
            (``mode="transmission"``), which need it. Points and self-luminous pictures are
            incoherent from point to point.
        sensor : Sensor, optional
            Photons, noise, bits; None keeps units of energy.
        progress : callable, optional
            Called as ``progress(done, total)`` after each batch of fields and each snapshot, from 0
            again for each part of the scene.
        method : {"auto", "points", "isoplanatic"}
            Route of self-luminous pictures: one field for each sample, or patterns at a few places
            of X under one lenslet, moved and added (the array's rows along x); "auto" takes the
            first where it is affordable.
        koehler : bool
            Whether the light behind a slide converges on the main lens (Goodman 2005, section
            5.3.2), so that all of the slide is seen; else it goes on parallel to the axis.
        snapshots, rtol, region, checkpoint
            Of slides, as in `Coherence.average`; the region is one of the sensor.

        Returns
        -------
        RawImage
            float32, shape of ``grid``; n sources of power 1 add up to n (1 - 1e-3 .. 1). A clear
            sample of a slide sends the energy 1 towards the lens. ``exposure`` says how the image
            was found and how exact it is; by rays ``truth`` holds that of a `SurfaceScene`.

        Raises
        ------
        SamplingError
            If light reaches the sensor at angles that the pixels do not sample, a point is imaged
            beyond the array, or the grid does not carry the light on a slide.
        ValueError
            If a point lies behind the lens, a slide has no light, a spatial model nothing to light,
            or ``model`` or ``method`` do not fit the scene or the camera.
        FormatError
            If the checkpoint is damaged or of another set-up.
        DeviceError
            If the fields do not fit the device.
        """
        how = Averaging(snapshots, rtol, region, checkpoint)
        if is_rays(model, scene, coherence, how):
            traced = expose_rays(self, scene)
            return traced if sensor is None else sensor.record(traced)
        total, exposure = expose_scene(
            self,
            scene,
            coherence=coherence,
            koehler=koehler,
            method=method,
            how=how,
            progress=progress,
        )
        data = total if total.dtype == np.float32 else total.astype(np.float32)
        raw = replace(geometry.raw_image(self, data), exposure=exposure)
        return raw if sensor is None else sensor.record(raw)

    def pupil(
        self, scene: PointSources, chosen: slice = slice(None), *, whole: bool = True
    ) -> Field:
        """Fields of sources right behind the main lens.

        Parameters
        ----------
        scene : PointSources
        chosen : slice
            Which of them.
        whole : bool
            On the whole grid, or only on those of its samples that the aperture touches.

        Returns
        -------
        Field
            Shape (n, ny, nx); not normalised.
        """
        return pupil_fields(
            scene,
            chosen,
            grid=self.grid if whole else aperture_grid(self.grid, self.aperture_diameter),
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.aperture_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )

    def array_field(self, pupil: Field, *, pad: int = 1) -> Field:
        """Fields behind the main lens propagated to the array, before its lenslets.

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
        return from_part(self.propagator(self.image_distance, "blas", pad), pupil)

    def sensor_field(self, at_array: Field, *, pad: int = 1) -> Field:
        """Fields at the array sent through it and on to the sensor.

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
        if self.field_lens:
            at_array = thin_lens(at_array, self.image_distance)
        return self.propagator(self.mla.f, "as", pad)(self.mla.apply(at_array))

    def padding(self, scene: PointSources) -> tuple[int, int]:
        """Padding of the ways to the array and to the sensor: 1 where no light leaves the window.

        A ray from u on the lens meets the array at X + u (1 - alpha), so it moves sideways by up
        to abs(X) + abs(alpha) D/2; diffraction adds a few Fresnel widths sqrt(lam F). Behind the
        array chief rays go on to X (1 + f_mu/F).

        Returns
        -------
        tuple of int
            1 or 2 each.
        """
        D, F, f_mu = self.aperture_diameter, self.image_distance, self.mla.f
        X = np.abs(self.image_of(scene.positions))[:, ::-1]  # (y, x)
        alpha = np.abs(np.atleast_1d(self.alpha(scene.positions[:, 2])))[:, None]
        guard = FRESNEL_WIDTHS * math.sqrt(self.wavelength * F)
        moved = X + np.maximum(1, alpha) * D / 2 + guard
        limit = np.array(
            [
                blas_limit(n, d, F, self.wavelength)
                for n, d in zip(self.grid.shape, self.grid.pitch, strict=True)
            ]
        )
        to_array = 1 if (moved / F / self.wavelength <= limit).all() else 2
        at_sensor = X * (1 + f_mu / F) + np.abs(1 - alpha) * D / 2 + guard + self.mla.pitch
        to_sensor = 1 if (at_sensor <= np.asarray(self.grid.extent) / 2).all() else 2
        return to_array, to_sensor

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        p, f_mu, lam = self.mla.pitch, self.mla.f, self.wavelength
        D, F = self.aperture_diameter, self.image_distance
        ny, nx = self.grid.shape
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
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
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

    def propagator(self, z: float, method: str, pad: int) -> Propagator:
        """The plan of a distance on the camera's grid, ``pad`` times as wide or a little more."""
        longest = max(self.grid.shape)
        smooth = 1 if pad == 1 else smooth_length(pad * longest) / longest  # a quick transform
        return plan(
            self.grid, z, wavelength=self.wavelength, method=method, pad=smooth, device=self.device
        )

    def check_scene(self, scene: PointSources) -> None:
        """Refuse sources that this camera cannot show; see `expose`."""
        geometry.check_place(self, scene)
        images = self.image_of(scene.positions)
        alpha = np.abs(np.atleast_1d(self.alpha(scene.positions[:, 2])))
        for reach, a in zip(np.abs(images).max(axis=1), alpha, strict=True):
            geometry.check_sampling(self, float(reach), max(1.0, float(a)))


def scene_energy(camera: Plenoptic1, scene: PointSources) -> Sequence[tuple[float, float, float]]:
    """Energy of each source at the aperture, the array and the sensor, as fractions of the first.

    Parameters
    ----------
    camera : Plenoptic1
    scene : PointSources

    Returns
    -------
    list of tuple of float
        (1.0, at the array, at the sensor) for each source.
    """
    rows = []
    to_array, to_sensor = camera.padding(scene)
    for n in range(len(scene)):
        pupil = camera.pupil(scene, slice(n, n + 1), whole=False)
        at_array = camera.array_field(pupil, pad=to_array)
        at_sensor = camera.sensor_field(at_array, pad=to_sensor)
        energies = [float(row_powers(f).sum()) for f in (pupil, at_array, at_sensor)]
        rows.append((1.0, energies[1] / energies[0], energies[2] / energies[0]))
    return rows
