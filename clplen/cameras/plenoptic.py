"""Waves through a plenoptic camera: from points to the main lens, the array and the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from clplen.cameras.exposure.emission import Method
from clplen.cameras.exposure.exposing import expose_scene
from clplen.cameras.exposure.ray_exposure import expose_rays, is_rays
from clplen.cameras.optics import camera_geometry, wave_optics
from clplen.cameras.optics.camera_aberrations import Aberrations
from clplen.cameras.optics.part import aperture_grid, from_part
from clplen.cameras.optics.pupil_fields import pupil_fields
from clplen.cameras.optics.ray_optics import Optics
from clplen.cameras.scenes.scene_sources import PicturePlane, PointSources
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.compute.lines import smooth_length
from clplen.files import PathLike
from clplen.lightfield.raw import RawImage
from clplen.lightfield.sensor import Sensor
from clplen.wave.average import Averaging, Progress
from clplen.wave.band import blas_limit
from clplen.wave.coherence import Coherence
from clplen.wave.elements import thin_lens
from clplen.wave.field import Field
from clplen.wave.propagation import Propagator, plan
from clplen.wave.statistics import Region

Scene = SurfaceScene | PointSources | PicturePlane | Sequence[PointSources | PicturePlane]
Kind = TypeVar("Kind", bound="Plenoptic")
FRESNEL_WIDTHS = 2  # diffraction beyond the geometric edge that a window without padding holds


@dataclass(frozen=True, repr=False)
class Plenoptic(Optics):
    """A plenoptic camera that takes raw images: `Plenoptic1` or `Plenoptic2`.

    Attributes are those of `Optics`.
    """

    def with_aberrations(self: Kind, aberrations: Aberrations) -> Kind:
        """The same camera as it is built: with these in place of its aberrations.

        Parameters
        ----------
        aberrations : Aberrations

        Returns
        -------
        Plenoptic1 or Plenoptic2

        Raises
        ------
        ValueError
            If Zernike terms of lenslets reach beyond their circle, or the sensor would not lie
            behind the array.
        SamplingError
            If the pixels cannot sample the light on the axis.
        TypeError
            If they are something else.
        """
        if not isinstance(aberrations, Aberrations):
            raise TypeError(f"aberrations are Aberrations(...), not {type(aberrations).__name__}.")
        found = replace(self, aberrations=aberrations)
        aberrations.check_lenslets(self.mla)
        if not found.sensor_distance > 0:
            raise ValueError(
                f"sensor_shift = {aberrations.sensor_shift:g} m puts the sensor at "
                f"{found.sensor_distance:g} m, not behind the array."
            )
        camera_geometry.check_sampling(
            found, 0.0, max(1.0, self.array_distance / self.image_distance)
        )
        return found

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
        raw = replace(camera_geometry.raw_image(self, data), exposure=exposure)
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
        pupil = pupil_fields(
            scene,
            chosen,
            grid=self.grid if whole else aperture_grid(self.grid, self.aperture_diameter),
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.aperture_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )
        places = self.image_of(scene.positions[chosen])[:, ::-1]
        return wave_optics.behind_main_lens(self, pupil, places)

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
        return from_part(self.propagator(self.array_distance, "blas", pad), pupil)

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
            at_array = thin_lens(at_array, self.array_distance)
        behind = wave_optics.behind_lenslets(self, self.mla.apply(at_array))
        return self.propagator(self.sensor_distance, "as", pad)(behind)

    def padding(self, scene: PointSources) -> tuple[int, int]:
        """Padding of the ways to the array and to the sensor: 1 where no light leaves the window.

        A ray to the array moves sideways by up to abs(X) + abs(beta) D/2 and z2 times the slope of
        the main lens' wavefront; diffraction adds a few Fresnel widths sqrt(lam z2). Behind the
        array it stays within `spread` of X (1 + z3/z2).

        Returns
        -------
        tuple of int
            1 or 2 each.
        """
        D, z2 = self.aperture_diameter, self.array_distance
        X = np.abs(self.on_array(scene.positions))[:, ::-1]  # (y, x)
        beta = np.abs(np.atleast_1d(self.array_alpha(scene.positions[:, 2])))[:, None]
        guard = FRESNEL_WIDTHS * math.sqrt(self.wavelength * z2)
        moved = X + np.maximum(1, beta) * D / 2 + z2 * self.main_slope() + guard
        limit = np.array(
            [
                blas_limit(n, d, z2, self.wavelength)
                for n, d in zip(self.grid.shape, self.grid.pitch, strict=True)
            ]
        )
        to_array = 1 if (moved / z2 / self.wavelength <= limit).all() else 2
        spread = np.atleast_1d(self.spread(scene.positions[:, 2]))[:, None]
        at_sensor = X * self.sub_image_scale + spread + guard
        to_sensor = 1 if (at_sensor <= np.asarray(self.grid.extent) / 2).all() else 2
        return to_array, to_sensor

    def propagator(self, z: float, method: str, pad: int) -> Propagator:
        """The plan of a distance on the camera's grid, ``pad`` times as wide or a little more."""
        longest = max(self.grid.shape)
        smooth = 1 if pad == 1 else smooth_length(pad * longest) / longest  # a quick transform
        return plan(
            self.grid, z, wavelength=self.wavelength, method=method, pad=smooth, device=self.device
        )

    def check_scene(self, scene: PointSources) -> None:
        """Refuse sources that this camera cannot show; see `expose`."""
        camera_geometry.check_place(self, scene)
        places = self.on_array(scene.positions)
        beta = np.abs(np.atleast_1d(self.array_alpha(scene.positions[:, 2])))
        for reach, b in zip(np.abs(places).max(axis=1), beta, strict=True):
            camera_geometry.check_sampling(self, float(reach), max(1.0, float(b)))
