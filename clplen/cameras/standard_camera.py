"""The standard plenoptic camera (1.0): the array lies on the main lens' image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.optics import camera_aberrations, exposure_rows
from clplen.cameras.optics.lenslet_camera import Description, Kind, Row, views
from clplen.cameras.optics.ray_optics import view_step


@dataclass(frozen=True, repr=False)
class Plenoptic1(Plenoptic):
    """A plenoptic 1.0 camera. Made by `PlenopticCamera.type1`.

    The array lies at F, the sensor f_mu behind it.

    Attributes
    ----------
    kind : str
        "standard".
    focal_length, object_distance, image_distance, aperture_diameter : float
        Main lens: f, lens to focused object plane, F (lens to array), D; in metres.
    mla : MicrolensArray
        The lenslets: pitch, focal lengths, count, lattice, fill, offset and rotation.
    wavelength : float
        In metres.
    pixels_per_lenslet : float
        Lenslet pitch over pixel pitch; may be fractional.
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor, and of every plane of the simulation.
    field_lens : bool
        Whether a lens of focal length F lies at the array (exit pupil at infinity).
    device : Device
        Where the simulation runs.
    aberrations : Aberrations
        What departs from this design; `with_aberrations` sets it.
    lens_model : {"thin", "corrected"}
        The main lens: a quadratic phase, or a lens that images every point without aberrations and
        obeys the sine condition.
    pixels : PixelArray or None
        None: each pixel takes the intensity in its middle.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=30, aperture_diameter=0.5e-3)
    >>> f"F = {camera.array_distance:.3f} m, f_mu = {camera.sensor_distance:.3f} m"
    'F = 0.240 m, f_mu = 0.010 m'
    >>> raw = camera.expose(clplen.PointSources((0, 0, 0)))
    >>> raw.shape, raw.camera is camera
    ((150, 150), True)
    """

    kind: ClassVar[Kind] = "standard"

    @property
    def array_distance(self) -> float:
        """z2 = F in metres, from the main lens to the array."""
        return self.image_distance

    @property
    def sensor_distance(self) -> float:
        """z3 = f_mu in metres, from the array to the sensor, and what this is moved by."""
        return self.mla.focal_length + self.aberrations.sensor_shift

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        p, f_mu, lam = self.mla.pitch, self.mla.focal_length, self.wavelength
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
            Row(
                "angle a pixel", self.pixel_pitch / self.sensor_distance, "rad", "angular sampling"
            ),
            Row("aperture a pixel", view_step(self), "m", "du on the main lens"),
            Row("views", views(self), "", "across, one a pixel of a lenslet"),
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
            *exposure_rows.rows(self.optics),
            *camera_aberrations.rows(self.aberrations, lam),
        )
        return Description("Plenoptic 1.0 camera", rows)
